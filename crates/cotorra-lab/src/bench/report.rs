//! Progress of benchmarks, and the rows of their table.

use std::{borrow::Cow, path::PathBuf};

use indicatif::ProgressBar;

/// Progress display of a benchmark, and what it needs to measure peers.
pub struct Bench {
    pub progress: ProgressBar,
    /// The program rattan.
    pub rattan: PathBuf,
    /// Whether this process is root, which peers need.
    pub root: bool,
}

impl Bench {
    /// Shows the measurement that is under way.
    pub fn show(&self, measurement: impl Into<Cow<'static, str>>) {
        self.progress.set_message(measurement);
    }
}

/// A row of the table.
#[derive(Debug)]
pub struct Row {
    /// Name of the figure.
    pub figure: String,
    pub median: String,
    pub tail: String,
    /// Goal on a machine with two cores.
    pub goal: &'static str,
    /// Reason why there is no figure, shown below the table because it is too long for a cell.
    pub missing: Option<String>,
}

impl Row {
    pub fn new(figure: impl Into<String>, median: impl Into<String>, tail: impl Into<String>) -> Self {
        Self { figure: figure.into(), median: median.into(), tail: tail.into(), goal: "", missing: None }
    }

    pub fn missing(figure: impl Into<String>, why: String) -> Self {
        Self { missing: Some(why), ..Self::new(figure, "-", "not measured") }
    }

    pub fn aiming_at(self, goal: &'static str) -> Self {
        Self { goal, ..self }
    }
}
