//! Outcomes of runs: results that count, or the reason for which a run has none.

use std::fmt;

use cotorra_testbed::Summary;
use serde::{Deserialize, Serialize};

/// The reason for which the figures of a run are not those of its testbed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Void(String);

impl Void {
    /// Returns whether a run shows something else than its testbed, and why: a plug-in that is not optional was cut off, or ended
    /// before the run did. A service without a sample is a result.
    pub fn of(summary: &Summary) -> Option<Self> {
        summary.plugin_faults.first().map(|fault| Self(format!("plug-in {fault}")))
    }

    /// Returns the reason for one of several runs.
    pub(crate) fn among(&self, void: usize, runs: usize) -> Self {
        if runs > 1 { Self(format!("{} ({void} of {runs} runs)", self.0)) } else { self.clone() }
    }

    /// Returns the reason.
    pub fn reason(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Void {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "void: {}", self.0)
    }
}

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
