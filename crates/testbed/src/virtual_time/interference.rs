//! Faults between robots and VNFs that no link causes: late, repeated or forged answers, and silent robots.

use std::{
    collections::{BTreeMap, VecDeque},
    net::{Ipv4Addr, SocketAddrV4},
};

use cotorra_fabric::PortId;
use cotorra_graph::{NodeId, Timestamp};

/// A datagram that is sent later.
pub(super) struct Held {
    pub(super) from: (PortId, u16),
    pub(super) to: (Ipv4Addr, u16),
    pub(super) payload: Vec<u8>,
}

#[derive(Default)]
pub(super) struct Interference {
    /// In the order of their due times.
    held: VecDeque<(Timestamp, Held)>,
    silent: Vec<NodeId>,
    /// The last answer that each robot received, if answers are tapped.
    answers: Option<BTreeMap<NodeId, (SocketAddrV4, Vec<u8>)>>,
}

impl Interference {
    pub(super) fn hold(&mut self, until: Timestamp, held: Held) {
        let place = self.held.partition_point(|(at, _)| *at <= until);
        self.held.insert(place, (until, held));
    }

    /// Takes a datagram that is due.
    pub(super) fn release(&mut self, now: Timestamp) -> Option<Held> {
        self.held.pop_front_if(|(at, _)| *at <= now).map(|(_, held)| held)
    }

    pub(super) fn next_deadline(&self) -> Option<Timestamp> {
        self.held.front().map(|(at, _)| *at)
    }

    /// Sets whether a robot neither sends nor receives.
    pub(super) fn set_silent(&mut self, robot: &NodeId, silent: bool) {
        self.silent.retain(|other| other != robot);
        if silent {
            self.silent.push(robot.clone());
        }
    }

    pub(super) fn is_silent(&self, robot: &NodeId) -> bool {
        self.silent.contains(robot)
    }

    /// Records the last answers from now on.
    pub(super) fn tap_answers(&mut self) {
        self.answers.get_or_insert_default();
    }

    pub(super) fn note_answer(&mut self, robot: &NodeId, from: SocketAddrV4, payload: &[u8]) {
        if let Some(answers) = &mut self.answers {
            answers.insert(robot.clone(), (from, payload.to_vec()));
        }
    }

    pub(super) fn last_answer(&self, robot: &NodeId) -> Option<(SocketAddrV4, Vec<u8>)> {
        self.answers.as_ref()?.get(robot).cloned()
    }
}
