//! A TCP connection with both of its ends.

use std::collections::VecDeque;

use cotorra_graph::{CongestionControl, Timestamp};
use cotorra_numbers::{Draws, Gathered, Quantiles};

use crate::{
    measured::{TcpMeasured, gather},
    receiver::Receiver,
    segment::{Ends, Segment},
    sender::Sender,
};

/// A connection whose sender and receiver are at two hosts.
#[derive(Debug)]
pub(crate) struct Connection {
    sender: Sender,
    receiver: Receiver,
    /// Acknowledgements to send.
    answers: VecDeque<Segment>,
    round_trips: Gathered,
    /// Bytes to send in all.
    bytes: Option<u64>,
    finished: Option<Timestamp>,
}

impl Connection {
    pub(crate) fn new(congestion_control: CongestionControl, bytes: Option<u64>, draws: Draws) -> Self {
        Self {
            sender: Sender::new(congestion_control, bytes, draws),
            receiver: Receiver::default(),
            answers: VecDeque::new(),
            round_trips: Gathered::default(),
            bytes,
            finished: None,
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

    /// Takes a frame at the receiver, whose ends are `forth`, or at the sender. Returns the bytes that newly arrived in order.
    pub(crate) fn handle(&mut self, now: Timestamp, forth: Option<Ends>, back: Ends, frame: &[u8]) -> u64 {
        if let Some(segment) = forth.and_then(|ends| Segment::read(ends, frame)) {
            let before = self.receiver.bytes();
            self.answers.extend(self.receiver.handle(now, &segment));
            return self.receiver.bytes() - before;
        }
        if let Some(segment) = Segment::read(back, frame) {
            if let Some(sample) = self.sender.handle(now, &segment) {
                gather(&mut self.round_trips, sample);
            }
            if self.finished.is_none() && self.bytes.is_some_and(|bytes| self.sender.has_delivered(bytes)) {
                self.finished = Some(now);
            }
        }
        0
    }

    /// Returns the packets that were sent, what was measured, and when all bytes were acknowledged.
    pub(crate) fn measured(&self, start: Timestamp) -> (u64, TcpMeasured, Option<Timestamp>) {
        let counts = self.sender.counts();
        let measured = TcpMeasured {
            retransmitted_packets: counts.retransmitted,
            timeouts: counts.timeouts,
            smoothed_round_trip_ms: self.sender.round_trips().smoothed().map(|trip| trip.as_secs_f64() * 1e3),
            round_trip_ms: Quantiles::gathered(&self.round_trips),
            finished_after_ms: self.finished.map(|at| at.since(start).as_secs_f64() * 1e3),
        };
        (counts.sent, measured, self.finished)
    }
}
