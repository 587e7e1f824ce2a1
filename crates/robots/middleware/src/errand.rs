//! A goal that a robot was given, as a state machine: what is told of it, and when it ends.

use std::time::Duration;

use cotorra_graph::{GoalEvent, GoalState, NodeId, Position, Timestamp};
use cotorra_plugin::wire::Headway;

/// Progress is told no more often.
const PROGRESS: Duration = Duration::from_secs(1);

/// A goal that a robot was given.
#[derive(Debug, Clone)]
pub(crate) struct Errand {
    goal: Position,
    /// The robot was there, or cannot get there: it stands.
    ended: bool,
    /// When it was last told of.
    told: Timestamp,
}

impl Errand {
    pub fn new(now: Timestamp, goal: Position) -> Self {
        Self { goal, ended: false, told: now }
    }

    pub fn goal(&self) -> Position {
        self.goal
    }

    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// Takes in how far the robot is, and returns what is to be told of it.
    pub fn hear(&mut self, now: Timestamp, robot: &NodeId, headway: &Headway) -> Option<GoalEvent> {
        let (state, remaining_m, reason) = match headway {
            _ if self.ended => return None,
            Headway::Left(_) if now.since(self.told) < PROGRESS => return None,
            Headway::Left(metres) => (GoalState::Progress, Some(*metres), None),
            Headway::Arrived => (GoalState::Reached, None, None),
            Headway::Blocked(reason) => (GoalState::Failed, None, Some(reason.clone())),
        };
        self.ended = state != GoalState::Progress;
        self.told = now;
        Some(GoalEvent { remaining_m, reason, ..self.event(robot, state) })
    }

    /// What is told when something becomes of it.
    pub fn event(&self, robot: &NodeId, state: GoalState) -> GoalEvent {
        GoalEvent { robot: robot.clone(), goal: self.goal, state, remaining_m: None, reason: None }
    }
}
