//! A Kobuki as a state machine: its bytes go in with the time, and commands come out.

use std::time::Duration;

use cotorra_graph::{RobotFault, Timestamp, Velocity};

use super::{
    command::Command,
    feedback::{Basic, Feedback, Gyro, Inertia, Version},
    frames::Frames,
    odometry::Odometry,
};
use crate::device::{SILENCE, Session};

/// Time without a command after which the base is stopped, as `cmd_vel_timeout` of Kobuki's own node.
pub const COMMAND_TIMEOUT: Duration = Duration::from_millis(600);
/// Interval at which a command is repeated.
const REPEAT: Duration = Duration::from_millis(50);
/// Number of stop commands in a row, because bytes may be lost.
const STOPS: u32 = 5;
/// Interval between requests for the versions, until they are answered.
const ASK: Duration = Duration::from_secs(1);

/// A Kobuki.
///
/// A velocity is repeated 20 times a second until [`COMMAND_TIMEOUT`]. Then, at a fault, and when the port is opened, the
/// base is commanded to stop.
#[derive(Debug, Clone)]
pub struct Base {
    frames: Frames,
    odometry: Odometry,
    /// Time of the last feedback, and what it said.
    heard: Option<(Timestamp, Basic)>,
    inertia: Option<Inertia>,
    gyro: Option<Gyro>,
    firmware: Option<Version>,
    ask: Timestamp,
    motion: Motion,
    faults: Vec<RobotFault>,
}

/// State of the commands to the base.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Motion {
    Standing,
    Driving { command: Command, until: Timestamp, next: Timestamp },
    Stopping { left: u32, next: Timestamp },
}

impl Default for Base {
    fn default() -> Self {
        Self {
            frames: Frames::default(),
            odometry: Odometry::default(),
            heard: None,
            inertia: None,
            gyro: None,
            firmware: None,
            ask: Timestamp::ZERO,
            motion: Motion::Standing,
            faults: vec![RobotFault::Absent],
        }
    }
}

impl Base {
    /// Returns the odometry since the first feedback.
    pub fn odometry(&self) -> &Odometry {
        &self.odometry
    }

    /// Returns the last basic sensor data with its time of arrival.
    pub fn basic(&self) -> Option<(Timestamp, Basic)> {
        self.heard
    }

    /// Returns the angular velocity about the robot's axes, rad/s, with its time of arrival. About the vertical axis it is
    /// the calibrated one, where the base sends that.
    pub fn angular_velocity(&self) -> Option<(Timestamp, [f64; 3])> {
        let [x, y, z] = self.gyro?.angular_velocity();
        let calibrated = self.inertia.map(|inertia| (f64::from(inertia.rate) / 100.0).to_radians());
        Some((self.heard?.0, [x, y, calibrated.unwrap_or(z)]))
    }

    /// Returns the version of the firmware, once the base has answered.
    pub fn firmware(&self) -> Option<Version> {
        self.firmware
    }

    /// Returns the number of frames that were torn or corrupt.
    pub fn rejected(&self) -> u64 {
        self.frames.rejected()
    }

    /// Returns the faults as of the last call with a time. With any fault, the base is stopped and rejects velocities.
    pub fn faults(&self) -> &[RobotFault] {
        &self.faults
    }

    /// Updates the faults to `now`.
    pub fn advance(&mut self, now: Timestamp) {
        let heard = self.heard;
        let last = |holds: fn(&Basic) -> bool| heard.is_some_and(|(_, basic)| holds(&basic));
        let is_there = |fault: &RobotFault| match fault {
            RobotFault::Absent => heard.is_none(),
            RobotFault::Silent => heard.is_some_and(|(at, _)| now.since(at) >= SILENCE),
            RobotFault::Cliff => last(|basic| basic.cliff != 0),
            RobotFault::WheelDrop => last(|basic| basic.wheel_drop != 0),
            _ => false,
        };
        self.faults = RobotFault::ALL.into_iter().filter(is_there).collect();
        let is_driving = matches!(self.motion, Motion::Driving { .. });
        if is_driving && !self.faults.is_empty() {
            self.stop(now);
        }
    }

    /// Moves at this velocity until another one or the command timeout.
    ///
    /// # Errors
    /// The base's first fault. It stands still then.
    pub fn drive(&mut self, now: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        self.follow(now, now, velocity)
    }

    /// Moves at a velocity that was given at an earlier time, from which on the command timeout counts. One that is too old
    /// changes nothing.
    ///
    /// # Errors
    /// The base's first fault. It stands still then.
    pub fn follow(&mut self, now: Timestamp, given: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        self.advance(now);
        if let Some(fault) = self.faults.first() {
            return Err(*fault);
        }
        let until = given + COMMAND_TIMEOUT;
        if now < until {
            // A command that came early replaces the one before at once.
            self.motion = Motion::Driving { command: Command::drive(velocity), until, next: now };
        }
        Ok(())
    }

    /// Stops the base.
    pub fn stop(&mut self, now: Timestamp) {
        self.motion = Motion::Stopping { left: STOPS, next: now };
    }
}

impl Session for Base {
    fn connected(&mut self, now: Timestamp) {
        self.frames.clear();
        self.ask = now;
        // The base may still follow the last command of a program that was killed.
        self.stop(now);
        self.advance(now);
    }

    fn receive(&mut self, now: Timestamp, bytes: &[u8]) {
        let Self { frames, odometry, heard, inertia, gyro, firmware, .. } = self;
        frames.feed(bytes, |payload| {
            let (mut basic, mut turned) = (None, None);
            for feedback in Feedback::all(payload) {
                match feedback {
                    Feedback::Basic(its) => basic = Some(its),
                    Feedback::Inertia(its) => turned = Some(its),
                    Feedback::Gyro(its) => *gyro = Some(its),
                    Feedback::Firmware(its) => *firmware = Some(its),
                    _ => {}
                }
            }
            if let Some(basic) = basic {
                odometry.update(now, basic, turned);
                *heard = Some((now, basic));
                *inertia = turned.or(*inertia);
            }
        });
        self.advance(now);
    }

    fn poll_transmit(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        self.advance(now);
        if let Motion::Driving { until, .. } = self.motion
            && now >= until
        {
            self.stop(now);
        }
        match &mut self.motion {
            Motion::Driving { command, next, .. } if now >= *next => {
                *next = now + REPEAT;
                return Some(command.encode());
            }
            Motion::Stopping { left, next } if now >= *next => {
                (*left, *next) = (*left - 1, now + REPEAT);
                if *left == 0 {
                    self.motion = Motion::Standing;
                }
                return Some(Command::STOP.encode());
            }
            _ => {}
        }
        if self.firmware.is_none() && now >= self.ask {
            self.ask = now + ASK;
            return Some(Command::RequestVersions.encode());
        }
        None
    }

    fn next_deadline(&self, now: Timestamp) -> Option<Timestamp> {
        let motion = match self.motion {
            Motion::Standing => None,
            Motion::Driving { until, next, .. } => Some(until.min(next)),
            Motion::Stopping { next, .. } => Some(next),
        };
        let silent = self.heard.map(|(at, _)| at + SILENCE).filter(|at| *at > now);
        let ask = self.firmware.is_none().then_some(self.ask);
        motion.into_iter().chain(silent).chain(ask).min()
    }

    fn farewell(&mut self) -> Vec<u8> {
        (0..STOPS).flat_map(|_| Command::STOP.encode()).collect()
    }
}

#[cfg(test)]
mod tests;
