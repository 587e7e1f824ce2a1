//! Prunes a history during a run as the testbed file demands, on a thread of its own.

use std::{
    io,
    sync::{
        Arc,
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use cotorra_graph::Testbed;
use cotorra_measurements::{History, Kind, RunId};

use crate::events::live::Live;

/// Interval between checks for old entries.
const PERIOD: Duration = Duration::from_secs(5);

/// The pruning thread. It ends when this is dropped.
pub(crate) struct Pruner {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Pruner {
    /// Starts the thread; returns `None` if everything is kept.
    pub fn start(
        testbed: &Testbed,
        history: &Arc<History>,
        run: RunId,
        live: &Live,
    ) -> io::Result<Option<Self>> {
        let kept = testbed.retention;
        let of = [
            (Kind::Robot, kept.robots),
            (Kind::Radio, kept.radio_units),
            (Kind::Link, kept.links),
            (Kind::Sensor, kept.sensors),
            (Kind::Machine, kept.machines),
        ];
        let of: Vec<_> = of.into_iter().filter_map(|(kind, kept)| Some((kind, kept?))).collect();
        if of.is_empty() {
            return Ok(None);
        }
        let (history, live) = (Arc::clone(history), live.clone());
        let (stop, stopped) = mpsc::channel::<()>();
        let work = move || {
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                let now = live.read(|now| now.at);
                for (kind, kept) in &of {
                    let go_on = || stopped.try_recv() == Err(mpsc::TryRecvError::Empty);
                    if let Err(error) = history.retain(run, *kind, kept, now, false, go_on) {
                        tracing::warn!(%error, "cannot roll up old samples");
                    }
                }
            }
        };
        let thread = thread::Builder::new().name("retention".to_owned()).spawn(work)?;
        Ok(Some(Self { stop: Some(stop), thread: Some(thread) }))
    }
}

impl Drop for Pruner {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that rolls old samples up panicked");
        }
    }
}
