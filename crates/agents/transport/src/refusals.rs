//! Reasons for which the core refuses connections.

use std::collections::BTreeSet;

/// Most reasons that are reported. Each is reported once.
const MOST: usize = 32;

/// The reasons that were reported.
#[derive(Debug, Default)]
pub(crate) struct Refusals(BTreeSet<String>);

impl Refusals {
    /// Warns of a reason, unless that was done.
    pub(crate) fn warn(&mut self, reason: String) {
        if self.is_new(&reason) {
            tracing::warn!(
                "refused a connection of an agent: {reason}; `cotorra-agent check` there says what to do"
            );
        }
    }

    /// Notes a reason that needs no action, unless it was noted before.
    pub(crate) fn note(&mut self, reason: String) {
        if self.is_new(&reason) {
            tracing::info!("refused a connection of an agent: {reason}");
        }
    }

    fn is_new(&mut self, reason: &str) -> bool {
        self.0.len() < MOST && self.0.insert(reason.to_owned())
    }
}
