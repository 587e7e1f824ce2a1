//! Messages, service calls and actions of ROS 2 over DDS.
//!
//! Sources: ROS 2 design, "Topic and Service name mapping to DDS" and "Actions"; OMG, "RPC over DDS" 1.0; `rmw_fastrtps`
//! and `rmw_cyclonedds` for how replies name their requests.

use std::{collections::VecDeque, time::Duration};

use crate::{
    fragments::{Fragments, Ranges},
    headers::{PROTOCOL_UDP, UDP},
    packet::{Frame, Packet},
    requests::{Id, Requests},
    rtps::{self, Data, ENCAPSULATION, Guid, Identity, PUBLICATIONS_WRITER},
    udp::datagrams,
};

/// Most known writers. Beyond that, the one that was quiet for longest is forgotten.
const MOST_WRITERS: usize = 256;
/// Most samples with missing fragments.
const MOST_PARTS: usize = 64;
/// Most known gaps between the samples of a writer, or the fragments of a sample.
const MOST_GAPS: usize = 1024;
/// Bytes kept of a sample's beginning: enough for any id.
const HEAD: usize = 256;
/// Longest datagram, bytes.
const MOST_DATAGRAM: usize = 1 << 16;

/// Length of the header of calls and replies in `rmw_cyclonedds`: the client and the number of its call.
const CYCLONE_HEADER: usize = 16;
/// Length of a goal's UUID.
const GOAL: usize = 16;
/// Length of the reply to a goal: whether it is accepted, and a time stamp.
const ACCEPTANCE: usize = 12;

/// The topics, service or action to measure.
#[derive(Debug, Clone)]
pub(crate) enum Measured {
    /// Messages of one topic from the port, and messages of another to it.
    Topics { request: String, answer: String, id: Option<Id> },
    /// Calls of a service from the port.
    Service(String),
    /// Goals of an action from the port, up to their results.
    Action(String),
}

/// The content of a writer's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Request,
    Answer,
    /// Replies that accept or reject goals.
    Acceptance,
    /// Calls for the results of goals.
    ResultCall,
}

/// Identifies the answer to a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Key {
    /// The message's id; empty if messages have none.
    Message(Vec<u8>),
    Call(Call),
    Goal {
        goal_call: Call,
        /// The beginning of the goal's message, with its UUID.
        head: Vec<u8>,
        /// The call for its result.
        result_call: Option<Call>,
    },
}

/// The ways in which replies may name a call.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Call {
    identity: Identity,
    /// Reader of the reply, if the call names it: `rmw_fastrtps` replies name it in place of the call's writer.
    reader: Option<Guid>,
    /// Header of the call in Cyclone DDS.
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

/// A completely received sample.
struct Reply<'a> {
    related: Option<Identity>,
    /// Beginning of the payload.
    head: &'a [u8],
}

#[derive(Debug)]
struct Writer {
    guid: Guid,
    /// Content of its samples if they arrive at the port, and if they leave it.
    roles: [Option<Role>; 2],
    /// Sequence numbers of seen samples.
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

/// A partly received sample.
#[derive(Debug)]
struct Parts {
    identity: Identity,
    related: Option<Identity>,
    head: Vec<u8>,
    received: Ranges,
}

/// A flow of ROS 2.
#[derive(Debug)]
pub(crate) struct Ros2 {
    measured: Measured,
    /// DDS names of the measured topics, whether they are published at the port, and the content of their samples.
    topics: Vec<(String, bool, Role)>,
    pub requests: Requests<Key>,
    /// Writers, the one that was quiet for longest first.
    writers: VecDeque<Writer>,
    /// IP fragments of arriving and of leaving datagrams.
    fragments: [Fragments; 2],
    /// Samples with missing fragments, oldest first.
    parts: VecDeque<Parts>,
}

/// Direction, times and mark of a datagram.
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
                    request(&result, Role::ResultCall),
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

    /// Records a frame that entered the network at the port (`is_here`), or was delivered there.
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

    /// Records the announcement of a writer on a topic.
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

    /// Returns the content of a sample; `None` if it is not measured, or was seen before.
    fn first_seen(&mut self, is_here: bool, data: &Data<'_>) -> Option<Role> {
        let Identity { writer: guid, sequence } = data.identity;
        let place = self.writers.iter().position(|writer| writer.guid == guid)?;
        let mut writer = self.writers.remove(place)?;
        let role = writer.roles[usize::from(is_here)].filter(|_| !writer.seen.has(sequence));
        // An arriving sample counts with its last fragment, a leaving one with its first.
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
                // A request with the id of a pending one is a retransmission.
                if id.is_some() && self.requests.has(&key) {
                    return;
                }
                key
            }
            (Measured::Service(_), _) => Key::Call(Call::of(data)),
            (Measured::Action(_), Role::ResultCall) => return self.call_for_result(Call::of(data), body),
            (Measured::Action(_), _) => {
                let head = body[..body.len().min(CYCLONE_HEADER + GOAL)].to_vec();
                Key::Goal { goal_call: Call::of(data), head, result_call: None }
            }
        };
        self.requests.begin(key, entered, mark);
    }

    /// Records a call for a goal's result. The call contains only the goal's UUID, so that its length shows whether a
    /// header precedes it.
    fn call_for_result(&mut self, call: Call, body: &[u8]) {
        let place = if body.len() < CYCLONE_HEADER + GOAL { 0 } else { CYCLONE_HEADER };
        let Some(goal) = body.get(place..place + GOAL) else { return };
        let matches = |key: &Key| match key {
            Key::Goal { head, result_call: None, .. } => head.get(place..place + GOAL) == Some(goal),
            _ => false,
        };
        if let Some(Key::Goal { result_call, .. }) = self.requests.find(matches) {
            *result_call = Some(call);
        }
    }

    /// Takes an arriving sample, or a fragment of one.
    fn part(&mut self, role: Role, at: Duration, data: &Data<'_>) {
        if data.count == 1 {
            return self.reply(role, at, &Reply { related: data.related, head: data.payload });
        }
        let place =
            self.parts.iter().position(|parts| parts.identity == data.identity).unwrap_or_else(|| {
                if self.parts.len() == MOST_PARTS {
                    self.parts.pop_front();
                }
                let (head, received) = Default::default();
                self.parts.push_back(Parts { identity: data.identity, related: None, head, received });
                self.parts.len() - 1
            });
        let parts = &mut self.parts[place];
        parts.related = parts.related.or(data.related);
        if data.fragments.start == 0 {
            parts.head = data.payload[..data.payload.len().min(HEAD)].to_vec();
        }
        parts.received.add(data.fragments.clone());
        let is_whole = parts.received.covers(data.count);
        if !is_whole && parts.received.count() <= MOST_GAPS {
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
                    let matches = |key: &Key| matches!(key, Key::Goal { goal_call, .. } if goal_call.is_answered_by(reply));
                    self.requests.reject(matches, at);
                }
            }
            Measured::Action(_) => {
                let matches = |key: &Key| match key {
                    Key::Goal { result_call: Some(call), .. } => call.is_answered_by(reply),
                    _ => false,
                };
                self.requests.answer_to(matches, at);
            }
        }
    }
}

/// Returns the id of a message, counted from behind the encapsulation header; `None` if the message ends before it.
fn name(id: Option<Id>, payload: &[u8]) -> Option<Vec<u8>> {
    let Some(Id { offset, length }) = id else { return Some(Vec::new()) };
    let from = ENCAPSULATION + usize::from(offset);
    payload.get(from..from + usize::from(length)).map(<[u8]>::to_vec)
}

#[cfg(test)]
mod tests;
