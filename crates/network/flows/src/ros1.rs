//! Parses messages and calls of ROS 1 on TCP connections (ROS wiki, "ROS/TCPROS" and "ROS/Connection Header").

use std::time::Duration;

use crate::requests::Id;

/// Longest connection header, bytes.
const MOST_HEADER: usize = 64 << 10;
const LENGTH: usize = 4;

/// The topics or service to measure.
#[derive(Debug, Clone)]
pub(crate) enum Measured {
    /// Messages of one topic from the port, and messages of another to it.
    Topics { request: String, answer: String, id: Option<Id> },
    /// Calls of a service from the port.
    Service(String),
}

/// A request or an answer on a connection.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Message {
    /// A request, with the time and mark of its first byte.
    Request(Name, (Duration, u64)),
    Answer(Name),
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Name {
    /// Number of the call on the connection.
    Call(u64),
    /// The message's id; empty if messages have none.
    Id(Vec<u8>),
}

/// The connection is not measured.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NotMeasured;

/// The content of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Requests,
    Answers,
    Calls,
}

/// A partly received frame.
#[derive(Debug, Default)]
struct Framed {
    /// Bytes before the frame's content, with its length.
    front: Vec<u8>,
    left: usize,
    /// Beginning of the content.
    kept: Vec<u8>,
    began: Option<(Duration, u64)>,
    is_reported: bool,
}

impl Framed {
    /// Takes its part off the front of `bytes`, which must not be empty. Returns whether the frame is complete. The length
    /// stands behind `before` other bytes.
    fn take(&mut self, now: (Duration, u64), bytes: &mut &[u8], before: usize, keep: usize) -> bool {
        self.began.get_or_insert(now);
        if self.front.len() < before + LENGTH {
            let (front, rest) = bytes.split_at(bytes.len().min(before + LENGTH - self.front.len()));
            self.front.extend_from_slice(front);
            *bytes = rest;
            let Some(length) = self.front[before.min(self.front.len())..].first_chunk::<LENGTH>() else {
                return false;
            };
            self.left = u32::from_le_bytes(*length) as usize;
        }
        let (its, rest) = bytes.split_at(bytes.len().min(self.left));
        self.kept.extend_from_slice(&its[..its.len().min(keep - self.kept.len())]);
        self.left -= its.len();
        *bytes = rest;
        self.left == 0
    }
}

/// A connection with one end at the port.
#[derive(Debug)]
pub(crate) struct Conversation {
    measured: Measured,
    role: Option<Role>,
    initiator: Framed,
    responder: Framed,
    /// Whether the responder's header is complete.
    is_accepted: bool,
    /// Number of calls and of their answers so far.
    calls: [u64; 2],
}

impl Conversation {
    pub fn new(measured: Measured) -> Self {
        let (initiator, responder) = Default::default();
        Self { measured, role: None, initiator, responder, is_accepted: false, calls: [0; 2] }
    }

    /// Takes the next bytes of the end that opened the connection. `is_here` says whether that end is at the port.
    pub fn initiator(
        &mut self,
        now: (Duration, u64),
        is_here: bool,
        mut bytes: &[u8],
        report: &mut dyn FnMut(Message),
    ) -> Result<(), NotMeasured> {
        while !bytes.is_empty() {
            let is_header = self.role.is_none();
            let is_whole = self.initiator.take(now, &mut bytes, 0, if is_header { MOST_HEADER } else { 0 });
            if is_header {
                if self.initiator.kept.len() + self.initiator.left > MOST_HEADER {
                    return Err(NotMeasured);
                }
                if is_whole {
                    self.role = Some(self.role(is_here).ok_or(NotMeasured)?);
                }
            } else if self.role != Some(Role::Calls) {
                // Subscribers send nothing behind their header.
                return Err(NotMeasured);
            } else if !std::mem::replace(&mut self.initiator.is_reported, true) {
                let began = self.initiator.began.unwrap_or(now);
                report(Message::Request(Name::Call(self.calls[0]), began));
                self.calls[0] += 1;
            }
            if is_whole {
                self.initiator = Framed::default();
            }
        }
        Ok(())
    }

    /// Takes the next bytes of the end that accepted the connection.
    pub fn responder(
        &mut self,
        now: (Duration, u64),
        mut bytes: &[u8],
        report: &mut dyn FnMut(Message),
    ) -> Result<(), NotMeasured> {
        let role = self.role.ok_or(NotMeasured)?;
        let id = match &self.measured {
            Measured::Topics { id, .. } => *id,
            Measured::Service(_) => None,
        };
        let end = id.map_or(0, |id| usize::from(id.offset) + usize::from(id.length));
        while !bytes.is_empty() {
            // An answer to a call begins with a success byte.
            let before = usize::from(self.is_accepted && role == Role::Calls);
            let is_whole = self.responder.take(now, &mut bytes, before, end);
            if self.is_accepted {
                self.message(role, is_whole, now, (id, end), report);
            }
            if is_whole {
                self.is_accepted = true;
                self.responder = Framed::default();
            }
        }
        Ok(())
    }

    fn message(
        &mut self,
        role: Role,
        is_whole: bool,
        now: (Duration, u64),
        (id, end): (Option<Id>, usize),
        report: &mut dyn FnMut(Message),
    ) {
        let framed = &mut self.responder;
        let name = || {
            let its = id.map_or(0, |id| usize::from(id.offset))..end;
            Some(Name::Id(framed.kept.get(its)?.to_vec()))
        };
        match role {
            Role::Requests if !framed.is_reported => {
                if let Some(name) = name() {
                    report(Message::Request(name, framed.began.unwrap_or(now)));
                    framed.is_reported = true;
                }
            }
            Role::Answers if is_whole => name().into_iter().for_each(|name| report(Message::Answer(name))),
            Role::Calls if is_whole => {
                report(Message::Answer(Name::Call(self.calls[1])));
                self.calls[1] += 1;
            }
            Role::Requests | Role::Answers | Role::Calls => {}
        }
    }

    /// Returns the role by the initiator's connection header; `None` if the connection is not measured.
    fn role(&self, is_here: bool) -> Option<Role> {
        let mut fields = self.initiator.kept.as_slice();
        let (mut topic, mut service) = (None, None);
        while let Some((length, rest)) = fields.split_first_chunk::<LENGTH>() {
            let field = rest.get(..u32::from_le_bytes(*length) as usize)?;
            topic = topic.or(field.strip_prefix(b"topic="));
            service = service.or(field.strip_prefix(b"service="));
            fields = &rest[field.len()..];
        }
        // Subscribers open connections to publishers, and clients to servers.
        match &self.measured {
            Measured::Topics { request, .. } if topic == Some(request.as_bytes()) && !is_here => {
                Some(Role::Requests)
            }
            Measured::Topics { answer, .. } if topic == Some(answer.as_bytes()) && is_here => {
                Some(Role::Answers)
            }
            Measured::Service(name) if service == Some(name.as_bytes()) && is_here => Some(Role::Calls),
            Measured::Topics { .. } | Measured::Service(_) => None,
        }
    }
}

#[cfg(test)]
mod tests;
