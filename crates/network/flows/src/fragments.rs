//! Datagrams that came in several IP fragments.

use std::{collections::VecDeque, net::IpAddr, ops::Range, time::Duration};

use crate::packet::{Fragment, Packet};

/// Of so many datagrams fragments wait for others at most.
const MOST: usize = 64;
/// So long fragments wait for others at most, as in their receiver.
const PATIENCE: Duration = Duration::from_secs(30);

/// The beginning of a datagram, all of which has come.
#[derive(Debug)]
pub(crate) struct Whole {
    pub source: IpAddr,
    pub destination: IpAddr,
    pub head: Vec<u8>,
    /// When its first fragment came, with its mark.
    pub began: (Duration, u64),
}

#[derive(Debug)]
struct Parts {
    key: (IpAddr, IpAddr, u8, u32),
    head: Vec<u8>,
    came: Ranges,
    end: Option<usize>,
    began: (Duration, u64),
}

/// Puts datagrams together.
#[derive(Debug)]
pub(crate) struct Fragments {
    /// So much of a datagram's beginning is kept.
    keep: usize,
    parts: VecDeque<Parts>,
}

impl Fragments {
    pub fn new(keep: usize) -> Self {
        Self { keep, parts: VecDeque::new() }
    }

    /// Takes a fragment; gives the datagram once it is whole.
    pub fn take(&mut self, now: (Duration, u64), packet: &Packet<'_>, fragment: Fragment) -> Option<Whole> {
        let Fragment { id, offset, more } = fragment;
        let key = (packet.source, packet.destination, packet.protocol, id);
        self.parts.retain(|parts| parts.began.0 + PATIENCE > now.0);
        let place = self.parts.iter().position(|parts| parts.key == key).unwrap_or_else(|| {
            if self.parts.len() == MOST {
                self.parts.pop_front();
            }
            let (head, came) = Default::default();
            self.parts.push_back(Parts { key, head, came, end: None, began: now });
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
        parts.came.add(offset as u64..end as u64);
        if !parts.end.is_some_and(|end| parts.came.are(end as u64)) {
            return None;
        }
        let Parts { head, began, .. } = self.parts.remove(place)?;
        Some(Whole { source: key.0, destination: key.1, head, began })
    }
}

/// What has come of something, in order.
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

    /// Whether all has come, up to this end.
    pub fn are(&self, end: u64) -> bool {
        self.0.first().is_some_and(|first| *first == (0..end))
    }

    /// How many there are: at most 8192 of a datagram, whose offsets count in eights.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Takes what is between the first two as come.
    pub fn close_first_gap(&mut self) {
        if let [first, second, ..] = &mut self.0[..] {
            second.start = first.start;
            self.0.remove(0);
        }
    }
}
