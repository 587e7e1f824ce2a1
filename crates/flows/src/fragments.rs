//! Datagrams that came in several IP fragments.

use std::{collections::VecDeque, net::IpAddr, ops::Range};

use crate::packet::{Fragment, Packet};

/// Of so many datagrams fragments wait for others at most.
const MOST: usize = 64;
/// So much of a datagram's beginning is kept.
const HEAD: usize = 256;

/// The beginning of a datagram, all of which has come.
#[derive(Debug)]
pub(crate) struct Whole {
    pub source: IpAddr,
    pub destination: IpAddr,
    pub head: Vec<u8>,
}

#[derive(Debug)]
struct Parts {
    key: (IpAddr, IpAddr, u8, u32),
    head: Vec<u8>,
    /// What has come, in order.
    come: Vec<Range<usize>>,
    end: Option<usize>,
}

/// Puts datagrams together; of each it keeps the beginning.
#[derive(Debug, Default)]
pub(crate) struct Fragments(VecDeque<Parts>);

impl Fragments {
    /// Takes a fragment; gives the datagram once it is whole.
    pub fn take(&mut self, packet: &Packet<'_>, fragment: Fragment) -> Option<Whole> {
        let Fragment { id, offset, more } = fragment;
        let key = (packet.source, packet.destination, packet.protocol, id);
        let place = self.0.iter().position(|parts| parts.key == key).unwrap_or_else(|| {
            if self.0.len() == MOST {
                self.0.pop_front();
            }
            self.0.push_back(Parts { key, head: Vec::new(), come: Vec::new(), end: None });
            self.0.len() - 1
        });
        let parts = &mut self.0[place];
        if offset == 0 {
            parts.head = packet.payload[..packet.payload.len().min(HEAD)].to_vec();
        }
        let end = offset + packet.payload.len();
        if !more {
            parts.end = Some(end);
        }
        parts.add(offset..end);
        let is_whole =
            parts.come.first().is_some_and(|first| first.start == 0 && Some(first.end) == parts.end);
        if !is_whole {
            return None;
        }
        let parts = self.0.remove(place)?;
        Some(Whole { source: key.0, destination: key.1, head: parts.head })
    }
}

impl Parts {
    /// At most 8192 ranges: offsets count in eights.
    fn add(&mut self, new: Range<usize>) {
        let place = self.come.partition_point(|range| range.start < new.start);
        self.come.insert(place, new);
        self.come.dedup_by(|after, before| {
            let touches = after.start <= before.end;
            if touches {
                before.end = before.end.max(after.end);
            }
            touches
        });
    }
}
