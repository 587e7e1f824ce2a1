//! Regrets: what the decisions of a run's plug-ins were worth, beside their alternatives.
//!
//! The run is repeated in virtual time with the same seed. At a decision it takes an alternative, and goes on with the same
//! random streams. Both are compared by the samples that were sent from the decision on. With several seeds, the differences
//! of each pair of runs show whether an alternative is better by more than chance.

mod compared;
mod decided;
mod folder;
mod twins;

use std::{
    num::NonZero,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool, atomic::Ordering},
    time::Duration,
};

use cotorra_graph::{ServiceId, Testbed, Timestamp, millis};
use cotorra_numbers::{median, seed};
use cotorra_testbed::{Altered, Fork, Unrecorded, Void};
use serde::{Deserialize, Serialize};

use self::decided::{Observer, Sample, Taken};
pub use self::{
    compared::{Compared, Paired, Verdict},
    decided::{Alternative, Decided},
    folder::FILES,
    twins::{DistanceCost, FiguresRegret, ServiceCost, TwinDecision, TwinGave},
};
pub use crate::kept::UnknownService;
use crate::{
    batch::{self, Again, BatchError, Maker, Wanted},
    journal::Journal,
    kept,
    key::Keys,
    outcome::Outcome,
};

/// Longest run with an alternative and without an own limit, as a multiple of the run as it was.
const LONGEST: u32 = 2;

/// A run whose decisions are examined, with one seed or several.
#[derive(Debug)]
pub struct Regret {
    testbed: Arc<Testbed>,
    text: String,
    keys: Keys,
    services: Vec<ServiceId>,
    seed: u64,
    seeds: u32,
    until: Option<Duration>,
    hold: Option<Duration>,
}

/// Error of examining decisions.
#[derive(Debug, thiserror::Error)]
pub enum RegretError {
    /// A service is unknown.
    #[error(transparent)]
    Service(#[from] UnknownService),
    /// A run failed.
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// There is no decision of that number.
    #[error("the run has no decision {number}: its plug-ins made {} about attachments and placements", .of)]
    NoDecision { number: usize, of: usize },
    /// A repeated run did not come to the decision. Plug-ins in process decide the same each time.
    #[error(
        "{0}: the repeated run did not come to the decision; does a plug-in decide by chance, or by the machine's clock?"
    )]
    NotRepeated(String),
}

/// A run as it was, with its decisions.
#[derive(Debug)]
pub struct Recorded {
    pub seed: u64,
    /// The decisions, in order.
    pub decided: Vec<Decided>,
    samples: Vec<Sample>,
    taken: Taken,
    duration: Duration,
    walked: bool,
}

/// Samples from a decision on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stood {
    /// Number of samples.
    pub samples: usize,
    /// Number of samples above their target, or without an answer; `None` in journals of earlier versions.
    #[serde(default, rename = "late_samples")]
    pub late: Option<usize>,
    /// Share of samples within their target; `None` without samples.
    pub kept: Option<f64>,
    /// Median of answered samples, milliseconds.
    pub service_time_p50_ms: Option<f64>,
    /// Whether every walk was done.
    pub walked: bool,
    /// Mean price of the CPUs that VNFs have, by the prices of servers; `None` in journals of earlier versions, as below.
    #[serde(default)]
    pub cost: Option<f64>,
    /// Number of changes of VNFs' nodes.
    #[serde(default)]
    pub migrations: Option<usize>,
    /// Number of changes of radio unit.
    #[serde(default)]
    pub handovers: Option<usize>,
}

/// A run with an alternative.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Forked {
    stood: Stood,
    /// Reason for which the alternative was rejected.
    refused: Option<String>,
}

/// The result of an alternative.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tried {
    /// The radio unit or the node.
    pub target: String,
    /// Whether the alternative left everything as it was.
    pub stays: bool,
    /// The samples; `None` if the alternative was rejected, or the run is void.
    pub stood: Option<Stood>,
    /// Reason for which the alternative was rejected.
    pub refused: Option<String>,
    /// Reason for which the run is void.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub void: Option<Void>,
}

/// A decision beside its alternatives.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Examined {
    pub seed: u64,
    #[serde(flatten)]
    pub decided: Decided,
    /// The samples with the decision as it was.
    pub stood: Stood,
    pub tried: Vec<Tried>,
    /// Share of samples kept with the best alternative, less that with the decision: above 0 if an alternative was better.
    /// `None` without an alternative that can be compared.
    pub regret_kept: Option<f64>,
    /// Median service time with the decision, less that with the same alternative, milliseconds.
    pub regret_ms: Option<f64>,
    /// Mean price of placed CPUs with the decision, less that with the same alternative.
    pub regret_cost: Option<f64>,
    /// What the plug-in decided beside the core, if it has a distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twin: Option<TwinDecision>,
}

/// The decisions that were examined.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Regrets {
    /// The first seed.
    pub seed: u64,
    /// Number of seeds.
    pub seeds: u32,
    /// The services whose samples count, and that have any.
    pub services: Vec<ServiceId>,
    /// The decisions of each seed.
    pub examined: Vec<Examined>,
    /// The alternatives of each decision, over all seeds with that decision. Empty with a single seed.
    pub compared: Vec<Compared>,
    /// What the distances of the plug-ins cost whose decisions were examined; empty if none has one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub distances: Vec<DistanceCost>,
    /// Whether all alternatives were tried; false after a stop.
    pub complete: bool,
    /// Number of runs with alternatives, and of twins.
    pub runs: usize,
    /// Number of these that the journal already had.
    #[serde(skip)]
    pub resumed: usize,
    /// Runs that the journal had, but not as they are now.
    #[serde(skip)]
    pub again: Again,
    /// Number of void runs.
    #[serde(rename = "void_runs")]
    pub void: usize,
}

impl Regret {
    /// Prepares a run with that seed on the testbed of a file, which is given by its path, itself and its text. Without names, the samples of all services
    /// count but those that localize.
    ///
    /// # Errors
    /// [`UnknownService`].
    pub fn new(
        (path, testbed, text): (&str, Testbed, String),
        services: &[String],
        seed: u64,
        until: Option<Duration>,
    ) -> Result<Self, UnknownService> {
        let services = kept::services(&testbed, services)?;
        let (testbed, keys) = (Arc::new(testbed), Keys::new(path));
        Ok(Self { testbed, text, keys, services, seed, seeds: 1, until, hold: None })
    }

    /// Examines runs with this many seeds, counted up from the first.
    pub fn seeds(self, seeds: u32) -> Self {
        Self { seeds, ..self }
    }

    /// Holds alternatives for this time; by default, until the next decision about the same robot or VNF.
    pub fn hold(self, hold: Option<Duration>) -> Self {
        Self { hold, ..self }
    }

    /// Returns a folder in `parent` for decisions of this testbed alone. Its name has the testbed's name, and a hash of the
    /// version, the testbed and the duration.
    pub fn default_folder(&self, parent: &Path) -> PathBuf {
        // The testbed holds its map and traces, wherever they are.
        let testbed = Testbed { folder: PathBuf::new(), ..Testbed::clone(&self.testbed) };
        let depends = format!("{} {testbed:?} {:?}", env!("CARGO_PKG_VERSION"), self.until);
        parent.join(format!("{}-decisions-{:08x}", testbed.name, seed::split(0, &depends) >> 32))
    }

    /// Repeats the run as it was, to the end of its walks, with each seed. If a plug-in is a program, it uses a new folder.
    /// Returns `None` if `go_on` stopped it; it is called now and then.
    ///
    /// # Errors
    /// [`RegretError`].
    pub fn record(
        &self,
        folder: &Path,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<Option<Vec<Recorded>>, RegretError> {
        let seeds = (0..u64::from(self.seeds)).map(|place| self.seed.wrapping_add(place));
        seeds.map(|seed| self.record_with(seed, folder, &mut go_on)).collect()
    }

    fn record_with(
        &self,
        seed: u64,
        folder: &Path,
        go_on: impl FnMut() -> bool,
    ) -> Result<Option<Recorded>, RegretError> {
        let mut observer = Observer::new(&self.testbed);
        let see = |event: &_| observer.see(event);
        let testbed = Arc::clone(&self.testbed);
        let (altered, text) = (&Altered::default(), self.text.as_str());
        let run = Unrecorded { seed, until: self.until, altered, folder, text };
        let ended = batch::sound(testbed, &run, "the run", see, go_on)?;
        Ok(ended.map(|ended| Recorded {
            seed,
            decided: observer.decided,
            samples: observer.samples,
            taken: observer.taken,
            duration: Duration::from_secs_f64(ended.summary.duration_ms / 1e3),
            walked: ended.summary.is_walked(),
        }))
    }

    /// Runs the alternatives of a decision of the first run, or of all without a number, with `jobs` runs at a time. With
    /// several seeds, the others' decisions are those of the same plug-in for the same robot or VNF and target, for the same
    /// time in their run. Runs that the journal has with the same key are not repeated. Calls `go_on` with the numbers of finished and of all
    /// runs, at the beginning and after each run; `false` stops.
    ///
    /// # Errors
    /// [`RegretError`].
    pub fn examine(
        &self,
        recorded: &[Recorded],
        number: Option<NonZero<usize>>,
        journal: &Journal,
        jobs: NonZero<usize>,
        mut go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Regrets, RegretError> {
        let decided = select(recorded, number)?;
        let end = |decided: &Decided| match self.hold {
            Some(hold) => decided.at + hold,
            None => decided.next.unwrap_or(Timestamp::from_nanos(u64::MAX)),
        };
        let tries: Vec<_> = decided
            .iter()
            .flat_map(|(run, decided)| {
                decided.alternatives.iter().map(move |alternative| (*run, *decided, alternative))
            })
            .collect();
        let services: Vec<_> = self.services.iter().map(ToString::to_string).collect();
        let name = |(run, decided, alternative): &(&Recorded, &Decided, &Alternative)| {
            let (number, subject, target) = (decided.number, decided.subject(), &alternative.target);
            let (at, hold, services) = (decided.at.as_nanos(), end(decided).as_nanos(), services.join(","));
            format!(
                "decision {number}: {subject} to {target} at_ns={at} hold_ns={hold} kpi={services} seed={}",
                run.seed
            )
        };
        let key = self.keys.key(journal.version(), &self.testbed, &self.text, self.until);
        let want = |tried| Wanted { name: name(tried), key: key.clone(), samples: None };
        let wanted: Vec<_> = tries.iter().map(want).collect();
        let maker = Maker { journal, keys: &self.keys, judge: Void::wrong };
        let fork = |place: usize, stop: &AtomicBool| {
            let (run, decided, alternative) = tries[place];
            let fork = Fork {
                index: decided.number - 1,
                at: decided.at,
                chosen: decided.instruction.clone(),
                instead: alternative.instead.clone(),
                hold: end(decided),
            };
            let folder = journal.path().join(format!("run-{place}"));
            self.fork(run, fork, (maker, &wanted[place]), &folder, stop)
        };
        let twins = self.twins(&decided);
        let (forks, total) = (wanted.len(), wanted.len() + twins.len());
        let batch = batch::run(journal, jobs, (&wanted, self.keys.file()), fork, |done| go_on(done, total))?;
        // Once stopped, it is not to go on.
        let is_whole = batch.is_whole();
        let mut go_on_with_twins = |done| is_whole && go_on(forks + done, total);
        let twinned = self.make_twins(&twins, journal, jobs, &mut go_on_with_twins)?;
        let (complete, void) = (batch.is_whole() && twinned.is_whole(), batch.void() + twinned.void());
        let runs = batch.made() + twinned.made();
        let mut forked = batch.done.into_iter();
        let mut examined: Vec<_> = decided
            .iter()
            .map(|(run, decided)| {
                let stood = self.stood(&run.samples, &run.taken, decided.at, run.duration, run.walked);
                let done = decided.alternatives.iter().zip(forked.by_ref());
                let tried = done.filter_map(|(alternative, forked)| {
                    let (target, stays) = (alternative.target.clone(), alternative.instead.is_none());
                    let tried = Tried { target, stays, stood: None, refused: None, void: None };
                    Some(match forked? {
                        Outcome::Void(void) => Tried { void: Some(void), ..tried },
                        Outcome::Measured(Forked { stood, refused: None }) => {
                            Tried { stood: Some(stood), ..tried }
                        }
                        Outcome::Measured(Forked { refused, .. }) => Tried { refused, ..tried },
                    })
                });
                Examined::of(run.seed, (*decided).clone(), stood, tried.collect())
            })
            .collect();
        let has_samples = |service: &ServiceId| {
            let place = self.testbed.services.iter().position(|of| of.id == *service);
            recorded.iter().flat_map(|run| &run.samples).any(|sample| Some(sample.service) == place)
        };
        let services = self.services.iter().filter(|service| has_samples(service)).cloned().collect();
        let distances = self.distances(&twins, &twinned, recorded, &mut examined);
        let compared = if self.seeds > 1 { Compared::all(&examined) } else { Vec::new() };
        let (seed, seeds) = (self.seed, self.seeds);
        let resumed = batch.resumed + twinned.resumed;
        let mut again = batch.again;
        again.add(twinned.again);
        let regrets = Regrets {
            seed,
            seeds,
            services,
            examined,
            compared,
            distances,
            complete,
            runs,
            resumed,
            again,
            void,
        };
        Ok(regrets)
    }

    /// Repeats the run with a fork; returns `None` if it was stopped before its end.
    fn fork(
        &self,
        recorded: &Recorded,
        fork: Fork,
        (maker, wanted): (Maker<'_>, &Wanted),
        folder: &Path,
        stop: &AtomicBool,
    ) -> Result<Option<Outcome<Forked>>, RegretError> {
        let (at, altered) = (fork.at, Altered { fork: Some(fork), ..Altered::default() });
        let until = self.until.unwrap_or(recorded.duration * LONGEST);
        let mut observer = Observer::new(&self.testbed);
        let see = |event: &_| observer.see(event);
        let go_on = || !stop.load(Ordering::Relaxed);
        let testbed = Arc::clone(&self.testbed);
        let (until, altered, text) = (Some(until), &altered, self.text.as_str());
        let run = Unrecorded { seed: recorded.seed, until, altered, folder, text };
        let ended = match maker.make(wanted, testbed, &run, see, go_on)? {
            None => return Ok(None),
            Some(Outcome::Void(void)) => return Ok(Some(Outcome::Void(void))),
            Some(Outcome::Measured(ended)) => ended,
        };
        let outcome = ended.forked.ok_or_else(|| RegretError::NotRepeated(wanted.name.clone()))?;
        let duration = Duration::from_secs_f64(ended.summary.duration_ms / 1e3);
        let walked = ended.summary.is_walked();
        let stood = self.stood(&observer.samples, &observer.taken, at, duration, walked);
        let refused = outcome.err().map(|reason| reason.to_string());
        Ok(Some(Outcome::Measured(Forked { stood, refused })))
    }

    /// Summarizes the samples that were sent from a moment on, and what that took.
    fn stood(
        &self,
        samples: &[Sample],
        taken: &Taken,
        from: Timestamp,
        duration: Duration,
        walked: bool,
    ) -> Stood {
        let targets: Vec<_> = self
            .testbed
            .services
            .iter()
            .map(|service| self.services.contains(&service.id).then_some(service.kpis.service_time))
            .collect();
        let counted = samples.iter().filter(|sample| sample.emitted >= from);
        let counted: Vec<_> =
            counted.filter_map(|sample| Some((sample.took, targets[sample.service]?))).collect();
        let within = counted.iter().filter(|(took, target)| took.is_some_and(|took| took <= *target)).count();
        let answered = counted.iter().filter_map(|(took, _)| Some(millis::of((*took)?))).collect();
        let count = |moments: &[Timestamp]| Some(moments.iter().filter(|at| **at >= from).count());
        Stood {
            samples: counted.len(),
            late: Some(counted.len() - within),
            kept: (!counted.is_empty()).then(|| within as f64 / counted.len() as f64),
            service_time_p50_ms: median(answered),
            walked,
            cost: taken.cost(from, Timestamp::ZERO + duration),
            migrations: count(&taken.migrations),
            handovers: count(&taken.handovers),
        }
    }
}

impl Examined {
    /// Compares a decision with its alternatives. One that leaves a walk undone is worse than all that end it. Of equals,
    /// the fastest is the best.
    fn of(seed: u64, decided: Decided, stood: Stood, tried: Vec<Tried>) -> Self {
        let rank = |stood: &&Stood| {
            let median = stood.service_time_p50_ms.unwrap_or(f64::INFINITY);
            (stood.walked, stood.kept.unwrap_or(0.0), -median)
        };
        let best = tried.iter().filter_map(|tried| tried.stood.as_ref()).max_by(|a, b| {
            let (a, b) = (rank(a), rank(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
        });
        let (mut regret_kept, mut regret_ms, mut regret_cost) = (None, None, None);
        // A void alternative may be the best one.
        if let Some(best) = best.filter(|_| tried.iter().all(|tried| tried.void.is_none())) {
            regret_kept = best.kept.zip(stood.kept).map(|(best, own)| best - own);
            regret_ms = stood.service_time_p50_ms.zip(best.service_time_p50_ms).map(|(own, best)| own - best);
            regret_cost = stood.cost.zip(best.cost).map(|(own, best)| own - best);
        }
        Self { seed, decided, stood, tried, regret_kept, regret_ms, regret_cost, twin: None }
    }
}

/// Selects a decision of the first run and its likes of the others, or all without a number.
fn select(
    recorded: &[Recorded],
    number: Option<NonZero<usize>>,
) -> Result<Vec<(&Recorded, &Decided)>, RegretError> {
    let all = || recorded.iter().flat_map(|run| run.decided.iter().map(move |decided| (run, decided)));
    let Some(number) = number.map(NonZero::get) else { return Ok(all().collect()) };
    let of = recorded.first().map_or(0, |run| run.decided.len());
    let wanted = recorded.first().and_then(|run| run.decided.get(number - 1));
    let wanted = wanted.ok_or(RegretError::NoDecision { number, of })?;
    Ok(all().filter(|(_, decided)| decided.is_like(wanted)).collect())
}

#[cfg(test)]
mod tests;
