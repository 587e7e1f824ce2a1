//! The emulated network as a state machine without a clock and without sockets.
#![forbid(unsafe_code)]

mod checksum;
mod fabric;
mod frame;
mod impairment;
mod lateness;
mod meter;
mod pipe;
mod pool;
mod radio;
mod random;
mod routes;
mod settings;
mod timers;
mod transmitter;

pub use fabric::{Drops, Fabric, FabricError, PortId};
pub use frame::{Checksum, Frame, Malformed, Offload, Segmentation, SegmentationKind};
pub use settings::Refusal;
