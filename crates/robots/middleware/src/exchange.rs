//! Requests of a service and their answers: decides which answers are accepted, and measures service times.

use std::{collections::VecDeque, net::SocketAddrV4, time::Duration};

use cotorra_graph::{LostAt, LostCause, NodeId, ServiceId, ServiceTime, Timestamp};

use crate::{answer_error::AnswerError, nonce::Nonces, request::Recipients};

/// The route of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Route {
    /// The radio unit that the robot is attached to; `None` if it is detached.
    pub attachment: Option<NodeId>,
    /// Nodes that the request goes to, and the sockets there; at least one node. A node without an address gets no copy.
    pub servers: Vec<(NodeId, Option<SocketAddrV4>)>,
}

/// A request that was emitted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Sent {
    pub sequence: u32,
    /// The first nonce.
    pub nonce: u64,
    /// Sockets that copies go to, each with its nonce.
    pub copies: Vec<(SocketAddrV4, u64)>,
}

/// Header of an answer: it repeats that of its request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reply {
    pub from: SocketAddrV4,
    pub sequence: u32,
    pub emitted: Timestamp,
    pub nonce: u64,
}

/// The requests of a robot's service, as a state machine. Each has a note of what its answer is to be used for.
///
/// Each request gives one service time: with the first accepted answer of its recipients, or without one when its timeout
/// ends, or if it could not be emitted when it was due.
#[derive(Debug, Clone)]
pub(crate) struct Exchange<N> {
    service: ServiceId,
    robot: NodeId,
    timeout: Duration,
    /// Sequence number of the next request.
    sequence: u32,
    /// Requests under way, oldest first.
    pending: VecDeque<Pending<N>>,
    /// The last requests that were answered or given up, oldest first.
    past: VecDeque<Past>,
}

#[derive(Debug, Clone)]
struct Pending<N> {
    sequence: u32,
    emitted: Timestamp,
    recipients: Recipients,
    attachment: Option<NodeId>,
    /// Nodes of the recipients.
    servers: Vec<NodeId>,
    note: N,
}

#[derive(Debug, Clone)]
struct Past {
    sequence: u32,
    recipients: Recipients,
    answered: bool,
}

impl<N> Exchange<N> {
    /// Number of past requests that are remembered, to distinguish late answers from invented ones.
    const REMEMBERED: usize = 256;

    pub fn new(service: ServiceId, robot: NodeId, timeout: Duration) -> Self {
        let (pending, past) = (VecDeque::new(), VecDeque::new());
        Self { service, robot, timeout, sequence: 0, pending, past }
    }

    pub fn robot(&self) -> &NodeId {
        &self.robot
    }

    /// Whether no request is under way.
    pub fn is_quiet(&self) -> bool {
        self.pending.is_empty()
    }

    /// Returns the time at which the oldest request is given up.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.pending.front().map(|pending| pending.emitted + self.timeout)
    }

    /// Emits a request on this route, with a nonce for each server.
    pub fn emit(&mut self, now: Timestamp, route: Route, note: N, nonces: &mut Nonces) -> Sent {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let Route { attachment, servers } = route;
        let recipients = Recipients::new(servers.iter().map(|(_, address)| *address), nonces);
        let servers = servers.into_iter().map(|(server, _)| server).collect();
        let (nonce, copies) = (recipients.nonce(), recipients.copies());
        self.pending.push_back(Pending { sequence, emitted: now, recipients, attachment, servers, note });
        Sent { sequence, nonce, copies }
    }

    /// Returns the service time of a request that was due on this route and not emitted: it has a number, and no answer.
    pub fn miss(&mut self, due: Timestamp, route: &Route) -> ServiceTime {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        ServiceTime {
            service: self.service.clone(),
            robot: self.robot.clone(),
            sequence,
            emitted: due,
            took: None,
            attachment: route.attachment.clone(),
            server: route.servers[0].0.clone(),
            parts: None,
            lost_at: Some(Box::new(LostAt { link: None, back: false, cause: LostCause::NotSent })),
        }
    }

    /// Receives an answer. Returns the service time of its request, and the note. `is_valid` says whether the answer's
    /// content fits the note.
    ///
    /// # Errors
    /// [`AnswerError`] if the answer is rejected; nothing changes then.
    pub fn receive(
        &mut self,
        now: Timestamp,
        reply: Reply,
        is_valid: impl FnOnce(&N) -> bool,
    ) -> Result<(ServiceTime, N), AnswerError> {
        let Some(place) = self.pending.iter().position(|p| p.sequence == reply.sequence) else {
            return Err(self.reject_past(reply));
        };
        let pending = &self.pending[place];
        let by =
            pending.recipients.find(reply.from, reply.nonce).filter(|_| pending.emitted == reply.emitted);
        let by = by.ok_or(AnswerError::Forged)?;
        let took = now.since(pending.emitted);
        if took >= self.timeout {
            // The request is given up at the next `expire`.
            return Err(AnswerError::Late);
        }
        if !is_valid(&pending.note) {
            return Err(AnswerError::Invalid);
        }
        let mut pending = self.pending.remove(place).expect("`position` found it there");
        pending.recipients.accept(by);
        Ok(self.measured(pending, Some((by, took))))
    }

    /// Gives up the oldest request without an answer in time; `None` if there is none.
    pub fn expire(&mut self, now: Timestamp) -> Option<ServiceTime> {
        let pending = self.pending.pop_front_if(|p| now.since(p.emitted) >= self.timeout)?;
        Some(self.measured(pending, None).0)
    }

    /// Returns the first nonce of a request that was answered or given up; `None` if it is forgotten.
    pub fn nonce_of(&self, sequence: u32) -> Option<u64> {
        let past = self.past.iter().rev().find(|past| past.sequence == sequence)?;
        Some(past.recipients.nonce())
    }

    /// Returns the reason for which an answer to a request that is not under way is rejected.
    fn reject_past(&mut self, reply: Reply) -> AnswerError {
        match self.past.iter_mut().find(|past| past.sequence == reply.sequence) {
            None => AnswerError::Unknown,
            Some(past) if !past.recipients.has_nonce(reply.nonce) => AnswerError::Forged,
            Some(past) if past.answered => past.recipients.reject_further(reply.from, reply.nonce),
            Some(_) => AnswerError::Late,
        }
    }

    /// Remembers a request, and returns its service time: with the index of the answering server and the delay, or without
    /// an answer.
    fn measured(&mut self, mut pending: Pending<N>, answer: Option<(usize, Duration)>) -> (ServiceTime, N) {
        if self.past.len() == Self::REMEMBERED {
            self.past.pop_front();
        }
        let (by, took) = answer.unzip();
        self.past.push_back(Past {
            sequence: pending.sequence,
            recipients: pending.recipients,
            answered: took.is_some(),
        });
        let service_time = ServiceTime {
            service: self.service.clone(),
            robot: self.robot.clone(),
            sequence: pending.sequence,
            emitted: pending.emitted,
            took,
            attachment: pending.attachment,
            // Without an answer, the preferred server.
            server: pending.servers.swap_remove(by.unwrap_or(0)),
            parts: None,
            lost_at: None,
        };
        (service_time, pending.note)
    }
}

#[cfg(test)]
mod tests;
