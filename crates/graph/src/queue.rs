//! Queues of links: their limits and their disciplines.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::units::{Probability, millis};

/// Limit of a link's queue, without the packet in transmission.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum QueueLimit {
    /// Limit in packets, as they are on the wire.
    Packets(u32),
    /// Limit in bytes of Ethernet frames, as rates count them.
    Bytes(u64),
}

impl Default for QueueLimit {
    /// 1000 packets, Linux's default `txqueuelen`.
    fn default() -> Self {
        Self::Packets(1000)
    }
}

/// Discipline of a link's queue: which packets it drops or marks, and in which order it sends them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum QueueDiscipline {
    /// First in, first out. Packets that find the queue full are dropped.
    #[default]
    DropTail,
    /// CoDel (RFC 8289).
    Codel(Codel),
    /// FQ-CoDel (RFC 8290).
    FqCodel(FqCodel),
    /// PIE (RFC 8033).
    Pie(Pie),
    /// RED (Floyd and Jacobson, 1993) in its gentle mode.
    Red(Red),
}

/// Parameters of CoDel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Codel {
    /// Acceptable time in the queue.
    #[serde(rename = "target_ms", with = "millis")]
    #[schema(value_type = f64, default = 5.0)]
    pub target: Duration,
    /// Time above the target before the first drop, about a round-trip time.
    #[serde(rename = "interval_ms", with = "millis")]
    #[schema(value_type = f64, default = 100.0)]
    pub interval: Duration,
    /// Whether ECN-capable packets are marked instead of dropped.
    pub ecn: bool,
}

impl Default for Codel {
    /// The defaults of RFC 8289, section 4; no ECN.
    fn default() -> Self {
        Self { target: Duration::from_millis(5), interval: Duration::from_millis(100), ecn: false }
    }
}

/// Parameters of FQ-CoDel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FqCodel {
    /// Acceptable time in the queue.
    #[serde(rename = "target_ms", with = "millis")]
    #[schema(value_type = f64, default = 5.0)]
    pub target: Duration,
    /// Time above the target before the first drop, about a round-trip time.
    #[serde(rename = "interval_ms", with = "millis")]
    #[schema(value_type = f64, default = 100.0)]
    pub interval: Duration,
    /// Queues that flows are hashed to.
    pub flows: u32,
    /// Bytes that a flow may send before the next one's turn.
    #[serde(rename = "quantum_bytes")]
    pub quantum: u32,
    /// Whether ECN-capable packets are marked instead of dropped.
    pub ecn: bool,
}

impl FqCodel {
    /// The parameters of Linux's mac80211 (`fq_init` in `include/net/fq_impl.h`, `ieee80211_txq_setup_flows` in
    /// `net/mac80211/tx.c`).
    pub const MAC80211: Self = Self {
        target: Duration::from_millis(20),
        interval: Duration::from_millis(100),
        flows: 4096,
        quantum: 300,
        ecn: true,
    };

    /// Returns the parameters of each flow's CoDel.
    pub const fn codel(&self) -> Codel {
        Codel { target: self.target, interval: self.interval, ecn: self.ecn }
    }
}

impl Default for FqCodel {
    /// The defaults of RFC 8290, section 5.2; no ECN.
    fn default() -> Self {
        let Codel { target, interval, ecn } = Codel::default();
        Self { target, interval, flows: 1024, quantum: 1514, ecn }
    }
}

/// Parameters of PIE.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Pie {
    /// Time in the queue that it aims at.
    #[serde(rename = "target_ms", with = "millis")]
    #[schema(value_type = f64, default = 15.0)]
    pub target: Duration,
    /// Time from one update of the drop probability to the next.
    #[serde(rename = "update_ms", with = "millis")]
    #[schema(value_type = f64, default = 15.0)]
    pub update: Duration,
    /// Length of a burst that passes without drops.
    #[serde(rename = "burst_ms", with = "millis")]
    #[schema(value_type = f64, default = 150.0)]
    pub burst: Duration,
    /// Whether ECN-capable packets are marked instead of dropped, while the drop probability is below 10 %.
    pub ecn: bool,
}

impl Default for Pie {
    /// The defaults of RFC 8033, section 4; no ECN.
    fn default() -> Self {
        let ms = Duration::from_millis;
        Self { target: ms(15), update: ms(15), burst: ms(150), ecn: false }
    }
}

/// Parameters of RED.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Red {
    /// Thresholds of the average queue.
    pub thresholds: RedThresholds,
    /// max_p: drop probability at the upper threshold.
    pub probability: Probability,
    /// w_q: weight of the newest length in the average; above 0.
    pub weight: Probability,
    /// Whether ECN-capable packets are marked instead of dropped, while the average is below the upper threshold.
    pub ecn: bool,
}

impl Default for Red {
    /// The values of the first simulation of Floyd and Jacobson ("Random Early Detection Gateways for Congestion
    /// Avoidance", 1993); no ECN.
    fn default() -> Self {
        let share = |p| Probability::new(p).expect("it is between 0 and 1");
        Self {
            thresholds: RedThresholds::Packets { min: 5, max: 15 },
            probability: share(0.02),
            weight: share(0.002),
            ecn: false,
        }
    }
}

/// Thresholds of RED's average queue. Below `min` no packet is dropped, from `max` on the probability rises to 1 at twice
/// `max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum RedThresholds {
    /// Thresholds in packets.
    Packets {
        /// Lower threshold.
        min: u32,
        /// Upper threshold.
        max: u32,
    },
    /// Thresholds in bytes.
    Bytes {
        /// Lower threshold.
        min: u64,
        /// Upper threshold.
        max: u64,
    },
}

/// A parameter of a queue discipline that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidDiscipline {
    /// A target of 0, or beyond [`QueueDiscipline::LONGEST`].
    #[error("a target of {0:?} cannot be: it is above 0 and at most {LONGEST:?}", LONGEST = QueueDiscipline::LONGEST)]
    Target(Duration),
    /// An interval that is not longer than the target, or beyond [`QueueDiscipline::LONGEST`].
    #[error(
        "an interval of {0:?} cannot be: it is longer than the target, and at most {LONGEST:?}",
        LONGEST = QueueDiscipline::LONGEST
    )]
    Interval(Duration),
    /// No flows, or too many.
    #[error("{0} flows cannot be: give 1 to 65536")]
    Flows(u32),
    /// A quantum that makes rounds too many, or too long.
    #[error("a quantum of {0} bytes cannot be: give 256 to 1000000")]
    Quantum(u32),
    /// Updates too often or too rarely.
    #[error("an update every {0:?} cannot be: it is every 1 ms to 1 s")]
    Update(Duration),
    /// A burst beyond [`QueueDiscipline::LONGEST`].
    #[error("a burst of {0:?} cannot be: it is at most {LONGEST:?}", LONGEST = QueueDiscipline::LONGEST)]
    Burst(Duration),
    /// An upper threshold that is not above the lower one.
    #[error("the upper threshold of {max} cannot be: it is above the lower one, {min}")]
    Thresholds {
        /// Lower threshold.
        min: u64,
        /// Upper threshold.
        max: u64,
    },
    /// A drop probability of 0.
    #[error("a drop probability of 0 cannot be: it is above 0")]
    Probability,
    /// A weight of 0, with which the average never moves.
    #[error("a weight of 0 cannot be: it is above 0 and at most 1")]
    Weight,
}

impl QueueDiscipline {
    /// The longest target, interval and burst.
    pub const LONGEST: Duration = Duration::from_secs(60);

    /// Whether it is drop tail.
    pub const fn is_drop_tail(&self) -> bool {
        matches!(self, Self::DropTail)
    }

    /// Returns the name by which it is known.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::DropTail => "drop tail",
            Self::Codel(_) => "CoDel",
            Self::FqCodel(_) => "FQ-CoDel",
            Self::Pie(_) => "PIE",
            Self::Red(_) => "RED",
        }
    }

    /// Checks the parameters.
    ///
    /// # Errors
    /// [`InvalidDiscipline`] with the first that cannot be.
    pub fn check(&self) -> Result<(), InvalidDiscipline> {
        match self {
            Self::DropTail => Ok(()),
            Self::Codel(codel) => codel.check(),
            Self::FqCodel(fq) => {
                fq.codel().check()?;
                require((1..=65_536).contains(&fq.flows), InvalidDiscipline::Flows(fq.flows))?;
                require((256..=1_000_000).contains(&fq.quantum), InvalidDiscipline::Quantum(fq.quantum))
            }
            Self::Pie(pie) => {
                check_target(pie.target)?;
                let updates = Duration::from_millis(1)..=Duration::from_secs(1);
                require(updates.contains(&pie.update), InvalidDiscipline::Update(pie.update))?;
                require(pie.burst <= Self::LONGEST, InvalidDiscipline::Burst(pie.burst))
            }
            Self::Red(red) => {
                let (min, max) = match red.thresholds {
                    RedThresholds::Packets { min, max } => (min.into(), max.into()),
                    RedThresholds::Bytes { min, max } => (min, max),
                };
                require(min < max, InvalidDiscipline::Thresholds { min, max })?;
                require(red.probability != Probability::ZERO, InvalidDiscipline::Probability)?;
                require(red.weight != Probability::ZERO, InvalidDiscipline::Weight)
            }
        }
    }
}

impl Codel {
    fn check(&self) -> Result<(), InvalidDiscipline> {
        check_target(self.target)?;
        let fits = self.interval > self.target && self.interval <= QueueDiscipline::LONGEST;
        require(fits, InvalidDiscipline::Interval(self.interval))
    }
}

fn check_target(target: Duration) -> Result<(), InvalidDiscipline> {
    let fits = !target.is_zero() && target <= QueueDiscipline::LONGEST;
    require(fits, InvalidDiscipline::Target(target))
}

fn require(holds: bool, otherwise: InvalidDiscipline) -> Result<(), InvalidDiscipline> {
    holds.then_some(()).ok_or(otherwise)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_alone_has_the_defaults() {
        for (kind, expected) in [
            ("drop_tail", QueueDiscipline::DropTail),
            ("codel", QueueDiscipline::Codel(Codel::default())),
            ("fq_codel", QueueDiscipline::FqCodel(FqCodel::default())),
            ("pie", QueueDiscipline::Pie(Pie::default())),
            ("red", QueueDiscipline::Red(Red::default())),
        ] {
            let read: QueueDiscipline = serde_json::from_value(serde_json::json!({ "kind": kind })).unwrap();
            assert_eq!(read, expected);
            assert_eq!(read.check(), Ok(()));
            let json = serde_json::to_string(&read).unwrap();
            assert_eq!(serde_json::from_str::<QueueDiscipline>(&json).unwrap(), read, "{json}");
        }
    }

    #[test]
    fn unknown_parameters_are_rejected() {
        for text in [r#"{"kind":"codel","flows":3}"#, r#"{"kind":"red","min":3}"#, r#"{"kind":"sfq"}"#] {
            assert!(serde_json::from_str::<QueueDiscipline>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn impossible_parameters_are_rejected() {
        let ms = Duration::from_millis;
        let codel = |target, interval| QueueDiscipline::Codel(Codel { target, interval, ecn: false });
        let fq = |flows, quantum| {
            QueueDiscipline::FqCodel(FqCodel { flows, quantum, ..FqCodel::default() }).check().unwrap_err()
        };
        let pie = |pie: Pie| QueueDiscipline::Pie(pie).check().unwrap_err();
        let red = |red: Red| QueueDiscipline::Red(red).check().unwrap_err();
        assert_eq!(codel(ms(0), ms(100)).check(), Err(InvalidDiscipline::Target(ms(0))));
        assert_eq!(codel(ms(5), ms(5)).check(), Err(InvalidDiscipline::Interval(ms(5))));
        assert_eq!(codel(ms(5), ms(60_001)).check(), Err(InvalidDiscipline::Interval(ms(60_001))));
        assert_eq!([fq(0, 1514), fq(65_537, 1514)], [0, 65_537].map(InvalidDiscipline::Flows));
        assert_eq!([fq(1, 255), fq(1, 1_000_001)], [255, 1_000_001].map(InvalidDiscipline::Quantum));
        let often = Duration::from_micros(999);
        assert_eq!(pie(Pie { update: often, ..Pie::default() }), InvalidDiscipline::Update(often));
        assert_eq!(pie(Pie { burst: ms(60_001), ..Pie::default() }), InvalidDiscipline::Burst(ms(60_001)));
        let thresholds = RedThresholds::Bytes { min: 9, max: 9 };
        let error = InvalidDiscipline::Thresholds { min: 9, max: 9 };
        assert_eq!(red(Red { thresholds, ..Red::default() }), error);
        let zero = Probability::ZERO;
        assert_eq!(red(Red { probability: zero, ..Red::default() }), InvalidDiscipline::Probability);
        assert_eq!(red(Red { weight: zero, ..Red::default() }), InvalidDiscipline::Weight);
    }
}
