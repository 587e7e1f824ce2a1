//! Follows the frames of clients to their servers, and the answers back, to split the time of a round trip.

use std::{collections::VecDeque, fmt, time::Duration};

use cotorra_flows::{Carried, Place};
use cotorra_graph::{LinkTime, LostAt, LostCause, NodeId, TimeParts, Timestamp};

use crate::{
    frame::Frame,
    port::PortId,
    trace::{Answered, Trace},
};

/// Most frames to a client of flows that are remembered, so that its unanswered requests can be explained.
const MOST_ANSWERS: usize = 256;
/// Most frames of a client that are remembered.
const MOST_SENT: usize = 1024;
/// Most of them if only datagrams with an id are followed. Answered ones are forgotten.
const MOST_DATAGRAMS: usize = 256;

/// Datagrams of a client to follow. Each has an id of 8 bytes, which its answer repeats at the same offset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagrams {
    /// The client's host.
    pub from: NodeId,
    /// The server's UDP port.
    pub port: u16,
    /// Offset of the id in the payload.
    pub id_at: usize,
}

/// The way of a packet from one host to another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trip {
    /// Time of entering the network.
    pub entered: Timestamp,
    /// Time at which it was due at the other host.
    pub due: Timestamp,
    /// Time of its delivery there.
    pub delivered: Timestamp,
    /// Links on the way.
    pub links: Vec<LinkTime>,
}

/// The ways of a datagram and its answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RoundTrip {
    /// The client's host.
    pub from: NodeId,
    /// The id of both, little endian.
    pub id: u64,
    /// The way to the server.
    pub out: Trip,
    /// The way back.
    pub back: Trip,
}

/// Fate of a followed datagram.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Followed {
    /// Its answer is handed out.
    RoundTrip(RoundTrip),
    /// It got on, or ended.
    Progress {
        /// The id, little endian.
        id: u64,
        /// The last place that it reached.
        progress: Progress,
    },
}

/// The last place that a followed datagram reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Progress {
    /// It entered the network.
    Sent,
    /// It was handed to its server.
    Reached,
    /// Its answer entered the network.
    Returned,
    /// It, or its answer, was lost or damaged.
    Lost(LostAt),
}

/// Takes what becomes of datagrams, on the thread that drives the fabric: a round trip before its answer is handed out. Must
/// not block.
pub type FollowedReader = Box<dyn FnMut(Followed) + Send>;

impl Trip {
    /// Splits the time of a sample into parts, from this way to the server and the way back. The parts add up to the
    /// sample. A driver that hands frames out ahead of time overstates the delivery; the VNF's part makes up for it.
    pub fn split(self, back: Self, emitted: Timestamp, took: Duration) -> TimeParts {
        let mut parts = TimeParts {
            sender: self.entered.since(emitted),
            vnf: back.entered.since(self.delivered),
            receiver: (emitted + took).since(back.delivered),
            unknown: Duration::ZERO,
            links: self.links,
        };
        parts.links.extend(back.links.into_iter().map(|on| LinkTime { back: true, ..on }));
        parts.unknown = took.saturating_sub(parts.total());
        parts.vnf = parts.vnf.saturating_sub(parts.total().saturating_sub(took));
        parts
    }
}

/// A frame that a client sent.
#[derive(Debug)]
struct Sent {
    /// Ports of the client and the server.
    ports: [u16; 2],
    place: Option<Place>,
    id: Option<u64>,
    trip: Option<Trip>,
    /// Place of its loss.
    lost: Option<LostAt>,
}

/// A frame to a client of flows.
#[derive(Debug)]
struct Answer {
    /// Ports of the client and the server.
    ports: [u16; 2],
    entered: Timestamp,
    /// Place of its loss.
    lost: Option<LostAt>,
}

/// A host whose frames are followed.
#[derive(Debug, Default)]
struct Client {
    /// Whether all frames with bytes of programs are followed.
    all: bool,
    /// Servers' UDP ports, and the offset of the id.
    datagrams: Vec<(u16, usize)>,
    /// The latest frames, oldest first.
    sent: VecDeque<Sent>,
    /// The latest frames to it, oldest first, if all are followed.
    answers: VecDeque<Answer>,
    /// Ticket of the next frame.
    next: u32,
}

/// Follows the frames of clients, and the frames to them.
#[derive(Default)]
pub(crate) struct Following {
    clients: Vec<Option<Client>>,
    reader: Option<FollowedReader>,
}

impl fmt::Debug for Following {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Following").field("clients", &self.clients).finish_non_exhaustive()
    }
}

impl Client {
    /// Returns the id of a datagram between a port of its own and this port of a server.
    fn id(&self, server: u16, carried: &Carried<'_>) -> Option<u64> {
        if carried.place.is_some() {
            return None;
        }
        let &(_, at) = self.datagrams.iter().find(|(port, _)| *port == server)?;
        Some(u64::from_le_bytes(*carried.payload.get(at..)?.first_chunk()?))
    }

    /// Whether a packet to or from this port of a server is followed.
    fn follows(&self, server: u16, carried: &Carried<'_>) -> bool {
        self.all || self.id(server, carried).is_some()
    }

    /// Remembers a packet to this port of a server, if it is followed, and returns its ticket.
    fn send(&mut self, server: u16, carried: &Carried<'_>) -> Option<u32> {
        if !self.follows(server, carried) {
            return None;
        }
        let most = if self.all { MOST_SENT } else { MOST_DATAGRAMS };
        if self.sent.len() == most {
            self.sent.pop_front();
        }
        let id = self.id(server, carried);
        self.sent.push_back(Sent { ports: carried.ports, place: carried.place, id, trip: None, lost: None });
        let ticket = self.next;
        self.next = ticket.wrapping_add(1);
        Some(ticket)
    }

    fn get(&mut self, ticket: u32) -> Option<&mut Sent> {
        let back = self.next.wrapping_sub(ticket) as usize;
        self.sent.len().checked_sub(back).and_then(|place| self.sent.get_mut(place))
    }

    /// Forgets the datagram with this id, and returns its way.
    fn answered(&mut self, id: u64) -> Option<Trip> {
        let request = self.sent.iter_mut().rev().find(|sent| sent.id == Some(id))?;
        request.id = None;
        if self.all {
            return request.trip.clone();
        }
        let trip = request.trip.take();
        while self.sent.pop_front_if(|first| first.id.is_none()).is_some() {}
        trip
    }

    /// Remembers a frame to it.
    fn returns(&mut self, now: Timestamp, carried: &Carried<'_>) {
        if self.all {
            if self.answers.len() == MOST_ANSWERS {
                self.answers.pop_front();
            }
            let [server, client] = carried.ports;
            self.answers.push_back(Answer { ports: [client, server], entered: now, lost: None });
        }
    }

    /// See [`Following::unanswered`].
    fn unanswered(&mut self, ticket: u32) -> Option<LostAt> {
        let at = |back, cause| LostAt { link: None, back, cause };
        let Sent { ports, place, .. } = *self.get(ticket)?;
        let first = self.sent.len().saturating_sub(self.next.wrapping_sub(ticket) as usize);
        // A packet of a stream may have been sent again.
        let copies = self.sent.range(first..).take(if place.is_some() { usize::MAX } else { 1 });
        let copies: Vec<_> = copies.filter(|sent| sent.ports == ports && sent.place == place).collect();
        let Some(reached) =
            copies.iter().filter_map(|sent| sent.trip.as_ref()).map(|trip| trip.delivered).min()
        else {
            let lost = copies.iter().rev().find_map(|sent| sent.lost.clone());
            return Some(lost.unwrap_or(at(false, LostCause::Late)));
        };
        let answer = self.answers.iter().find(|answer| answer.ports == ports && answer.entered >= reached);
        Some(match answer {
            None => at(false, LostCause::NoAnswer),
            Some(answer) => answer.lost.clone().unwrap_or(at(true, LostCause::Late)),
        })
    }

    /// See [`Following::completing`].
    fn completing(&mut self, ticket: u32, later: &[u32], by: Timestamp) -> Option<Trip> {
        let Some(Place { stream, sequence }) = self.get(ticket)?.place else {
            return self.get(ticket)?.trip.clone().filter(|trip| trip.delivered <= by);
        };
        let behind = |sent: &Sent| {
            let place = sent.place.filter(|place| place.stream == stream)?;
            u32::try_from(place.sequence.wrapping_sub(sequence).cast_signed()).ok()
        };
        let ends = later.iter().filter_map(|ticket| behind(self.get(*ticket)?)).filter(|behind| *behind > 0);
        let end = ends.min().unwrap_or(u32::MAX);
        let first = self.sent.len().saturating_sub(self.next.wrapping_sub(ticket) as usize);
        // Of a packet that was sent again, the copy that came first.
        let mut packets: Vec<(u32, &Trip)> = Vec::new();
        for sent in self.sent.range(first..) {
            let (Some(behind), Some(trip)) = (behind(sent), &sent.trip) else { continue };
            if behind >= end || trip.delivered > by {
                continue;
            }
            match packets.iter_mut().find(|(other, _)| *other == behind) {
                Some((_, before)) if before.delivered <= trip.delivered => {}
                Some((_, before)) => *before = trip,
                None => packets.push((behind, trip)),
            }
        }
        packets.into_iter().map(|(_, trip)| trip).max_by_key(|trip| trip.delivered).cloned()
    }
}

impl Following {
    fn client(&mut self, PortId(place): PortId) -> Option<&mut Client> {
        self.clients.get_mut(place)?.as_mut()
    }

    fn add(&mut self, PortId(place): PortId) -> &mut Client {
        if self.clients.len() <= place {
            self.clients.resize_with(place + 1, || None);
        }
        self.clients[place].get_or_insert_default()
    }

    /// Follows all frames of a client with bytes of programs.
    pub fn follow_all(&mut self, port: PortId) {
        self.add(port).all = true;
    }

    /// Follows datagrams of a client.
    pub fn follow_datagrams(&mut self, port: PortId, to: u16, id_at: usize) {
        let client = self.add(port);
        client.datagrams.retain(|(port, _)| *port != to);
        client.datagrams.push((to, id_at));
    }

    /// Passes what becomes of followed datagrams to a reader, instead of to the one before.
    pub fn read(&mut self, reader: FollowedReader) {
        self.reader = Some(reader);
    }

    fn tell(&mut self, id: Option<u64>, progress: Progress) {
        if let (Some(id), Some(reader)) = (id, &mut self.reader) {
            reader(Followed::Progress { id, progress });
        }
    }

    /// Follows a frame that enters at a port for a host, if it is from or to a client. Returns the ticket of one that is
    /// from a client.
    pub fn enter(&mut self, now: Timestamp, ends: [PortId; 2], frame: &mut Frame) -> Option<u32> {
        let [port, to] = ends;
        if ends.iter().all(|end| self.client(*end).is_none()) {
            return None;
        }
        let carried = Carried::of(&frame.seen())?;
        let [source, destination] = carried.ports;
        let ticket = self.client(port).and_then(|client| client.send(destination, &carried));
        if let Some(ticket) = ticket {
            let id = self.client(port).and_then(|client| client.get(ticket)?.id);
            self.tell(id, Progress::Sent);
        }
        let answered = self.client(to).filter(|client| client.follows(source, &carried)).map(|client| {
            client.returns(now, &carried);
            client.id(source, &carried)
        });
        let id = answered.flatten();
        self.tell(id, Progress::Returned);
        if ticket.is_some() || answered.is_some() {
            let [of_server, of_client] = carried.ports;
            let answers = answered.map(|_| Answered { client: to, ports: [of_client, of_server], id });
            frame.follow(Trace { answers, ..Trace::new(port, ticket, now) });
        }
        ticket
    }

    /// Records that a followed frame was lost or damaged.
    pub fn dropped(&mut self, trace: &Trace, at: LostAt) {
        if let Some(sent) =
            self.client(trace.port).zip(trace.ticket).and_then(|(client, ticket)| client.get(ticket))
        {
            let id = sent.id;
            sent.lost = Some(at.clone());
            self.tell(id, Progress::Lost(at.clone()));
        }
        let Some(Answered { client, ports, id }) = trace.answers else { return };
        let at = LostAt { back: true, ..at };
        let answers = self.client(client).map(|client| &mut client.answers);
        let is_it = |answer: &&mut Answer| answer.ports == ports && answer.entered == trace.entered;
        if let Some(answer) = answers.and_then(|answers| answers.iter_mut().find(is_it)) {
            answer.lost = Some(at.clone());
        }
        self.tell(id, Progress::Lost(at));
    }

    /// Records the delivery of a followed frame at a port.
    pub fn delivered(
        &mut self,
        (port, ticket): (PortId, Option<u32>),
        at: PortId,
        frame: &Frame,
        trip: &Trip,
        name: impl Fn(PortId) -> NodeId,
    ) {
        if let Some(sent) = self.client(port).zip(ticket).and_then(|(client, ticket)| client.get(ticket)) {
            sent.trip = Some(trip.clone());
            let id = sent.id;
            self.tell(id, Progress::Reached);
        }
        let Some(client) = self.client(at).filter(|client| !client.datagrams.is_empty()) else { return };
        let id = Carried::of(&frame.seen()).and_then(|carried| client.id(carried.ports[0], &carried));
        let Some(id) = id else { return };
        let out = client.answered(id).filter(|out| out.delivered <= trip.entered);
        if let (Some(out), Some(reader)) = (out, &mut self.reader) {
            reader(Followed::RoundTrip(RoundTrip { from: name(at), id, out, back: trip.clone() }));
        }
    }

    /// Returns the way of the packet that completed a client's request at its server. `ticket` is that of the request's
    /// first packet, `later` are those of later requests, and `by` is the time of the answer.
    pub fn completing(&mut self, port: PortId, ticket: u32, later: &[u32], by: Timestamp) -> Option<Trip> {
        self.client(port)?.completing(ticket, later, by)
    }

    /// Returns where a request that got no answer in time ended. `ticket` is that of its first packet.
    pub fn unanswered(&mut self, port: PortId, ticket: u32) -> Option<LostAt> {
        self.client(port)?.unanswered(ticket)
    }
}
