//! Messages to the thread of agents.

use std::sync::Arc;

use cotorra_agent_protocol::{WantedInstance, WantedLink};
use cotorra_agent_transport::FromAgent;
use cotorra_engine::InstanceId;
use cotorra_graph::{AgentId, LinkId};

use crate::wifi::{Place, Wish};

/// A message to the thread.
pub(super) enum Command {
    Start(AgentId, InstanceId, Box<WantedInstance>),
    Stop(InstanceId),
    /// An agent shall emulate a link like this.
    Emulate(AgentId, LinkId, Box<WantedLink>),
    /// The core has a wish for a Wi-Fi interface.
    Radio(Place, Wish),
    /// A command to a robot is to be sent.
    Wake,
    /// Something arrived from an agent. The last part is held until it is handled, to bound the number that waits.
    Arrived(AgentId, FromAgent, Arc<()>),
    /// Stop everything, and end.
    End,
}
