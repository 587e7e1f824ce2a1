//! Time that robots' radios spend on frames.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Direction, NodeId};

use super::{Path, Radio, RadioUnitIndex, emitter::Emitter};

/// Time that a robot's radio spent on frames, retries included. With contention, that is the time of the frames themselves and of
/// requests to send. Where senders take turns, it is that of whole turns, which include backoffs and acknowledgements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Airtime {
    /// Time of frames that it sent.
    pub sending: Duration,
    /// Time of frames that were for it, whether it could decode them or not.
    pub receiving: Duration,
}

impl Radio {
    /// Returns the airtime of each robot so far.
    pub(crate) fn airtimes(&self) -> BTreeMap<NodeId, Airtime> {
        self.robots.iter().map(|robot| (robot.id.clone(), robot.airtime)).collect()
    }

    /// Counts the time of a frame between a robot and its radio unit.
    pub(super) fn count_turn(&mut self, path: Path, time: Duration) {
        let airtime = &mut self.robots[path.robot].airtime;
        match path.direction {
            Direction::Forward => airtime.sending += time,
            Direction::Backward => airtime.receiving += time,
        }
    }

    /// Counts the time of a frame to all stations of a radio unit.
    pub(super) fn count_group(&mut self, unit: RadioUnitIndex, time: Duration) {
        for robot in &self.units[unit].stations {
            self.robots[*robot].airtime.receiving += time;
        }
    }

    /// Counts the time of a frame for who sent it, if that is the radio of a robot.
    pub(super) fn count_sent(&mut self, sender: Emitter, time: Duration) {
        if let Emitter::Robot(robot) = sender {
            self.robots[robot].airtime.sending += time;
        }
    }

    /// Counts the time of a frame for whom it was sent to, if that is the radio of a robot.
    pub(super) fn count_received(&mut self, receiver: Emitter, time: Duration) {
        if let Emitter::Robot(robot) = receiver {
            self.robots[robot].airtime.receiving += time;
        }
    }
}
