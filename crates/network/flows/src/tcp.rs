//! Measures requests and answers on TCP connections.

use std::{collections::HashMap, net::IpAddr, time::Duration};

use crate::{
    headers::PROTOCOL_TCP,
    http::{Exchange, Next},
    packet::{Frame, Packet, Segment},
    requests::Requests,
    ros1,
    stream::Stream,
};

/// Most connections that are followed. Beyond that, the one that was quiet for longest is dropped.
const MOST: usize = 256;

/// The protocol of the connections.
#[derive(Debug, Clone)]
pub(crate) enum Kind {
    /// An unknown protocol to this port. The first bytes of the server after the client's answer the client's.
    Bursts(u16),
    /// HTTP to this port: requests of one path, or all.
    Http(u16, Option<String>),
    /// ROS 1 to any port.
    Ros1(ros1::Measured),
}

/// Both ends of a connection, the one that opened it first.
type Ends = [(IpAddr, u16); 2];

/// Identifies the answer to a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Key {
    /// The connection's number, and the request's number on it.
    Connection(u64, u64),
    /// The message's id.
    Message(Vec<u8>),
}

#[derive(Debug)]
enum Conversation {
    /// `is_open` if the client's next bytes begin a request.
    Bursts {
        is_open: bool,
    },
    Http(Exchange),
    Ros1(ros1::Conversation),
    /// No longer followed.
    Lost,
}

#[derive(Debug)]
struct Connection {
    /// Number of the connection, part of its requests' keys.
    number: u64,
    /// Sequence number of the client's SYN, if it was seen.
    first: Option<u32>,
    client: Stream,
    /// The server's bytes, once the number of the first is known.
    server: Option<Stream>,
    used: Duration,
    conversation: Conversation,
}

/// A flow on TCP connections.
#[derive(Debug)]
pub(crate) struct Tcp {
    kind: Kind,
    pub requests: Requests<Key>,
    connections: HashMap<Ends, Connection>,
    /// Number of connections so far.
    count: u64,
    /// Bytes that all streams hold back.
    held: usize,
    /// The connection whose messages without an id are requests. Others carry the same messages to other subscribers.
    leading: Option<u64>,
}

/// The origin of bytes that passed the port.
#[derive(Clone, Copy)]
struct Passed {
    at: Duration,
    mark: u64,
    /// Whether the end that opened the connection sent them.
    of_client: bool,
    /// Whether the end at the port sent them.
    is_here: bool,
}

impl Tcp {
    pub fn new(kind: Kind, timeout: Duration) -> Self {
        let (connections, requests) = (HashMap::new(), Requests::new(timeout));
        Self { kind, requests, connections, count: 0, held: 0, leading: None }
    }

    /// Records a frame that entered the network at the port (`is_here`), or was delivered there.
    pub fn passed(&mut self, at: Duration, frame: &Frame<'_>, mark: u64, is_here: bool) {
        let Some((packet, segment)) = segment(frame) else { return };
        let mut ends = [(packet.source, segment.from), (packet.destination, segment.to)];
        let Some(of_client) = self.is_of_client(&ends, &segment, is_here) else { return };
        if !of_client {
            ends.reverse();
        }
        if segment.reset {
            return self.remove(&ends);
        }
        let first = segment.sequence.wrapping_add(u32::from(segment.syn));
        if of_client {
            let is_again = |its: &Connection| its.first == Some(segment.sequence);
            if segment.syn && !self.connections.get(&ends).is_some_and(is_again) {
                self.insert(at, ends, first, Some(segment.sequence));
            } else if !segment.payload.is_empty() && !self.connections.contains_key(&ends) {
                self.insert(at, ends, first, None);
            }
        }
        let Some(its) = self.connections.get_mut(&ends) else { return };
        its.used = at;
        if its.server.is_none() {
            let server = if of_client { segment.acknowledged } else { segment.syn.then_some(first) };
            its.server = server.map(Stream::new);
        }
        let stream = if of_client { Some(&mut its.client) } else { its.server.as_mut() };
        let Some(stream) = stream else { return };
        let (number, conversation) = (its.number, &mut its.conversation);
        let (requests, leading) = (&mut self.requests, &mut self.leading);
        let passed = Passed { at, mark, of_client, is_here };
        let pushed = stream.push(first, segment.payload, segment.fin, &mut self.held, &mut |bytes| {
            if !conversation.take(passed, bytes, number, requests, leading) {
                *conversation = Conversation::Lost;
            }
        });
        if !of_client
            && stream.is_over()
            && let Conversation::Http(exchange) = conversation
            && let Some(request) = exchange.close()
        {
            requests.answer(&Key::Connection(number, request), at);
        }
        self.settle(&ends, pushed.is_err());
    }

    /// Whether a segment comes from the end that opened its connection; `None` if the connection is not followed.
    fn is_of_client(&self, ends: &Ends, segment: &Segment<'_>, is_here: bool) -> Option<bool> {
        match self.kind {
            Kind::Bursts(port) | Kind::Http(port, _) => match is_here {
                true => (segment.to == port).then_some(true),
                false => (segment.from == port).then_some(false),
            },
            Kind::Ros1(_) if segment.syn => Some(segment.acknowledged.is_none()),
            Kind::Ros1(_) if self.connections.contains_key(ends) => Some(true),
            Kind::Ros1(_) => self.connections.contains_key(&[ends[1], ends[0]]).then_some(false),
        }
    }

    fn insert(&mut self, at: Duration, ends: Ends, first: u32, syn: Option<u32>) {
        self.remove(&ends);
        if self.connections.len() == MOST {
            let quiet = self.connections.iter().min_by_key(|(_, its)| (its.used, its.number));
            if let Some((quiet, its)) = quiet {
                let (quiet, is_followed) = (*quiet, !matches!(its.conversation, Conversation::Lost));
                self.requests.counts.given_up += u64::from(is_followed);
                self.remove(&quiet);
            }
        }
        self.count += 1;
        let conversation = match &self.kind {
            Kind::Bursts(_) => Conversation::Bursts { is_open: true },
            Kind::Http(_, path) => Conversation::Http(Exchange::new(path.clone())),
            Kind::Ros1(measured) => Conversation::Ros1(ros1::Conversation::new(measured.clone())),
        };
        let connection = Connection {
            number: self.count,
            first: syn,
            client: Stream::new(first),
            server: None,
            used: at,
            conversation,
        };
        self.connections.insert(ends, connection);
    }

    fn remove(&mut self, ends: &Ends) {
        if let Some(its) = self.connections.remove(ends) {
            self.leading.take_if(|leading| *leading == its.number);
            self.held -= its.client.held() + its.server.as_ref().map_or(0, Stream::held);
        }
    }

    /// Removes a connection that is over, and the bytes of one that can no longer be followed.
    fn settle(&mut self, ends: &Ends, is_full: bool) {
        let Some(its) = self.connections.get_mut(ends) else { return };
        let is_over = its.client.is_over() && its.server.as_ref().is_some_and(Stream::is_over);
        if is_full && !matches!(its.conversation, Conversation::Lost) {
            self.requests.counts.given_up += 1;
        }
        if is_over {
            self.remove(ends);
        } else if is_full || matches!(its.conversation, Conversation::Lost) {
            its.conversation = Conversation::Lost;
            self.held -= its.client.clear() + its.server.as_mut().map_or(0, Stream::clear);
        }
    }
}

impl Conversation {
    /// Takes the next bytes of a connection. Returns whether to follow it further.
    fn take(
        &mut self,
        passed: Passed,
        bytes: &[u8],
        number: u64,
        requests: &mut Requests<Key>,
        leading: &mut Option<u64>,
    ) -> bool {
        let Passed { at, mark, of_client, is_here } = passed;
        let key = |request| Key::Connection(number, request);
        match self {
            Self::Bursts { is_open } if of_client => {
                if std::mem::take(is_open) {
                    requests.begin(key(0), at, mark);
                }
            }
            Self::Bursts { is_open } => {
                *is_open = true;
                requests.answer(&key(0), at);
            }
            Self::Http(exchange) => {
                let taken = if of_client {
                    let begin = |request, (entered, mark)| requests.begin(key(request), entered, mark);
                    exchange.client((at, mark), bytes, begin).map(|()| Next::Http)
                } else {
                    exchange.server(bytes, |request| requests.answer(&key(request), at))
                };
                requests.counts.given_up += u64::from(taken.is_err());
                return taken == Ok(Next::Http);
            }
            Self::Ros1(conversation) => {
                let name = |name| match name {
                    ros1::Name::Call(call) => key(call),
                    ros1::Name::Id(id) => Key::Message(id),
                };
                let mut report = |message| match message {
                    ros1::Message::Answer(answer) => requests.answer(&name(answer), at),
                    ros1::Message::Request(request, (entered, mark)) => {
                        let request = name(request);
                        let is_repeated = match &request {
                            Key::Connection(..) => false,
                            Key::Message(id) if id.is_empty() => *leading.get_or_insert(number) != number,
                            Key::Message(_) => requests.has(&request),
                        };
                        if !is_repeated {
                            requests.begin(request, entered, mark);
                        }
                    }
                };
                let taken = if of_client {
                    conversation.initiator((at, mark), is_here, bytes, &mut report)
                } else {
                    conversation.responder((at, mark), bytes, &mut report)
                };
                return taken.is_ok();
            }
            Self::Lost => {}
        }
        true
    }
}

fn segment<'a>(frame: &Frame<'a>) -> Option<(Packet<'a>, Segment<'a>)> {
    let packet =
        Packet::of(frame).filter(|packet| packet.protocol == PROTOCOL_TCP && packet.fragment.is_none())?;
    let segment = Segment::of(packet.payload)?;
    Some((packet, segment))
}

#[cfg(test)]
mod tests;
