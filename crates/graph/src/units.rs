//! Units as types, so that a figure in milliseconds never meets one in seconds, nor a rate one in bytes.

use std::{
    f64::consts::{PI, TAU},
    fmt,
    time::Duration,
};

use serde::{Deserialize, Serialize};

/// A point in time: nanoseconds since the run began. Real and virtual time share it.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Default,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
)]
#[serde(transparent)]
pub struct Timestamp(u64);

impl Timestamp {
    /// The beginning of the run.
    pub const ZERO: Self = Self(0);
    /// Later than any time that a run reaches.
    pub const MAX: Self = Self(u64::MAX);

    /// The time that lies `nanos` nanoseconds after the run began.
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos)
    }

    /// The time that lies `seconds` after the run began; negative and NaN give the beginning.
    pub fn from_secs_f64(seconds: f64) -> Self {
        Self((seconds * 1e9) as u64)
    }

    /// Nanoseconds since the run began.
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Seconds since the run began.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / 1e9
    }

    /// Time passed since `earlier`; zero if `earlier` is not earlier.
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

impl std::ops::Add<Duration> for Timestamp {
    type Output = Self;
    fn add(self, rhs: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(rhs.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl std::ops::Sub<Duration> for Timestamp {
    type Output = Self;
    fn sub(self, rhs: Duration) -> Self {
        Self(self.0.saturating_sub(u64::try_from(rhs.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} s", self.as_secs_f64())
    }
}

/// A bit rate in bit/s; never zero.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[schema(value_type = u64)]
#[serde(try_from = "u64", into = "u64")]
pub struct BitRate(std::num::NonZeroU64);

impl BitRate {
    /// A rate in bit/s; `None` for zero, which no link can serve.
    pub const fn from_bits_per_second(rate: u64) -> Option<Self> {
        match std::num::NonZeroU64::new(rate) {
            Some(rate) => Some(Self(rate)),
            None => None,
        }
    }

    /// A rate in Mbit/s (10⁶ bit/s); `None` below 1 bit/s, and for NaN.
    pub fn from_mbps(rate: f64) -> Option<Self> {
        Self::from_bits_per_second((rate * 1e6).round() as u64)
    }

    /// bit/s.
    pub const fn bits_per_second(self) -> u64 {
        self.0.get()
    }

    /// Mbit/s.
    pub fn mbps(self) -> f64 {
        self.bits_per_second() as f64 / 1e6
    }

    /// Returns the time to serialise `bytes` at this rate, rounded up to the nanosecond.
    pub fn serialisation(self, bytes: usize) -> Duration {
        let bits = bytes as u128 * 8;
        Duration::from_nanos((bits * 1_000_000_000).div_ceil(u128::from(self.bits_per_second())) as u64)
    }
}

impl From<BitRate> for u64 {
    fn from(rate: BitRate) -> Self {
        rate.bits_per_second()
    }
}

impl TryFrom<u64> for BitRate {
    type Error = &'static str;
    fn try_from(rate: u64) -> Result<Self, Self::Error> {
        Self::from_bits_per_second(rate).ok_or("a bit rate is above 0 bit/s")
    }
}

impl fmt::Display for BitRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.bits_per_second() {
            rate @ 1_000_000_000.. => write!(f, "{} Gbit/s", rate as f64 / 1e9),
            rate @ 1_000_000.. => write!(f, "{} Mbit/s", rate as f64 / 1e6),
            rate @ 1_000.. => write!(f, "{} kbit/s", rate as f64 / 1e3),
            rate => write!(f, "{rate} bit/s"),
        }
    }
}

/// A probability or a share, in 0..=1; never NaN.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(value_type = f64)]
#[serde(try_from = "f64", into = "f64")]
pub struct Probability(f64);

impl Probability {
    /// Never.
    pub const ZERO: Self = Self(0.0);
    /// Always.
    pub const ONE: Self = Self(1.0);

    /// `None` outside 0..=1, and for NaN.
    pub fn new(p: f64) -> Option<Self> {
        (0.0..=1.0).contains(&p).then_some(Self(p))
    }

    /// The number in 0..=1.
    pub const fn get(self) -> f64 {
        self.0
    }
}

impl From<Probability> for f64 {
    fn from(p: Probability) -> Self {
        p.0
    }
}

impl TryFrom<f64> for Probability {
    type Error = &'static str;
    fn try_from(p: f64) -> Result<Self, Self::Error> {
        Self::new(p).ok_or("a probability is between 0 and 1")
    }
}

/// Power in dBm (decibels over one milliwatt).
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(transparent)]
pub struct Dbm(pub f64);

impl Dbm {
    /// Power in milliwatts.
    pub fn milliwatts(self) -> f64 {
        10f64.powf(self.0 / 10.0)
    }
}

impl fmt::Display for Dbm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} dBm", self.0)
    }
}

/// Whether a height or an angle is that of what stands on the floor. Left out when written, and so read where it is not
/// there: what moves in the plane has no third dimension in files and in JSON.
pub(crate) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// A place, in metres, in the map's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Position {
    /// Metres to the east of the map's origin.
    pub x: f64,
    /// Metres to the north of the map's origin.
    pub y: f64,
    /// Metres above the floor; 0 where it is left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub z: f64,
}

impl Position {
    /// The place (x, y) on the floor, in metres.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y, z: 0.0 }
    }

    /// The place above or below this one, at `z` metres above the floor.
    pub const fn at_height(self, z: f64) -> Self {
        Self { z, ..self }
    }

    /// The place on the floor below this one.
    pub const fn on_floor(self) -> Self {
        self.at_height(0.0)
    }

    /// Euclidean distance in metres, heights included.
    pub fn distance(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y).hypot(self.z - other.z)
    }

    /// The place so far on the straight way to another one: this one at 0, the other at 1, exactly so at both.
    pub fn towards(self, to: Self, share: f64) -> Self {
        let between = |from: f64, to: f64| from * (1.0 - share) + to * share;
        Self { x: between(self.x, to.x), y: between(self.y, to.y), z: between(self.z, to.z) }
    }

    /// Whether it is above or below the inside of a polygon, by the even-odd rule.
    pub fn is_within(self, polygon: &[Self]) -> bool {
        let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
        let crossed = |a: &Self, b: &Self| {
            (a.y > self.y) != (b.y > self.y) && self.x < a.x + (self.y - a.y) / (b.y - a.y) * (b.x - a.x)
        };
        edges.filter(|(a, b)| crossed(a, b)).count() % 2 == 1
    }
}

/// Wraps an angle into (-π, π], radians.
pub fn wrapped_angle(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.z {
            0.0 => write!(f, "({:.1}, {:.1})", self.x, self.y),
            z => write!(f, "({:.1}, {:.1}, {z:.1})", self.x, self.y),
        }
    }
}

/// serde for a [`Duration`] as a number of milliseconds; the field's name ends in `_ms`.
pub mod millis {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    /// Writes milliseconds with a fraction.
    pub fn serialize<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(of(*duration))
    }

    /// Reads milliseconds; negative, infinite and NaN are errors.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
        duration(f64::deserialize(deserializer)?).map_err(D::Error::custom)
    }

    /// Milliseconds of a duration: what [`duration`] makes the same of again, if it is less than 26 days.
    pub fn of(duration: Duration) -> f64 {
        duration.as_nanos() as f64 / 1e6
    }

    /// The duration of so many milliseconds, to the nearest nanosecond.
    ///
    /// # Errors
    /// In words, for a number that is negative, infinite or NaN.
    pub fn duration(ms: f64) -> Result<Duration, String> {
        // Whole nanoseconds, rounded: 0.001 ms is 1000 ns, not 999.
        if ms.is_finite() && (0.0..1e15).contains(&ms) {
            Ok(Duration::from_nanos((ms * 1e6).round() as u64))
        } else {
            Err(format!("{ms} ms is not a duration: it must be zero or more"))
        }
    }

    /// The same for an optional field.
    pub mod option {
        use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
        use std::time::Duration;

        /// Writes milliseconds, or null.
        pub fn serialize<S: Serializer>(value: &Option<Duration>, serializer: S) -> Result<S::Ok, S::Error> {
            value.map(super::of).serialize(serializer)
        }

        /// Reads milliseconds, or null.
        pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Duration>, D::Error> {
            Option::<f64>::deserialize(deserializer)?
                .map(super::duration)
                .transpose()
                .map_err(D::Error::custom)
        }
    }
}
