//! Contexts and instructions as datagrams of the emulated network.
//!
//! A message is JSON, in as many datagrams as it needs. A context is sent once: if a datagram of it is lost, the plug-in
//! never gets it. Instructions arrive once and in order: each is acknowledged, and sent again until it is. Datagrams have the
//! bytes that they would have between two programs. What they stand for stays here until they arrive. One from elsewhere than
//! the other end changes nothing.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{NodeId, Stamped, Timestamp};

/// Bytes of a message in a datagram. With the headers it fits an Ethernet frame.
const PIECE: usize = 1400;
/// Bytes before the piece: the plug-in's number, what it is, the numbers of the message and of the piece.
const HEADER: usize = 2 + 1 + 8 + 4;
/// Time until an instruction without an acknowledgement is sent again: the least of Linux's TCP. It doubles each time.
const FIRST_RETRY: Duration = Duration::from_millis(200);
/// Longest such time.
const LONGEST_RETRY: Duration = Duration::from_millis(3200);
/// Contexts under way. Older ones count as lost.
const UNDER_WAY: usize = 16_384;

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Datagram {
    pub(crate) from: NodeId,
    pub(crate) to: NodeId,
    pub(crate) payload: Vec<u8>,
}

/// What a datagram completed when it arrived.
pub(super) enum Heard<I> {
    Context(Arc<Stamped>),
    Instructions(Vec<I>),
    Nothing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum What {
    Context,
    Instruction,
    Acknowledgement,
}

/// A piece of a message.
struct Piece {
    what: What,
    message: u64,
    piece: u32,
    bytes: Vec<u8>,
}

/// A message that has not arrived as a whole.
struct Arriving<T> {
    contents: T,
    /// Pieces that have not arrived.
    missing: BTreeSet<u32>,
}

/// An instruction that is not acknowledged.
struct Unacknowledged {
    json: Vec<u8>,
    retry_at: Timestamp,
    interval: Duration,
}

/// The datagrams between the core and one plug-in, with instructions `I`.
pub(super) struct Datagrams<I> {
    core: NodeId,
    plugin: NodeId,
    outbox: VecDeque<Piece>,
    /// Number of contexts so far, which is the number of the next.
    contexts_sent: u64,
    contexts: BTreeMap<u64, Arriving<Arc<Stamped>>>,
    /// Number of instructions so far.
    instructions_sent: u64,
    unacknowledged: BTreeMap<u64, Unacknowledged>,
    instructions: BTreeMap<u64, Arriving<I>>,
}

/// Returns the number of the plug-in that a datagram is from or for.
pub(super) fn number(payload: &[u8]) -> Option<u16> {
    payload.first_chunk().map(|bytes| u16::from_be_bytes(*bytes))
}

impl<I> Datagrams<I> {
    /// Creates the datagrams between two nodes.
    pub(super) fn new(core: &NodeId, plugin: &NodeId) -> Self {
        Self {
            core: core.clone(),
            plugin: plugin.clone(),
            outbox: VecDeque::new(),
            contexts_sent: 0,
            contexts: BTreeMap::new(),
            instructions_sent: 0,
            unacknowledged: BTreeMap::new(),
            instructions: BTreeMap::new(),
        }
    }

    /// Sends a context to the plug-in.
    pub(super) fn send_context(&mut self, context: Arc<Stamped>) {
        let json = serde_json::to_vec(&*context).unwrap_or_default();
        let message = self.contexts_sent;
        self.contexts_sent += 1;
        self.contexts.insert(message, Arriving::new(context, &json));
        if self.contexts.len() > UNDER_WAY {
            self.contexts.pop_first();
        }
        self.outbox.extend(pieces(What::Context, message, &json));
    }

    /// Sends an instruction, with its JSON, to the core.
    pub(super) fn send_instruction(&mut self, now: Timestamp, instruction: I, json: Vec<u8>) {
        let message = self.instructions_sent;
        self.instructions_sent += 1;
        self.instructions.insert(message, Arriving::new(instruction, &json));
        self.outbox.extend(pieces(What::Instruction, message, &json));
        let retry_at = now + FIRST_RETRY;
        self.unacknowledged.insert(message, Unacknowledged { json, retry_at, interval: FIRST_RETRY });
    }

    /// Returns the next datagram of the plug-in with this number.
    pub(super) fn poll_transmit(&mut self, now: Timestamp, number: u16) -> Option<Datagram> {
        for (message, sent) in &mut self.unacknowledged {
            if sent.retry_at <= now {
                sent.interval = (sent.interval * 2).min(LONGEST_RETRY);
                sent.retry_at = now + sent.interval;
                self.outbox.extend(pieces(What::Instruction, *message, &sent.json));
            }
        }
        let piece = self.outbox.pop_front()?;
        let (from, to) = match piece.what {
            What::Context | What::Acknowledgement => (&self.core, &self.plugin),
            What::Instruction => (&self.plugin, &self.core),
        };
        Some(Datagram { from: from.clone(), to: to.clone(), payload: piece.payload(number) })
    }

    /// Returns the number of instructions that have not arrived, or are not acknowledged.
    pub(super) fn instructions_under_way(&self) -> usize {
        self.instructions.len().max(self.unacknowledged.len())
    }

    /// Handles a datagram that has arrived.
    pub(super) fn receive(&mut self, Datagram { from, to, payload }: &Datagram) -> Heard<I> {
        let piece = Piece::parse(payload);
        let (sender, receiver) = match piece {
            Some((What::Instruction, ..)) => (&self.plugin, &self.core),
            _ => (&self.core, &self.plugin),
        };
        if (from, to) != (sender, receiver) {
            return Heard::Nothing;
        }
        match piece {
            Some((What::Context, message, piece)) => {
                let is_whole = self.contexts.get_mut(&message).is_some_and(|context| context.takes(piece));
                let context = if is_whole { self.contexts.remove(&message) } else { None };
                context.map_or(Heard::Nothing, |context| Heard::Context(context.contents))
            }
            Some((What::Instruction, message, piece)) => {
                // One that is gone was passed on, and its acknowledgement lost.
                if self.instructions.get_mut(&message).is_none_or(|instruction| instruction.takes(piece)) {
                    let what = What::Acknowledgement;
                    self.outbox.push_back(Piece { what, message, piece: 0, bytes: Vec::new() });
                }
                let mut whole = Vec::new();
                while let Some(first) = self.instructions.first_entry()
                    && first.get().missing.is_empty()
                {
                    whole.push(first.remove().contents);
                }
                Heard::Instructions(whole)
            }
            Some((What::Acknowledgement, message, _)) => {
                self.unacknowledged.remove(&message);
                Heard::Nothing
            }
            None => Heard::Nothing,
        }
    }

    /// Returns when to poll next; a time in the past is now.
    pub(super) fn next_deadline(&self) -> Option<Timestamp> {
        let retry = self.unacknowledged.values().map(|sent| sent.retry_at).min();
        if self.outbox.is_empty() { retry } else { Some(Timestamp::ZERO) }
    }
}

impl<T> Arriving<T> {
    fn new(contents: T, json: &[u8]) -> Self {
        Self { contents, missing: (0..).take(json.chunks(PIECE).len()).collect() }
    }

    /// Takes a piece. Returns whether the message is whole.
    fn takes(&mut self, piece: u32) -> bool {
        self.missing.remove(&piece);
        self.missing.is_empty()
    }
}

fn pieces(what: What, message: u64, json: &[u8]) -> impl Iterator<Item = Piece> {
    let chunks = json.chunks(PIECE).zip(0..);
    chunks.map(move |(bytes, piece)| Piece { what, message, piece, bytes: bytes.to_vec() })
}

impl Piece {
    fn payload(&self, number: u16) -> Vec<u8> {
        let mut payload = Vec::with_capacity(HEADER + self.bytes.len());
        payload.extend(number.to_be_bytes());
        payload.push(self.what as u8);
        payload.extend(self.message.to_be_bytes());
        payload.extend(self.piece.to_be_bytes());
        payload.extend(&self.bytes);
        payload
    }

    /// Returns what a datagram has, and the numbers of its message and piece.
    fn parse(payload: &[u8]) -> Option<(What, u64, u32)> {
        let (_, rest) = payload.split_first_chunk::<2>()?;
        let (what, rest) = rest.split_first()?;
        let (message, rest) = rest.split_first_chunk()?;
        let piece = rest.first_chunk()?;
        let all = [What::Context, What::Instruction, What::Acknowledgement];
        let what = all.into_iter().find(|known| *known as u8 == *what)?;
        Some((what, u64::from_be_bytes(*message), u32::from_be_bytes(*piece)))
    }
}
