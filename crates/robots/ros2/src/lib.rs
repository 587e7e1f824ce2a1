#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod carried;
mod config;
mod dds;
mod error;
mod names;
mod node;
mod peers;
mod qos;
mod topics;
#[cfg(feature = "zenoh")]
mod zenoh;

pub use carried::{Carried, Command, Kind};
pub use config::{ConfigError, Middleware, NodeConfig};
pub use cotorra_ros_messages::{self as messages, DecodeError, Message, queue::RecvError};
pub use error::NodeError;
pub use names::NameError;
pub use node::Node;
pub use peers::Peers;
pub use qos::Qos;
pub use topics::{Publisher, Subscriber};
