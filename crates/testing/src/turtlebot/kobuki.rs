//! A Kobuki: follows the last base control, and reports 50 times a second. It does not stop by itself.

use std::time::Duration;

use super::Place;

const STEP: Duration = Duration::from_millis(20);
/// Millimetres.
const WHEEL_BASE: f64 = 230.0;
const TICKS_PER_METRE: f64 = 11_724.416_58;

/// A Kobuki.
#[derive(Debug, Clone, Default)]
pub struct Kobuki {
    /// Its true place.
    pub place: Place,
    /// Pressed bumpers, dropped wheels, and cliffs, as bits of the protocol.
    pub bumper: u8,
    pub wheel_drop: u8,
    pub cliff: u8,
    /// Every base control so far: time, speed in mm/s, and radius in mm.
    pub controls: Vec<(Duration, i16, i16)>,
    /// Whether it says nothing.
    pub is_silent: bool,
    steps: u32,
    /// Way of the left and the right wheel, metres.
    wheels: [f64; 2],
    is_asked: bool,
    input: Vec<u8>,
    output: Vec<u8>,
}

impl Kobuki {
    /// Creates one that stands there.
    pub fn at(place: Place) -> Self {
        Self { place, ..Self::default() }
    }

    /// Returns the bytes that it sent since the last call.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Returns the velocity that it was commanded: m/s and rad/s.
    pub fn velocity(&self) -> (f64, f64) {
        let &(_, speed, radius) = self.controls.last().unwrap_or(&(Duration::ZERO, 0, 0));
        let (speed, radius) = (f64::from(speed), f64::from(radius));
        if radius == 0.0 {
            (speed / 1000.0, 0.0)
        } else if radius == 1.0 {
            (0.0, speed * 2.0 / WHEEL_BASE)
        } else {
            let turn =
                speed / if radius > 0.0 { radius + WHEEL_BASE / 2.0 } else { radius - WHEEL_BASE / 2.0 };
            (turn * radius / 1000.0, turn)
        }
    }

    /// Takes bytes of the driver.
    pub fn receive(&mut self, now: Duration, bytes: &[u8]) {
        self.advance(now);
        self.input.extend(bytes);
        while self.input.len() >= 3 {
            if self.input[..2] != [0xAA, 0x55] {
                self.input.remove(0);
                continue;
            }
            let end = 3 + usize::from(self.input[2]);
            let Some(&sum) = self.input.get(end) else { return };
            let frame: Vec<u8> = self.input.drain(..=end).collect();
            assert_eq!(frame[2..end].iter().fold(0, |sum, byte| sum ^ byte), sum, "{frame:02X?}");
            let short = |at: usize| i16::from_le_bytes([frame[at], frame[at + 1]]);
            match (frame[3], frame[4]) {
                (1, 4) => self.controls.push((now, short(5), short(7))),
                (9, 2) => self.is_asked = short(5) & 0x02 != 0,
                other => panic!("an unexpected command: {other:?}"),
            }
        }
    }

    /// Moves, and reports.
    pub fn advance(&mut self, now: Duration) {
        while STEP * (self.steps + 1) <= now {
            self.steps += 1;
            let (linear, angular) = self.velocity();
            let seconds = STEP.as_secs_f64();
            let half = angular * WHEEL_BASE / 2000.0;
            self.wheels[0] += (linear - half) * seconds;
            self.wheels[1] += (linear + half) * seconds;
            let middle = self.place.heading + angular * seconds / 2.0;
            self.place.x += linear * seconds * middle.cos();
            self.place.y += linear * seconds * middle.sin();
            self.place.heading += angular * seconds;
            if !self.is_silent {
                self.report(angular);
            }
        }
    }

    fn report(&mut self, angular: f64) {
        let [left, right] =
            self.wheels.map(|way| ((way * TICKS_PER_METRE).floor() as i64 as u16).to_le_bytes());
        let stamp = ((STEP * self.steps).as_millis() as u16).to_le_bytes();
        let mut payload = vec![1, 15, stamp[0], stamp[1], self.bumper, self.wheel_drop, self.cliff];
        payload.extend([left[0], left[1], right[0], right[1], 0, 0, 0, 0, 160, 0]);
        payload.extend([3, 3, 0, 0, 0]);
        // Hundredths of degrees in ±180°.
        let turned = (self.place.heading.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
        let [angle, rate] =
            [turned, angular.to_degrees()].map(|degrees| ((degrees * 100.0) as i16).to_le_bytes());
        payload.extend([4, 7, angle[0], angle[1], rate[0], rate[1], 0, 0, 0]);
        payload.extend([5, 6, 0, 8, 0, 8, 0, 8, 6, 2, 3, 3]);
        let raw = ((angular.to_degrees() / 0.00875) as i16).to_le_bytes();
        payload.extend([13, 14, self.steps as u8, 6, 0, 0, 0, 0, raw[0], raw[1], 0, 0, 0, 0, raw[0], raw[1]]);
        payload.extend([16, 16]);
        payload.extend([0; 16]);
        if std::mem::take(&mut self.is_asked) {
            payload.extend([10, 4, 4, 0, 1, 0, 11, 4, 0, 2, 1, 0]);
            payload.extend([19, 12, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0]);
        }
        let length = u8::try_from(payload.len()).unwrap();
        let sum = payload.iter().fold(length, |sum, byte| sum ^ byte);
        self.output.extend([0xAA, 0x55, length]);
        self.output.extend(payload);
        self.output.push(sum);
    }
}
