//! Fault injection in virtual time: random testbeds, random faults at random times, and invariants that are checked after
//! each step. The same seed repeats a run to the last event.
#![forbid(unsafe_code)]

mod draw;
mod error;
mod generator;
mod invariants;
mod plan;
mod run;
mod saboteur;

use std::{
    collections::BTreeMap,
    num::NonZero,
    path::PathBuf,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    thread,
};

use cotorra_graph::Timestamp;
use parking_lot::Mutex;

pub use error::FaultTestError;
pub use invariants::{Checked, Invariant};

/// Runs with faults, each with a seed of its own.
#[derive(Debug, Clone)]
pub struct FaultTest {
    /// Seed of the first run; the next ones follow.
    pub first_seed: u64,
    /// Number of runs.
    pub runs: u64,
    /// Runs at a time.
    pub jobs: NonZero<usize>,
    /// Folder for the testbed, plan and history of each run that broke a promise.
    pub keep: Option<PathBuf>,
}

/// The results of runs with faults.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaultTested {
    /// Number of finished runs.
    pub runs: u64,
    /// Number of events.
    pub events: u64,
    /// Faults by kind.
    pub faults: BTreeMap<&'static str, u64>,
    /// Checks of each invariant, in the order of [`Invariant::ALL`].
    pub checked: [Checked; Invariant::ALL.len()],
    /// In the order of their seeds.
    pub violations: Vec<Violation>,
}

/// A promise that was broken.
#[derive(Debug, Clone, PartialEq)]
pub struct Violation {
    /// Seed of the run.
    pub seed: u64,
    /// Virtual time.
    pub at: Timestamp,
    /// The promise.
    pub invariant: Invariant,
    /// State that breaks it.
    pub found: String,
    /// Folder in which the run is kept.
    pub kept: Option<PathBuf>,
}

impl FaultTest {
    /// Runs all tests. Calls `go_on` with the number of finished runs, first with 0; `false` ends the test early.
    ///
    /// # Errors
    /// [`FaultTestError`]. A broken promise is no error, but part of the result.
    pub fn run(&self, go_on: &mut (dyn FnMut(u64) -> bool + Send)) -> Result<FaultTested, FaultTestError> {
        let (next, stop) = (AtomicU64::new(0), AtomicBool::new(!go_on(0)));
        let done = Mutex::new((Ok(FaultTested::default()), go_on));
        let work = || {
            while !stop.load(Ordering::Relaxed) {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= self.runs {
                    return;
                }
                let one = self.one(number);
                let (all, go_on) = &mut *done.lock();
                match (all, one) {
                    (Ok(all), Ok(one)) => {
                        all.add(one);
                        if !go_on(all.runs) {
                            stop.store(true, Ordering::Relaxed);
                        }
                    }
                    (all, Err(error)) => {
                        *all = Err(error);
                        stop.store(true, Ordering::Relaxed);
                    }
                    (Err(_), Ok(_)) => {}
                }
            }
        };
        thread::scope(|scope| (0..self.jobs.get()).for_each(|_| drop(scope.spawn(work))));
        done.into_inner().0
    }

    fn one(&self, number: u64) -> Result<FaultTested, FaultTestError> {
        let seed = self.first_seed.wrapping_add(number);
        let outcome = run::run(seed)?;
        let mut violations = Vec::new();
        if let Some((at, invariants::Broken(invariant, found))) = outcome.broken.clone() {
            let kept = self.keep.as_ref().map(|folder| outcome.keep(seed, folder)).transpose()?;
            violations.push(Violation { seed, at, invariant, found, kept });
        }
        let events = outcome.events.len() as u64;
        let checked = outcome.watch.checked;
        Ok(FaultTested { runs: 1, events, faults: outcome.injected, checked, violations })
    }
}

impl FaultTested {
    fn add(&mut self, other: Self) {
        self.runs += other.runs;
        self.events += other.events;
        other.faults.into_iter().for_each(|(kind, faults)| *self.faults.entry(kind).or_default() += faults);
        for (all, one) in self.checked.iter_mut().zip(other.checked) {
            all.checks += one.checks;
            all.exercised += one.exercised;
        }
        for violation in other.violations {
            let place = self.violations.partition_point(|before| before.seed < violation.seed);
            self.violations.insert(place, violation);
        }
    }
}

#[cfg(test)]
mod tests;
