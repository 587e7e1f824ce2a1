#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod link_probe;
mod pace;

pub use link_probe::LinkProbe;
pub use pace::{FRAME_BYTES, estimate, on_air, on_wire};
