//! The contexts that a plug-in knows, and their ages.

use std::collections::BTreeMap;

use cotorra_graph::{ContextKind, EventKind, PluginId, Series, Staleness, Stamped, Timestamp};

/// Time of the newest context of each series that has arrived.
#[derive(Debug, Default)]
pub(super) struct Known(BTreeMap<Series, Timestamp>);

/// Times of the contexts that a plug-in knew when it decided, by kind.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Ages(BTreeMap<ContextKind, Times>);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Times {
    contexts: u32,
    youngest: Timestamp,
    oldest: Timestamp,
}

impl Known {
    /// Adds a context. Events that are no contexts, and older contexts, change nothing.
    pub(super) fn add(&mut self, context: &Stamped) {
        if EventKind::of(&context.event).context().is_some()
            && let Some(series) = context.event.series()
        {
            let at = self.0.entry(series).or_insert(context.at);
            *at = context.at.max(*at);
        }
    }

    pub(super) fn ages(&self) -> Ages {
        let mut ages = Ages::default();
        for (series, &at) in &self.0 {
            let Some(kind) = series.kind.context() else { continue };
            let new = Times { contexts: 0, youngest: at, oldest: at };
            let times = ages.0.entry(kind).or_insert(new);
            times.contexts += 1;
            (times.youngest, times.oldest) = (times.youngest.max(at), times.oldest.min(at));
        }
        ages
    }
}

impl Ages {
    /// Returns the ages at a time.
    pub(super) fn at(&self, now: Timestamp, plugin: &PluginId) -> Vec<Staleness> {
        let staleness = |(&kind, times): (&ContextKind, &Times)| Staleness {
            plugin: plugin.clone(),
            kind,
            contexts: times.contexts,
            youngest: now.since(times.youngest),
            oldest: now.since(times.oldest),
        };
        self.0.iter().map(staleness).collect()
    }
}
