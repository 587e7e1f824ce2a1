//! Computing of VNFs: their demands, and the order in which they serve requests.

use std::time::Duration;

use cotorra_graph::{Computing, Demand, MeasuredTimes, Program, Scheduling, WarmUp};

use super::builder::Builder;
use crate::{
    file,
    records::{DemandRecord, SchedulingWord, VnfRecord},
    yaml::{
        Span,
        decode::{Either, Spanned},
    },
};

/// Speeds of servers, as multiples of that on which demands were measured.
const SPEEDS: std::ops::RangeInclusive<f64> = 0.001..=1000.0;
/// Highest ratio of a 95th percentile to the median. The logarithm then has a deviation of 5.6.
const MOST_SPREAD: f64 = 10_000.0;

impl Builder<'_> {
    /// Builds the speed of a server.
    pub(super) fn speed(&mut self, speed: &Spanned<crate::yaml::decode::Amount>) -> Option<f64> {
        let value = speed.value.0;
        if !SPEEDS.contains(&value) {
            self.sink.error(&speed.span, format!("a speed of {value}")).help(format!(
                "write a speed from {} to {}: 1 is that of the machine on which demands were measured",
                SPEEDS.start(),
                SPEEDS.end()
            ));
            return None;
        }
        Some(value)
    }

    /// Builds the most CPUs that a VNF uses; `None` for a mistake.
    pub(super) fn cpu_limit(&mut self, record: &VnfRecord) -> Option<Option<f64>> {
        let Some(limit) = &record.cpu_limit else { return Some(None) };
        let (most, room) = (limit.value.0, record.cpus.0);
        if most < room || most == 0.0 {
            self.sink
                .error(&limit.span, format!("a limit of {most} CPUs, of a VNF that takes {room} of its node"))
                .help("write a `cpu_limit` that is not below `cpus`, and above 0");
            return None;
        }
        Some(Some(most))
    }

    /// Builds how a VNF computes its answers, if it has a demand; `None` for a mistake.
    pub(super) fn computing(
        &mut self,
        record: &VnfRecord,
        program: Option<&Program>,
    ) -> Option<Option<Box<Computing>>> {
        let Some(record_of_demand) = &record.demand else {
            let given = [
                ("workers", record.workers.as_ref().map(|key| &key.span)),
                ("scheduling", record.scheduling.as_ref().map(|key| &key.span)),
                ("backlog", record.backlog.as_ref().map(|key| &key.span)),
                ("warm_up", record.warm_up.as_ref().map(|key| &key.span)),
            ];
            let mut well = true;
            for (key, span) in given.into_iter().filter_map(|(key, span)| Some((key, span?))) {
                self.sink
                    .error(span, format!("`{key}` of a VNF without a `demand`"))
                    .help(format!("add `demand: 3 ms`, or leave out `{key}`"));
                well = false;
            }
            return well.then_some(None);
        };
        let span = &record_of_demand.span;
        if program.is_some_and(|program| !program.serves_robots()) {
            self.sink.error(span, "a demand of a program that is not `navigation` or `localization`").help(
                "leave out `demand`: other programs take the time that they take, and do not run in virtual time",
            );
            return None;
        }
        if let Some(delay) = &record.processing_delay {
            self.sink.error(&delay.span, "both a delay and a demand").help(
                "keep one of them: with a `demand`, an answer is late when the server is busy; with a `processing_delay` never",
            );
            return None;
        }
        if record.cpus.0 == 0.0 && record.cpu_limit.is_none() {
            self.sink
                .error(span, "a demand of a VNF without CPUs, which never answers")
                .help("write `cpus` or a `cpu_limit` above 0");
            return None;
        }
        let scheduling = self.scheduling(record);
        let backlog = match &record.backlog {
            Some(backlog) if backlog.value == 0 => {
                self.sink
                    .error(&backlog.span, "a backlog of no request")
                    .help("write 1 or more, or leave it out");
                None
            }
            Some(backlog) => Some(backlog.value),
            None => Some(Computing::BACKLOG),
        };
        let (demand, per_kb) = match &record_of_demand.value {
            Either::Short(time) => (Some(Demand::Constant { time: *time }), Duration::ZERO),
            Either::Long(long) => (self.demand(span, long), long.per_kb),
        };
        let warm_up = record.warm_up.as_ref();
        let warm_up =
            warm_up.map(|warm| WarmUp { requests: warm.value.requests, factor: warm.value.factor.0 });
        Some(Some(Box::new(Computing {
            demand: demand?,
            per_kb,
            scheduling: scheduling?,
            backlog: backlog?,
            warm_up,
        })))
    }

    fn scheduling(&mut self, record: &VnfRecord) -> Option<Scheduling> {
        let word = record.scheduling.as_ref().map_or(SchedulingWord::Fifo, |word| word.value);
        match (word, &record.workers) {
            (SchedulingWord::Shared, None) => Some(Scheduling::Shared),
            (SchedulingWord::Fifo, None) => Some(Scheduling::default()),
            (SchedulingWord::Fifo, Some(workers)) if workers.value > 0 => {
                Some(Scheduling::Fifo { workers: workers.value })
            }
            (SchedulingWord::Fifo, Some(workers)) => {
                self.sink.error(&workers.span, "no worker").help("write 1 or more, or leave it out");
                None
            }
            (SchedulingWord::Shared, Some(workers)) => {
                self.sink
                    .error(&workers.span, "workers of a VNF that serves all requests at once")
                    .help("leave out `workers`, or write `scheduling: fifo`");
                None
            }
        }
    }

    /// Builds a demand from its long form, which has exactly one distribution.
    fn demand(&mut self, span: &Span, record: &DemandRecord) -> Option<Demand> {
        let DemandRecord { constant, exponential, lognormal, uniform, samples, per_kb: _ } = record;
        let given = [
            constant.is_some(),
            exponential.is_some(),
            lognormal.is_some(),
            uniform.is_some(),
            samples.is_some(),
        ];
        if given.into_iter().filter(|given| *given).count() != 1 {
            self.sink
                .error(span, "a demand has one distribution")
                .help("write one of `constant`, `exponential`, `lognormal`, `uniform` and `samples`, such as `{ exponential: 3 ms }`");
            return None;
        }
        if let Some(time) = constant {
            return Some(Demand::Constant { time: *time });
        }
        if let Some(mean) = exponential {
            return self.above_zero(mean).map(|mean| Demand::Exponential { mean });
        }
        if let Some(lognormal) = lognormal {
            let median = self.above_zero(&lognormal.value.median)?;
            let p95 = lognormal.value.p95;
            if p95 < median || p95.as_secs_f64() > median.as_secs_f64() * MOST_SPREAD {
                self.sink
                    .error(
                        &lognormal.span,
                        format!("a 95th percentile of {p95:?} beside a median of {median:?}"),
                    )
                    .help(format!("write a `p95` from the median to {MOST_SPREAD} times the median"));
                return None;
            }
            return Some(Demand::Lognormal { median, p95 });
        }
        if let Some(uniform) = uniform {
            let [least, greatest] = uniform.value[..] else {
                let message = format!("{} bounds of a uniform distribution", uniform.value.len());
                self.sink.error(&uniform.span, message).help("write two, such as `uniform: [1 ms, 4 ms]`");
                return None;
            };
            if least > greatest {
                self.sink
                    .error(&uniform.span, "the first bound is above the second")
                    .help("write the lower one first");
                return None;
            }
            return Some(Demand::Uniform { least, greatest });
        }
        samples.as_ref().and_then(|path| self.measured_times(path)).map(|samples| Demand::Samples { samples })
    }

    fn above_zero(&mut self, time: &Spanned<Duration>) -> Option<Duration> {
        if time.value.is_zero() {
            self.sink
                .error(&time.span, "no time at all")
                .help("write a time above 0, or leave out the `demand`");
            return None;
        }
        Some(time.value)
    }

    fn measured_times(&mut self, path: &Spanned<String>) -> Option<MeasuredTimes> {
        let times = file::read_text(&self.base_dir.join(&path.value))
            .map_err(|error| format!("the samples cannot be read: {error}"))
            .and_then(|text| MeasuredTimes::parse(&text).map_err(|error| format!("{}: {error}", path.value)));
        times
            .map_err(|message| {
                self.sink
                    .error(&path.span, message)
                    .help("a line for each request, with its CPU time in milliseconds in the first column");
            })
            .ok()
    }
}
