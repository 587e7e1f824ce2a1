#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod buffers;
mod config;
mod http;
mod master;
mod master_server;
mod names;
mod node;
mod notices;
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

/// Parses bytes as everything that peers send. For fuzzing: no bytes make it panic.
#[doc(hidden)]
pub fn parse_anything(bytes: &[u8]) {
    let _ = (xmlrpc::Call::from_xml(bytes).map(slave::Request::read), xmlrpc::answer_from_xml(bytes));
    let mut registry = registry::Registry::new(String::new());
    let _ = xmlrpc::Call::from_xml(bytes)
        .map(|call| registry.answer(std::net::Ipv4Addr::LOCALHOST.into(), &call, &mut Vec::new()));
    let _ = (http::parse_request(bytes, 1 << 20), http::parse_response(bytes, true, 1 << 20));
    let _ = tcpros::Header::from_bytes(bytes);
    let _ = (messages::LaserScan::decode_ros1(bytes), messages::TFMessage::decode_ros1(bytes));
    let _ = (messages::OccupancyGrid::decode_ros1(bytes), messages::BatteryState::decode_ros1(bytes));
    let _ = (messages::Imu::decode_ros1(bytes), messages::Float64MultiArray::decode_ros1(bytes));
    let _ = (messages::Image::decode_ros1(bytes), messages::CompressedImage::decode_ros1(bytes));
}
