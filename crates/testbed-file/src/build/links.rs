//! Links and their conditions.

use std::{path::Path, sync::Arc, time::Duration};

use cotorra_graph::{
    BitRate, Conditions, CorrelationTime, HardwareGraph, InvalidCorrelation, Jitter, JitterDistribution,
    Link, LinkId, Loss, NodeId, Probability, Rate, Scale, Trace,
};

use super::builder::{Builder, each};
use crate::{
    file,
    records::{ConditionsRecord, JitterRecord, LinkRecord, LossRecord, NodeRecord},
    yaml::{
        Span,
        decode::{Amount, Either, Spanned},
    },
};

impl Builder<'_> {
    pub(super) fn links(&mut self) -> Option<Vec<Link>> {
        if let Some((_, span)) = self.record.link_entries().nth(HardwareGraph::MAX_LINKS) {
            self.sink
                .error(
                    span,
                    format!("with this entry there are more than {} links", HardwareGraph::MAX_LINKS),
                )
                .help("connect nodes through a switch, which has one link to each");
            return None;
        }
        let nested: Option<Vec<Vec<Link>>> = each(&self.record.links, |record| self.links_of(record));
        let links: Vec<Link> = nested?.into_iter().flatten().collect();
        Some(links)
    }

    /// The links that one entry stands for.
    fn links_of(&mut self, record: &LinkRecord) -> Option<Vec<Link>> {
        let [first, second] = &record.ends.value[..] else {
            self.sink
                .error(&record.ends.span, format!("a link has 2 ends, not {}", record.ends.value.len()))
                .help("write `ends: [A, B]`, or `ends: [A, [B, C]]` for links from A to each of the others");
            return None;
        };
        let mut end = |end: &Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>| -> Option<Vec<NodeId>> {
            let several = match end {
                Either::Short(one) => std::slice::from_ref(one),
                Either::Long(several) => several,
            };
            each(several, |id| {
                let node = self.node(id)?;
                if matches!(self.nodes[node.as_str()], NodeRecord::Robot(_)) {
                    self.sink
                        .error(&id.span, format!("`{node}` is a robot, and a robot has no wire"))
                        .help("it is reached through the radio units of its wireless network");
                }
                Some(node)
            })
        };
        let (first, second) = (end(first), end(second));
        let forward = self.conditions(record, record.forward.as_ref());
        let backward = self.conditions(record, record.backward.as_ref());
        let scales = [&record.forward, &record.backward].map(|own| self.scale(record, own.as_ref()));
        let reliability = self.reliability(&record.reliability);
        let (first, second, forward, backward) = (first?, second?, forward?, backward?);
        let several = first.len() * second.len() != 1;
        if let (true, Some(id)) = (several, &record.id) {
            self.sink
                .error(&id.span, "one name for several links")
                .help("leave out `id`: each is named `A-B` after its ends");
        }
        let mut links = Vec::with_capacity(first.len() * second.len());
        for a in &first {
            for b in &second {
                let id = match &record.id {
                    Some(id) => id.value.clone(),
                    None => LinkId::between(a, b),
                };
                if a == b {
                    self.sink
                        .error(&record.ends.span, format!("a link from `{a}` to itself"))
                        .help("name two different nodes");
                }
                links.push(Link {
                    id,
                    ends: [a.clone(), b.clone()],
                    forward: forward.clone(),
                    backward: backward.clone(),
                    scales,
                    medium: record.medium,
                    medium_delay: record.medium_delay.as_ref().map(|delay| delay.value).unwrap_or_default(),
                    cost: record.cost.0,
                    reliability,
                });
            }
        }
        Some(links)
    }

    /// One direction's conditions: what it says itself, else what the link says.
    fn conditions(&mut self, link: &LinkRecord, own: Option<&ConditionsRecord>) -> Option<Conditions> {
        let base = &link.conditions;
        macro_rules! pick {
            ($key:ident) => {
                own.and_then(|own| own.$key.as_ref()).or(base.$key.as_ref())
            };
        }
        let delay = pick!(delay).copied().unwrap_or_default();
        let jitter = pick!(jitter).map(|jitter| {
            let Spanned { value, span } = jitter;
            let jitter = self.jitter(value);
            self.warn_of_mean(span, jitter, delay);
            jitter
        });
        let reordering = pick!(reordering);
        if let Some(share) = reordering.filter(|share| share.value.get() > 0.0 && delay.is_zero()) {
            self.sink
                .error(&share.span, "reordering on a link without delay")
                .help("packets overtake by skipping the delay: give the link one, such as `delay: 5 ms`");
        }
        let loss = match pick!(loss) {
            None => Loss::None,
            Some(loss) => self.loss(loss)?,
        };
        let (queue, queue_discipline) = self.queue(pick!(queue))?;
        // A rate and a trace are two answers to one question: a direction's own stands in for either of the link's.
        let from = own.filter(|own| own.rate.is_some() || own.trace.is_some()).unwrap_or(base);
        Some(Conditions {
            delay,
            jitter,
            loss,
            duplication: pick!(duplication).copied().unwrap_or_default(),
            corruption: pick!(corruption).copied().unwrap_or_default(),
            reordering: reordering.map(|share| share.value).unwrap_or_default(),
            rate: self.rate(from, link.medium)?,
            queue: queue.unwrap_or_default(),
            queue_discipline: queue_discipline.unwrap_or_default(),
        })
    }

    /// One direction's ψ and δ: what it says itself, else what the link says.
    fn scale(&mut self, link: &LinkRecord, own: Option<&ConditionsRecord>) -> Scale {
        let base = &link.conditions;
        let delay = own.and_then(|own| own.delay_scale).or(base.delay_scale);
        let drop = own.and_then(|own| own.drop_scale.as_ref()).or(base.drop_scale.as_ref());
        if let Some(drop) = drop.filter(|drop| drop.value.0 == 0.0) {
            self.sink
                .error(&drop.span, "a throughput cannot be divided by 0")
                .help("write a number above 0; 1 leaves the link as it is");
        }
        Scale {
            delay_scale: delay.map_or(1.0, |scale| scale.0),
            drop_scale: drop.map_or(1.0, |scale| scale.value.0),
        }
    }

    /// Warns of a jitter that raises the mean of a delay.
    pub(super) fn warn_of_mean(&mut self, span: &Span, jitter: Jitter, delay: Duration) {
        let Some(mean) = jitter.raised_mean(delay) else { return };
        // The largest deviation that leaves the mean as it is, or raises it by less than half a percent, for a delay of 1.
        let largest = match jitter.distribution {
            JitterDistribution::Uniform => 1.0,
            JitterDistribution::Normal => 0.5,
            JitterDistribution::Pareto => 3f64.sqrt(),
        };
        let micros = |time: Duration, factor: f64| (time.as_secs_f64() * 1e6 * factor).round() as u64;
        let shortest = Duration::from_micros(micros(jitter.deviation, 1.0 / largest));
        let smaller = match micros(delay, largest) {
            0 => String::new(),
            deviation => format!(", or a jitter of {:?} or less", Duration::from_micros(deviation)),
        };
        self.sink
            .warning(span, format!("with this jitter, the mean delay is {mean:?}, not {delay:?}"))
            .help(format!(
                "delays below zero count as zero: write a delay of {shortest:?} or more{smaller}, or expect this mean"
            ));
    }

    pub(super) fn jitter(&mut self, jitter: &Either<Duration, JitterRecord>) -> Jitter {
        let record = match jitter {
            Either::Short(deviation) => return Jitter { deviation: *deviation, ..Jitter::default() },
            Either::Long(record) => record,
        };
        let JitterRecord { deviation, distribution, correlation, over } = record;
        let jitter = Jitter {
            deviation: *deviation,
            distribution: *distribution,
            correlation: correlation.value,
            over: over.as_ref().and_then(|over| CorrelationTime::new(over.value)),
        };
        if let Some(over) = over.as_ref().filter(|_| jitter.over.is_none()) {
            self.sink
                .error(&over.span, "a jitter changes over a time from 1 ms to 65 s")
                .help("leave `over` out for a jitter of each packet");
        }
        if let Err(error) = jitter.check() {
            let (span, help) = match (over, error) {
                (Some(over), InvalidCorrelation::Both) => {
                    (&over.span, "write `over: 50 ms` without `correlation`, or leave `over` out")
                }
                _ => (&correlation.span, "give it another distribution"),
            };
            self.sink.error(span, error.to_string()).help(help);
        }
        jitter
    }

    pub(super) fn loss(&mut self, loss: &Either<Probability, LossRecord>) -> Option<Loss> {
        match loss {
            Either::Short(rate) if rate.get() == 0.0 => Some(Loss::None),
            Either::Short(rate) => Some(Loss::Independent { rate: *rate }),
            Either::Long(loss) => self.bursty(&loss.rate, &loss.mean_burst),
        }
    }

    fn bursty(&mut self, rate: &Spanned<Probability>, mean_burst: &Spanned<Amount>) -> Option<Loss> {
        let (p, burst) = (rate.value.get(), mean_burst.value.0);
        if p == 1.0 {
            self.sink
                .error(&rate.span, "bursts that never end")
                .help("write a rate below 100 %, or `loss: 100 %` to lose everything");
        } else if burst < 1.0 {
            self.sink
                .error(&mean_burst.span, format!("a burst of {burst} packets"))
                .help("a burst has one packet or more: write 1 or above");
        } else if p / (1.0 - p) > burst {
            // The good state would have to be left with a probability above one.
            self.sink
                .error(&mean_burst.span, format!("{} % cannot be lost in bursts of {burst}", p * 100.0))
                .help(format!(
                    "at that rate a burst has {:.2} packets or more: rate / (1 - rate)",
                    p / (1.0 - p)
                ));
        } else {
            return Some(Loss::Bursty { rate: rate.value, mean_burst: burst });
        }
        None
    }

    pub(super) fn rate(&mut self, record: &ConditionsRecord, medium: BitRate) -> Option<Rate> {
        match (&record.rate, &record.trace) {
            (None, None) => Some(Rate::Fixed { bits_per_second: medium }),
            (Some(_), Some(trace)) => {
                self.sink
                    .error(&trace.span, "both a rate and a trace")
                    .help("a trace stands in place of a rate: keep one of them");
                None
            }
            (Some(rate), None) => {
                if let Rate::Fixed { bits_per_second } = rate.value
                    && bits_per_second > medium
                {
                    self.faster(&rate.span, &bits_per_second.to_string(), medium);
                }
                Some(rate.value.clone())
            }
            (None, Some(path)) => {
                let trace = self.trace(path)?;
                let mean = trace.mean_bits_per_second();
                if mean > medium.bits_per_second() as f64 {
                    self.faster(&path.span, &format!("{:.3} Mbit/s", mean / 1e6), medium);
                }
                Some(Rate::Trace { trace })
            }
        }
    }

    fn faster(&mut self, span: &Span, rate: &str, medium: BitRate) {
        self.sink
            .error(span, format!("{rate} is more than the medium carries"))
            .help(format!("write at most {medium}, or give the link a faster `medium`"));
    }

    fn trace(&mut self, path: &Spanned<String>) -> Option<Arc<Trace>> {
        if let Some(known) = self.traces.get(&path.value) {
            return known.clone();
        }
        let trace = file::read_text(&self.base_dir.join(&path.value))
            .map_err(|error| format!("the trace cannot be read: {error}"))
            .and_then(|text| Trace::parse(&text).map_err(|error| format!("{}: {error}", path.value)));
        let file = Path::new(&path.value).file_name().unwrap_or_default().to_string_lossy();
        let trace = match trace {
            Ok(trace) => Some(Arc::new(trace.in_file(file))),
            Err(message) => {
                self.sink.error(&path.span, message).help(
                    "a trace has a line for each packet of 1500 bytes that can pass, with its time in milliseconds",
                );
                None
            }
        };
        self.traces.insert(path.value.clone(), trace.clone());
        trace
    }
}
