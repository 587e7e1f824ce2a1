//! The core's end: a robot whose ports are at an agent.

use std::time::Duration;

use cotorra_graph::{RobotFault, Timestamp, Velocity};
use cotorra_turtlebot::{Body, Readings, SILENCE, kobuki::Odometry, rplidar::Turn};

use super::message::{Motion, RobotCommand, RobotReading, RobotSession, RobotTurn};
use crate::{clock::AgentClock, run::Run};

/// A robot whose ports are at an agent.
///
/// Tell it which process of the agent reports; give it what arrives of the agent; send what [`Self::poll_command`] returns. The time in calls never falls.
#[derive(Debug)]
pub struct RemoteRobot {
    run: Run,
    /// The process of the agent that reports, and its clock.
    process: Option<(u64, AgentClock)>,
    session: Option<RobotSession>,
    /// Arrival of the newest reading, and its time of sending on the agent's clock, nanoseconds.
    heard: Option<(Timestamp, u64)>,
    /// Odometry of the sessions that are over.
    before: Odometry,
    /// The newest readings, with times on the core's clock, and the odometry since the beginning of the run.
    readings: Readings,
    /// Times on the agent's clock of the newest basic data and angular velocity.
    measured: [Option<Timestamp>; 2],
    turn: Option<Turn>,
    /// Time of sending of the session's newest turn.
    turned: Option<u64>,
    sequence: u64,
    motion: Option<Motion>,
    must_confirm: bool,
}

impl RemoteRobot {
    /// Follows a robot of this run.
    pub fn new(run: Run) -> Self {
        Self {
            run,
            process: None,
            session: None,
            heard: None,
            before: Odometry::default(),
            readings: Readings::default(),
            measured: [None; 2],
            turn: None,
            turned: None,
            sequence: 0,
            motion: None,
            must_confirm: false,
        }
    }

    /// Takes the process of the agent that reports, and its clock.
    pub fn follow(&mut self, boot: u64, clock: AgentClock) {
        self.process = Some((boot, clock));
    }

    /// Takes a reading. Ignores one of another run or process, of a session that is over, and one that is not newer than
    /// those before.
    pub fn receive(&mut self, now: Timestamp, reading: RobotReading) {
        let RobotReading { session, sent_ns, mut readings } = reading;
        if session.run != self.run || self.process.as_ref().is_none_or(|(boot, _)| *boot != session.boot) {
            return;
        }
        match self.session.filter(|its| its.boot == session.boot) {
            Some(its) if session.opening < its.opening => return,
            Some(its) if session.opening == its.opening => {
                if self.heard.is_some_and(|(_, newest)| sent_ns <= newest) {
                    return;
                }
            }
            _ => self.begin(session),
        }
        self.heard = Some((now, sent_ns));
        self.must_confirm = true;
        // A measurement keeps the time that it had, whatever is known of the clocks later.
        let measured = [readings.basic.map(|(at, _)| at), readings.angular_velocity.map(|(at, _)| at)];
        let known = [self.readings.basic.map(|(at, _)| at), self.readings.angular_velocity.map(|(at, _)| at)];
        let time = |what: usize, at: Timestamp| match known[what] {
            Some(known) if self.measured[what] == Some(at) => known,
            _ => self.to_core(now, sent_ns, at),
        };
        readings.basic = readings.basic.map(|(at, basic)| (time(0, at), basic));
        readings.angular_velocity = readings.angular_velocity.map(|(at, turns)| (time(1, at), turns));
        readings.odometry = readings.odometry.after(&self.before);
        readings.faults.sort_unstable();
        readings.faults.dedup();
        (self.measured, self.readings) = (measured, readings);
    }

    /// Takes a turn of the lidar, under the rules of readings.
    pub fn receive_turn(&mut self, now: Timestamp, turn: RobotTurn) {
        let RobotTurn { session, sent_ns, mut turn } = turn;
        if self.session != Some(session) || self.turned.is_some_and(|newest| sent_ns <= newest) {
            return;
        }
        turn.at = self.to_core(now, sent_ns, turn.at);
        (self.turn, self.turned) = (Some(turn), Some(sent_ns));
    }

    /// Returns the next command to send.
    pub fn poll_command(&mut self) -> Option<RobotCommand> {
        let (session, (_, heard_ns)) = (self.session?, self.heard?);
        let motion = self.motion.take();
        if motion.is_none() && !self.must_confirm {
            return None;
        }
        self.must_confirm = false;
        self.sequence += 1;
        Some(RobotCommand { session, sequence: self.sequence, heard_ns, motion })
    }

    /// Whether [`Self::poll_command`] returns a command.
    pub fn has_command(&self) -> bool {
        self.session.is_some() && (self.motion.is_some() || self.must_confirm)
    }

    /// Begins a session. The robot stands where it was last: its ports are opened at rest.
    fn begin(&mut self, session: RobotSession) {
        self.session = Some(session);
        self.before = self.readings.odometry.clone();
        self.measured = [None; 2];
        (self.motion, self.turned) = (None, None);
    }

    /// Converts a time of the agent's clock: by the distance of the clocks, or else as if the message took no time.
    fn to_core(&self, now: Timestamp, sent_ns: u64, at: Timestamp) -> Timestamp {
        match self.process.as_ref().and_then(|(_, clock)| clock.to_core(at.as_nanos())) {
            Some(time) => time.measured.min(now),
            None => now - Duration::from_nanos(sent_ns.saturating_sub(at.as_nanos())),
        }
    }
}

impl Body for RemoteRobot {
    fn read(&mut self, now: Timestamp) -> Readings {
        let mut readings = self.readings.clone();
        let is_silent = self.heard.is_some_and(|(at, _)| now.since(at) >= SILENCE);
        if is_silent && !readings.faults.contains(&RobotFault::Silent) {
            readings.faults.push(RobotFault::Silent);
            readings.faults.sort_unstable();
        }
        readings
    }

    fn turn(&self, known: Option<Timestamp>) -> Option<Turn> {
        self.turn.as_ref().filter(|turn| known != Some(turn.at)).cloned()
    }

    fn drive(&mut self, now: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        if let Some(fault) = self.read(now).faults.first() {
            return Err(*fault);
        }
        // A robot that was never heard is absent.
        self.motion = self.heard.map(|(_, given_ns)| Motion::Drive { velocity, given_ns });
        Ok(())
    }

    fn stop(&mut self, _now: Timestamp) {
        self.motion = Some(Motion::Stop);
    }
}
