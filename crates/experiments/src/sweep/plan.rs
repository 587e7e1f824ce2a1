//! The runs of a sweep, without its testbed file.

use serde::{Deserialize, Serialize};

use super::axis::{Axis, combinations};
use crate::key::{Key, Listed};

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
    /// Key of each combination's runs.
    pub(super) keys: Vec<Key>,
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

    /// Returns the key of the run at this place.
    pub(super) fn key(&self, place: usize) -> &Key {
        &self.keys[place / self.seeds as usize]
    }

    /// Returns whether there is a first seed and a key for each combination.
    pub(super) fn is_whole(&self) -> bool {
        let combinations =
            self.axes.iter().try_fold(1_usize, |product, axis| product.checked_mul(axis.values().len()));
        combinations == Some(self.first_seeds.len())
            && combinations == Some(self.keys.len())
            && self.seeds > 0
    }

    /// Returns what another plan has otherwise; `None` if both have the same runs.
    pub(super) fn difference(&self, other: &Self) -> Option<String> {
        let paths = |plan: &Self| plan.axes.iter().map(|axis| axis.path().to_owned()).collect::<Vec<_>>();
        let values = |plan: &Self| plan.axes.iter().map(|axis| axis.values().to_owned()).collect::<Vec<_>>();
        if paths(self) != paths(other) {
            return Some("paths of --set".to_owned());
        }
        if values(self) != values(other) {
            return Some("values of --set".to_owned());
        }
        let mut keys = self.keys.iter().zip(&other.keys);
        if let Some((one, another)) = keys.find(|(one, another)| one != another) {
            return Some(Listed(&one.changes(another, "testbed file")).to_string());
        }
        let difference = if self.seeds != other.seeds {
            "number of seeds"
        } else if self.first_seeds != other.first_seeds {
            "first seeds"
        } else if self.sweep != other.sweep {
            "testbed file, version of cotorra or --until"
        } else {
            return None;
        };
        Some(difference.to_owned())
    }
}
