//! How far a plug-in is from the core.

use std::{fmt, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{id::NodeId, units::millis};

/// The distance of a plug-in from the core, and the time of its decisions. By default, it is beside the core, and decides at
/// once.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PluginDistance {
    /// The way of contexts to the plug-in, and of its instructions back.
    #[serde(default)]
    pub way: Way,
    /// Time of a decision, i.e. of a call with instructions, in virtual time. Contexts wait meanwhile. `None` if it decides at
    /// once.
    #[serde(flatten)]
    pub decides_in: Option<DecidesIn>,
}

/// Time of a plug-in's decisions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum DecidesIn {
    /// A time that the file says.
    Fixed {
        /// The time.
        #[serde(rename = "decides_in_ms", with = "millis")]
        #[schema(value_type = f64)]
        time: Duration,
    },
    /// The CPU time that a program uses from the events that it gets to its instruction. Runs do not repeat.
    Cpu {
        /// Multiple of that time.
        #[serde(rename = "decides_in_cpu_factor")]
        factor: CpuFactor,
    },
}

/// Time on the CPU of a plug-in for each time on that of this machine: above 0, and 1000 at most.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(value_type = f64)]
#[serde(try_from = "f64", into = "f64")]
pub struct CpuFactor(f64);

impl DecidesIn {
    /// Returns the time that is always the same; `None` for none.
    pub fn fixed(time: Duration) -> Option<Self> {
        (!time.is_zero()).then_some(Self::Fixed { time })
    }

    /// Whether the time is measured.
    pub fn is_measured(self) -> bool {
        matches!(self, Self::Cpu { .. })
    }
}

impl CpuFactor {
    /// The CPU of this machine.
    pub const ONE: Self = Self(1.0);
    /// The highest factor.
    pub const MOST: f64 = 1000.0;

    /// Returns `None` for 0 and less, and above [`Self::MOST`].
    pub fn new(factor: f64) -> Option<Self> {
        (factor > 0.0 && factor <= Self::MOST).then_some(Self(factor))
    }

    /// Returns the time for a CPU time of this machine.
    pub fn of(self, used: Duration) -> Duration {
        used.mul_f64(self.0)
    }
}

impl From<CpuFactor> for f64 {
    fn from(factor: CpuFactor) -> Self {
        factor.0
    }
}

impl TryFrom<f64> for CpuFactor {
    type Error = String;
    fn try_from(factor: f64) -> Result<Self, Self::Error> {
        Self::new(factor).ok_or_else(|| format!("a factor is above 0, and {} at most", Self::MOST))
    }
}

impl fmt::Display for DecidesIn {
    /// Writes it as in a testbed file: `5 ms`, `cpu`, `2x cpu`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed { time } => write!(f, "{} ms", millis::of(*time)),
            Self::Cpu { factor } if *factor == CpuFactor::ONE => f.write_str("cpu"),
            Self::Cpu { factor: CpuFactor(factor) } => write!(f, "{factor}x cpu"),
        }
    }
}

/// The way between the core and a plug-in.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// None: the plug-in is beside the core.
    #[default]
    None,
    /// Each message arrives so much later.
    Delay {
        /// Time of one way.
        #[serde(rename = "control_delay_ms", with = "millis")]
        #[schema(value_type = f64)]
        control_delay: Duration,
    },
    /// Messages cross the emulated network.
    Nodes {
        /// Node of the core.
        core: NodeId,
        /// Node of the plug-in, another one.
        plugin: NodeId,
    },
}

impl PluginDistance {
    /// Whether the plug-in is beside the core, and decides at once.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for PluginDistance {
    /// Writes the keys of the testbed file that make it: `control_delay 100 ms, decides_in 5 ms`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |duration: Duration| format!("{} ms", millis::of(duration));
        let way = match &self.way {
            Way::None => None,
            Way::Delay { control_delay } => Some(format!("control_delay {}", ms(*control_delay))),
            Way::Nodes { core, plugin } => Some(format!("node {plugin}, core {core}")),
        };
        let decides_in = self.decides_in.map(|decides_in| format!("decides_in {decides_in}"));
        match [way, decides_in].into_iter().flatten().collect::<Vec<_>>().join(", ") {
            none if none.is_empty() => f.write_str("none"),
            keys => f.write_str(&keys),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_have_the_keys_of_their_kind() {
        let json = |decides_in| serde_json::to_value(PluginDistance { way: Way::None, decides_in }).unwrap();
        let five = DecidesIn::fixed(Duration::from_millis(5));
        let twice = Some(DecidesIn::Cpu { factor: CpuFactor::new(2.0).unwrap() });
        for (decides_in, expected) in [
            (None, serde_json::json!({ "way": "none" })),
            (five, serde_json::json!({ "way": "none", "decides_in_ms": 5.0 })),
            (twice, serde_json::json!({ "way": "none", "decides_in_cpu_factor": 2.0 })),
        ] {
            assert_eq!(json(decides_in), expected);
            let read: PluginDistance = serde_json::from_value(expected).unwrap();
            assert_eq!(read.decides_in, decides_in);
        }
        assert_eq!(DecidesIn::fixed(Duration::ZERO), None);
        assert_eq!([five, twice].map(|its| its.unwrap().to_string()), ["5 ms", "2x cpu"]);
    }

    #[test]
    fn a_factor_is_above_0_and_bounded() {
        assert_eq!(CpuFactor::new(0.5).unwrap().of(Duration::from_millis(8)), Duration::from_millis(4));
        for wrong in [0.0, -1.0, 1000.1, f64::NAN, f64::INFINITY] {
            assert_eq!(CpuFactor::new(wrong), None);
        }
    }
}
