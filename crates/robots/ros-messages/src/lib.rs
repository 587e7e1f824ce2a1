#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod codec;
mod description;
mod field;
mod geometry;
mod message;
mod navigation;
pub mod queue;
mod sensors;
mod services;
mod standard;
mod time;
mod visualization;

pub use codec::{DecodeError, Reader, Version, Writer};
pub use description::{Constant, Description, FieldDescription, FieldType};
pub use field::{Byte, Field, min_len};
pub use geometry::*;
pub use message::Message;
pub use navigation::*;
pub use sensors::*;
pub use services::*;
pub use standard::*;
pub use time::{Duration, Time};
pub use visualization::*;

#[cfg(test)]
mod tests;
