//! Units of figures.

/// The unit of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Milliseconds.
    Millis,
    /// Microseconds.
    Micros,
    /// Metres.
    Metres,
    /// m/s.
    Speed,
    /// Radians.
    Radians,
    /// rad/s.
    TurningRate,
    /// bit/s.
    BitRate,
    /// dBm.
    Power,
    /// Watt hours.
    Energy,
    /// Packets.
    Packets,
    /// Bytes.
    Bytes,
    /// A share, 0 to 1.
    Share,
    /// A bare number.
    Number,
}

impl Unit {
    /// Returns the symbol of the unit in which figures are; empty for a share and a bare number.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Millis => "ms",
            Self::Micros => "µs",
            Self::Metres => "m",
            Self::Speed => "m/s",
            Self::Radians => "rad",
            Self::TurningRate => "rad/s",
            Self::BitRate => "bit/s",
            Self::Power => "dBm",
            Self::Energy => "Wh",
            Self::Packets => "packets",
            Self::Bytes => "bytes",
            Self::Share | Self::Number => "",
        }
    }

    /// Returns the units that a limit can have, each with its size in that of figures. The first is the usual one.
    pub(super) const fn written(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Millis => {
                &[("ms", 1.0), ("s", 1e3), ("min", 6e4), ("us", 1e-3), ("µs", 1e-3), ("ns", 1e-6)]
            }
            Self::Micros => &[("µs", 1.0), ("us", 1.0), ("ms", 1e3), ("s", 1e6), ("ns", 1e-3)],
            Self::Metres => &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("km", 1e3)],
            Self::Speed => &[("m/s", 1.0)],
            Self::Radians => &[("rad", 1.0), ("deg", std::f64::consts::PI / 180.0)],
            Self::TurningRate => &[("rad/s", 1.0)],
            Self::BitRate => &[("Mbit/s", 1e6), ("bit/s", 1.0), ("kbit/s", 1e3), ("Gbit/s", 1e9)],
            Self::Power => &[("dBm", 1.0)],
            Self::Energy => &[("Wh", 1.0), ("mWh", 1e-3), ("kWh", 1e3)],
            Self::Packets => &[("packets", 1.0)],
            Self::Bytes => &[("MB", 1e6), ("bytes", 1.0), ("kB", 1e3), ("GB", 1e9)],
            Self::Share => &[("%", 1e-2)],
            Self::Number => &[("", 1.0)],
        }
    }

    /// Writes a value as people read it: a share in percent, all others with at most six digits.
    pub fn describe(self, value: f64) -> String {
        let (unit, factor) = match self {
            Self::Share => ("%", 1e-2),
            other => (other.symbol(), 1.0),
        };
        let value = value / factor;
        let digits = value.abs().log10();
        let decimals = if digits.is_finite() { (5 - digits.floor() as i32).clamp(0, 6) as usize } else { 0 };
        let text = format!("{value:.decimals$}");
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        if unit.is_empty() { text.to_owned() } else { format!("{text} {unit}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_written_with_their_unit_and_without_idle_digits() {
        assert_eq!(Unit::Share.describe(0.991_234_567), "99.1235 %");
        assert_eq!(Unit::Millis.describe(15.0), "15 ms");
        assert_eq!(Unit::Metres.describe(0.1), "0.1 m");
        assert_eq!(Unit::Number.describe(1200.0), "1200");
        assert_eq!(Unit::Number.describe(0.0), "0");
        assert_eq!(Unit::BitRate.describe(2.5e7), "25000000 bit/s");
    }
}
