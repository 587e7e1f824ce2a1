//! Whatever sends on a channel.

use crate::port::{RadioUnitIndex, StationIndex};

/// Whatever sends on a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Emitter {
    Robot(StationIndex),
    Unit(RadioUnitIndex),
    Interference(usize),
    /// A radio that is not the fabric's.
    Foreign(usize),
}
