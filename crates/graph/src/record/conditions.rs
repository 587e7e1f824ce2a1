//! Conditions of a link, which contexts share by their id.

use std::sync::Arc;

use super::{Columns, Fields, Reader, Unreadable, Value, json, parse_json, required, unreadable};
use crate::{
    conditions::{Conditions, Loss, Rate, Trace},
    jitter::{Correlation, CorrelationTime, Jitter, JitterDistribution},
    queue::QueueLimit,
    units::{BitRate, Probability},
};

/// Columns of conditions after their id.
#[rustfmt::skip]
pub const CONDITIONS: &[&str] = &[
    "delay_ms", "jitter_deviation_ms", "jitter_distribution", "loss", "loss_share", "loss_mean_burst",
    "duplication", "corruption", "reordering", "rate_bps", "trace_ms", "queue_packets", "queue_bytes",
    "queue_discipline", "jitter_correlation", "trace_file",
];

/// Between the distribution of a jitter and the time over which it changes.
const OVER: &str = " over ";

impl Columns for Conditions {
    fn put<'a>(&'a self, row: &mut Fields<'a>) {
        let text = |row: &mut Fields<'a>, text: &'static str| row.0.push(Value::Text(text.into()));
        self.delay.put(row);
        match &self.jitter {
            Some(jitter) => {
                jitter.deviation.put(row);
                let distribution = match jitter.distribution {
                    JitterDistribution::Uniform => "uniform",
                    JitterDistribution::Normal => "normal",
                    JitterDistribution::Pareto => "pareto",
                };
                // A column more would be missing in spools and histories of before.
                row.0.push(Value::Text(match jitter.over {
                    None => distribution.into(),
                    Some(over) => format!("{distribution}{OVER}{} ms", f64::from(over)).into(),
                }));
            }
            None => row.nulls(2),
        }
        match &self.loss {
            Loss::None => {
                text(row, "none");
                row.nulls(2);
            }
            Loss::Independent { rate } => {
                text(row, "independent");
                rate.put(row);
                row.nulls(1);
            }
            Loss::Bursty { rate, mean_burst } => {
                text(row, "bursty");
                rate.put(row);
                mean_burst.put(row);
            }
        }
        self.duplication.put(row);
        self.corruption.put(row);
        self.reordering.put(row);
        match &self.rate {
            Rate::Unlimited => row.nulls(2),
            Rate::Fixed { bits_per_second } => {
                bits_per_second.put(row);
                row.nulls(1);
            }
            Rate::Trace { trace } => {
                row.nulls(1);
                row.0.push(Value::Text(json(&trace.opportunities_ms()).into()));
            }
            Rate::NamedTrace(name) => {
                row.nulls(1);
                row.json(Some(name));
            }
        }
        match &self.queue {
            QueueLimit::Packets(packets) => {
                packets.put(row);
                row.nulls(1);
            }
            QueueLimit::Bytes(bytes) => {
                row.nulls(1);
                bytes.put(row);
            }
        }
        row.json(Some(&self.queue_discipline).filter(|discipline| !discipline.is_drop_tail()));
        let correlation = self.jitter.map(|jitter| jitter.correlation);
        row.0.push(match correlation.filter(|correlation| !correlation.is_none()) {
            Some(correlation) => Value::Real(correlation.get()),
            None => Value::Null,
        });
        let file = self.rate.trace_name().and_then(|name| name.file.clone());
        row.0.push(file.map_or(Value::Null, |file| Value::Text(file.into())));
    }

    fn take<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Self, E> {
        let delay = row.take()?;
        let deviation = row.take::<Option<_>>()?;
        let shape = row.0.text()?;
        let (shape, over) = match shape.as_deref().map(|shape| shape.split_once(OVER).ok_or(shape)) {
            Some(Ok((shape, over))) => {
                let ms = over.strip_suffix(" ms").and_then(|ms| ms.parse().ok());
                let over = ms.and_then(|ms: f64| CorrelationTime::try_from(ms).ok());
                (Some(shape), Some(over.ok_or_else(|| unreadable("a jitter changes over no time"))?))
            }
            Some(Err(shape)) => (Some(shape), None),
            None => (None, None),
        };
        let distribution = match shape {
            None => None,
            Some("uniform") => Some(JitterDistribution::Uniform),
            Some("normal") => Some(JitterDistribution::Normal),
            Some("pareto") => Some(JitterDistribution::Pareto),
            Some(other) => return Err(unreadable(format_args!("`{other}` is not a distribution"))),
        };
        let loss = required(row.0.text()?)?;
        let (share, mean_burst) = (row.take::<Option<Probability>>()?, row.take()?);
        let loss = match loss.as_str() {
            "none" => Loss::None,
            "independent" => Loss::Independent { rate: required(share)? },
            "bursty" => Loss::Bursty { rate: required(share)?, mean_burst },
            other => return Err(unreadable(format_args!("`{other}` is not a kind of loss"))),
        };
        let (duplication, corruption, reordering) = (row.take()?, row.take()?, row.take()?);
        let rate = match (row.0.integer()?, row.0.text()?) {
            (_, Some(name)) if name.starts_with('{') => Rate::NamedTrace(parse_json(&name)?),
            (_, Some(trace)) => Rate::Trace { trace: Arc::new(parse_json::<Trace, E>(&trace)?) },
            (Some(rate), None) => Rate::Fixed {
                bits_per_second: BitRate::from_bits_per_second(rate.cast_unsigned())
                    .ok_or_else(|| unreadable("a rate is zero"))?,
            },
            (None, None) => Rate::Unlimited,
        };
        let queue = match (row.0.integer()?, row.take()?) {
            (Some(packets), _) => QueueLimit::Packets(
                u32::try_from(packets)
                    .map_err(|_| unreadable(format_args!("{packets} packets are out of range")))?,
            ),
            (None, Some(bytes)) => QueueLimit::Bytes(bytes),
            (None, None) => return Err(unreadable("a queue has no limit")),
        };
        let queue_discipline = row.json()?.unwrap_or_default();
        let correlation = match row.0.real()? {
            None => Correlation::NONE,
            Some(correlation) => Correlation::new(correlation)
                .ok_or_else(|| unreadable(format_args!("{correlation} is not a correlation")))?,
        };
        let rate = match (rate, row.0.text()?) {
            (Rate::Trace { trace }, Some(file)) => {
                Rate::Trace { trace: Arc::new(Arc::unwrap_or_clone(trace).in_file(file)) }
            }
            (rate, _) => rate,
        };
        let jitter = deviation.zip(distribution);
        let jitter =
            jitter.map(|(deviation, distribution)| Jitter { deviation, distribution, correlation, over });
        Ok(Self { delay, jitter, loss, duplication, corruption, reordering, rate, queue, queue_discipline })
    }
}
