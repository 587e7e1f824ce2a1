//! Copies of data on demand, from one host to another.

use std::collections::BTreeMap;

use cotorra_flows::headers::{ETHERNET, IPV4, u16_at};
use cotorra_graph::{CongestionControl, Timestamp};
use cotorra_numbers::Draws;

use crate::{
    segment::{Ends, is_from},
    tcp::{Brought, Connection},
};

/// First port of copies, and the number of such ports. A copy has the same one at both ends.
const FIRST_PORT: u16 = 50_000;
const PORTS: u16 = 10_000;

/// A copy of [`Copies`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct CopyId(u16);

/// Copies of data on demand, each from one host to another over a TCP connection of its own, with CUBIC as in Linux.
///
/// Like [`Sources`](crate::Sources), they give frames to send by [`Self::poll`], and take frames that arrive at a host by
/// [`Self::handle`]. Hosts are named by their place among all hosts.
#[derive(Debug, Default)]
pub struct Copies {
    open: BTreeMap<CopyId, Open>,
    /// Number of copies so far, for their ports.
    begun: u16,
}

#[derive(Debug)]
struct Open {
    connection: Connection,
    ends: Ends,
    /// Bytes to send in all.
    bytes: u64,
}

impl Copies {
    /// Begins a copy from one host to another, without data yet; `None` while too many others are open.
    pub fn begin(&mut self, from: usize, to: usize) -> Option<CopyId> {
        let ids = (0..PORTS).map(|more| CopyId(FIRST_PORT + (self.begun + more) % PORTS));
        let id = ids.into_iter().find(|id| !self.open.contains_key(id))?;
        self.begun = (id.0 - FIRST_PORT + 1) % PORTS;
        // CUBIC draws no random numbers.
        let connection = Connection::new(CongestionControl::Cubic, Some(0), Draws::new(0, "copies"));
        let ends = Ends { from: (from, id.0), to: (to, id.0) };
        self.open.insert(id, Open { connection, ends, bytes: 0 });
        Some(id)
    }

    /// Adds bytes to a copy.
    pub fn add(&mut self, id: CopyId, bytes: u64) {
        if let Some(open) = self.open.get_mut(&id) {
            open.bytes += bytes;
            open.connection.add(bytes);
        }
    }

    /// Returns the bytes of a copy that have arrived.
    pub fn arrived(&self, id: CopyId) -> u64 {
        self.open.get(&id).map_or(0, |open| open.connection.arrived())
    }

    /// Whether all bytes of a copy have arrived.
    pub fn has_arrived(&self, id: CopyId) -> bool {
        self.open.get(&id).is_some_and(|open| open.connection.has_arrived(open.bytes))
    }

    /// Ends a copy. What has not arrived is lost.
    pub fn end(&mut self, id: CopyId) {
        self.open.remove(&id);
    }

    /// Replaces `frame` by the next frame to send now, and returns the place of the host that sends it. Call it until there is
    /// none.
    pub fn poll(&mut self, now: Timestamp, frame: &mut Vec<u8>) -> Option<usize> {
        let next = |open: &mut Open| {
            let (segment, is_answer) = open.connection.poll(now)?;
            Some((segment, if is_answer { open.ends.reversed() } else { open.ends }))
        };
        let (segment, ends) = self.open.values_mut().find_map(next)?;
        segment.write(ends, frame);
        Some(ends.from.0)
    }

    /// Returns when a copy has something to send, or no less than soon.
    pub fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        self.open.values().filter_map(|open| open.connection.deadline(now)).min()
    }

    /// Takes a frame that arrives at a host. Returns its copy, and `None` for a frame of others.
    pub fn handle(&mut self, now: Timestamp, host: usize, frame: &[u8]) -> Option<CopyId> {
        // The ports of UDP and of TCP are at the same place.
        let ports = [0, 2].map(|at| u16_at(frame, ETHERNET + IPV4 + at));
        let id = CopyId(ports[0].filter(|_| ports[0] == ports[1])?);
        let open = self.open.get_mut(&id)?;
        let Ends { from, to } = open.ends;
        let arrives = host == to.0;
        let there = if arrives { from.0 } else { to.0 };
        if ![from.0, to.0].contains(&host) || !is_from(frame, there) {
            return None;
        }
        let brought = open.connection.handle(now, open.ends, arrives, frame);
        (brought != Brought::Nothing).then_some(id)
    }
}

#[cfg(test)]
mod tests;
