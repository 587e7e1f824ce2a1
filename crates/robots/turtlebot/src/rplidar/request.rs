//! Requests to the lidar.

const BEGIN: u8 = 0xA5;

/// A request to the lidar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Stops to measure. Has no answer.
    Stop,
    /// Restarts the device. Has no answer.
    Reset,
    /// Measures, with five bytes a sample.
    Scan,
    /// Measures, with 32 samples in a capsule.
    ExpressScan,
    /// Model, versions and number.
    Info,
    /// Whether the device is well.
    Health,
    /// Time between samples.
    SampleRate,
    /// Turns the motor, 0 to 1023; 0 stops it. Has no answer. It is for the A2's adapter.
    MotorPwm(u16),
}

impl Request {
    /// Returns the bytes of the request. Those with data end in the exclusive or of all bytes before.
    pub fn encode(self) -> Vec<u8> {
        let (command, data): (u8, &[u8]) = match self {
            Self::Stop => (0x25, &[]),
            Self::Reset => (0x40, &[]),
            Self::Scan => (0x20, &[]),
            Self::ExpressScan => (0x82, &[0; 5]),
            Self::Info => (0x50, &[]),
            Self::Health => (0x52, &[]),
            Self::SampleRate => (0x59, &[]),
            Self::MotorPwm(pwm) => (0xF0, &pwm.to_le_bytes()),
        };
        let mut bytes = vec![BEGIN, command];
        if let Ok(length @ 1..) = u8::try_from(data.len()) {
            bytes.push(length);
            bytes.extend(data);
            bytes.push(bytes.iter().fold(0, |sum, byte| sum ^ byte));
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_those_of_the_protocol() {
        assert_eq!(Request::Stop.encode(), [0xA5, 0x25]);
        assert_eq!(Request::Reset.encode(), [0xA5, 0x40]);
        assert_eq!(Request::Scan.encode(), [0xA5, 0x20]);
        assert_eq!(Request::ExpressScan.encode(), [0xA5, 0x82, 0x05, 0, 0, 0, 0, 0, 0x22]);
        assert_eq!(Request::Info.encode(), [0xA5, 0x50]);
        assert_eq!(Request::Health.encode(), [0xA5, 0x52]);
        assert_eq!(Request::SampleRate.encode(), [0xA5, 0x59]);
        assert_eq!(Request::MotorPwm(660).encode(), [0xA5, 0xF0, 0x02, 0x94, 0x02, 0xC1]);
    }
}
