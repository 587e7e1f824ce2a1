//! Goals that robots are given, and what becomes of them.

use serde::{Deserialize, Serialize};

use crate::{id::NodeId, units::Position};

/// What became of a goal that a robot was given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct GoalEvent {
    /// The robot.
    pub robot: NodeId,
    /// The goal.
    pub goal: Position,
    /// What became of it.
    pub state: GoalState,
    /// Of progress: how much is left of the way there, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remaining_m: Option<f64>,
    /// Of a failure: why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The life of a goal. It ends once: reached, replaced, canceled or failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    /// It was taken back before the robot was there.
    Canceled,
    /// No way leads there; the robot stands.
    Failed,
}

impl GoalState {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Set, Self::Progress, Self::Reached, Self::Replaced, Self::Canceled, Self::Failed];

    /// Its name, as in JSON.
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
