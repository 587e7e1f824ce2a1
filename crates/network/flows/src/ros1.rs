//! Messages and calls of ROS 1 on TCP connections (ROS wiki, "ROS/TCPROS" and "ROS/Connection Header").

use std::time::Duration;

use crate::requests::Id;

/// So long a connection header is at most.
const MOST_HEADER: usize = 64 << 10;
const LENGTH: usize = 4;

/// What is measured.
#[derive(Debug, Clone)]
pub(crate) enum Measured {
    /// A message of one topic from here, and one of another to here.
    Topics { request: String, answer: String, id: Option<Id> },
    /// A call of a service from here.
    Service(String),
}

/// What a request or an answer is known by.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Told {
    /// A request that began then, with its mark.
    Request(Name, (Duration, u64)),
    Answer(Name),
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Name {
    /// The call of this number on the connection.
    Call(u64),
    /// What the message has as its id; empty without.
    Message(Vec<u8>),
}

/// The connection is none of those that are measured.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Other;

/// What a connection is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Requests,
    Answers,
    Calls,
}

/// A frame as far as it has come.
#[derive(Debug, Default)]
struct Framed {
    /// What stands in front of it.
    front: Vec<u8>,
    left: usize,
    /// Its beginning.
    kept: Vec<u8>,
    began: Option<(Duration, u64)>,
    is_told: bool,
}

impl Framed {
    /// Takes what belongs to it off the front of `bytes`, which are not empty; gives whether it is whole. Its length stands behind
    /// `before` other bytes.
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

/// A connection, of which one end is here.
#[derive(Debug)]
pub(crate) struct Conversation {
    measured: Measured,
    role: Option<Role>,
    initiator: Framed,
    responder: Framed,
    /// Whether the responder's header has come.
    is_accepted: bool,
    /// Calls and their answers so far.
    calls: [u64; 2],
}

impl Conversation {
    pub fn new(measured: Measured) -> Self {
        let (initiator, responder) = Default::default();
        Self { measured, role: None, initiator, responder, is_accepted: false, calls: [0; 2] }
    }

    /// Whoever opened the connection says this next; `is_here` if that is at this end.
    pub fn initiator(
        &mut self,
        now: (Duration, u64),
        is_here: bool,
        mut bytes: &[u8],
        tell: &mut dyn FnMut(Told),
    ) -> Result<(), Other> {
        while !bytes.is_empty() {
            let is_header = self.role.is_none();
            let is_whole = self.initiator.take(now, &mut bytes, 0, if is_header { MOST_HEADER } else { 0 });
            if is_header {
                if self.initiator.kept.len() + self.initiator.left > MOST_HEADER {
                    return Err(Other);
                }
                if is_whole {
                    self.role = Some(self.role(is_here).ok_or(Other)?);
                }
            } else if self.role != Some(Role::Calls) {
                // Subscribers have nothing more to say.
                return Err(Other);
            } else if !std::mem::replace(&mut self.initiator.is_told, true) {
                let began = self.initiator.began.unwrap_or(now);
                tell(Told::Request(Name::Call(self.calls[0]), began));
                self.calls[0] += 1;
            }
            if is_whole {
                self.initiator = Framed::default();
            }
        }
        Ok(())
    }

    /// Whoever accepted the connection says this next.
    pub fn responder(
        &mut self,
        now: (Duration, u64),
        mut bytes: &[u8],
        tell: &mut dyn FnMut(Told),
    ) -> Result<(), Other> {
        let role = self.role.ok_or(Other)?;
        let id = match &self.measured {
            Measured::Topics { id, .. } => *id,
            Measured::Service(_) => None,
        };
        let end = id.map_or(0, |id| usize::from(id.offset) + usize::from(id.length));
        while !bytes.is_empty() {
            // An answer to a call begins with whether it went well.
            let before = usize::from(self.is_accepted && role == Role::Calls);
            let is_whole = self.responder.take(now, &mut bytes, before, end);
            if self.is_accepted {
                self.message(role, is_whole, now, (id, end), tell);
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
        tell: &mut dyn FnMut(Told),
    ) {
        let framed = &mut self.responder;
        let name = || {
            let its = id.map_or(0, |id| usize::from(id.offset))..end;
            Some(Name::Message(framed.kept.get(its)?.to_vec()))
        };
        match role {
            Role::Requests if !framed.is_told => {
                if let Some(name) = name() {
                    tell(Told::Request(name, framed.began.unwrap_or(now)));
                    framed.is_told = true;
                }
            }
            Role::Answers if is_whole => name().into_iter().for_each(|name| tell(Told::Answer(name))),
            Role::Calls if is_whole => {
                tell(Told::Answer(Name::Call(self.calls[1])));
                self.calls[1] += 1;
            }
            Role::Requests | Role::Answers | Role::Calls => {}
        }
    }

    /// What the header of whoever opened the connection makes it; `None` if it is not measured.
    fn role(&self, is_here: bool) -> Option<Role> {
        let mut fields = self.initiator.kept.as_slice();
        let (mut topic, mut service) = (None, None);
        while let Some((length, rest)) = fields.split_first_chunk::<LENGTH>() {
            let field = rest.get(..u32::from_le_bytes(*length) as usize)?;
            topic = topic.or(field.strip_prefix(b"topic="));
            service = service.or(field.strip_prefix(b"service="));
            fields = &rest[field.len()..];
        }
        // A subscriber opens the connection to its publisher, a client the one to its server.
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
