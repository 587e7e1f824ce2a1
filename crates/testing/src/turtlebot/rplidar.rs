//! An RPLIDAR A2: turns clockwise ten times a second, and measures 4000 times a second in an express scan, and 2000 times in
//! a standard scan.

use std::time::Duration;

use super::{Place, Wall, cast};

/// Microseconds between samples.
const EXPRESS: u32 = 250;
const STANDARD: u32 = 500;
/// Degrees per second.
const SPEED: f64 = 3600.0;
/// Metres.
const FARTHEST: f64 = 12.0;

/// An RPLIDAR A2.
#[derive(Debug, Clone, Default)]
pub struct Rplidar {
    /// The walls that it sees.
    pub walls: Vec<Wall>,
    /// The robot's place. The lidar is in its middle, and looks ahead.
    pub place: Place,
    /// Drive of the motor. Without it, there are no samples.
    pub motor: u16,
    /// Whether its firmware is too old for an express scan.
    pub is_old: bool,
    /// Code of an error that a restart ends.
    pub error: u16,
    /// Whether it says nothing.
    pub is_silent: bool,
    /// Commands so far.
    pub commands: Vec<u8>,
    scan: Option<Scan>,
    input: Vec<u8>,
    output: Vec<u8>,
}

#[derive(Debug, Clone, Copy)]
struct Scan {
    is_express: bool,
    is_first: bool,
    /// Time of the next sample.
    at: Duration,
}

impl Rplidar {
    /// Creates one between these walls, on a robot that stands there.
    pub fn new(walls: Vec<Wall>, place: Place) -> Self {
        Self { walls, place, ..Self::default() }
    }

    /// Returns the bytes that it sent since the last call.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Takes bytes of the driver.
    pub fn receive(&mut self, now: Duration, bytes: &[u8]) {
        self.advance(now);
        self.input.extend(bytes);
        while self.input.len() >= 2 {
            assert_eq!(self.input[0], 0xA5, "{:02X?}", self.input);
            let command = self.input[1];
            let mut data = Vec::new();
            if command & 0x80 != 0 {
                let Some(&length) = self.input.get(2) else { return };
                let end = 3 + usize::from(length);
                let Some(&sum) = self.input.get(end) else { return };
                assert_eq!(self.input[..end].iter().fold(0, |sum, byte| sum ^ byte), sum);
                data.extend(&self.input[3..end]);
                self.input.drain(..=end);
            } else {
                self.input.drain(..2);
            }
            self.command(now, command, &data);
        }
    }

    fn command(&mut self, now: Duration, command: u8, data: &[u8]) {
        self.commands.push(command);
        if self.is_silent {
            return;
        }
        let begins = |is_express| Some(Scan { is_express, is_first: true, at: now });
        match command {
            0x25 => self.scan = None,
            0x40 => {
                (self.scan, self.error) = (None, 0);
                self.output.extend(b"RP LIDAR System.\r\n");
            }
            0x20 => {
                self.output.extend([0xA5, 0x5A, 0x05, 0, 0, 0x40, 0x81]);
                self.scan = begins(false);
            }
            0x82 if !self.is_old => {
                assert_eq!(data, [0; 5]);
                self.output.extend([0xA5, 0x5A, 0x54, 0, 0, 0x40, 0x82]);
                self.scan = begins(true);
            }
            0x50 => {
                self.output.extend([0xA5, 0x5A, 0x14, 0, 0, 0, 0x04, 0x28, 0x1D, 0x01, 0x06]);
                self.output.extend([7; 16]);
            }
            0x52 => {
                let [low, high] = self.error.to_le_bytes();
                let status = if self.error == 0 { 0 } else { 2 };
                self.output.extend([0xA5, 0x5A, 0x03, 0, 0, 0, 0x06, status, low, high]);
            }
            0x59 if !self.is_old => {
                let [standard, express] = [STANDARD, EXPRESS].map(|us| (us as u16).to_le_bytes());
                self.output.extend([0xA5, 0x5A, 0x04, 0, 0, 0, 0x15]);
                self.output.extend([standard, express].concat());
            }
            0xF0 => self.motor = u16::from_le_bytes([data[0], data[1]]),
            // Old firmware ignores what it does not know.
            0x59 | 0x82 => {}
            other => panic!("an unexpected command: {other:#x}"),
        }
    }

    /// Measures until now.
    pub fn advance(&mut self, now: Duration) {
        while let Some(mut scan) = self.scan {
            let interval = Duration::from_micros(if scan.is_express { EXPRESS } else { STANDARD }.into());
            let samples = if scan.is_express { 32 } else { 1 };
            let end = scan.at + interval * samples;
            if end > now {
                return;
            }
            if !self.is_silent && self.motor > 0 {
                if scan.is_express {
                    self.capsule(scan, interval)
                } else {
                    self.node(scan, interval)
                }
                scan.is_first = false;
            }
            scan.at = end;
            self.scan = Some(scan);
        }
    }

    /// Returns the range in a direction, metres; 0 beyond the farthest.
    fn range(&self, clockwise: f64) -> f64 {
        let range = cast(&self.walls, &self.place, self.place.heading - clockwise.to_radians());
        range.filter(|range| *range < FARTHEST).unwrap_or(0.0)
    }

    fn angle(at: Duration) -> f64 {
        (at.as_secs_f64() * SPEED).rem_euclid(360.0)
    }

    fn capsule(&mut self, scan: Scan, interval: Duration) {
        let start = Self::angle(scan.at);
        let mark = if scan.is_first { 0x8000 } else { 0 };
        let mut body = ((start * 64.0) as u16 | mark).to_vec();
        for cabin in 0..16 {
            // A correction of 2.5° is subtracted again: 20 eighths, of which the upper two bits are with the distance.
            let distance = |i: u32| {
                let raw = Self::angle(scan.at + interval * (2 * cabin + i));
                let millimetres = self.range((raw - 2.5).rem_euclid(360.0)) * 1000.0;
                (millimetres as u16) << 2 | 20 >> 4
            };
            body.extend([distance(0).to_vec(), distance(1).to_vec()].concat());
            body.push((20 & 0xF) << 4 | 20 & 0xF);
        }
        let sum = body.iter().fold(0, |sum, byte| sum ^ byte);
        self.output.extend([0xA0 | sum & 0xF, 0x50 | sum >> 4]);
        self.output.extend(body);
    }

    fn node(&mut self, scan: Scan, interval: Duration) {
        let angle = Self::angle(scan.at);
        let is_first = angle < Self::angle(scan.at.saturating_sub(interval));
        let quarters = ((self.range(angle) * 4000.0) as u16).to_vec();
        self.output.push(if is_first { 0b1000_1001 } else { 0b1000_1010 });
        self.output.extend((((angle * 64.0) as u16) << 1 | 1).to_vec());
        self.output.extend(quarters);
    }
}

/// Numbers in the order of bytes of both protocols.
trait ToVec {
    fn to_vec(self) -> Vec<u8>;
}

impl ToVec for u16 {
    fn to_vec(self) -> Vec<u8> {
        self.to_le_bytes().into()
    }
}
