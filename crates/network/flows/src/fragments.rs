//! Reassembles datagrams from IP fragments, and keeps sets of ranges.

use std::{collections::VecDeque, net::IpAddr, ops::Range, time::Duration};

use crate::packet::{Fragment, Packet};

/// Most datagrams with missing fragments.
const MOST: usize = 64;
/// Longest wait for missing fragments, as in a receiver.
const PATIENCE: Duration = Duration::from_secs(30);

/// The beginning of a complete datagram.
#[derive(Debug)]
pub(crate) struct Whole {
    pub source: IpAddr,
    pub destination: IpAddr,
    pub head: Vec<u8>,
    /// Time and mark of its first fragment.
    pub began: (Duration, u64),
}

#[derive(Debug)]
struct Parts {
    key: (IpAddr, IpAddr, u8, u32),
    head: Vec<u8>,
    received: Ranges,
    end: Option<usize>,
    began: (Duration, u64),
}

/// Reassembles datagrams.
#[derive(Debug)]
pub(crate) struct Fragments {
    /// Bytes kept of a datagram's beginning.
    keep: usize,
    parts: VecDeque<Parts>,
}

impl Fragments {
    pub fn new(keep: usize) -> Self {
        Self { keep, parts: VecDeque::new() }
    }

    /// Takes a fragment. Returns the datagram once it is complete.
    pub fn take(&mut self, now: (Duration, u64), packet: &Packet<'_>, fragment: Fragment) -> Option<Whole> {
        let Fragment { id, offset, more } = fragment;
        let key = (packet.source, packet.destination, packet.protocol, id);
        self.parts.retain(|parts| parts.began.0 + PATIENCE > now.0);
        let place = self.parts.iter().position(|parts| parts.key == key).unwrap_or_else(|| {
            if self.parts.len() == MOST {
                self.parts.pop_front();
            }
            let (head, received) = Default::default();
            self.parts.push_back(Parts { key, head, received, end: None, began: now });
            self.parts.len() - 1
        });
        let parts = &mut self.parts[place];
        let end = offset + packet.payload.len();
        let kept = offset.min(self.keep)..end.min(self.keep);
        parts.head.resize(parts.head.len().max(kept.end), 0);
        parts.head[kept.clone()].copy_from_slice(&packet.payload[..kept.len()]);
        if !more {
            parts.end = Some(end);
        }
        parts.received.add(offset as u64..end as u64);
        if !parts.end.is_some_and(|end| parts.received.covers(end as u64)) {
            return None;
        }
        let Parts { head, began, .. } = self.parts.remove(place)?;
        Some(Whole { source: key.0, destination: key.1, head, began })
    }
}

/// A set of numbers, as sorted ranges.
#[derive(Debug, Default)]
pub(crate) struct Ranges(Vec<Range<u64>>);

impl Ranges {
    pub fn add(&mut self, new: Range<u64>) {
        let place = self.0.partition_point(|range| range.start < new.start);
        self.0.insert(place, new);
        self.0.dedup_by(|after, before| {
            let touches = after.start <= before.end;
            if touches {
                before.end = before.end.max(after.end);
            }
            touches
        });
    }

    pub fn has(&self, number: u64) -> bool {
        let place = self.0.partition_point(|range| range.end <= number);
        self.0.get(place).is_some_and(|range| range.contains(&number))
    }

    /// Whether the set is exactly `0..end`.
    pub fn covers(&self, end: u64) -> bool {
        self.0.first().is_some_and(|first| *first == (0..end))
    }

    /// Returns the number of ranges: at most 8192 for a datagram, whose offsets count in eights.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Adds the numbers between the first two ranges.
    pub fn close_first_gap(&mut self) {
        if let [first, second, ..] = &mut self.0[..] {
            second.start = first.start;
            self.0.remove(0);
        }
    }
}
