//! Record of the state of a VNF.

use std::time::Duration;

use cotorra_graph::BitRate;

use crate::yaml::{
    Bytes,
    decode::{Spanned, choice, record},
};

record! {
    /// State of a VNF, which is copied over the network when it moves in virtual time (docs/use/migrations.md).
    StateRecord {
        /// Its size.
        size: Bytes,
        /// When the VNF serves while its state is copied.
        migration: MigrationWord = "stop_and_copy",
        /// With `pre_copy`: rate at which the state changes while the VNF serves.
        dirty_rate: Option<Spanned<BitRate>>,
        /// With `pre_copy`: the VNF stops once the rest takes no longer. Without it: 300 ms.
        downtime: Option<Spanned<Duration>>,
        /// With `pre_copy`: most rounds while the VNF serves. Without it: 30.
        rounds: Option<Spanned<u32>>,
    }
}

/// Ways in which a VNF moves with its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MigrationWord {
    StopAndCopy,
    PreCopy,
}

choice!(MigrationWord, "kind of migration", {
    "stop_and_copy" => Self::StopAndCopy, "the VNF stops, and all of its state is copied";
    "pre_copy" => Self::PreCopy, "the VNF serves while its state is copied in rounds, and stops for the last one";
});
