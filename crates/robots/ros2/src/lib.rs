//! A ROS 2 node, without ROS: DDS by RustDDS, ROS 2's names, quality of service and messages on top.
//!
//! [`Node`] is the way in; [`messages`] has what mobile robots speak.
//!
//! ```no_run
//! use cotorra_ros2::{Command, Node, NodeConfig, Qos, messages::LaserScan};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::new(NodeConfig::from_env("avoider")?.with_args(std::env::args().skip(1))?)?;
//! let scans = node.subscribe::<LaserScan>("scan", Qos::SENSORS)?;
//! let commands = node.publish::<Command>("cmd_vel", Qos::COMMANDS)?;
//! while let Some(scan) = scans.recv() {
//!     let mut command = Command::default();
//!     command.twist.linear.x = if scan.ranges.iter().all(|range| *range > 0.5) { 0.2 } else { 0.0 };
//!     commands.publish(&command);
//! }
//! # Ok(()) }
//! ```
//!
//! A node leaves when its last handle is dropped, or by [`Node::shut_down`]. It has a thread besides RustDDS's two; all
//! are started by the thread that makes the node or by each other, so that they live in its network namespace.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod carried;
mod config;
mod dds;
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
pub use names::NameError;
pub use node::{Node, NodeError};
pub use peers::Peers;
pub use qos::Qos;
pub use topics::{Publisher, Subscriber};
