//! Conversion of a testbed link's conditions to NetEm's.

use cotorra_graph::{Conditions, QueueLimit, Rate};

use crate::{
    loss::Loss,
    netem::{Jitter, Netem},
};

/// Conditions that NetEm cannot emulate.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ConditionsError {
    /// A rate from a packet-delivery trace: NetEm has fixed rates only.
    #[error("NetEm plays no packet-delivery traces: give a fixed rate, or let the fabric emulate")]
    Trace,
    /// A queue that is not drop tail.
    #[error("NetEm's queue drops at its tail only: leave the discipline out, or let the fabric emulate")]
    QueueDiscipline,
    /// A jitter with a correlation: NetEm's own blends uniform random numbers of successive packets, which narrows the
    /// distribution. It has none over time.
    #[error(
        "NetEm cannot correlate jitter without narrowing it: leave the correlation out, or let the fabric emulate"
    )]
    JitterCorrelation,
    /// Bursty loss for which no Gilbert-Elliott model exists.
    #[error("a share of {rate} cannot be lost in bursts of {mean_burst} packets")]
    Burst {
        /// Long-run share of lost packets.
        rate: f64,
        /// Mean length of a burst, packets.
        mean_burst: f64,
    },
}

/// Bytes of a full Ethernet frame.
const FRAME: u64 = 1514;

impl TryFrom<&Conditions> for Netem {
    type Error = ConditionsError;

    /// Keeps packets in order. A queue limit in bytes is converted to full frames, because NetEm counts packets.
    fn try_from(conditions: &Conditions) -> Result<Self, ConditionsError> {
        let loss = match conditions.loss {
            cotorra_graph::Loss::None => Loss::None,
            cotorra_graph::Loss::Independent { rate } => Loss::Independent { rate },
            cotorra_graph::Loss::Bursty { rate, mean_burst } => Loss::bursty(rate, mean_burst)
                .ok_or(ConditionsError::Burst { rate: rate.get(), mean_burst })?,
        };
        let rate = match conditions.rate {
            Rate::Unlimited => None,
            Rate::Fixed { bits_per_second } => Some(bits_per_second),
            Rate::Trace { .. } | Rate::NamedTrace(_) => return Err(ConditionsError::Trace),
        };
        if !conditions.queue_discipline.is_drop_tail() {
            return Err(ConditionsError::QueueDiscipline);
        }
        if conditions.jitter.is_some_and(|jitter| jitter.is_correlated()) {
            return Err(ConditionsError::JitterCorrelation);
        }
        let netem = Self {
            delay: conditions.delay,
            jitter: conditions.jitter.map(|jitter| Jitter {
                deviation: jitter.deviation,
                distribution: Some(jitter.distribution.into()),
            }),
            loss,
            duplication: conditions.duplication,
            corruption: conditions.corruption,
            reordering: conditions.reordering,
            rate,
            ..Self::default()
        };
        let queue = match conditions.queue {
            QueueLimit::Packets(packets) => packets,
            QueueLimit::Bytes(bytes) => u32::try_from(bytes.div_ceil(FRAME)).unwrap_or(u32::MAX),
        };
        Ok(Self { limit: Some(netem.limit_for(queue)), ..netem })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use cotorra_graph::{
        BitRate, Codel, Correlation, CorrelationTime, Jitter, Probability, QueueDiscipline, Trace,
    };

    use super::*;

    #[test]
    fn link_conditions_convert_to_netem() {
        let bits_per_second = BitRate::from_mbps(10.0).unwrap();
        let conditions = Conditions {
            delay: Duration::from_millis(100),
            rate: Rate::Fixed { bits_per_second },
            loss: cotorra_graph::Loss::Bursty { rate: Probability::new(0.1).unwrap(), mean_burst: 4.0 },
            queue: QueueLimit::Bytes(15_140),
            ..Conditions::default()
        };
        let netem = Netem::try_from(&conditions).unwrap();
        // 1 Mbit in flight is 83 full frames, and 10 may queue.
        assert_eq!(netem.limit(), 93);
        assert!((netem.loss.share() - 0.1).abs() < 1e-9);
        assert_eq!((netem.delay, netem.rate), (conditions.delay, Some(bits_per_second)));
        let trace = Rate::Trace { trace: Trace::parse("1").unwrap().into() };
        let traced = Conditions { rate: trace, ..conditions.clone() };
        assert_eq!(Netem::try_from(&traced), Err(ConditionsError::Trace));
        let queue_discipline = QueueDiscipline::Codel(Codel::default());
        let codel = Conditions { queue_discipline, ..conditions.clone() };
        assert_eq!(Netem::try_from(&codel), Err(ConditionsError::QueueDiscipline));
        let jitter = Jitter { deviation: Duration::from_millis(1), ..Jitter::default() };
        let of = |jitter| Netem::try_from(&Conditions { jitter: Some(jitter), ..conditions.clone() });
        assert_eq!(of(jitter).unwrap().jitter.unwrap().deviation, jitter.deviation);
        let correlation = Correlation::new(0.3).unwrap();
        assert_eq!(of(Jitter { correlation, ..jitter }), Err(ConditionsError::JitterCorrelation));
        let over = CorrelationTime::new(Duration::from_millis(50));
        assert_eq!(of(Jitter { over, ..jitter }), Err(ConditionsError::JitterCorrelation));
    }
}
