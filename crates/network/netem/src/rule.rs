//! What people ask for: rules, each of which gives conditions to the packets of one interface that leave for a network
//! or arrive from one.

use cotorra_graph::LinkCounters;
use serde::{Deserialize, Serialize};

use crate::{
    handle::{Handle, Network},
    netem::Netem,
};

/// Which packets of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Those that leave.
    #[default]
    Egress,
    /// Those that arrive; they take a detour through an interface of their own (ifb).
    Ingress,
}

/// Conditions, and the packets that have them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rule {
    /// Those that leave, or those that arrive.
    pub side: Side,
    /// Of those, the ones that go there, or come from there; `None` are all that no other rule is for.
    pub network: Option<Network>,
    /// What happens to them.
    pub netem: Netem,
}

/// What the kernel counted for a rule since it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Bytes that left the discipline.
    pub bytes: u64,
    /// Packets that left it.
    pub packets: u64,
    /// Packets that were lost, or came when it was full.
    pub dropped: u64,
    /// Packets in it.
    pub waiting: u64,
}

/// What NetEm lost, and what came when its queue was full, it counts as one: lost. What it duplicated or corrupted it does
/// not count.
impl From<Counters> for LinkCounters {
    fn from(Counters { bytes, packets, dropped, .. }: Counters) -> Self {
        Self { packets, bytes, lost: dropped, ..Self::default() }
    }
}

/// Somebody's discipline that made place for ours, as the kernel told it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Replaced {
    /// Its name.
    pub handle: Handle,
    /// What it is.
    pub kind: String,
    /// Its options, in the kernel's own format.
    pub options: Vec<u8>,
}

/// Why a rule cannot be. Nothing has changed then.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DisciplineError {
    /// Somebody else's discipline is in the place.
    #[error(
        "`{interface}` has a queueing discipline that somebody put there ({kind}): it would be lost; \
         --replace puts NetEm in its place, and `cotorra netem clear` puts it back"
    )]
    Foreign {
        /// The interface.
        interface: String,
        /// The discipline's kind.
        kind: String,
    },
    /// Somebody else's discipline with others below it is in the place.
    #[error(
        "`{interface}` has queueing disciplines in classes that somebody put there ({kind}), which could not be put \
         back: remove them first, with `tc qdisc delete dev {interface} root`"
    )]
    ForeignTree {
        /// The interface.
        interface: String,
        /// The root's kind.
        kind: String,
    },
    /// Nobody has so many.
    #[error(
        "there is no place for another rule: there can be 16000, and 400 for networks of the same length"
    )]
    TooMany,
    /// The interface that is to be conditioned is one that conditions others.
    #[error(
        "`{0}` only carries what arrives elsewhere: name the interface at which it arrives, and --ingress"
    )]
    Detour(String),
}
