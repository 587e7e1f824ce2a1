//! The goal of a robot as a state machine: reports progress, and ends once.

use std::time::Duration;

use cotorra_graph::{GoalEvent, GoalState, NodeId, Position, Timestamp};
use cotorra_plugin::wire::Headway;

/// Shortest interval between two progress events.
const PROGRESS: Duration = Duration::from_secs(1);

/// A goal that a robot goes to in place of its walk.
#[derive(Debug, Clone)]
pub(crate) struct Goal {
    position: Position,
    /// Whether the robot reached it or failed. The robot stands from then on.
    ended: bool,
    /// Time of the last event.
    reported: Timestamp,
}

impl Goal {
    pub fn new(now: Timestamp, position: Position) -> Self {
        Self { position, ended: false, reported: now }
    }

    pub fn position(&self) -> Position {
        self.position
    }

    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// Records how far the robot has come, and returns the event to report, if any.
    pub fn update(&mut self, now: Timestamp, robot: &NodeId, headway: &Headway) -> Option<GoalEvent> {
        let (state, remaining_m, reason) = match headway {
            _ if self.ended => return None,
            Headway::Left(_) if now.since(self.reported) < PROGRESS => return None,
            Headway::Left(metres) => (GoalState::Progress, Some(*metres), None),
            Headway::Arrived => (GoalState::Reached, None, None),
            Headway::Blocked(reason) => (GoalState::Failed, None, Some(reason.clone())),
        };
        self.ended = state != GoalState::Progress;
        self.reported = now;
        Some(GoalEvent { remaining_m, reason, ..self.event(robot, state) })
    }

    /// Returns the event that reports this state.
    pub fn event(&self, robot: &NodeId, state: GoalState) -> GoalEvent {
        GoalEvent { robot: robot.clone(), goal: self.position, state, remaining_m: None, reason: None }
    }
}
