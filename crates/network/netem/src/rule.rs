//! Rules: each gives conditions to the packets of one interface to or from a network.

use cotorra_graph::{Conditions, IpNetwork, LinkCounters};
use serde::{Deserialize, Serialize};

use crate::{conditions::ConditionsError, handle::Handle, netem::Netem};

/// Direction of packets at an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Outgoing packets.
    #[default]
    Egress,
    /// Incoming packets, which take a detour through an ifb interface.
    Ingress,
}

/// Conditions and the packets that they apply to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rule {
    /// Direction of the packets.
    pub side: Side,
    /// Network that they go to or come from. `None` matches all packets that no other rule matches.
    pub network: Option<IpNetwork>,
    /// Conditions of these packets.
    pub netem: Netem,
}

impl Rule {
    /// Converts conditions of packets that leave to these addresses, or arrive from them. `None` is for all packets that no
    /// other rule matches.
    ///
    /// # Errors
    /// [`ConditionsError`].
    pub fn new(
        side: Side,
        addresses: Option<IpNetwork>,
        conditions: &Conditions,
    ) -> Result<Self, ConditionsError> {
        Ok(Self { side, network: addresses, netem: Netem::try_from(conditions)? })
    }

    /// The packets that it applies to.
    pub fn packets(&self) -> (Side, Option<IpNetwork>) {
        (self.side, self.network)
    }
}

/// The kernel's counters of a rule since its creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Bytes sent by the discipline.
    pub bytes: u64,
    /// Packets sent by the discipline.
    pub packets: u64,
    /// Packets lost at random or by a full queue.
    pub dropped: u64,
    /// Packets in the queue.
    pub waiting: u64,
}

impl std::ops::Add for Counters {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            packets: self.packets + other.packets,
            dropped: self.dropped + other.dropped,
            waiting: self.waiting + other.waiting,
        }
    }
}

impl Counters {
    /// Returns what these are ahead of others.
    #[must_use]
    pub fn since(self, other: Self) -> Self {
        Self {
            bytes: self.bytes.saturating_sub(other.bytes),
            packets: self.packets.saturating_sub(other.packets),
            dropped: self.dropped.saturating_sub(other.dropped),
            waiting: self.waiting.saturating_sub(other.waiting),
        }
    }
}

/// NetEm counts random losses and queue overflows as one number: lost. It does not count duplicated or corrupted
/// packets.
impl From<Counters> for LinkCounters {
    fn from(Counters { bytes, packets, dropped, .. }: Counters) -> Self {
        Self { packets, bytes, lost: dropped, ..Self::default() }
    }
}

/// A foreign discipline that NetEm replaced, as the kernel reported it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Replaced {
    /// Handle of the discipline.
    pub handle: Handle,
    /// Kind of the discipline.
    pub kind: String,
    /// Its options in the kernel's format.
    pub options: Vec<u8>,
}

/// A rule that cannot be installed. Nothing has changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DisciplineError {
    /// A foreign discipline is in the way.
    #[error(
        "`{interface}` has a queueing discipline of kind {kind} that NetEm would replace: pass \
         --replace to allow it; `cotorra netem clear` restores the old one"
    )]
    Foreign {
        /// Name of the interface.
        interface: String,
        /// Kind of the discipline.
        kind: String,
    },
    /// A foreign discipline with others below it is in the way.
    #[error(
        "`{interface}` has foreign queueing disciplines in classes ({kind}), which could not be restored: \
         remove them first with `tc qdisc delete dev {interface} root`"
    )]
    ForeignTree {
        /// Name of the interface.
        interface: String,
        /// Kind of the root discipline.
        kind: String,
    },
    /// No class or priority is free.
    #[error("too many rules: an interface can have 16000, and 400 for networks of the same prefix length")]
    TooMany,
    /// The interface is the ingress detour of another one.
    #[error(
        "`{0}` only carries ingress packets of another interface: name that interface, and pass --ingress"
    )]
    Detour(String),
}
