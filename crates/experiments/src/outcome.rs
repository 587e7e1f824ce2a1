//! Outcomes of runs: results that count, or the reason for which a run has none.

use cotorra_testbed::Void;
use serde::{Deserialize, Serialize};

/// The outcome of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome<M> {
    /// Its results.
    Measured(M),
    /// It is void.
    Void(Void),
}

impl<M> Outcome<M> {
    /// Returns the results, unless the run is void.
    pub fn measured(&self) -> Option<&M> {
        match self {
            Self::Measured(measured) => Some(measured),
            Self::Void(_) => None,
        }
    }

    /// Returns the results, unless the run is void.
    pub(crate) fn into_measured(self) -> Option<M> {
        match self {
            Self::Measured(measured) => Some(measured),
            Self::Void(_) => None,
        }
    }

    /// Returns why the run is void, if it is.
    pub fn void(&self) -> Option<&Void> {
        match self {
            Self::Measured(_) => None,
            Self::Void(void) => Some(void),
        }
    }

    /// Converts the results.
    pub(crate) fn map<N>(self, convert: impl FnOnce(M) -> N) -> Outcome<N> {
        match self {
            Self::Measured(measured) => Outcome::Measured(convert(measured)),
            Self::Void(void) => Outcome::Void(void),
        }
    }
}
