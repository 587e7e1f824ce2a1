//! What a sweep runs, without its testbed file.

use serde::{Deserialize, Serialize};

use super::axis::{Axis, combinations};

/// One run of a sweep.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Point {
    /// One value per axis, in the order of the axes.
    pub values: Vec<String>,
    pub seed: u64,
}

impl Point {
    /// Returns the name of the run, as users and journals have it.
    pub(super) fn name(&self, axes: &[Axis]) -> String {
        let settings = axes.iter().zip(&self.values).map(|(axis, value)| format!("{}={value}", axis.path()));
        settings.chain([format!("seed={}", self.seed)]).collect::<Vec<_>>().join(" ")
    }
}

/// All runs of a sweep.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Name of the testbed, and a hash of all that the runs have in common.
    pub(super) sweep: String,
    pub(super) axes: Vec<Axis>,
    /// Number of runs of each combination.
    pub(super) seeds: u32,
    /// Seed of each combination's first run.
    pub(super) first_seeds: Vec<u64>,
}

impl Plan {
    /// Returns the number of runs.
    pub(super) fn len(&self) -> usize {
        self.first_seeds.len() * self.seeds as usize
    }

    /// Returns the runs: each combination with each seed.
    pub(super) fn points(&self) -> Vec<Point> {
        let each = combinations(&self.axes).into_iter().zip(&self.first_seeds);
        let seeds = |first: u64| (0..u64::from(self.seeds)).map(move |i| first.wrapping_add(i));
        each.flat_map(|(values, &first)| seeds(first).map(move |seed| Point { values: values.clone(), seed }))
            .collect()
    }

    /// Returns whether there is a first seed for each combination.
    pub(super) fn is_whole(&self) -> bool {
        let combinations =
            self.axes.iter().try_fold(1_usize, |product, axis| product.checked_mul(axis.values().len()));
        combinations == Some(self.first_seeds.len())
    }

    /// Returns what another plan has otherwise; `None` if both have the same runs.
    pub(super) fn difference(&self, other: &Self) -> Option<&'static str> {
        let settings = |plan: &Self| -> Vec<_> {
            plan.axes.iter().map(|axis| (axis.path().to_owned(), axis.values().to_owned())).collect()
        };
        if self.sweep != other.sweep {
            Some("testbed file, version of cotorra, --until or paths of --set")
        } else if settings(self) != settings(other) {
            Some("values of --set")
        } else if self.seeds != other.seeds {
            Some("number of seeds")
        } else {
            (self.first_seeds != other.first_seeds).then_some("first seeds")
        }
    }
}
