//! Feedback of the base, which comes 50 times a second.

use serde::{Deserialize, Serialize};

use super::{command::Gains, frames::parts};

/// One part of the base's feedback.
#[derive(Debug, Clone, PartialEq)]
pub enum Feedback {
    /// Basic sensor data.
    Basic(Basic),
    /// Signals of the docking station at the right, central and left receiver.
    DockingIr([u8; 3]),
    /// Heading and its rate.
    Inertia(Inertia),
    /// Converted voltages of the right, central and left cliff sensor, 0 to 4095.
    Cliff([u16; 3]),
    /// Currents of the left and the right motor, in 10 mA.
    Current([u8; 2]),
    /// Version of the hardware.
    Hardware(Version),
    /// Version of the firmware.
    Firmware(Version),
    /// Raw readings of the gyro.
    Gyro(Gyro),
    /// Digital inputs, and four analogue ones, 0 to 4095.
    Inputs(u16, [u16; 4]),
    /// Number of the device.
    DeviceId([u32; 3]),
    /// Gains of the wheels' controller, and whether they are the user's.
    Gains(bool, Gains),
}

/// Basic sensor data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Basic {
    /// The base's clock, milliseconds. It wraps.
    pub stamp: u16,
    /// Pressed bumpers: 1 right, 2 centre, 4 left.
    pub bumper: u8,
    /// Dropped wheels: 1 right, 2 left.
    pub wheel_drop: u8,
    /// Cliffs: 1 right, 2 centre, 4 left.
    pub cliff: u8,
    /// Encoder of the left wheel, ticks. It wraps.
    pub left: u16,
    /// Encoder of the right wheel, ticks. It wraps.
    pub right: u16,
    /// State of the charger.
    pub charger: u8,
    /// Voltage of the battery, tenths of a volt.
    pub battery: u8,
}

impl Basic {
    /// Returns the voltage of the battery.
    pub fn volts(&self) -> f64 {
        f64::from(self.battery) / 10.0
    }

    /// Returns the charge of the battery, 0 to 1, as `Battery::percent` in `kobuki_core`: 5 % at 13.2 V and 100 % at
    /// 16.5 V, and also when the charger reports a full battery.
    pub fn charge(&self) -> f64 {
        const CHARGED: u8 = 2;
        if self.charger & 0x0F == CHARGED {
            return 1.0;
        }
        (0.05 + 0.95 * (self.volts() - 13.2) / (16.5 - 13.2)).clamp(0.0, 1.0)
    }
}

/// Heading by the base's gyro, calibrated in the factory, in hundredths of degrees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inertia {
    /// Heading, counter-clockwise. It wraps.
    pub angle: i16,
    /// Its rate, per second.
    pub rate: i16,
}

/// Version of hardware or firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names say it all")]
pub struct Version {
    pub major: u8,
    pub minor: u8,
    pub patch: u8,
}

impl std::fmt::Display for Version {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// Last of the gyro's raw readings in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gyro {
    /// Number of the frame's first reading.
    pub number: u8,
    /// In 0.00875 °/s, about the axes of the sensor.
    pub raw: [i16; 3],
}

impl Gyro {
    /// Returns the angular velocity about the robot's axes, rad/s. The sensor is mounted 90° counter-clockwise, as the
    /// specification says.
    pub fn angular_velocity(&self) -> [f64; 3] {
        const DEGREES_PER_DIGIT: f64 = 0.00875;
        let [x, y, z] = self.raw.map(|digits| (f64::from(digits) * DEGREES_PER_DIGIT).to_radians());
        [-y, x, z]
    }
}

impl Feedback {
    /// Returns the parts of a frame's payload. Unknown ones, and those of another length, are left out.
    pub fn all(payload: &[u8]) -> impl Iterator<Item = Self> {
        parts(payload).flatten().filter_map(|(id, data)| Self::decode(id, data))
    }

    fn decode(id: u8, data: &[u8]) -> Option<Self> {
        let short = |at: usize| u16::from_le_bytes([data[at], data[at + 1]]);
        let signed = |at: usize| i16::from_le_bytes([data[at], data[at + 1]]);
        let long = |at: usize| u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]);
        let version = || Version { patch: data[0], minor: data[1], major: data[2] };
        Some(match (id, data.len()) {
            (1, 15) => Self::Basic(Basic {
                stamp: short(0),
                bumper: data[2],
                wheel_drop: data[3],
                cliff: data[4],
                left: short(5),
                right: short(7),
                charger: data[12],
                battery: data[13],
            }),
            (3, 3) => Self::DockingIr([data[0], data[1], data[2]]),
            (4, 7) => Self::Inertia(Inertia { angle: signed(0), rate: signed(2) }),
            (5, 6) => Self::Cliff([short(0), short(2), short(4)]),
            (6, 2) => Self::Current([data[0], data[1]]),
            (10, 4) => Self::Hardware(version()),
            (11, 4) => Self::Firmware(version()),
            (13, 8..) if data.len() == 2 + 2 * usize::from(data[1]) && data[1].is_multiple_of(3) => {
                let last = data.len() - 6;
                Self::Gyro(Gyro { number: data[0], raw: [0, 2, 4].map(|axis| signed(last + axis)) })
            }
            (16, 16) => Self::Inputs(short(0), [2, 4, 6, 8].map(short)),
            (19, 12) => Self::DeviceId([0, 4, 8].map(long)),
            (21, 13) => {
                let [proportional, integral, derivative] = [1, 5, 9].map(long);
                Self::Gains(data[0] == 1, Gains { proportional, integral, derivative })
            }
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(payload: &[u8]) -> Feedback {
        let [feedback] = &Feedback::all(payload).collect::<Vec<_>>()[..] else { panic!("{payload:?}") };
        feedback.clone()
    }

    #[test]
    fn feedback_is_that_of_the_specification() {
        let basic = [1, 15, 0x10, 0x27, 4, 1, 2, 0xFF, 0xFF, 0x02, 0x01, 10, 0xF6, 0, 22, 165, 0];
        let Feedback::Basic(basic) = only(&basic) else { panic!("another part") };
        let expected = Basic {
            stamp: 10_000,
            bumper: 4,
            wheel_drop: 1,
            cliff: 2,
            left: 65_535,
            right: 258,
            charger: 22,
            battery: 165,
        };
        assert_eq!(basic, expected);
        assert_eq!(only(&[3, 3, 1, 2, 32]), Feedback::DockingIr([1, 2, 32]));
        let inertia = Inertia { angle: -9000, rate: 300 };
        assert_eq!(only(&[4, 7, 0xD8, 0xDC, 0x2C, 1, 0, 0, 0]), Feedback::Inertia(inertia));
        assert_eq!(only(&[5, 6, 1, 0, 2, 0, 0xFF, 0x0F]), Feedback::Cliff([1, 2, 4095]));
        assert_eq!(only(&[6, 2, 5, 7]), Feedback::Current([5, 7]));
        let Feedback::Firmware(version) = only(&[11, 4, 4, 1, 1, 0]) else { panic!("another part") };
        assert_eq!(version.to_string(), "1.1.4");
        assert!(matches!(
            only(&[10, 4, 4, 0, 1, 0]),
            Feedback::Hardware(Version { major: 1, minor: 0, patch: 4 })
        ));
        let inputs = [16, 16, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(only(&inputs), Feedback::Inputs(1, [2, 3, 4, 5]));
        let id = [19, 12, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0xFF];
        assert_eq!(only(&id), Feedback::DeviceId([1, 2, 0xFF00_0003]));
        let gains = [21, 13, 1, 0xA0, 0x86, 1, 0, 100, 0, 0, 0, 0xD0, 7, 0, 0];
        assert_eq!(only(&gains), Feedback::Gains(true, Gains::FACTORY));
    }

    #[test]
    fn last_raw_reading_of_the_gyro_is_turned_to_the_robots_axes() {
        let payload = [13, 14, 7, 6, 1, 0, 2, 0, 3, 0, 0x10, 0x27, 0xF0, 0xD8, 100, 0];
        let Feedback::Gyro(gyro) = only(&payload) else { panic!("another part") };
        assert_eq!(gyro, Gyro { number: 7, raw: [10_000, -10_000, 100] });
        let wanted = [87.5_f64, 87.5, 0.875].map(f64::to_radians);
        let found = gyro.angular_velocity();
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn unknown_parts_and_lengths_are_left_out() {
        assert_eq!(Feedback::all(&[99, 1, 0, 6, 2, 5, 7, 4, 1, 0, 13, 8, 0, 4, 0, 0, 0, 0, 0, 0]).count(), 1);
    }

    #[test]
    fn charge_follows_the_voltage_as_published() {
        let charge = |battery, charger| {
            let basic =
                Basic { stamp: 0, bumper: 0, wheel_drop: 0, cliff: 0, left: 0, right: 0, charger, battery };
            basic.charge()
        };
        assert_eq!((charge(165, 0), charge(132, 0), charge(100, 0)), (1.0, 0.05, 0.0));
        assert!((charge(150, 6) - (0.05 + 0.95 * 1.8 / 3.3)).abs() < 1e-12);
        assert_eq!((charge(160, 2), charge(160, 18)), (1.0, 1.0), "the charger knows better");
    }
}
