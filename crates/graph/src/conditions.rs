//! Conditions of links, and their changes while a run goes on.

use std::{sync::Arc, time::Duration};

use serde::{Deserialize, Serialize, Serializer};
use sha2::{Digest, Sha256};

use crate::{
    jitter::Jitter,
    queue::{QueueDiscipline, QueueLimit},
    units::{BitRate, Probability, millis},
};

/// Conditions of one direction of a link.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Conditions {
    /// Time from the last bit sent to the last bit received, without queueing and serialisation.
    #[serde(rename = "delay_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub delay: Duration,
    /// Random part of the delay; keeps order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jitter: Option<Jitter>,
    /// Packets that vanish.
    #[serde(default)]
    pub loss: Loss,
    /// Share of packets that arrive twice.
    #[serde(default)]
    pub duplication: Probability,
    /// Share of packets in which one bit is flipped, behind the Ethernet header.
    #[serde(default)]
    pub corruption: Probability,
    /// Share of packets that skip the delay, and so overtake those before them.
    #[serde(default)]
    pub reordering: Probability,
    /// Serialisation rate. Serialised with a trace's name in place of its opportunities.
    #[serde(default, serialize_with = "Rate::serialize_named")]
    pub rate: Rate,
    /// Limit of the queue.
    #[serde(default)]
    pub queue: QueueLimit,
    /// Discipline of the queue.
    #[serde(default, skip_serializing_if = "QueueDiscipline::is_drop_tail")]
    pub queue_discipline: QueueDiscipline,
}

impl Conditions {
    /// Returns the time that a frame takes on the idle link; `None` where it depends on chance or on a trace.
    pub fn alone(&self, bytes: usize) -> Option<Duration> {
        let Self { delay, jitter, reordering, rate, .. } = self;
        let by_chance = jitter.is_some_and(|jitter| !jitter.deviation.is_zero()) || reordering.get() > 0.0;
        let sending = match rate {
            Rate::Unlimited => Duration::ZERO,
            Rate::Fixed { bits_per_second } => {
                Duration::from_secs_f64(bytes as f64 * 8.0 / bits_per_second.bits_per_second() as f64)
            }
            Rate::Trace { .. } | Rate::NamedTrace(_) => return None,
        };
        (!by_chance).then(|| *delay + sending)
    }
}

/// Packets that vanish on a link.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Loss {
    /// None do.
    #[default]
    None,
    /// Each with the same probability, whatever happened to the one before.
    Independent {
        /// Long-run share that is lost.
        #[serde(rename = "share")]
        rate: Probability,
    },
    /// Gilbert-Elliott in Gilbert's simple form: a good state that loses nothing and a bad one that loses all.
    /// From bad to good with r = 1/mean_burst, from good to bad with p = r·rate/(1-rate).
    Bursty {
        /// Long-run share that is lost; below 1.
        #[serde(rename = "share")]
        rate: Probability,
        /// Mean number of packets lost in a row; 1 or more.
        mean_burst: f64,
    },
}

/// Serialisation rate of a link.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Rate {
    /// Takes no time.
    #[default]
    Unlimited,
    /// Fixed rate. It counts Ethernet frames without preamble, FCS and gap.
    Fixed {
        /// bit/s.
        #[serde(rename = "rate_bps")]
        bits_per_second: BitRate,
    },
    /// Rate of a trace's opportunities.
    Trace {
        /// The delivery opportunities, milliseconds from the start.
        #[serde(rename = "trace_ms")]
        #[schema(value_type = Vec<u64>)]
        trace: Arc<Trace>,
    },
    /// Rate of a trace's opportunities, which are known where the link is emulated. As a change of conditions, it names the
    /// trace that the link has.
    NamedTrace(Box<TraceName>),
}

impl Rate {
    /// Returns the rate, or a trace's mean rate, in bit/s; infinity without a limit.
    pub fn mean_bits_per_second(&self) -> f64 {
        match self {
            Self::Unlimited => f64::INFINITY,
            Self::Fixed { bits_per_second } => bits_per_second.bits_per_second() as f64,
            Self::Trace { trace } => trace.name().mean_bits_per_second(),
            Self::NamedTrace(name) => name.mean_bits_per_second(),
        }
    }

    /// Returns the name of its trace, if it has one.
    pub fn trace_name(&self) -> Option<&TraceName> {
        match self {
            Self::Unlimited | Self::Fixed { .. } => None,
            Self::Trace { trace } => Some(trace.name()),
            Self::NamedTrace(name) => Some(name),
        }
    }

    fn serialize_named<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Trace { trace } => Self::NamedTrace(Box::new(trace.name().clone())).serialize(serializer),
            other => other.serialize(serializer),
        }
    }
}

/// Facts of a trace without its opportunities.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TraceName {
    /// Name of its file; `None` for one that is in no file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// SHA-256 of its opportunities, one in each line: that of its file, if that has no spaces and no empty lines.
    pub sha256: String,
    /// Number of its opportunities; above zero.
    pub opportunities: u64,
    /// After how many milliseconds it begins again; above zero.
    pub period_ms: u64,
}

impl TraceName {
    /// The mean rate over one period in bit/s, Ethernet headers left out.
    pub fn mean_bits_per_second(&self) -> f64 {
        self.opportunities as f64 * Trace::BYTES as f64 * 8e3 / self.period_ms as f64
    }
}

/// A packet-delivery trace in Mahimahi's format: one line an opportunity to deliver an IP packet of 1500 bytes, at that many
/// milliseconds from the start; after the last one it begins again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<u64>", into = "Vec<u64>")]
pub struct Trace {
    name: TraceName,
    opportunities_ms: Vec<u64>,
}

/// Error of a text or list that is not a trace.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidTrace {
    /// There is no line in it.
    #[error("a trace needs at least one delivery opportunity")]
    Empty,
    /// Time runs backwards.
    #[error("line {line}: {at} ms comes after {before} ms, but a trace's times never fall")]
    Backwards {
        /// Line, from 1.
        line: usize,
        /// Time of the line, ms.
        at: u64,
        /// The time before.
        before: u64,
    },
    /// The trace lasts no time, so that its rate would be infinite.
    #[error("a trace ends later than 0 ms")]
    Instant,
    /// A line is no number.
    #[error("line {line}: `{text}` is not a whole number of milliseconds")]
    NotANumber {
        /// Line, from 1.
        line: usize,
        /// The line's text.
        text: String,
    },
}

impl Trace {
    /// Bytes of the IP packet that one opportunity delivers.
    pub const BYTES: usize = 1500;

    /// Reads Mahimahi's format.
    ///
    /// # Errors
    /// [`InvalidTrace`], with the line.
    pub fn parse(text: &str) -> Result<Self, InvalidTrace> {
        let number = |(i, line): (usize, &str)| {
            line.trim()
                .parse()
                .map_err(|_| InvalidTrace::NotANumber { line: i + 1, text: line.chars().take(40).collect() })
        };
        text.lines()
            .enumerate()
            .filter(|(_, l)| !l.trim().is_empty())
            .map(number)
            .collect::<Result<Vec<_>, _>>()?
            .try_into()
    }

    /// Names its file.
    #[must_use]
    pub fn in_file(mut self, file: impl Into<String>) -> Self {
        self.name.file = Some(file.into());
        self
    }

    /// The name that stands for it in contexts.
    pub fn name(&self) -> &TraceName {
        &self.name
    }

    /// The opportunities, in milliseconds from the start; never falling, never empty.
    pub fn opportunities_ms(&self) -> &[u64] {
        &self.opportunities_ms
    }

    /// After how many milliseconds it begins again; above zero.
    pub fn period_ms(&self) -> u64 {
        self.name.period_ms
    }

    /// The mean rate over one period in bit/s, Ethernet headers left out.
    pub fn mean_bits_per_second(&self) -> f64 {
        self.name.mean_bits_per_second()
    }
}

impl TryFrom<Vec<u64>> for Trace {
    type Error = InvalidTrace;
    fn try_from(opportunities_ms: Vec<u64>) -> Result<Self, InvalidTrace> {
        for (i, pair) in opportunities_ms.windows(2).enumerate() {
            if pair[1] < pair[0] {
                return Err(InvalidTrace::Backwards { line: i + 2, at: pair[1], before: pair[0] });
            }
        }
        let period_ms = match opportunities_ms.last() {
            None => return Err(InvalidTrace::Empty),
            Some(0) => return Err(InvalidTrace::Instant),
            Some(end) => *end,
        };
        let mut digest = Sha256::new();
        for ms in &opportunities_ms {
            digest.update(format!("{ms}\n"));
        }
        let sha256 = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        let opportunities = opportunities_ms.len() as u64;
        Ok(Self { name: TraceName { file: None, sha256, opportunities, period_ms }, opportunities_ms })
    }
}

impl From<Trace> for Vec<u64> {
    fn from(trace: Trace) -> Self {
        trace.opportunities_ms
    }
}

/// Scaling of a link by emulation: delay ψ·d, throughput λ/δ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Scale {
    /// ψ: the delay is multiplied by it; 0 or more, 1 = untouched.
    pub delay_scale: f64,
    /// δ: the throughput is divided by it; above 0, 1 = untouched.
    pub drop_scale: f64,
}

impl Default for Scale {
    fn default() -> Self {
        Self { delay_scale: 1.0, drop_scale: 1.0 }
    }
}

/// A wished change of a link's conditions while it runs; what is `None` stays as it is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ConditionChange {
    /// Absolute delay, milliseconds.
    #[serde(rename = "delay_ms", default, skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
    /// Absolute jitter; deviation 0 switches it off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jitter: Option<Jitter>,
    /// Loss.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loss: Option<Loss>,
    /// Duplication.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duplication: Option<Probability>,
    /// Corruption.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corruption: Option<Probability>,
    /// Reordering.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reordering: Option<Probability>,
    /// Rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate: Option<Rate>,
    /// Queue limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue: Option<QueueLimit>,
    /// Queue discipline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue_discipline: Option<QueueDiscipline>,
    /// ψ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_scale: Option<f64>,
    /// δ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drop_scale: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn traced() -> Conditions {
        let trace = Trace::parse("1\n1\n4\n").unwrap().in_file("air.trace");
        Conditions { rate: Rate::Trace { trace: trace.into() }, ..Conditions::default() }
    }

    #[test]
    fn conditions_name_their_trace_in_place_of_its_opportunities() {
        let json = serde_json::to_value(traced()).unwrap();
        let rate = serde_json::json!({
            "kind": "named_trace",
            "file": "air.trace",
            // printf '1\n1\n4\n' | sha256sum
            "sha256": "249889e73c46d3ce2b1b34d1fd385d3b8774c484863496d662ac3e52cae5a095",
            "opportunities": 3,
            "period_ms": 4,
        });
        assert_eq!(json["rate"], rate);
        let read: Conditions = serde_json::from_value(json).unwrap();
        assert_eq!(read.rate.trace_name(), traced().rate.trace_name());
        assert_eq!(read.rate.mean_bits_per_second(), 9e6);
    }

    #[test]
    fn the_name_of_a_long_trace_is_short() {
        let trace: Trace = (1..100_000).collect::<Vec<_>>().try_into().unwrap();
        let conditions = Conditions { rate: Rate::Trace { trace: trace.into() }, ..Conditions::default() };
        assert!(serde_json::to_string(&conditions).unwrap().len() < 500);
    }

    #[test]
    fn conditions_with_opportunities_are_read_as_before() {
        let mut json = serde_json::to_value(traced()).unwrap();
        json["rate"] = serde_json::json!({ "kind": "trace", "trace_ms": [1, 1, 4] });
        let read: Conditions = serde_json::from_value(json).unwrap();
        let expected = Trace::parse("1\n1\n4").unwrap();
        assert_eq!(read.rate, Rate::Trace { trace: expected.into() });
    }

    #[test]
    fn a_change_sends_the_opportunities() {
        let change = ConditionChange { rate: Some(traced().rate), ..ConditionChange::default() };
        let json = serde_json::to_value(&change).unwrap();
        assert_eq!(json["rate"], serde_json::json!({ "kind": "trace", "trace_ms": [1, 1, 4] }));
    }
}
