//! Scripted conditions of links: by time, or by where a robot is.

use std::{path::PathBuf, time::Duration};

use crate::{
    conditions::ConditionChange,
    hardware::Direction,
    id::{LinkId, NodeId},
    units::Position,
};

/// Scripted conditions of a testbed's links.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Script {
    /// A recorded run whose conditions are played: its folder, or an export.
    pub replay: Option<PathBuf>,
    /// Changes, in the file's order.
    pub schedule: Vec<Scheduled>,
}

/// A change of some links that happens by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Scheduled {
    /// Time or place of the change.
    pub when: When,
    /// The links.
    pub links: Vec<LinkId>,
    /// One direction, or both.
    pub direction: Option<Direction>,
    /// The change.
    pub set: ConditionChange,
}

/// Time or place of a scripted change.
#[derive(Debug, Clone, PartialEq)]
pub enum When {
    /// Time since the run began.
    At(Duration),
    /// Each time that a robot comes into a polygon; also if it starts there.
    Enters {
        /// The robot.
        robot: NodeId,
        /// Three corners or more.
        area: Vec<Position>,
    },
}
