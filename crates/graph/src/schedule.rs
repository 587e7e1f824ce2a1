//! What is to happen to links by itself: conditions that follow the time, or where a robot is.

use std::{path::PathBuf, time::Duration};

use crate::{
    conditions::ConditionChange,
    hardware::Direction,
    id::{LinkId, NodeId},
    units::Position,
};

/// What a testbed file scripts for its links.
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
    /// When.
    pub when: When,
    /// Which links.
    pub links: Vec<LinkId>,
    /// One direction, or both.
    pub direction: Option<Direction>,
    /// The change.
    pub set: ConditionChange,
}

/// When a change happens.
#[derive(Debug, Clone, PartialEq)]
pub enum When {
    /// So long after the run began.
    At(Duration),
    /// Each time that a robot comes into a polygon; also if it starts there.
    Enters {
        /// The robot.
        robot: NodeId,
        /// Three corners or more.
        area: Vec<Position>,
    },
}
