//! Recordings and eyes: what happens in a testbed as ROS 2 messages, in an MCAP file that Foxglove, `PlotJuggler` and
//! `ros2 bag` open, and live for Foxglove.
//!
//! [`Recording`] goes behind a run; [`Export`] writes what a history has. Both use one encoder, which turns events and
//! scans into messages on topics; a [`Sink`] takes those. `docs/recording.md` says which topics there are.
#![forbid(unsafe_code)]

mod channel;
mod encoder;
mod export;
#[cfg(feature = "foxglove")]
mod foxglove;
mod frames;
mod markers;
mod mcap_file;
mod messages;
mod recording;
mod sink;
mod told;

pub use channel::{Channel, Encoded, Qos};
pub use export::Export;
pub use mcap_file::{About, McapFile};
pub use recording::{Pace, Recording, RecordingPlace, RecordingSummary, Tap, Wanted};
pub use sink::{RecordingError, Sink};
