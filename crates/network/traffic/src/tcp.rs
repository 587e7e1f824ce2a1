//! A TCP connection with both of its ends.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{CongestionControl, Timestamp};
use cotorra_numbers::Draws;

use crate::{
    receiver::Receiver,
    segment::{Ends, Segment},
    sender::{Counts, Sender},
};

/// A connection whose sender and receiver are at two hosts.
#[derive(Debug)]
pub(crate) struct Connection {
    sender: Sender,
    receiver: Receiver,
    /// Acknowledgements to send.
    answers: VecDeque<Segment>,
}

/// What a frame brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Brought {
    /// Bytes that newly arrived in order.
    Data(u64),
    /// An acknowledgement, with the round trip that it measures.
    Acknowledgement(Option<Duration>),
    /// It is damaged, or another connection's.
    Nothing,
}

impl Connection {
    pub(crate) fn new(congestion_control: CongestionControl, bytes: Option<u64>, draws: Draws) -> Self {
        Self {
            sender: Sender::new(congestion_control, bytes, draws),
            receiver: Receiver::default(),
            answers: VecDeque::new(),
        }
    }

    /// Sends no new data any more.
    pub(crate) fn stop(&mut self) {
        self.sender.stop();
    }

    /// Returns the next segment to send now, and whether the receiver sends it.
    pub(crate) fn poll(&mut self, now: Timestamp) -> Option<(Segment, bool)> {
        let answer =
            self.answers.pop_front().or_else(|| self.receiver.poll(now)).map(|answer| (answer, true));
        answer.or_else(|| Some((self.sender.poll(now)?, false)))
    }

    pub(crate) fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        let answer = (!self.answers.is_empty()).then_some(now);
        [answer, self.receiver.deadline(), self.sender.deadline(now)].into_iter().flatten().min()
    }

    /// Takes a frame between these ends: at the receiver if it `arrives`, else at the sender.
    pub(crate) fn handle(&mut self, now: Timestamp, ends: Ends, arrives: bool, frame: &[u8]) -> Brought {
        let ends = if arrives { ends } else { ends.reversed() };
        match Segment::read(ends, frame) {
            Some(segment) if arrives => {
                let before = self.receiver.bytes();
                self.answers.extend(self.receiver.handle(now, &segment));
                Brought::Data(self.receiver.bytes() - before)
            }
            Some(segment) => Brought::Acknowledgement(self.sender.handle(now, &segment)),
            None => Brought::Nothing,
        }
    }

    /// Sends so many more bytes, if their number is bounded.
    pub(crate) fn add(&mut self, bytes: u64) {
        self.sender.add(bytes);
    }

    /// Returns the bytes that arrived in order.
    pub(crate) fn arrived(&self) -> u64 {
        self.receiver.bytes()
    }

    /// Whether so many bytes arrived in order.
    pub(crate) fn has_arrived(&self, bytes: u64) -> bool {
        self.receiver.bytes() >= bytes
    }

    /// Whether so many bytes are acknowledged.
    pub(crate) fn has_delivered(&self, bytes: u64) -> bool {
        self.sender.has_delivered(bytes)
    }

    /// Returns what the sender did.
    pub(crate) fn counts(&self) -> Counts {
        self.sender.counts()
    }

    /// Returns the smoothed round trip.
    pub(crate) fn smoothed_round_trip(&self) -> Option<Duration> {
        self.sender.round_trips().smoothed()
    }
}
