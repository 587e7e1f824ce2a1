//! Commands to the base.

use std::f64::consts::PI;

use cotorra_graph::Velocity;

use super::frames::frame;

/// Distance between the wheels, metres (`en_appendix_parameters.dox`).
pub const WHEEL_BASE: f64 = 0.230;

/// A command to the base. Each is sent in a frame of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Drives along an arc. Speed is in mm/s, and radius in mm; 0 is straight on, and 1 turns on the spot.
    BaseControl {
        /// Speed of the outer wheel, or of both straight on.
        speed: i16,
        /// Radius of the arc; its centre is on the left if it is positive.
        radius: i16,
    },
    /// Plays a note.
    Sound {
        /// 1 / (f · 0.00000275), with the frequency f in Hz.
        note: u16,
        /// Milliseconds.
        duration: u8,
    },
    /// Plays a melody, 0 to 6.
    SoundSequence(u8),
    /// Requests the versions of hardware and firmware, and the device's number.
    RequestVersions,
    /// Sets digital outputs, external power and lamps, by the bits of the specification.
    GeneralOutput(u16),
    /// Sets the gains of the wheels' controller; `None` is the factory's.
    SetGains(Option<Gains>),
    /// Requests the gains of the wheels' controller.
    GetGains,
}

/// Gains of the wheels' controller, in thousandths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it all")]
pub struct Gains {
    pub proportional: u32,
    pub integral: u32,
    pub derivative: u32,
}

/// Largest angular velocity, rad/s (180 °/s).
pub const MAX_ANGULAR_SPEED: f64 = PI;

/// Scales a velocity down to the limits of a robot with this speed limit, m/s, on the same curve. The vertical part is
/// dropped.
pub fn limited(wanted: Velocity, speed_limit: f64) -> Velocity {
    let over = (wanted.linear.abs() / speed_limit).max(wanted.angular.abs() / MAX_ANGULAR_SPEED);
    let over = over.max(1.0);
    Velocity::planar(wanted.linear / over, wanted.angular / over)
}

/// Velocities below it count as none, m/s or rad/s (`DiffDrive::velocityCommands`).
const EPSILON: f64 = 1e-4;

impl Command {
    /// Stops both wheels.
    pub const STOP: Self = Self::BaseControl { speed: 0, radius: 0 };

    /// Drives at a velocity. The conversion is that of `DiffDrive::velocityCommands` in `kobuki_core`, with b the wheel
    /// base: straight on, the speed is v, and the radius 0. On the spot, they are ω·b/2 and 1. On an arc of radius
    /// r = v/ω, the speed is that of the outer wheel, (r ± b/2)·ω. Values are rounded to whole millimetres.
    pub fn drive(velocity: Velocity) -> Self {
        let (linear, angular) = (1000.0 * velocity.linear, velocity.angular);
        let half = 1000.0 * WHEEL_BASE / 2.0;
        let radius = linear / angular;
        let (speed, radius) = if angular.abs() < EPSILON {
            (linear, 0.0)
        } else if velocity.linear.abs() < EPSILON || radius.abs() <= 1.0 {
            (half * angular, 1.0)
        } else {
            ((radius + half * radius.signum()) * angular, radius)
        };
        // Casts saturate. A radius of less than 1.5 mm would be rounded to the turn on the spot, whose meaning is another.
        let radius = if radius.abs() > 1.0 { radius.signum() * radius.abs().max(2.0) } else { radius };
        Self::BaseControl { speed: speed.round() as i16, radius: radius.round() as i16 }
    }

    /// Returns the frame with this command.
    pub fn encode(self) -> Vec<u8> {
        let part = |id: u8, data: &[u8]| {
            let length = u8::try_from(data.len()).expect("commands are short");
            frame(&[&[id, length], data].concat())
        };
        match self {
            Self::BaseControl { speed, radius } => {
                part(1, &[speed.to_le_bytes(), radius.to_le_bytes()].concat())
            }
            Self::Sound { note, duration } => {
                let [low, high] = note.to_le_bytes();
                part(3, &[low, high, duration])
            }
            Self::SoundSequence(number) => part(4, &[number]),
            // Bits 0, 1 and 3.
            Self::RequestVersions => part(9, &[0x0B, 0x00]),
            Self::GeneralOutput(flags) => part(12, &flags.to_le_bytes()),
            Self::SetGains(gains) => {
                let is_own = u8::from(gains.is_some());
                let Gains { proportional, integral, derivative } = gains.unwrap_or(Gains::FACTORY);
                let numbers = [proportional, integral, derivative].map(u32::to_le_bytes).concat();
                part(13, &[&[is_own], &numbers[..]].concat())
            }
            Self::GetGains => part(14, &[0]),
        }
    }
}

impl Gains {
    /// The factory's: 100, 0.1 and 2.
    pub const FACTORY: Self = Self { proportional: 100_000, integral: 100, derivative: 2_000 };
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn drive(linear: f64, angular: f64) -> (i16, i16) {
        match Command::drive(Velocity::planar(linear, angular)) {
            Command::BaseControl { speed, radius } => (speed, radius),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn velocities_become_speed_and_radius_as_published() {
        assert_eq!(drive(0.0, 0.0), (0, 0));
        assert_eq!(drive(0.3, 0.0), (300, 0), "straight on");
        assert_eq!(drive(-0.3, 0.00005), (-300, 0), "backward, with a turn that is none");
        assert_eq!(drive(0.0, 1.0), (115, 1), "on the spot, to the left");
        assert_eq!(drive(0.0, -2.0), (-230, 1), "and to the right");
        assert_eq!(drive(0.0005, 1.0), (115, 1), "a radius of half a millimetre is none");
        assert_eq!(drive(0.2, 0.5), (258, 400), "a left arc of 400 mm: (400 + 115) · 0.5");
        assert_eq!(drive(0.2, -0.5), (258, -400), "a right arc");
        assert_eq!(drive(-0.2, 0.5), (-258, -400), "backward");
        assert_eq!(drive(0.3, 0.001), (300, i16::MAX), "flat arcs saturate");
        assert_eq!(drive(0.0013, 1.0), (116, 2), "a small radius is not the turn on the spot");
    }

    #[test]
    fn commands_are_those_of_the_specification() {
        let payload = |command: Command| {
            let frame = command.encode();
            frame[3..frame.len() - 1].to_vec()
        };
        assert_eq!(payload(Command::BaseControl { speed: -2, radius: 1 }), [1, 4, 0xFE, 0xFF, 1, 0]);
        assert_eq!(payload(Command::Sound { note: 0x0102, duration: 100 }), [3, 3, 2, 1, 100]);
        assert_eq!(payload(Command::SoundSequence(6)), [4, 1, 6]);
        assert_eq!(payload(Command::RequestVersions), [9, 2, 0x0B, 0]);
        assert_eq!(payload(Command::GeneralOutput(0x0810)), [12, 2, 0x10, 0x08]);
        let gains = [13, 13, 0, 0xA0, 0x86, 1, 0, 100, 0, 0, 0, 0xD0, 7, 0, 0];
        assert_eq!(payload(Command::SetGains(None)), gains);
        assert_eq!(payload(Command::GetGains), [14, 1, 0]);
    }

    proptest! {
        /// By the specification, the base makes of a command the velocity that was wanted.
        #[test]
        fn the_base_drives_the_wanted_velocity(linear in -0.7..0.7_f64, angular in -3.1..3.1_f64) {
            let (speed, radius) = drive(linear, angular);
            let (speed, radius) = (f64::from(speed) / 1000.0, f64::from(radius) / 1000.0);
            let half = WHEEL_BASE / 2.0;
            let (v, w) = if radius == 0.0 {
                (speed, 0.0)
            } else if radius == 0.001 {
                (0.0, speed / half)
            } else {
                let w = speed / (radius + half * radius.signum());
                (w * radius, w)
            };
            prop_assert!((v - linear).abs() < 0.004, "{v} m/s");
            // A radius is off by a millimetre at most, and none is larger than 32.8 m.
            prop_assert!((w - angular).abs() < 0.035 + linear.abs() / 32.0, "{w} rad/s");
        }
    }
}
