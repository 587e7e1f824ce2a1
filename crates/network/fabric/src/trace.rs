//! The way of a followed frame through the fabric: when it entered, and how long it spent on each link.

use std::time::Duration;

use cotorra_graph::{Direction, LostCause, Timestamp};

use crate::port::{PortId, RadioUnitIndex, StationIndex};

/// The way of a frame so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Trace {
    /// Port where it entered.
    pub port: PortId,
    /// Number of the frame among the followed ones of a client; `None` if it only answers one.
    pub ticket: Option<u32>,
    /// Time of entering.
    pub entered: Timestamp,
    pub crossings: Vec<Crossing>,
    /// The client that it is for, if it may answer followed frames.
    pub answers: Option<Answered>,
    /// Place and cause of its first loss or damage.
    pub ended: Option<(Option<DirectedLink>, LostCause)>,
}

/// The client that a frame may answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Answered {
    pub client: PortId,
    /// Ports of the client and the server.
    pub ports: [u16; 2],
    /// Id of the datagram that it answers, if that has one.
    pub id: Option<u64>,
}

/// The crossing of one link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Crossing {
    pub link: DirectedLink,
    pub queueing: Duration,
    pub retries: Duration,
    pub crossing: Duration,
}

/// One direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DirectedLink {
    /// A wired link, by its edge.
    Wire(usize),
    Air(StationIndex, RadioUnitIndex, Direction),
}

impl Trace {
    /// Most crossings. The time of further ones stays unknown.
    const MOST: usize = 32;

    pub fn new(port: PortId, ticket: Option<u32>, entered: Timestamp) -> Self {
        Self { port, ticket, entered, crossings: Vec::new(), answers: None, ended: None }
    }

    /// Adds a crossing, from entering the link over the start of the transmission to the arrival.
    pub fn crossed(&mut self, link: DirectedLink, [entered, began, due]: [Timestamp; 3], retries: Duration) {
        if self.crossings.len() < Self::MOST {
            let sent = due.since(began);
            let retries = retries.min(sent);
            let (queueing, crossing) = (began.since(entered), sent - retries);
            self.crossings.push(Crossing { link, queueing, retries, crossing });
        }
    }
}
