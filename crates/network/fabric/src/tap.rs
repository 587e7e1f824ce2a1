//! Taps: who reads the packets that cross links, and of which links.

use std::fmt;

use cotorra_graph::{Direction, LinkId, Timestamp};

use crate::{frame::Frame, port::PortId};

/// Most taps at a time. Each looks at every packet of its links, on the thread that moves them.
pub(crate) const MOST_TAPS: usize = 16;

/// Error of a tap that cannot begin.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TapError {
    /// An unknown name.
    #[error("there is no link or node `{0}`")]
    Unknown(String),
    /// All places are taken.
    #[error("{MOST_TAPS} captures are under way, which is the most: end one of them first")]
    TooMany,
}

/// A packet of a host that has crossed one direction of a link.
#[derive(Debug, Clone, Copy)]
pub struct Passage<'a> {
    /// The link.
    pub link: &'a LinkId,
    /// Direction of the crossing.
    pub direction: Direction,
    /// Time of entering the link.
    pub entered: Timestamp,
    /// Time at which the packet was due at the other end.
    pub due: Timestamp,
    /// Time of the poll that moved it on.
    pub delivered: Timestamp,
    /// Packets that this direction has lost since the run began.
    pub lost: u64,
    /// Packets that the queue of this direction has dropped since the run began.
    pub overflowed: u64,
    /// Bytes and offload. A super-packet that crossed as a whole is shown as a whole.
    pub frame: &'a Frame,
}

/// Reads the packets that cross links, on the thread that drives the fabric, and must not block. Returns whether it wants
/// more. Called without a packet now and then, to ask only that.
pub type TapReader = Box<dyn FnMut(Option<&Passage<'_>>) -> bool + Send>;

/// A reader and its links.
pub(crate) struct Tap {
    /// Its directions of wired links: edges of the routes.
    pub(crate) edges: Vec<usize>,
    /// The ends of its wireless links: all links of one port, or the link of two.
    pub(crate) ends: Vec<PortId>,
    pub(crate) reader: TapReader,
}

impl Tap {
    /// Whether its reader sees what crosses the wireless link between two ports.
    pub(crate) fn is_of_air(&self, link: [PortId; 2]) -> bool {
        !self.ends.is_empty() && self.ends.iter().all(|end| link.contains(end))
    }
}

impl fmt::Debug for Tap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tap").field("edges", &self.edges).field("ends", &self.ends).finish_non_exhaustive()
    }
}
