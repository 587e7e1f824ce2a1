//! The agent's end: drives a robot as the core orders, and passes its reports on.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{RobotModel, Timestamp};
use cotorra_turtlebot::{Body, Turtlebot, kobuki::limited};

use super::message::{Motion, RobotCommand, RobotReading, RobotSession, RobotTurn};

/// Interval of readings.
const INTERVAL: Duration = Duration::from_millis(50);
/// Readings under way to a core that has not confirmed them, at most. Further ones wait, and only the newest is sent then: a
/// slow network delays readings by half a second, and no more.
const MOST_UNDER_WAY: usize = 10;
/// Time without a confirmation after which the oldest of them counts as lost.
const LOST: Duration = Duration::from_millis(500);

/// A robot at open ports, which the core drives. When it is dropped, the robot is left at rest.
///
/// Give it each command; call [`Self::poll`] at [`Self::next_deadline`]. The time in calls never falls.
pub struct DrivenRobot {
    session: RobotSession,
    turtlebot: Turtlebot,
    /// Sequence number of the last command.
    sequence: u64,
    next: Timestamp,
    /// Times of sending of readings that are not confirmed.
    under_way: VecDeque<Timestamp>,
    /// Time of the last turn that was sent.
    turn: Option<Timestamp>,
}

impl DrivenRobot {
    /// Drives a robot whose ports were opened at `now`.
    pub fn new(now: Timestamp, session: RobotSession, turtlebot: Turtlebot) -> Self {
        Self { session, turtlebot, sequence: 0, next: now, under_way: VecDeque::new(), turn: None }
    }

    /// Takes a command. Ignores one of another session, and one that is not newer than those before. A velocity counts from
    /// the time at which it was given at the earliest, so that one that comes late drives for a shorter time, or not at all.
    pub fn receive(&mut self, now: Timestamp, command: &RobotCommand) {
        let RobotCommand { session, sequence, heard_ns, motion } = *command;
        if session != self.session || sequence <= self.sequence {
            return;
        }
        self.sequence = sequence;
        while self.under_way.front().is_some_and(|sent| sent.as_nanos() <= heard_ns) {
            self.under_way.pop_front();
        }
        match motion {
            Some(Motion::Drive { velocity, given_ns }) if velocity.is_finite() => {
                // No clock but the agent's own counts, and that is not ahead of itself.
                let given = Timestamp::from_nanos(given_ns).min(now);
                let velocity = limited(velocity, RobotModel::Turtlebot2.max_speed());
                // The core learns of faults by readings.
                let _ = self.turtlebot.follow(now, given, velocity);
            }
            Some(Motion::Drive { .. } | Motion::Stop) => self.turtlebot.stop(now),
            None => {}
        }
    }

    /// Returns the reading to send now, with a turn if there is a new one.
    pub fn poll(&mut self, now: Timestamp) -> Option<(RobotReading, Option<RobotTurn>)> {
        // It stops itself at a fault when it is read.
        let readings = self.turtlebot.read(now);
        if now < self.next {
            return None;
        }
        self.next = now + INTERVAL;
        if self.under_way.len() == MOST_UNDER_WAY {
            if self.under_way.back().is_some_and(|sent| now < *sent + LOST) {
                return None;
            }
            self.under_way.pop_front();
        }
        self.under_way.push_back(now);
        let (session, sent_ns) = (self.session, now.as_nanos());
        let turn = self.turtlebot.turn(self.turn);
        self.turn = turn.as_ref().map(|turn| turn.at).or(self.turn);
        let turn = turn.map(|turn| RobotTurn { session, sent_ns, turn });
        Some((RobotReading { session, sent_ns, readings }, turn))
    }

    /// Returns the time at which [`Self::poll`] has something to do.
    pub fn next_deadline(&self) -> Timestamp {
        self.next
    }
}
