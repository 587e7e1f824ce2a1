//! Real machines, radios and networks that nodes of G stand for.

use std::{collections::BTreeMap, net::Ipv4Addr};

use serde::{Deserialize, Serialize};

use crate::{
    exposure::IpNetwork,
    id::{AgentId, NodeId},
};

/// The real machine that a server is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RealServer {
    /// The agent that starts VNFs there.
    pub agent: AgentId,
    /// Through this interface of this machine, as `ip link` names it. Several real servers can share it.
    pub interface: String,
    /// Network namespace of the interface: a name of `ip netns`, or an absolute path; `None` for this machine's.
    pub netns: Option<String>,
    /// Its address there.
    #[schema(value_type = String)]
    pub address: Ipv4Addr,
}

/// A Wi-Fi interface of a real machine: the radio of a robot, or of a radio unit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RealRadio {
    /// The agent of the machine.
    pub agent: AgentId,
    /// The interface, as `iw dev` names it there.
    pub interface: String,
    /// The bridge that an access point joins; `None` for that in which the interface is found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bridge: Option<String>,
}

/// A gateway: joins an interface to the emulated network. Packets pass between the hosts and the real machines behind it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Gateway {
    /// The interface, as `ip link` names it.
    pub interface: String,
    /// Network namespace of the interface: a name of `ip netns`, or an absolute path; `None` for this machine's.
    pub netns: Option<String>,
    /// Addresses of the real machines behind it, by name. No other machine passes.
    #[schema(value_type = BTreeMap<String, String>)]
    pub machines: BTreeMap<NodeId, Ipv4Addr>,
}

impl Gateway {
    /// Real machines behind a gateway, at most.
    pub const MAX_MACHINES: usize = 64;
}

/// A real machine: this one, that of an agent, or one that is reached through an interface of such a machine. Only the link
/// to it is emulated: on that interface, for the packets that whatever programs send there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Machine {
    /// Interface and address by which it is reached; `None` for this machine, or one via whose agent others are reached.
    pub reached: Option<Reached>,
    /// The agent that reports its context.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<AgentId>,
}

/// Interface and address of another real machine.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Reached {
    /// The agent on whose machine the interface is; `None` for this machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub via: Option<AgentId>,
    /// Through this interface, as `ip link` names it.
    pub interface: String,
    /// Addresses of the machine; `None` for everything behind the interface that no other machine has.
    #[schema(value_type = Option<String>)]
    pub address: Option<IpNetwork>,
    /// Whether a reflector of STAMP (RFC 8762) is at its address, by which a run measures the delay of the medium before
    /// it begins, and then what the link does. An agent measures only the latter.
    #[serde(default)]
    pub reflector: bool,
}

impl Reached {
    /// Machines that are reached via one agent, at most.
    pub const MOST_VIA_AGENT: usize = 256;
}
