//! Messages, service calls and actions of ROS 2 over DDS.
//!
//! Sources: ROS 2 design, "Topic and Service name mapping to DDS" and "Actions"; OMG, "RPC over DDS" 1.0; `rmw_fastrtps`
//! and `rmw_cyclonedds` for how a reply says to which request it belongs.

use std::{collections::VecDeque, time::Duration};

use crate::{
    fragments::{Fragments, Ranges},
    headers::{PROTOCOL_UDP, UDP},
    packet::{Frame, Packet},
    requests::{Id, Requests},
    rtps::{self, Data, ENCAPSULATION, Guid, Identity, PUBLICATIONS_WRITER},
    udp::datagrams,
};

/// So many writers are known at most; then the one that was quiet for longest is forgotten.
const MOST_WRITERS: usize = 256;
/// Of so many samples fragments wait for others at most.
const MOST_PARTS: usize = 64;
/// So many gaps are known at most, between the samples of a writer and the fragments of a sample.
const MOST_GAPS: usize = 1024;
/// So much of a sample's beginning is kept: its id, wherever that may be.
const HEAD: usize = 256;
/// So long a datagram is at most.
const MOST_DATAGRAM: usize = 1 << 16;

/// In front of calls and replies, `rmw_cyclonedds` puts the client and the number of its call.
const CYCLONE_HEADER: usize = 16;
/// A goal's UUID.
const GOAL: usize = 16;
/// The reply to a goal: whether it is accepted, and a stamp.
const ACCEPTANCE: usize = 12;

/// What is measured.
#[derive(Debug, Clone)]
pub(crate) enum Measured {
    /// A message of one topic from here, and one of another to here.
    Topics { request: String, answer: String, id: Option<Id> },
    /// A call of a service from here.
    Service(String),
    /// A goal of an action from here, to its result.
    Action(String),
}

/// What the samples of a writer are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Request,
    Answer,
    /// Whether a goal is accepted.
    Acceptance,
    /// The call that asks for a goal's result.
    AskForResult,
}

/// What tells an answer.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Key {
    /// The message's id; empty without.
    Message(Vec<u8>),
    Call(Call),
    Goal {
        sent: Call,
        /// The beginning of the goal's message, with its UUID.
        head: Vec<u8>,
        /// What asks for its result.
        asked: Option<Call>,
    },
}

/// A call, as replies may name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Call {
    identity: Identity,
    /// Where the reply is awaited, if the call says so: `rmw_fastrtps` names that in place of its writer.
    reader: Option<Guid>,
    /// What stands in front of it in Cyclone DDS.
    header: Option<[u64; 2]>,
}

impl Call {
    fn of(data: &Data<'_>) -> Self {
        Self {
            identity: data.identity,
            reader: data.related.map(|related| related.writer),
            header: rtps::numbers(data.payload),
        }
    }

    fn is_answered_by(&self, reply: &Reply<'_>) -> bool {
        match reply.related {
            Some(Identity { writer, sequence }) => {
                sequence == self.identity.sequence
                    && (writer == self.identity.writer || Some(writer) == self.reader)
            }
            None => self.header.is_some() && self.header == rtps::numbers(reply.head),
        }
    }
}

/// A sample that came, all of it.
struct Reply<'a> {
    related: Option<Identity>,
    /// Its beginning.
    head: &'a [u8],
}

#[derive(Debug)]
struct Writer {
    guid: Guid,
    /// What its samples are if they come from elsewhere, and if they are from here.
    roles: [Option<Role>; 2],
    /// Numbers of the samples that were seen.
    seen: Ranges,
}

impl Writer {
    fn see(&mut self, sequence: u64) {
        self.seen.add(sequence..sequence + 1);
        if self.seen.count() > MOST_GAPS {
            self.seen.close_first_gap();
        }
    }
}

/// A sample of which fragments have come.
#[derive(Debug)]
struct Parts {
    identity: Identity,
    related: Option<Identity>,
    head: Vec<u8>,
    came: Ranges,
}

/// A flow of ROS 2.
#[derive(Debug)]
pub(crate) struct Ros2 {
    measured: Measured,
    /// The topics that matter, by DDS's names, whether they are published here, and what their samples are.
    topics: Vec<(String, bool, Role)>,
    pub requests: Requests<Key>,
    /// The one that was quiet for longest first.
    writers: VecDeque<Writer>,
    /// IP fragments of what leaves and of what comes.
    fragments: [Fragments; 2],
    /// Samples that come in parts, oldest first.
    parts: VecDeque<Parts>,
}

/// Which way a datagram went, when it began to, and its mark.
#[derive(Clone, Copy)]
struct Passed {
    is_here: bool,
    began: (Duration, u64),
    ended: Duration,
}

impl Ros2 {
    pub fn new(measured: Measured, timeout: Duration) -> Self {
        let request = |service: &str, role| (format!("rq{service}Request"), true, role);
        let reply = |service: &str, role| (format!("rr{service}Reply"), false, role);
        let topics = match &measured {
            Measured::Topics { request, answer, .. } => {
                vec![
                    (format!("rt{request}"), true, Role::Request),
                    (format!("rt{answer}"), false, Role::Answer),
                ]
            }
            Measured::Service(service) => vec![request(service, Role::Request), reply(service, Role::Answer)],
            Measured::Action(action) => {
                let [goal, result] = ["send_goal", "get_result"].map(|its| format!("{action}/_action/{its}"));
                vec![
                    request(&goal, Role::Request),
                    reply(&goal, Role::Acceptance),
                    request(&result, Role::AskForResult),
                    reply(&result, Role::Answer),
                ]
            }
        };
        Self {
            measured,
            topics,
            requests: Requests::new(timeout),
            writers: VecDeque::new(),
            fragments: [Fragments::new(MOST_DATAGRAM), Fragments::new(MOST_DATAGRAM)],
            parts: VecDeque::new(),
        }
    }

    /// A frame entered the network at the port, or was delivered there.
    pub fn passed(&mut self, at: Duration, frame: &Frame<'_>, mark: u64, is_here: bool) {
        let Some(packet) = Packet::of(frame).filter(|packet| packet.protocol == PROTOCOL_UDP) else { return };
        let passed = Passed { is_here, began: (at, mark), ended: at };
        match packet.fragment {
            None => datagrams(packet.payload, frame).for_each(|payload| self.message(passed, payload)),
            Some(fragment) => {
                let fragments = &mut self.fragments[usize::from(is_here)];
                let Some(whole) = fragments.take((at, mark), &packet, fragment) else { return };
                let payload = whole.head.get(UDP..).unwrap_or_default();
                self.message(Passed { began: whole.began, ..passed }, payload);
            }
        }
    }

    fn message(&mut self, passed: Passed, message: &[u8]) {
        rtps::read(message, |data| {
            if data.identity.writer.ends_with(&PUBLICATIONS_WRITER) {
                if data.fragments.start == 0
                    && let Some((writer, topic)) = rtps::announced(data.payload)
                {
                    self.announce(writer, topic);
                }
            } else if let Some(role) = self.first_seen(passed.is_here, &data) {
                match passed.is_here {
                    true => self.request(role, passed.began, &data),
                    false => self.part(role, passed.ended, &data),
                }
            }
        });
    }

    /// A writer is there, on this topic.
    fn announce(&mut self, guid: Guid, topic: &[u8]) {
        let role = |wanted: bool| {
            let mut its = self
                .topics
                .iter()
                .filter(|(name, is_here, _)| name.as_bytes() == topic && *is_here == wanted);
            its.next().map(|(_, _, role)| *role)
        };
        let roles = [role(false), role(true)];
        let known = self.writers.iter().position(|writer| writer.guid == guid);
        match known {
            Some(place) => self.writers[place].roles = roles,
            None if roles == [None; 2] => {}
            None => {
                if self.writers.len() == MOST_WRITERS {
                    self.writers.pop_front();
                    self.requests.counts.given_up += 1;
                }
                self.writers.push_back(Writer { guid, roles, seen: Ranges::default() });
            }
        }
    }

    /// What a sample is; `None` if it does not matter, or was seen before.
    fn first_seen(&mut self, is_here: bool, data: &Data<'_>) -> Option<Role> {
        let Identity { writer: guid, sequence } = data.identity;
        let place = self.writers.iter().position(|writer| writer.guid == guid)?;
        let mut writer = self.writers.remove(place)?;
        let role = writer.roles[usize::from(is_here)].filter(|_| !writer.seen.has(sequence));
        // A sample that comes is there with its last fragment; one that leaves begins with its first.
        if role.is_some() && if is_here { data.fragments.start == 0 } else { data.count == 1 } {
            writer.see(sequence);
        }
        self.writers.push_back(writer);
        role
    }

    fn request(&mut self, role: Role, (entered, mark): (Duration, u64), data: &Data<'_>) {
        if data.fragments.start > 0 {
            return;
        }
        let body = data.payload.get(ENCAPSULATION..).unwrap_or_default();
        let key = match (&self.measured, role) {
            (Measured::Topics { id, .. }, _) => {
                let Some(name) = name(*id, data.payload) else { return };
                let key = Key::Message(name);
                // One with the same words is the same request once more.
                if id.is_some() && self.requests.has(&key) {
                    return;
                }
                key
            }
            (Measured::Service(_), _) => Key::Call(Call::of(data)),
            (Measured::Action(_), Role::AskForResult) => return self.ask_for_result(Call::of(data), body),
            (Measured::Action(_), _) => {
                let head = body[..body.len().min(CYCLONE_HEADER + GOAL)].to_vec();
                Key::Goal { sent: Call::of(data), head, asked: None }
            }
        };
        self.requests.begin(key, entered, mark);
    }

    /// The call has nothing in it but the goal's UUID, so that its length tells what is in front of it.
    fn ask_for_result(&mut self, call: Call, body: &[u8]) {
        let place = if body.len() < CYCLONE_HEADER + GOAL { 0 } else { CYCLONE_HEADER };
        let Some(goal) = body.get(place..place + GOAL) else { return };
        let is_its = |key: &Key| match key {
            Key::Goal { head, asked: None, .. } => head.get(place..place + GOAL) == Some(goal),
            _ => false,
        };
        if let Some(Key::Goal { asked, .. }) = self.requests.find(is_its) {
            *asked = Some(call);
        }
    }

    /// Of a sample from elsewhere a part has come, or all.
    fn part(&mut self, role: Role, at: Duration, data: &Data<'_>) {
        if data.count == 1 {
            return self.reply(role, at, &Reply { related: data.related, head: data.payload });
        }
        let place =
            self.parts.iter().position(|parts| parts.identity == data.identity).unwrap_or_else(|| {
                if self.parts.len() == MOST_PARTS {
                    self.parts.pop_front();
                }
                let (head, came) = Default::default();
                self.parts.push_back(Parts { identity: data.identity, related: None, head, came });
                self.parts.len() - 1
            });
        let parts = &mut self.parts[place];
        parts.related = parts.related.or(data.related);
        if data.fragments.start == 0 {
            parts.head = data.payload[..data.payload.len().min(HEAD)].to_vec();
        }
        parts.came.add(data.fragments.clone());
        let is_whole = parts.came.are(data.count);
        if !is_whole && parts.came.count() <= MOST_GAPS {
            return;
        }
        let Some(parts) = self.parts.remove(place) else { return };
        if let Some(writer) = self.writers.back_mut().filter(|_| is_whole) {
            writer.see(parts.identity.sequence);
            self.reply(role, at, &Reply { related: parts.related, head: &parts.head });
        }
    }

    fn reply(&mut self, role: Role, at: Duration, reply: &Reply<'_>) {
        match &self.measured {
            Measured::Topics { id, .. } => {
                if let Some(name) = name(*id, reply.head) {
                    self.requests.answer(&Key::Message(name), at);
                }
            }
            Measured::Service(_) => {
                self.requests
                    .answer_to(|key| matches!(key, Key::Call(call) if call.is_answered_by(reply)), at);
            }
            Measured::Action(_) if role == Role::Acceptance => {
                let body = reply.head.get(ENCAPSULATION..).unwrap_or_default();
                let place = if body.len() < CYCLONE_HEADER + ACCEPTANCE { 0 } else { CYCLONE_HEADER };
                if body.get(place) == Some(&0) {
                    let is_its =
                        |key: &Key| matches!(key, Key::Goal { sent, .. } if sent.is_answered_by(reply));
                    self.requests.refuse(is_its, at);
                }
            }
            Measured::Action(_) => {
                let is_its = |key: &Key| matches!(key, Key::Goal { asked: Some(asked), .. } if asked.is_answered_by(reply));
                self.requests.answer_to(is_its, at);
            }
        }
    }
}

/// What a message has as its id, behind what says how it is serialized; `None` for one that ends before.
fn name(id: Option<Id>, payload: &[u8]) -> Option<Vec<u8>> {
    let Some(Id { offset, length }) = id else { return Some(Vec::new()) };
    let from = ENCAPSULATION + usize::from(offset);
    payload.get(from..from + usize::from(length)).map(<[u8]>::to_vec)
}

#[cfg(test)]
mod tests;
