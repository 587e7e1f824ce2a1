//! A robot at an agent: what the core and the agent say to each other beside wanted state and reports, many times a second.
//!
//! The agent sends [readings](RobotReading) and [turns](RobotTurn) of the lidar; the core answers each with a
//! [command](RobotCommand), also one that says nothing new. A command to drive has the time of the last reading that the core
//! had. The command timeout counts from then, on the agent's clock alone: however long a command was under way, the robot
//! stops in time. Messages are lost, doubled and overtaken without harm.

mod driven;
mod message;
mod remote;

pub use driven::DrivenRobot;
pub use message::{
    Motion, RobotCommand, RobotReading, RobotSession, RobotState, RobotTurn, TurnError, WantedRobot,
};
pub use remote::RemoteRobot;

#[cfg(test)]
mod tests;
