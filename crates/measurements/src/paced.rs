//! The way in for callers that decide when to write. The history depends on the events and on the flushes alone, not on
//! the speed of the machine: in virtual time the same run leaves the same bytes.

use std::sync::Arc;

use cotorra_graph::{Stamped, Timestamp};
use parking_lot::Mutex;

use crate::{
    error::Result,
    run::{Entry, Gap, RunId},
    store::Store,
};

/// Records the events of one run, and writes them on the thread that calls [`Self::flush`]. Clones share the events that
/// wait. Their number is unbounded, so callers must flush.
#[derive(Clone)]
pub struct PacedRecorder {
    run: RunId,
    store: Arc<dyn Store>,
    waiting: Arc<Mutex<Waiting>>,
}

#[derive(Default)]
struct Waiting {
    entries: Vec<Entry>,
    /// Events that no history can hold.
    gap: Option<Gap>,
    dropped: u64,
}

impl PacedRecorder {
    pub(crate) fn new(store: Arc<dyn Store>, run: RunId) -> Self {
        Self { run, store, waiting: Arc::default() }
    }

    /// Records an event.
    pub fn record(&self, stamped: Stamped) {
        let mut waiting = self.waiting.lock();
        if stamped.is_storable() {
            waiting.entries.push(Entry { run: self.run, stamped });
        } else {
            waiting.lose(stamped.at);
        }
    }

    /// Writes the events that wait. They are durable when this returns.
    ///
    /// # Errors
    /// When they cannot be written. Nothing is lost by that: they wait for the next flush.
    pub fn flush(&self) -> Result<()> {
        let mut waiting = self.waiting.lock();
        if waiting.entries.is_empty() && waiting.gap.is_none() {
            return Ok(());
        }
        let gaps: Vec<_> = waiting.gap.iter().map(|gap| (self.run, *gap)).collect();
        self.store.append(&waiting.entries, &gaps)?;
        waiting.entries.clear();
        waiting.gap = None;
        Ok(())
    }

    /// Returns the number of events lost because no history can hold them; the history has them as gaps.
    pub fn dropped(&self) -> u64 {
        self.waiting.lock().dropped
    }
}

impl Waiting {
    fn lose(&mut self, at: Timestamp) {
        self.dropped += 1;
        let before = self.gap.unwrap_or(Gap { from: at, until: at, events: 0 });
        let (from, until) = (before.from.min(at), before.until.max(at));
        self.gap = Some(Gap { from, until, events: before.events + 1 });
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        History, PageRequest,
        testing::{notice, run_info},
    };

    #[test]
    fn events_are_written_on_flush_only_and_unstorable_ones_become_a_gap() {
        let history = History::in_memory().unwrap();
        let run = history.begin_run(&run_info("paced")).unwrap();
        let recorder = history.paced_recorder(run).unwrap();
        recorder.record(notice(1, "first"));
        recorder.clone().record(notice(u64::MAX, "too late for any history"));
        let events = || history.events(run, &[], .., PageRequest::default()).unwrap().items;
        assert_eq!(events(), []);
        recorder.flush().unwrap();
        assert_eq!(events(), [notice(1, "first")]);
        let gaps = history.gaps(run, .., PageRequest::default()).unwrap().items;
        assert_eq!((gaps.len(), gaps[0].events, recorder.dropped()), (1, 1, 1));
        recorder.flush().unwrap();
        assert_eq!(events().len(), 1);
    }
}
