//! Flows: requests of programs that are no part of cotorra, and their answers, whose time is a service's.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{id::NodeId, units::millis};

/// A flow between a client on one node and a server on any other, measured at the client's port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Flow {
    /// The client's node.
    pub from: NodeId,
    /// A request without an answer after so long is lost.
    #[serde(rename = "timeout_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub timeout: Duration,
    /// Protocol between the two.
    #[serde(flatten)]
    pub protocol: FlowProtocol,
}

/// Protocol of a flow: it defines requests and answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "protocol")]
pub enum FlowProtocol {
    /// A datagram to a port, and the datagram from there that answers it.
    Udp {
        /// The server's port.
        port: u16,
        /// Bytes that an answer repeats of its request. Without them, a socket has one request under way at a time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        id: Option<FlowId>,
    },
    /// A client's bytes on a connection until the server's next first byte.
    Tcp {
        /// The server's port.
        port: u16,
    },
    /// A request of HTTP/1 or HTTP/2, and the last byte of the response.
    Http {
        /// The server's port.
        port: u16,
        /// Requests of this path alone, whatever their query.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        path: Option<String>,
    },
    /// A message of one topic of ROS 1 that the node publishes, and one of another topic to which it subscribes.
    Ros1 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// Bytes that an answer repeats of its request. Without them, one request is under way at a time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        id: Option<FlowId>,
    },
    /// A call of a service of ROS 1, and its result.
    Ros1Service {
        /// The service.
        service: String,
    },
    /// A message of one topic of ROS 2 that the node publishes, and one of another topic to which it subscribes.
    Ros2 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// Bytes that an answer repeats of its request. Without them, one request is under way at a time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        id: Option<FlowId>,
    },
    /// A call of a service of ROS 2, and its reply.
    Ros2Service {
        /// The service.
        service: String,
    },
    /// A goal of an action of ROS 2, and its result.
    Ros2Action {
        /// The action.
        action: String,
    },
}

/// Bytes of a datagram's payload, or of a message, that the answer repeats at the same place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FlowId {
    /// Index of the first byte.
    pub offset: u8,
    /// Number of bytes.
    pub length: u8,
}

impl FlowId {
    /// The most bytes that it can have.
    pub const MOST: u8 = 16;
    /// The farthest place at which it can begin.
    pub const FARTHEST: u8 = 200;
}
