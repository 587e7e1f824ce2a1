//! The Measurements block: the history of every embedding of the hardware graph.
//!
//! A [`Recorder`] takes [`cotorra_graph::Stamped`] events, and never blocks its caller. A [`History`] answers questions
//! about them: a series, events in a range of time, the whole graph at a time. Answers are [`Page`]s of bounded size.
#![forbid(unsafe_code)]

mod chunk;
mod codec;
mod curve;
pub mod difference;
mod error;
pub mod export;
mod figure;
mod history;
mod kind;
mod large_data;
mod location;
mod memory;
mod paced;
mod page;
mod recorder;
pub mod regret;
mod retention;
mod rolled;
mod run;
mod schema;
#[cfg(feature = "databases")]
mod server;
mod silence;
mod sql;
mod sqlite;
mod store;
#[cfg(test)]
mod testing;

pub use cotorra_graph::{
    Figure, InvalidFigure, LatenessQuantity, LinkQuantity, MachineQuantity, RobotQuantity,
};
pub use curve::{Curve, CurveRequest, Point, Values};
pub use difference::Difference;
pub use error::{Error, Result};
pub use history::{GraphState, History, Sample};
pub use kind::{InvalidKind, Kind};
pub use large_data::{LargeDataWriter, StoredData, WantedData, read_large_data};
pub use location::{InvalidLocation, Location, Server};
pub use paced::PacedRecorder;
pub use page::{Cursor, InvalidCursor, Page, PageRequest};
pub use recorder::{Recorder, RecorderStats};
pub use retention::{Pruned, Retained};
pub use run::{Gap, Run, RunId, RunInfo};
pub use silence::Silence;

/// Reads bytes as chunks of a history and as entries of a spool, for fuzzing.
#[doc(hidden)]
pub fn read_anything(bytes: &[u8]) {
    for part in [
        chunk::Part::Column { place: 2, is_duration: true },
        chunk::Part::LateColumn { early: 4, place: 5, is_duration: false },
        chunk::Part::children(Kind::Robot, 1),
    ] {
        let _ = chunk::read(bytes, part, |_, _| {});
    }
    let mut entries = codec::binary::Bytes(bytes);
    while entries.entry().is_ok() {}
}
