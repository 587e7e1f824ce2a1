//! Slows robots where their radio is weak: radio units report the signal of each station, ι(R), and the Robot Middleware
//! limits the robot's speed.
//!
//! It gains way, not time: a robot goes on with its last command while it waits for an answer, and a slow one goes
//! less far meanwhile. docs/use/pace.md has figures.
#![forbid(unsafe_code)]

mod settings;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Dbm, Event, Instruction, NodeId, Testbed, Timestamp};
use cotorra_plugin::{Actions, Plugin, settings::InvalidSettings};

pub use crate::settings::Settings;

/// Shortest time between two orders to a robot.
const HOLD: Duration = Duration::from_secs(1);

/// Slows robots where their radio is weak.
#[derive(Debug)]
pub struct Pace {
    settings: Settings,
    robots: BTreeMap<NodeId, Known>,
}

/// State of a robot.
#[derive(Debug, Clone, Copy, Default)]
struct Known {
    /// Speed limit in its last context.
    limit: Option<f64>,
    /// Time of the last instruction to it.
    told: Option<Timestamp>,
}

/// The speed limit that a robot is to have, m/s, by the signal that its radio unit receives from it; none is the weakest.
/// Between the two signals of the settings it keeps the limit that it has, and it keeps one that is stricter.
pub fn pace(signal: Option<Dbm>, limit: Option<f64>, settings: &Settings) -> Option<f64> {
    let signal = signal.map_or(f64::NEG_INFINITY, |signal| signal.0);
    let slow = settings.speed_mps;
    if signal < settings.weak_dbm {
        Some(limit.map_or(slow, |limit| limit.min(slow)))
    } else if signal > settings.strong_dbm && limit == Some(slow) {
        None
    } else {
        limit
    }
}

impl Pace {
    /// Reads the settings of a testbed file, [`Settings`].
    ///
    /// # Errors
    /// [`InvalidSettings`] for a setting that does not exist, or that has no such value.
    pub fn from_settings(
        settings: &serde_json::Map<String, serde_json::Value>,
    ) -> Result<Self, InvalidSettings> {
        Ok(Self { settings: Settings::decode(settings)?, robots: BTreeMap::new() })
    }

    /// Tells a robot its speed limit, if it is to have another.
    fn tell(&mut self, now: Timestamp, robot: &NodeId, signal: Option<Dbm>, actions: &mut Actions) {
        let Some(known) = self.robots.get_mut(robot) else { return };
        let speed_limit_mps = pace(signal, known.limit, &self.settings);
        let held = known.told.is_some_and(|told| now.since(told) < HOLD);
        if speed_limit_mps == known.limit || held {
            return;
        }
        known.told = Some(now);
        let reason = match signal {
            Some(signal) => format!("it is received with {:.1} dBm", signal.0),
            None => "it has no radio unit".to_owned(),
        };
        actions.instruct_because(Instruction::LimitSpeed { robot: robot.clone(), speed_limit_mps }, reason);
    }
}

impl Plugin for Pace {
    fn start(&mut self, _now: Timestamp, testbed: &Testbed, _actions: &mut Actions) {
        let robots = testbed.graph.robots().map(|(node, _)| (node.id.clone(), Known::default()));
        self.robots = robots.collect();
    }

    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions) {
        match event {
            Event::Robot(context) => {
                if let Some(known) = self.robots.get_mut(&context.robot) {
                    known.limit = context.speed_limit_mps;
                }
            }
            Event::Radio(context) => {
                for station in &context.stations {
                    self.tell(now, &station.robot, Some(station.signal), actions);
                }
            }
            Event::Detached { robot, .. } => self.tell(now, robot, None, actions),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests;
