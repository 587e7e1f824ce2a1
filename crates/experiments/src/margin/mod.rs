//! Margins: the smallest change of a testbed that breaks a target, found by runs in virtual time.
//!
//! A target breaks if less than a share of a service's samples keeps it, counted over all seeds, or if a walk does not end
//! that ends without the change. Delays, losses and slow servers are searched by bisection, with the same seeds each time.

mod bisection;
mod change;
mod error;
mod finding;
mod folder;
mod measured;
mod search;

use std::{
    num::NonZero,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool, atomic::Ordering},
    time::Duration,
};

use cotorra_graph::{NodeId, ServiceId, Testbed};
use cotorra_numbers::seed;
use cotorra_testbed::{Unrecorded, UnrecordedRun, Void};

pub use self::{
    bisection::Grid,
    change::{Change, Dimension, Kind, LOSS_UNITS},
    error::MarginError,
    finding::{Finding, Margins, ServiceKept},
    folder::FILES,
};
use self::{
    measured::Measured,
    search::{Search, Verdict},
};
use crate::{
    batch::{self, Again, BatchError, Maker, Wanted},
    journal::Journal,
    kept,
    key::Keys,
    outcome::Outcome,
};

/// Longest changed run without an own limit, as a multiple of the unchanged run.
const LONGEST: f64 = 2.0;

/// Extent of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Names of the services whose targets count. Without names, all count but those that localize.
    pub services: Vec<String>,
    /// Share of a service's samples that must keep its target.
    pub keep: f64,
    /// Seed of the first run.
    pub seed: u64,
    /// Number of seeds, counted up from the first.
    pub seeds: u32,
    /// Limit of each run; by default, changed runs take twice as long as unchanged ones at most.
    pub until: Option<Duration>,
    /// Kinds of changes to try.
    pub kinds: Vec<Kind>,
    /// Names of the links, networks, servers and radio units to change; all without names.
    pub on: Vec<String>,
    /// Extra delays of links and answers, in nanoseconds.
    pub delays: Grid,
    /// Extra losses, in units of [`LOSS_UNITS`].
    pub losses: Grid,
    /// Whether delays are also searched with each radio unit down that the target survives.
    pub pairs: bool,
}

/// A search for the margins of a testbed.
#[derive(Debug)]
pub struct Margin {
    testbed: Arc<Testbed>,
    text: String,
    keys: Keys,
    services: Vec<ServiceId>,
    options: Options,
    dimensions: Vec<Dimension>,
    units: Vec<NodeId>,
}

/// Number of runs of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// If the target survives every largest change on its own, and no radio unit's loss.
    pub least: u64,
    /// If everything breaks it only at some amount, and it survives the loss of each radio unit.
    pub most: u64,
}

/// Runs that are under way: their journal, and the progress.
struct Runs<'a> {
    journal: &'a Journal,
    jobs: NonZero<usize>,
    go_on: &'a mut dyn FnMut(usize, usize) -> bool,
    done: usize,
    resumed: usize,
    again: Again,
    void: usize,
    /// For each seed, the limit of a changed run, and whether the unchanged one ended its walks.
    limits: Vec<(Option<Duration>, bool)>,
    /// The services whose targets count, and have samples in unchanged runs.
    services: Vec<ServiceId>,
}

impl Margin {
    /// Prepares a search on the testbed of a file with this path and text.
    ///
    /// # Errors
    /// [`MarginError`] if a name is unknown, or nothing can be changed.
    pub fn new(path: &str, testbed: Testbed, text: String, options: Options) -> Result<Self, MarginError> {
        let services = kept::services(&testbed, &options.services)?;
        let of = |kind| options.kinds.contains(&kind);
        let graph = &testbed.graph;
        let real: Vec<_> = graph.real_links().map(|real| &real.link.id).collect();
        let links = || graph.links.iter().map(|link| &link.id).filter(|link| !real.contains(link)).cloned();
        let mut dimensions = Vec::new();
        if of(Kind::Delay) {
            dimensions.extend(links().map(Dimension::Delay));
            dimensions.extend(graph.wireless.keys().cloned().map(Dimension::AirDelay));
        }
        if of(Kind::Loss) {
            dimensions.extend(links().map(Dimension::Loss));
            dimensions.extend(graph.wireless.keys().cloned().map(Dimension::AirLoss));
        }
        if of(Kind::Answers) {
            dimensions.extend(graph.servers().map(|(node, _)| Dimension::Answers(node.id.clone())));
        }
        let serving = graph.radio_units().filter(|(_, unit)| unit.serving && of(Kind::Down));
        let mut units: Vec<_> = serving.map(|(node, _)| node.id.clone()).collect();
        let mut known: Vec<String> = dimensions.iter().map(|dimension| dimension.on().to_owned()).collect();
        known.extend(units.iter().map(ToString::to_string));
        known.sort();
        known.dedup();
        if let Some(unknown) = options.on.iter().find(|name| !known.contains(name)) {
            return Err(MarginError::Unknown(unknown.clone(), known));
        }
        if !options.on.is_empty() {
            dimensions.retain(|dimension| options.on.iter().any(|name| name == dimension.on()));
            units.retain(|unit| options.on.iter().any(|name| name == unit.as_str()));
        }
        if dimensions.is_empty() && units.is_empty() {
            return Err(MarginError::Nothing);
        }
        let sets_links = |dimension: &Dimension| dimension.kind() != Kind::Answers;
        if testbed.script.replay.is_some() && dimensions.iter().any(sets_links) {
            return Err(MarginError::Replay);
        }
        let (testbed, keys) = (Arc::new(testbed), Keys::new(path));
        Ok(Self { testbed, text, keys, services, options, dimensions, units })
    }

    /// Returns the services whose targets count.
    pub fn services(&self) -> &[ServiceId] {
        &self.services
    }

    /// Returns what gets worse.
    pub fn dimensions(&self) -> &[Dimension] {
        &self.dimensions
    }

    /// Returns the radio units that go down.
    pub fn units(&self) -> &[NodeId] {
        &self.units
    }

    /// Returns a folder in `parent` for searches on this testbed alone. Its name has the testbed's name, and a hash of the
    /// version, the testbed and the duration. A search with other seeds, services or bounds uses the same folder.
    pub fn default_folder(&self, parent: &Path) -> PathBuf {
        // The testbed holds its map and traces, wherever they are.
        let testbed = Testbed { folder: PathBuf::new(), ..Testbed::clone(&self.testbed) };
        let depends = format!("{} {testbed:?} {:?}", env!("CARGO_PKG_VERSION"), self.options.until);
        parent.join(format!("{}-{:08x}", testbed.name, seed::split(0, &depends) >> 32))
    }

    /// Returns the number of runs.
    pub fn estimate(&self) -> Estimate {
        let count = self.dimensions.len() as u64 + self.units.len() as u64;
        let most: u64 = self.dimensions.iter().map(|dimension| self.grid(dimension).most_tests()).sum();
        let pairs: u64 = self.paired().map(|dimension| self.grid(dimension).most_tests()).sum();
        let (seeds, units) = (u64::from(self.options.seeds), self.units.len() as u64);
        let most = (1 + most + units).saturating_add(pairs.saturating_mul(units));
        Estimate { least: (1 + count) * seeds, most: most.saturating_mul(seeds) }
    }

    fn grid(&self, dimension: &Dimension) -> Grid {
        if dimension.kind() == Kind::Loss { self.options.losses } else { self.options.delays }
    }

    /// Returns the delays that are also searched with a radio unit down.
    fn paired(&self) -> impl Iterator<Item = &Dimension> {
        let is_delay = |dimension: &&Dimension| matches!(dimension, Dimension::Delay(_));
        self.dimensions.iter().filter(move |dimension| self.options.pairs && is_delay(dimension))
    }

    /// Searches, with `jobs` runs at a time. Runs that the journal has with the same key are not repeated. Calls `go_on` with the numbers of
    /// finished and of known runs, at the beginning and after each run; `false` stops the search.
    ///
    /// # Errors
    /// [`MarginError`].
    pub fn run(
        &self,
        journal: &Journal,
        jobs: NonZero<usize>,
        mut go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Margins, MarginError> {
        let mut runs = Runs {
            journal,
            jobs,
            go_on: &mut go_on,
            done: 0,
            resumed: 0,
            again: Again::default(),
            void: 0,
            limits: Vec::new(),
            services: self.services.clone(),
        };
        let mut margins = Margins {
            keep: self.options.keep,
            seeds: self.options.seeds,
            unchanged: Vec::new(),
            findings: Vec::new(),
            complete: false,
            runs: 0,
            resumed: 0,
            again: Again::default(),
            void: 0,
        };
        let unchanged = self.measure(&mut runs, &[Change::default()])?.into_iter().flatten().next();
        if let Some(unchanged) = unchanged.map(|outcomes| self.sound(journal, outcomes)).transpose()? {
            margins.unchanged = self.check(&unchanged)?;
            let limit = |run: &Measured| {
                let twice = || Duration::from_secs_f64(run.duration_ms * LONGEST / 1e3);
                (Some(self.options.until.unwrap_or_else(twice)), run.walked)
            };
            runs.limits = unchanged.iter().map(limit).collect();
            runs.services = margins.unchanged.iter().map(|its| its.service.clone()).collect();
            let worse =
                |dimension: &Dimension| Search::new(Some(dimension.clone()), None, self.grid(dimension));
            let down = |unit: &NodeId| Search::new(None, Some(unit.clone()), Grid::ONE);
            let mut searches: Vec<_> =
                self.dimensions.iter().map(worse).chain(self.units.iter().map(down)).collect();
            margins.complete = self.search(&mut runs, &mut searches)?;
            if margins.complete {
                let survived =
                    searches.iter().filter(|search| search.broken.is_none() && search.void.is_none());
                let survived = survived.filter(|search| search.dimension.is_none());
                let survived: Vec<_> = survived.filter_map(|search| search.down.clone()).collect();
                let pairs = survived.iter().flat_map(|unit| self.paired().map(move |of| (unit, of)));
                let mut pairs: Vec<_> = pairs
                    .map(|(unit, of)| Search::new(Some(of.clone()), Some(unit.clone()), self.grid(of)))
                    .collect();
                margins.complete = self.search(&mut runs, &mut pairs)?;
                searches.extend(pairs);
            }
            margins.findings = searches.iter().map(Search::finding).collect();
        }
        (margins.runs, margins.resumed) = (runs.done, runs.resumed);
        (margins.again, margins.void) = (runs.again, runs.void);
        Ok(margins)
    }

    /// Returns the results of runs without changes, which nothing can be found without.
    fn sound(
        &self,
        journal: &Journal,
        outcomes: Vec<Outcome<Measured>>,
    ) -> Result<Vec<Measured>, MarginError> {
        let sound = |(place, outcome): (usize, Outcome<Measured>)| match outcome {
            Outcome::Measured(measured) => Ok(measured),
            Outcome::Void(void) => {
                Err(BatchError::void_in(journal, &self.name(&Change::default(), place), &void).into())
            }
        };
        outcomes.into_iter().enumerate().map(sound).collect()
    }

    /// Searches to the end; returns false if it was stopped before. All searches make their next test at the same time.
    fn search(&self, runs: &mut Runs<'_>, searches: &mut [Search]) -> Result<bool, MarginError> {
        loop {
            let (places, changes): (Vec<_>, Vec<_>) = searches
                .iter()
                .enumerate()
                .filter_map(|(place, search)| Some((place, search.next()?)))
                .unzip();
            if changes.is_empty() {
                return Ok(true);
            }
            let mut is_complete = true;
            for (place, measured) in places.into_iter().zip(self.measure(runs, &changes)?) {
                match measured {
                    Some(outcomes) => match outcomes.iter().find_map(|outcome| outcome.void()) {
                        Some(void) => searches[place].void = Some(void.clone()),
                        None => {
                            let measured: Vec<_> =
                                outcomes.into_iter().filter_map(Outcome::into_measured).collect();
                            searches[place].learn(self.verdict(&measured, runs));
                        }
                    },
                    None => is_complete = false,
                }
            }
            if !is_complete {
                return Ok(false);
            }
        }
    }

    /// Runs each change with each seed. Returns `None` for changes whose runs were stopped.
    fn measure(
        &self,
        runs: &mut Runs<'_>,
        changes: &[Change],
    ) -> Result<Vec<Option<Vec<Outcome<Measured>>>>, MarginError> {
        let seeds = self.options.seeds as usize;
        let key = self.keys.key(runs.journal.version(), &self.testbed, &self.text, self.options.until);
        let want = |place: usize| Wanted {
            name: self.name(&changes[place / seeds], place % seeds),
            key: key.clone(),
            samples: None,
        };
        let wanted: Vec<_> = (0..changes.len() * seeds).map(want).collect();
        let maker = Maker { journal: runs.journal, keys: &self.keys, judge: Void::wrong };
        let limits = &runs.limits;
        let measure = |place: usize, stop: &AtomicBool| {
            let mut testbed = Testbed::clone(&self.testbed);
            let altered = changes[place / seeds].apply(&mut testbed);
            let until = limits.get(place % seeds).map_or(self.options.until, |(until, _)| *until);
            let folder = runs.journal.path().join(format!("run-{place}"));
            let seed = self.seed(place % seeds);
            let run = Unrecorded { seed, until, altered: &altered, folder: &folder, text: &self.text };
            let go_on = || !stop.load(Ordering::Relaxed);
            let outcome = maker.make(&wanted[place], Arc::new(testbed), &run, |_| {}, go_on)?;
            let measured = |ended: UnrecordedRun| Measured::of(&ended.summary);
            Ok::<_, BatchError>(outcome.map(|outcome| outcome.map(measured)))
        };
        let (before, total, go_on) = (runs.done, runs.done + wanted.len(), &mut runs.go_on);
        let named = (&wanted[..], self.keys.file());
        let batch = batch::run(runs.journal, runs.jobs, named, measure, |done| go_on(before + done, total))?;
        runs.done += batch.made();
        runs.void += batch.void();
        runs.resumed += batch.resumed;
        runs.again.add(batch.again);
        let mut done = batch.done.into_iter();
        Ok(changes
            .iter()
            .map(|_| done.by_ref().take(seeds).collect::<Vec<_>>().into_iter().collect())
            .collect())
    }

    /// Returns the seed of a run, counted from 0.
    fn seed(&self, place: usize) -> u64 {
        self.options.seed.wrapping_add(place as u64)
    }

    /// Returns the name of a run.
    fn name(&self, change: &Change, place: usize) -> String {
        format!("{change} seed={}", self.seed(place))
    }

    /// Returns the services' shares over these runs.
    fn kept(&self, runs: &[Measured]) -> Vec<ServiceKept> {
        let of = |service: &ServiceId| {
            let its = runs.iter().flat_map(|run| &run.services).filter(|its| its.service == *service);
            let failed = its.clone().flat_map(|its| &its.failed).next().cloned();
            let (samples, within) =
                its.fold((0, 0), |(samples, within), its| (samples + its.samples, within + its.within));
            let target = self.testbed.services.iter().find(|of| of.id == *service);
            let target = target.map_or(Duration::ZERO, |service| service.kpis.service_time);
            ServiceKept {
                service: service.clone(),
                service_time_target_ms: cotorra_graph::millis::of(target),
                samples,
                kept: (samples > 0).then(|| within as f64 / samples as f64),
                failed,
            }
        };
        self.services.iter().map(of).collect()
    }

    /// Checks that the targets are kept before anything changes. Services without samples count only if they were chosen.
    fn check(&self, unchanged: &[Measured]) -> Result<Vec<ServiceKept>, MarginError> {
        let mut all = self.kept(unchanged);
        if self.options.services.is_empty() {
            all.retain(|its| its.samples > 0);
        }
        for ServiceKept { service, kept, failed, .. } in &all {
            if let Some(kpi) = failed {
                return Err(MarginError::Fails { service: service.clone(), kpi: kpi.clone() });
            }
            match kept {
                None => return Err(MarginError::NoSamples(service.clone())),
                Some(kept) if *kept < self.options.keep => {
                    let (kept, keep) = (*kept, self.options.keep);
                    return Err(MarginError::Broken { service: service.clone(), kept, keep });
                }
                Some(_) => {}
            }
        }
        match (all.is_empty(), self.services.first()) {
            (true, Some(first)) => Err(MarginError::NoSamples(first.clone())),
            (true, None) => Err(MarginError::NoService),
            (false, _) => Ok(all),
        }
    }

    fn verdict(&self, changed: &[Measured], runs: &Runs<'_>) -> Verdict {
        let unended = changed.iter().zip(&runs.limits).any(|(run, (_, walked))| *walked && !run.walked);
        let counts = |its: &ServiceKept| runs.services.contains(&its.service);
        let is_broken =
            |its: &ServiceKept| its.failed.is_some() || its.kept.is_none_or(|kept| kept < self.options.keep);
        let first = self.kept(changed).into_iter().find(|its| counts(its) && is_broken(its));
        Verdict { breaks: unended || first.is_some(), first }
    }
}

#[cfg(test)]
mod tests;
