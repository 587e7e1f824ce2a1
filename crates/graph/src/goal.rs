//! Goals that robots are given, and what becomes of them.

use serde::{Deserialize, Serialize};

use crate::{id::NodeId, units::Position};

/// Change of a robot's goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct GoalEvent {
    /// The robot.
    pub robot: NodeId,
    /// The goal.
    pub goal: Position,
    /// Its new state.
    pub state: GoalState,
    /// Length of the way that is left, metres; with [`GoalState::Progress`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remaining_m: Option<f64>,
    /// Reason of a failure; with [`GoalState::Failed`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The life of a goal. It ends once: reached, replaced, canceled or failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum GoalState {
    /// The robot was given it.
    Set,
    /// The robot is on its way; once a second at most.
    Progress,
    /// The robot is there, and stands.
    Reached,
    /// The robot was given another before it was there.
    Replaced,
    /// Canceled before the robot was there.
    Canceled,
    /// No way leads there; the robot stands.
    Failed,
}

impl GoalState {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Set, Self::Progress, Self::Reached, Self::Replaced, Self::Canceled, Self::Failed];

    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Set => "set",
            Self::Progress => "progress",
            Self::Reached => "reached",
            Self::Replaced => "replaced",
            Self::Canceled => "canceled",
            Self::Failed => "failed",
        }
    }
}
