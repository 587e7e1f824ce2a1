//! Records the events of a testbed as ROS 2 messages, in an MCAP file that Foxglove, `PlotJuggler` and `ros2 bag` open, and
//! serves them live to Foxglove.
//!
//! [`Recording`] records a run; [`Export`] converts a history. Both use one encoder, which turns events and scans into
//! messages on topics for a [`Sink`]. `docs/use/recording.md` lists the topics.
#![forbid(unsafe_code)]

mod channel;
mod encoder;
mod export;
#[cfg(feature = "foxglove")]
mod foxglove;
mod frames;
mod log;
mod markers;
mod mcap_file;
mod messages;
mod recording;
mod sink;

pub use channel::{Channel, Encoded, Qos};
pub use export::Export;
pub use mcap_file::{About, McapFile};
pub use recording::{Pace, Recording, RecordingPlace, RecordingSummary, Tap, Wanted};
pub use sink::{RecordingError, Sink};
