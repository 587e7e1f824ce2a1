//! The protocol between the core and its agents, without a clock or sockets.
//!
//! The core sends each agent its **wanted state**: all that shall run there, with a generation. It sends it whole, again until
//! the agent reports this generation, and a **beat** several times in each lease. The [`Agent`] saves the wanted state,
//! starts and stops what differs, and **reports** all that runs. [`Controller`] is the core's end. Messages can be lost,
//! doubled and overtaken, and both ends can be killed at any time; what runs is still what is wanted in the end.
//!
//! An agent that gets no beat for a lease stops all that shall not go on without the core. A core that gets no report for a
//! lease counts such instances as dead.
//!
//! [Links](WantedLink) over interfaces of its machine are part of the wanted state. They have their conditions only as long as
//! the agent hears the core.
//!
//! So are [Wi-Fi interfaces](WantedWifi), which are their owner's again when the agent does not hear the core.
//!
//! A [robot](WantedRobot) at an agent is part of the wanted state, too. Its readings and commands go beside it, between a
//! [`DrivenRobot`] and a [`RemoteRobot`].
#![forbid(unsafe_code)]

mod action;
mod agent;
mod clock;
mod controller;
mod controller_event;
mod encoding;
mod link;
mod machine_reading;
mod message;
mod robot;
mod run;
mod shipped;
mod wifi;

pub use action::Action;
pub use agent::{Agent, RADIOS_KEPT};
pub use clock::AgentClock;
pub use controller::{Controller, Transmit};
pub use controller_event::ControllerEvent;
pub use encoding::MessageError;
pub use link::{LinkReading, LinkState, WantedLink, WantedProbes};
pub use machine_reading::MachineReading;
pub use message::{Beat, Echo, InstanceState, LEASE, Report, Wanted, WantedInstance};
pub use robot::{
    DrivenRobot, Motion, RemoteRobot, RobotCommand, RobotReading, RobotSession, RobotState, RobotTurn,
    TurnError, WantedRobot,
};
pub use run::Run;
pub use shipped::Shipped;
pub use wifi::{
    LastEvent, MOST_HEARD, MOST_RADIOS, RadioEvent, RadioState, RequestError, RequestState, WantedRadio,
    WantedRequest, WantedWifi, WifiReport, WifiRequest,
};
