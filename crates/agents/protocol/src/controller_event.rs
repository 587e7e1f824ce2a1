//! Events that the core receives of its agents.

use cotorra_engine::EngineEvent;
use cotorra_graph::{AgentId, LinkId};
use cotorra_wifi::InterfaceName;

use crate::{
    link::LinkState,
    robot::RobotState,
    wifi::{RadioEvent, RadioState, RequestError},
};

/// Something that happened to an agent, or to an instance on its machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ControllerEvent {
    /// An agent reports, for the first time or again.
    Joined(AgentId),
    /// An agent does not report any more, with the reason.
    Left(AgentId, String),
    /// The outcome of an instance.
    Instance(EngineEvent),
    /// The robot of an agent has another state.
    Robot(AgentId, RobotState),
    /// A link over an interface of an agent's machine has another state.
    Link(AgentId, LinkId, LinkState),
    /// A wanted Wi-Fi interface of an agent's machine has another state.
    Radio(AgentId, InterfaceName, RadioState),
    /// The program of a Wi-Fi interface took a request, or refused it with this reason.
    Request(AgentId, u64, Result<(), RequestError>),
    /// The program of a Wi-Fi interface reports an event.
    Wifi(AgentId, RadioEvent),
}
