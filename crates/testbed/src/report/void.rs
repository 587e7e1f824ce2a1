//! The reasons for which a run's figures are not valid.

use std::fmt;

use serde::{Deserialize, Serialize, Serializer};

/// The reasons for which the figures of a run are not valid; none if they are. As JSON, the first reason.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", from = "String")]
pub struct Void(Vec<Reason>);

#[derive(Debug, Clone, PartialEq, Eq)]
struct Reason {
    text: String,
    /// Place of the log of a plug-in, in the run's folder.
    log: Option<String>,
    /// Whether figures are missing, and the others are not wrong.
    is_missing: bool,
}

impl Void {
    /// Returns itself unless the figures are valid.
    pub fn void(&self) -> Option<Self> {
        (!self.is_valid()).then(|| self.clone())
    }

    /// Returns the reasons for which figures are wrong; `None` if some are missing at most.
    ///
    /// If an earlier run had all figures, missing ones are the effect of the change since.
    pub fn wrong(&self) -> Option<Self> {
        Self(self.0.iter().filter(|reason| !reason.is_missing).cloned().collect()).void()
    }

    /// Whether the figures are valid.
    pub fn is_valid(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the reason for one of several runs.
    pub fn among(&self, void: usize, runs: usize) -> Self {
        if runs > 1 { format!("{} ({void} of {runs} runs)", self.reason()).into() } else { self.clone() }
    }

    /// Returns the first reason; empty without any.
    pub fn reason(&self) -> &str {
        self.0.first().map_or("", |reason| &reason.text)
    }

    /// Returns all reasons, with the places of logs in the run's folder.
    pub fn reasons(&self) -> impl Iterator<Item = String> {
        let of = |Reason { text, log, .. }: &Reason| match log {
            Some(log) => format!("{text} ({log})"),
            None => text.clone(),
        };
        self.0.iter().map(of)
    }

    /// Serializes all reasons as a list.
    pub(super) fn list<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.reasons())
    }

    /// Adds plug-ins that were cut off: why, and the places of their logs in the run's folder.
    pub(super) fn cut_off(&mut self, plugins: impl IntoIterator<Item = (String, Option<String>)>) {
        self.0.extend(plugins.into_iter().map(|(text, log)| Reason { text, log, is_missing: false }));
    }

    /// Adds reasons for which figures are wrong.
    pub(super) fn wrong_by(&mut self, texts: impl IntoIterator<Item = String>) {
        self.0.extend(texts.into_iter().map(|text| Reason { text, log: None, is_missing: false }));
    }

    /// Adds figures that are missing.
    pub(super) fn missing(&mut self, texts: impl IntoIterator<Item = String>) {
        self.0.extend(texts.into_iter().map(|text| Reason { text, log: None, is_missing: true }));
    }
}

impl fmt::Display for Void {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "void: {}", self.reason())
    }
}

impl From<String> for Void {
    fn from(text: String) -> Self {
        Self(vec![Reason { text, log: None, is_missing: false }])
    }
}

impl From<Void> for String {
    fn from(void: Void) -> Self {
        void.reason().to_owned()
    }
}
