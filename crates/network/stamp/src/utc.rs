//! Points in time, their NTP and PTP formats in packets, and the error estimates of clocks.

use std::{
    ops::{Add, Sub},
    time::Duration,
};

/// Seconds from 1900, where NTP begins, to 1970.
const NTP_TO_UNIX_S: u64 = 2_208_988_800;
const NS_PER_S: u64 = 1_000_000_000;

/// A point in time: nanoseconds since 1970, until the year 2554.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Utc(u64);

impl Utc {
    /// 1970-01-01T00:00:00Z.
    pub const UNIX_EPOCH: Self = Self(0);

    /// Returns the time since an earlier point; zero if that is later.
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Returns the nanoseconds since another point; negative if that is later, as may happen with two clocks.
    pub(crate) fn minus(self, other: Self) -> i64 {
        self.0.wrapping_sub(other.0).cast_signed()
    }

    /// Encodes the 64 bits of a packet. Seconds count from 1900 (NTP; RFC 5905, section 6) or from 1970 (PTP;
    /// IEEE 1588-2008, section 5.3.3, the last 32 bits of the seconds), and wrap around.
    pub(crate) fn to_wire(self, format: Format) -> [u8; 8] {
        let (s, ns) = (self.0 / NS_PER_S, self.0 % NS_PER_S);
        let (high, low) = match format {
            // Rounds up, because decoding rounds down: that gives the same nanosecond.
            Format::Ntp => (s + NTP_TO_UNIX_S, ((ns << 32).div_ceil(NS_PER_S)) & 0xffff_ffff),
            Format::Ptp => (s, ns),
        };
        ((high << 32) | low).to_be_bytes()
    }

    /// Decodes the 64 bits of a packet, in the era (136 years) closest to `near`.
    pub(crate) fn from_wire(bytes: [u8; 8], format: Format, near: Self) -> Self {
        let bits = u64::from_be_bytes(bytes);
        let (s, fraction) = ((bits >> 32) as u32, bits & 0xffff_ffff);
        let (s, ns) = match format {
            Format::Ntp => (s.wrapping_sub(NTP_TO_UNIX_S as u32), (fraction * NS_PER_S) >> 32),
            Format::Ptp => (s, fraction.min(NS_PER_S - 1)),
        };
        let near_s = near.0 / NS_PER_S;
        let ahead = s.wrapping_sub(near_s as u32).cast_signed();
        Self(near_s.saturating_add_signed(ahead.into()).saturating_mul(NS_PER_S).saturating_add(ns))
    }
}

impl Add<Duration> for Utc {
    type Output = Self;

    fn add(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl Sub<Duration> for Utc {
    type Output = Self;

    fn sub(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)))
    }
}

/// The format of timestamps: the Z bit of an error estimate (RFC 8186).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Format {
    Ntp,
    Ptp,
}

/// The error estimate of a clock (RFC 4656, section 4.1.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorEstimate {
    /// Whether the clock is synchronised to UTC by an external source. One-way delays need this.
    pub synchronized: bool,
    pub(crate) format: Format,
    scale: u8,
    multiplier: u8,
}

impl ErrorEstimate {
    /// Creates the estimate of a clock with NTP timestamps. Rounds the error up to the next value of the format.
    pub fn new(synchronized: bool, error: Duration) -> Self {
        // Error = multiplier x 2^(scale - 32) seconds.
        let mut units = ((error.as_nanos() << 32).div_ceil(u128::from(NS_PER_S))).max(1);
        let mut scale = 0;
        while units > 0xff {
            units = units.div_ceil(2);
            scale += 1;
        }
        let format = Format::Ntp;
        Self { synchronized, format, scale: scale.min(0x3f), multiplier: units as u8 }
    }

    /// Returns the estimated error.
    pub fn error(self) -> Duration {
        let units = u128::from(self.multiplier) << self.scale;
        let ns = units.saturating_mul(u128::from(NS_PER_S)) >> 32;
        Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    pub(crate) fn to_wire(self) -> [u8; 2] {
        let flags = (u8::from(self.synchronized) << 7) | (u8::from(self.format == Format::Ptp) << 6);
        [flags | self.scale, self.multiplier]
    }

    /// Decodes an estimate; `None` if the multiplier is zero, which marks a packet as corrupt.
    pub(crate) fn from_wire([first, multiplier]: [u8; 2]) -> Option<Self> {
        (multiplier > 0).then_some(Self {
            synchronized: first & 0x80 != 0,
            format: if first & 0x40 != 0 { Format::Ptp } else { Format::Ntp },
            scale: first & 0x3f,
            multiplier,
        })
    }
}

/// The estimate of an unsynchronised clock with an internal error of one microsecond.
impl Default for ErrorEstimate {
    fn default() -> Self {
        Self::new(false, Duration::from_micros(1))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn timestamps_have_the_formats_of_ntp_and_ptp() {
        // 2021-01-18T00:00:00.5Z.
        let time = Utc(1_610_928_000_500_000_000);
        assert_eq!(
            time.to_wire(Format::Ntp),
            (((1_610_928_000 + NTP_TO_UNIX_S) << 32) | 1 << 31).to_be_bytes()
        );
        assert_eq!(time.to_wire(Format::Ptp), ((1_610_928_000 << 32) | 500_000_000_u64).to_be_bytes());
    }

    #[test]
    fn the_next_era_of_ntp_is_decoded() {
        // NTP's seconds wrap around in February 2036.
        let (before, after) = (Utc(2_085_978_495 * NS_PER_S), Utc(2_085_978_497 * NS_PER_S));
        assert_eq!(Utc::from_wire(after.to_wire(Format::Ntp), Format::Ntp, before), after);
        assert_eq!(Utc::from_wire(before.to_wire(Format::Ntp), Format::Ntp, after), before);
    }

    #[test]
    fn errors_are_rounded_up() {
        for ns in [0, 1, 59, 1_000, 1_000_000, 3_600 * NS_PER_S] {
            let estimate = ErrorEstimate::new(true, Duration::from_nanos(ns));
            assert!(estimate.error().as_nanos() as u64 + 1 >= ns, "{ns}: {estimate:?}");
            assert!(estimate.error().as_nanos() as f64 <= ns as f64 * 1.02 + 2.0, "{ns}: {estimate:?}");
        }
    }

    proptest! {
        #[test]
        fn timestamps_survive_the_wire(ns in 0..4_000_000_000_000_000_000_u64, off_s in -2_000_000_000..2_000_000_000_i64) {
            let time = Utc(ns);
            let near = Utc((ns / NS_PER_S).saturating_add_signed(off_s) * NS_PER_S);
            for format in [Format::Ntp, Format::Ptp] {
                prop_assert_eq!(Utc::from_wire(time.to_wire(format), format, near), time);
            }
        }

        #[test]
        fn estimates_survive_the_wire(bytes: [u8; 2]) {
            if let Some(estimate) = ErrorEstimate::from_wire(bytes) {
                prop_assert_eq!(estimate.to_wire(), bytes);
            } else {
                prop_assert_eq!(bytes[1], 0);
            }
        }
    }
}
