//! The finished runs of a sweep, or of a shard of it.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::{Path, PathBuf},
};

use super::{
    axis::{Axis, combinations},
    cells::Cell,
    measured::Measured,
    plan::Point,
};
use crate::{batch::Again, outcome::Outcome};

/// A finished run.
#[derive(Debug, Clone, PartialEq)]
pub struct Done {
    pub point: Point,
    pub outcome: Outcome<Measured>,
    /// Place of its samples in the folder of the sweep, if they were kept.
    pub samples: PathBuf,
}

/// The result of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Runs {
    /// The axes of the sweep.
    pub axes: Vec<Axis>,
    /// The finished runs, in the order of [`Sweep::points`](super::Sweep::points).
    pub done: Vec<Done>,
    /// Number of finished runs that the folder already had.
    pub resumed: usize,
    /// Runs that the folder had, but not as they are now.
    pub again: Again,
    /// Number of all runs; more than the finished ones if the sweep was stopped.
    pub total: usize,
}

impl Runs {
    /// Creates the result of these runs; `None` stands for a run that is not finished.
    pub(super) fn new(
        axes: &[Axis],
        runs: impl ExactSizeIterator<Item = (Point, PathBuf, Option<Outcome<Measured>>)>,
        resumed: usize,
        again: Again,
    ) -> Self {
        let total = runs.len();
        let done =
            |(point, samples, outcome): (_, _, Option<_>)| Some(Done { point, outcome: outcome?, samples });
        let done = runs.filter_map(done).collect();
        Self { axes: axes.to_owned(), done, resumed, again, total }
    }

    /// Returns the number of void runs.
    pub fn void(&self) -> usize {
        self.done.iter().filter(|done| done.outcome.void().is_some()).count()
    }

    /// Returns the results of all runs that are not void.
    pub fn measured(&self) -> impl Iterator<Item = &Measured> {
        self.done.iter().filter_map(|done| done.outcome.measured())
    }

    /// Returns whether there are runs that differ in their seed alone, and all of these have the same results.
    pub fn are_alike(&self) -> bool {
        let mut first: BTreeMap<&[String], &Outcome<Measured>> = BTreeMap::new();
        let mut pairs = 0;
        self.done.iter().all(|done| match first.entry(&done.point.values) {
            Entry::Vacant(place) => {
                place.insert(&done.outcome);
                true
            }
            Entry::Occupied(other) => {
                pairs += 1;
                **other.get() == done.outcome
            }
        }) && pairs > 0
    }

    /// Returns the number of runs whose samples are in the folder of the sweep.
    pub fn with_samples(&self, folder: &Path) -> usize {
        self.done.iter().filter(|done| folder.join(&done.samples).is_file()).count()
    }

    /// Returns the statistics of each combination of the axes' values, without those that have no run. The last axis
    /// changes fastest.
    pub fn cells(&self) -> Vec<Cell> {
        let of = |values: Vec<String>| {
            let done = self.done.iter().filter(|done| done.point.values == values);
            let outcomes: Vec<_> = done.map(|done| &done.outcome).collect();
            (!outcomes.is_empty()).then(|| Cell::of(values, &outcomes))
        };
        combinations(&self.axes).into_iter().filter_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_alike_if_the_seed_changes_nothing() {
        let alike = |runs: &[(&str, usize)]| {
            let run = |&(value, handovers): &(&str, usize)| {
                let point = Point { values: vec![value.to_owned()], seed: 1 };
                let measured = Outcome::Measured(Measured { handovers, ..Measured::default() });
                (point, PathBuf::new(), Some(measured))
            };
            let runs: Vec<_> = runs.iter().map(run).collect();
            Runs::new(&[], runs.into_iter(), 0, Again::default()).are_alike()
        };
        assert!(alike(&[("a", 1), ("a", 1), ("b", 2), ("b", 2)]));
        assert!(!alike(&[("a", 1), ("a", 1), ("b", 2), ("b", 3)]));
        assert!(!alike(&[("a", 1), ("b", 1)]), "one seed says nothing");
    }
}
