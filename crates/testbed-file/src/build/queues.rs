//! Queues of links.

use cotorra_graph::{
    Codel, FqCodel, InvalidDiscipline, Pie, QueueDiscipline, QueueLimit, Red, RedThresholds,
};

use super::builder::Builder;
use crate::{
    records::{CodelControlRecord, QueueRecord, RedRecord},
    yaml::{Span, decode::Either},
};

impl Builder<'_> {
    /// Returns the limit and the discipline of a queue, each where the file gives it.
    pub(super) fn queue(
        &mut self,
        queue: Option<&Either<QueueLimit, QueueRecord>>,
    ) -> Option<(Option<QueueLimit>, Option<QueueDiscipline>)> {
        match queue {
            None => Some((None, None)),
            Some(Either::Short(limit)) => Some((Some(*limit), None)),
            Some(Either::Long(record)) => {
                let (limit, discipline) = self.discipline(record)?;
                Some((limit, Some(discipline)))
            }
        }
    }

    fn discipline(&mut self, record: &QueueRecord) -> Option<(Option<QueueLimit>, QueueDiscipline)> {
        let (limit, discipline) = match record {
            QueueRecord::DropTail(r) => (r.limit, QueueDiscipline::DropTail),
            QueueRecord::Codel(r) => (r.limit, QueueDiscipline::Codel(codel(&r.control))),
            QueueRecord::FqCodel(r) => {
                let Codel { target, interval, ecn } = codel(&r.control);
                let quantum = u32::try_from(r.quantum.value.0).unwrap_or(u32::MAX);
                let fq = FqCodel { target, interval, flows: r.flows.value, quantum, ecn };
                (r.limit, QueueDiscipline::FqCodel(fq))
            }
            QueueRecord::Pie(r) => {
                let [target, update, burst] = [&r.target, &r.update, &r.burst].map(|time| time.value);
                (r.limit, QueueDiscipline::Pie(Pie { target, update, burst, ecn: r.ecn }))
            }
            QueueRecord::Red(r) => {
                let thresholds = self.thresholds(r)?;
                let (probability, weight) = (r.probability.value, r.weight.value);
                (r.limit, QueueDiscipline::Red(Red { thresholds, probability, weight, ecn: r.ecn }))
            }
        };
        let Err(error) = discipline.check() else { return Some((limit, discipline)) };
        let place = place(record, error).expect("a discipline has all parameters that it is checked for");
        self.sink.error(place, error.to_string()).help(help(error));
        None
    }

    fn thresholds(&mut self, red: &RedRecord) -> Option<RedThresholds> {
        match (red.min.value, red.max.value) {
            (QueueLimit::Packets(min), QueueLimit::Packets(max)) => Some(RedThresholds::Packets { min, max }),
            (QueueLimit::Bytes(min), QueueLimit::Bytes(max)) => Some(RedThresholds::Bytes { min, max }),
            _ => {
                self.sink
                    .error(
                        given(&red.max.span, &red.min.span),
                        "one threshold in packets, the other in bytes",
                    )
                    .help("give `min` and `max` both in packets, or both in bytes");
                None
            }
        }
    }
}

fn codel(control: &CodelControlRecord) -> Codel {
    Codel { target: control.target.value, interval: control.interval.value, ecn: control.ecn }
}

/// Returns the place of the wrong parameter in the file.
fn place(record: &QueueRecord, error: InvalidDiscipline) -> Option<&Span> {
    let control = match record {
        QueueRecord::Codel(r) => Some(&r.control),
        QueueRecord::FqCodel(r) => Some(&r.control),
        _ => None,
    };
    Some(match (error, record) {
        (InvalidDiscipline::Target(_), QueueRecord::Pie(r)) => &r.target.span,
        (InvalidDiscipline::Target(_), _) => &control?.target.span,
        (InvalidDiscipline::Interval(_), _) => given(&control?.interval.span, &control?.target.span),
        (InvalidDiscipline::Flows(_), QueueRecord::FqCodel(r)) => &r.flows.span,
        (InvalidDiscipline::Quantum(_), QueueRecord::FqCodel(r)) => &r.quantum.span,
        (InvalidDiscipline::Update(_), QueueRecord::Pie(r)) => &r.update.span,
        (InvalidDiscipline::Burst(_), QueueRecord::Pie(r)) => &r.burst.span,
        (InvalidDiscipline::Thresholds { .. }, QueueRecord::Red(r)) => given(&r.max.span, &r.min.span),
        (InvalidDiscipline::Probability, QueueRecord::Red(r)) => &r.probability.span,
        (InvalidDiscipline::Weight, QueueRecord::Red(r)) => &r.weight.span,
        _ => return None,
    })
}

/// Returns the place of a parameter, or that of the `other` one if it has its default.
fn given<'a>(place: &'a Span, other: &'a Span) -> &'a Span {
    if place.is_empty() { other } else { place }
}

fn help(error: InvalidDiscipline) -> &'static str {
    match error {
        InvalidDiscipline::Target(_) => "leave it out for the default of the RFC",
        InvalidDiscipline::Interval(_) => {
            "it is usually 10 to 20 times the target, such as `interval: 100 ms`"
        }
        InvalidDiscipline::Flows(_) => "write it like `flows: 1024`",
        InvalidDiscipline::Quantum(_) => "one full frame is usual: `quantum: 1514 B`",
        InvalidDiscipline::Update(_) => "write it like `update: 15 ms`",
        InvalidDiscipline::Burst(_) => "write it like `burst: 150 ms`",
        InvalidDiscipline::Thresholds { .. } => "three times `min` is usual",
        InvalidDiscipline::Probability => {
            "write it like `probability: 2 %`; for a plain queue, `discipline: drop_tail`"
        }
        InvalidDiscipline::Weight => "write it like `weight: 0.2 %`",
    }
}
