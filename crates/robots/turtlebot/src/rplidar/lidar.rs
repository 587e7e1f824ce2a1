//! An RPLIDAR A2 as a state machine: its bytes go in with the time, and requests come out.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{
    answers::{Answer, Answers, Health},
    capsule::Capsule,
    request::Request,
    turns::{Sample, Turn, Turns},
};
use crate::device::Session;

/// Time after a stop in which the lidar may still send samples; LR001 asks for 1 ms.
const QUIET: Duration = Duration::from_millis(20);
/// Time of a restart, with the text that the lidar sends then.
const RESTART: Duration = Duration::from_secs(1);
/// Longest time until an answer.
const ANSWER: Duration = Duration::from_millis(500);
/// Longest time between samples, in which the motor also gets up to speed.
const SILENCE: Duration = Duration::from_secs(3);
/// Rate of samples of an express scan unless the lidar says another: 4000 a second.
const EXPRESS_INTERVAL: Duration = Duration::from_micros(250);
/// Samples in a capsule behind its first.
const BEHIND: u32 = 31;

/// Settings of a lidar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LidarSettings {
    /// Drive of the motor, 1 to 1023.
    pub motor_pwm: u16,
}

impl Default for LidarSettings {
    /// 660, as in `rplidar_sdk`: about ten turns a second.
    fn default() -> Self {
        Self { motor_pwm: 660 }
    }
}

/// An RPLIDAR A2.
///
/// It is stopped, asked who it is and whether it is well, and started in an express scan; in a standard scan if it has no
/// express one. A lidar that does not answer, or stops to send samples, is started again.
#[derive(Debug, Clone)]
pub struct Lidar {
    settings: LidarSettings,
    answers: Answers,
    stage: Stage,
    outbox: VecDeque<Request>,
    turns: Turns,
    interval: Duration,
    /// The last capsule, whose angles wait for the next, and its time.
    waiting: Option<(Timestamp, Capsule)>,
    is_express: bool,
    /// Whether an express scan began, and no sample came.
    has_no_express: bool,
    heard: Option<Timestamp>,
    info: Option<(u8, (u8, u8))>,
    health: Option<Health>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// There is no port.
    Absent,
    /// Until then, input is ignored.
    Quiet(Timestamp),
    /// This was asked, with a time limit.
    Asked(Request, Timestamp),
    /// It measures. Its last sample, or its start, was then.
    Scanning(Timestamp),
}

impl Lidar {
    /// Creates a lidar without bytes so far.
    pub fn new(settings: LidarSettings) -> Self {
        Self {
            settings,
            answers: Answers::default(),
            stage: Stage::Absent,
            outbox: VecDeque::new(),
            turns: Turns::default(),
            interval: EXPRESS_INTERVAL,
            waiting: None,
            is_express: true,
            has_no_express: false,
            heard: None,
            info: None,
            health: None,
        }
    }

    /// Returns the last complete turn.
    pub fn turn(&self) -> Option<&Turn> {
        self.turns.complete()
    }

    /// Returns the time of the last sample.
    pub fn heard(&self) -> Option<Timestamp> {
        self.heard
    }

    /// Returns its model, and the version of its firmware, once it has answered.
    pub fn info(&self) -> Option<(u8, (u8, u8))> {
        self.info
    }

    /// Returns its own judgement of its health, once it has answered.
    pub fn health(&self) -> Option<Health> {
        self.health
    }

    /// Returns the number of answers that were torn or corrupt.
    pub fn rejected(&self) -> u64 {
        self.answers.rejected()
    }

    /// Stops the lidar, and starts it anew after a while.
    fn begin(&mut self, now: Timestamp, request: Request, pause: Duration) {
        self.outbox.clear();
        self.outbox.push_back(request);
        self.turns.restart();
        self.waiting = None;
        self.stage = Stage::Quiet(now + pause);
    }

    fn ask(&mut self, now: Timestamp, request: Request) {
        self.outbox.push_back(request);
        self.stage = Stage::Asked(request, now + ANSWER);
    }

    fn start(&mut self, now: Timestamp) {
        self.outbox.push_back(Request::MotorPwm(self.settings.motor_pwm));
        self.outbox.push_back(if self.is_express { Request::ExpressScan } else { Request::Scan });
        self.stage = Stage::Scanning(now);
    }

    /// Goes on when time is up.
    fn advance(&mut self, now: Timestamp) {
        match self.stage {
            Stage::Quiet(until) if now >= until => {
                self.answers.reset();
                self.ask(now, Request::Info);
            }
            // Firmware before 1.17 does not know it, nor the express scan.
            Stage::Asked(Request::SampleRate, until) if now >= until => {
                self.is_express = false;
                self.start(now);
            }
            Stage::Asked(_, until) if now >= until => self.begin(now, Request::Stop, QUIET),
            Stage::Scanning(last) if now >= last + SILENCE => {
                // Later models may answer an express scan in another form.
                self.has_no_express |= self.is_express && self.heard.is_none_or(|heard| heard < last);
                self.begin(now, Request::Stop, QUIET);
            }
            _ => {}
        }
    }

    fn answer(&mut self, now: Timestamp, answer: Answer) {
        match (self.stage, answer) {
            (Stage::Asked(Request::Info, _), Answer::Info { model, firmware }) => {
                self.info = Some((model, firmware));
                self.ask(now, Request::Health);
            }
            (Stage::Asked(Request::Health, _), Answer::Health(health)) => {
                self.health = Some(health);
                match health {
                    // LR001: only a restart ends the protection stop.
                    Health::Error(_) => self.begin(now, Request::Reset, RESTART),
                    Health::Good | Health::Warning(_) => self.ask(now, Request::SampleRate),
                }
            }
            (Stage::Asked(Request::SampleRate, _), Answer::SampleRate { express, .. }) => {
                self.interval = Duration::from_micros(express.into());
                self.is_express = !self.has_no_express;
                self.start(now);
            }
            (Stage::Scanning(_), Answer::Node { angle, range, .. }) => self.sample(now, now, (angle, range)),
            (Stage::Scanning(_), Answer::Capsule(capsule)) => {
                let before = self.waiting.replace((now, capsule));
                let Some((at, before)) = before.filter(|_| capsule.follows && !capsule.is_first) else {
                    return;
                };
                // A capsule is sent when its last sample was measured.
                let first = at - self.interval * BEHIND;
                for (i, sample) in (0..).zip(before.samples(&capsule)) {
                    self.sample(now, first + self.interval * i, sample);
                }
            }
            _ => {}
        }
    }

    fn sample(&mut self, now: Timestamp, at: Timestamp, (angle, range): (f64, f32)) {
        self.stage = Stage::Scanning(now);
        self.heard = Some(now);
        self.turns.add(at, Sample { angle, range: (range > 0.0).then_some(range) });
    }
}

impl Session for Lidar {
    fn connected(&mut self, now: Timestamp) {
        self.has_no_express = false;
        self.begin(now, Request::Stop, QUIET);
    }

    fn receive(&mut self, now: Timestamp, bytes: &[u8]) {
        self.advance(now);
        let mut answers = std::mem::take(&mut self.answers);
        answers.feed(bytes, |answer| self.answer(now, answer));
        self.answers = answers;
    }

    fn poll_transmit(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        self.advance(now);
        self.outbox.pop_front().map(Request::encode)
    }

    fn next_deadline(&self, _now: Timestamp) -> Option<Timestamp> {
        match self.stage {
            Stage::Absent => None,
            Stage::Quiet(until) | Stage::Asked(_, until) => Some(until),
            Stage::Scanning(last) => Some(last + SILENCE),
        }
    }

    fn farewell(&mut self) -> Vec<u8> {
        [Request::Stop, Request::MotorPwm(0)].into_iter().flat_map(Request::encode).collect()
    }
}

#[cfg(test)]
mod tests;
