//! A ROS 1 node, without ROS: the master's and nodes' XML-RPC API, TCPROS, messages and their MD5 sums.
//!
//! [`Node`] is the way in. [`messages`] has the messages of mobile robots, and the macro that declares others.
//!
//! ```no_run
//! use cotorra_ros1::{Node, NodeConfig, PublishOptions, SubscribeOptions, messages::{LaserScan, Twist}};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::new(NodeConfig::from_env("avoider")?.with_args(std::env::args().skip(1))?)?;
//! let scans = node.subscribe::<LaserScan>("scan", SubscribeOptions::default())?;
//! let commands = node.publish::<Twist>("cmd_vel", PublishOptions::default())?;
//! while let Some(scan) = scans.recv() {
//!     let mut command = Twist::default();
//!     command.linear.x = if scan.ranges.iter().all(|range| *range > 0.5) { 0.2 } else { 0.0 };
//!     commands.publish(&command);
//! }
//! # Ok(()) }
//! ```
//!
//! A node unregisters when its last handle is dropped, or by [`Node::shut_down`]. Signals belong to the program: it
//! has a handler for Ctrl-C call that, on a clone of the node.
//!
//! Protocols are functions of bytes; only the node and what asks the master have sockets, threads and a clock. A
//! node has two threads, one more for each service that it offers, and one while it connects to a publisher. All
//! are started by the thread that makes the node or by each other, so that they live in its network namespace.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod config;
mod http;
mod master;
mod master_server;
mod names;
mod node;
mod queue;
mod registry;
mod slave;
mod tcpros;
mod uri;
mod xmlrpc;

pub use config::{ConfigError, NodeConfig};
pub use cotorra_ros_messages::{self as messages, DecodeError, Message, Service};
pub use http::HttpError;
pub use master::{Master, RpcError, SystemState};
pub use master_server::MasterServer;
pub use names::NameError;
pub use node::{
    CallError, Node, NodeError, ParamWatch, PublishOptions, Publisher, RecvError, ServiceServer,
    SubscribeOptions, Subscriber,
};
pub use tcpros::TcprosError;
pub use uri::{Endpoint, UriError};
pub use xmlrpc::{Fault, Value, XmlRpcError};

/// What is parsed, for fuzzing: none of it panics, whatever the bytes.
#[doc(hidden)]
pub fn parse_anything(bytes: &[u8]) {
    let _ = (xmlrpc::Call::from_xml(bytes).map(slave::Request::read), xmlrpc::answer_from_xml(bytes));
    let mut registry = registry::Registry::new(String::new());
    let _ = xmlrpc::Call::from_xml(bytes).map(|call| registry.answer(&call, &mut Vec::new()));
    let _ = (http::parse_request(bytes, 1 << 20), http::parse_response(bytes, true, 1 << 20));
    let _ = tcpros::Header::from_bytes(bytes);
}
