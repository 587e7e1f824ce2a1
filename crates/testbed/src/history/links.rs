//! The history of the present run as bundled plug-ins read it.

use std::{
    fmt,
    sync::{Arc, OnceLock},
};

use cotorra_graph::{LinkContext, Timestamp};
use cotorra_measurements::{Error, History, RunId};
use cotorra_plugin::links::LinkHistory;

/// A run's history for its plug-ins. They are made before it begins.
#[derive(Clone, Default)]
pub(crate) struct RunHistory(Arc<OnceLock<Begun>>);

/// A history that has begun.
struct Begun {
    history: Arc<History>,
    run: RunId,
    /// Writes the events that wait.
    flush: Flush,
}

type Flush = Box<dyn Fn() -> Result<(), Error> + Send + Sync>;

impl RunHistory {
    /// Sets the history. `flush` writes the events that wait, and is called before each reading.
    pub(crate) fn begin(
        &self,
        history: &Arc<History>,
        run: RunId,
        flush: impl Fn() -> Result<(), Error> + Send + Sync + 'static,
    ) {
        let begun = Begun { history: Arc::clone(history), run, flush: Box::new(flush) };
        assert!(self.0.set(begun).is_ok(), "a run has one history");
    }
}

impl fmt::Debug for RunHistory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let run = self.0.get().map(|begun| begun.run);
        f.debug_struct("RunHistory").field("run", &run).finish_non_exhaustive()
    }
}

impl LinkHistory for RunHistory {
    fn latest(&mut self, now: Timestamp) -> Result<Vec<(Timestamp, LinkContext)>, String> {
        let Begun { history, run, flush } = self.0.get().ok_or("the history has not begun")?;
        let state = flush().and_then(|()| history.state_at(*run, now));
        let links = state.map_err(|error| error.to_string())?.links;
        Ok(links.into_iter().map(|sample| (sample.at, sample.value)).collect())
    }
}
