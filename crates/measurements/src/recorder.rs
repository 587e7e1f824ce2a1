//! The way in. Events enter a bounded queue without blocking; one thread writes them in batches. Events that do not fit
//! are counted, and recorded as a gap.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicIsize, AtomicU64, AtomicUsize, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle, Thread},
    time::Duration,
};

use cotorra_graph::{Stamped, Timestamp};
use parking_lot::{Condvar, Mutex};
use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    run::{Entry, Gap, RunId},
    store::Store,
};

/// Capacity of the queue, events of about 400 bytes each: 13 MB.
const QUEUE: usize = 32_768;

/// The most bytes of events that are not written yet, with their texts and lists.
const QUEUE_BYTES: usize = 64 << 20;

/// Queue length at which the writer is woken early. Below it, recording makes no system call.
const WAKE_AT: isize = QUEUE as isize / 4;

/// Poll interval of the writer.
const PERIOD: Duration = Duration::from_millis(100);

/// Records the events of one run. Clones share the run and may be used from any thread.
#[derive(Clone)]
pub struct Recorder {
    run: RunId,
    tally: Arc<Tally>,
    queue: Arc<Queue>,
}

/// Counters of a recorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RecorderStats {
    /// Events accepted.
    pub recorded: u64,
    /// Accepted events that are durable.
    pub written: u64,
    /// Events lost because the queue was full or no history can hold them; the history has them as gaps.
    pub dropped: u64,
}

impl Recorder {
    /// Records an event. Never blocks: if the writer cannot keep up for long, the event is dropped and becomes part of a
    /// [`Gap`]. The event is durable within about 100 ms, or when [`Self::flush`] returns.
    pub fn record(&self, stamped: Stamped) {
        let at = stamped.at;
        if stamped.is_storable() && self.queue.push(Entry { run: self.run, stamped }) {
            self.tally.recorded.fetch_add(1, Ordering::Relaxed);
        } else {
            self.tally.drop_one(at);
        }
    }

    /// Waits until all events that this thread recorded before are durable: they survive kill -9 and a loss of power.
    ///
    /// # Errors
    /// When they cannot be written. Nothing is lost by that: the writer keeps its events and retries ten times a second.
    pub fn flush(&self) -> Result<()> {
        self.queue.flush()
    }

    /// Returns the counters of all clones together.
    pub fn stats(&self) -> RecorderStats {
        RecorderStats {
            recorded: self.tally.recorded.load(Ordering::Relaxed),
            written: self.tally.written.load(Ordering::Relaxed),
            dropped: self.tally.dropped.load(Ordering::Relaxed),
        }
    }
}

/// Counters for the events of one run.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    recorded: AtomicU64,
    written: AtomicU64,
    dropped: AtomicU64,
    gap: OpenGap,
}

impl Tally {
    fn drop_one(&self, at: Timestamp) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
        self.gap.extend(at);
    }
}

/// A gap that is not written yet. Lock-free, because recording must not wait for the writer.
#[derive(Debug)]
struct OpenGap {
    from: AtomicU64,
    until: AtomicU64,
    events: AtomicU64,
}

impl Default for OpenGap {
    fn default() -> Self {
        Self { from: AtomicU64::new(u64::MAX), until: AtomicU64::new(0), events: AtomicU64::new(0) }
    }
}

impl OpenGap {
    fn extend(&self, at: Timestamp) {
        self.from.fetch_min(at.as_nanos(), Ordering::Relaxed);
        self.until.fetch_max(at.as_nanos(), Ordering::Relaxed);
        self.events.fetch_add(1, Ordering::Release);
    }

    /// Closes the gap. An event that is lost meanwhile may have its time in this gap and its count in the next. The next
    /// gap then has no times of its own, and takes those of the one before.
    fn close(&self, before: Option<Gap>) -> Option<Gap> {
        let events = self.events.swap(0, Ordering::Acquire);
        if events == 0 {
            return None;
        }
        let from = Timestamp::from_nanos(self.from.swap(u64::MAX, Ordering::Relaxed));
        let until = Timestamp::from_nanos(self.until.swap(0, Ordering::Relaxed));
        Some(match before {
            Some(before) if from > until => Gap { events, ..before },
            _ => Gap { from, until, events },
        })
    }
}

/// The queue, and the thread that empties it. When the last recorder and the history are gone, the thread writes the
/// events that wait, and ends.
pub(crate) struct Queue {
    sender: SyncSender<Entry>,
    shared: Arc<Shared>,
    writer: Option<JoinHandle<()>>,
    wake: Thread,
}

/// State shared by the writer's thread and recorders.
#[derive(Default)]
struct Shared {
    /// Events in the queue. Below zero for a moment if an event is taken before it was counted.
    waiting: AtomicIsize,
    /// Bytes of all events that are not written yet.
    bytes: AtomicUsize,
    closing: AtomicBool,
    flush: Mutex<Flush>,
    flushed: Condvar,
    tallies: Mutex<BTreeMap<RunId, Arc<Tally>>>,
}

/// Flushes are numbered. Each waits for a round of the writer that began after the flush was requested.
#[derive(Default)]
struct Flush {
    asked: u64,
    /// The latest flush that a round served, with or without an error.
    tried: u64,
    /// The latest flush that succeeded.
    durable: u64,
    /// Error of the last round that failed.
    error: Option<Error>,
}

impl Queue {
    pub fn new(store: Arc<dyn Store>) -> Result<Self> {
        let (sender, receiver) = sync_channel(QUEUE);
        let shared = Arc::new(Shared::default());
        let mut writer = Writer {
            store,
            receiver,
            shared: shared.clone(),
            batch: Vec::new(),
            gaps: BTreeMap::new(),
            failing: false,
        };
        let thread = thread::Builder::new().name("history".to_owned()).spawn(move || writer.work());
        let thread = thread.map_err(|cause| Error::Thread { cause: Arc::new(cause) })?;
        Ok(Self { sender, shared, wake: thread.thread().clone(), writer: Some(thread) })
    }

    pub fn recorder(self: &Arc<Self>, run: RunId) -> Recorder {
        let tally = self.shared.tallies.lock().entry(run).or_default().clone();
        Recorder { run, tally, queue: self.clone() }
    }

    /// Adds an entry. Returns whether there was room.
    fn push(&self, entry: Entry) -> bool {
        let bytes = entry.stamped.event.bytes();
        if self.shared.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > QUEUE_BYTES {
            self.shared.bytes.fetch_sub(bytes, Ordering::Relaxed);
            return false;
        }
        match self.sender.try_send(entry) {
            Ok(()) => {
                if self.shared.waiting.fetch_add(1, Ordering::Relaxed) + 1 == WAKE_AT {
                    self.wake.unpark();
                }
                true
            }
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.shared.bytes.fetch_sub(bytes, Ordering::Relaxed);
                false
            }
        }
    }

    pub fn flush(&self) -> Result<()> {
        let mut flush = self.shared.flush.lock();
        flush.asked += 1;
        let mine = flush.asked;
        self.wake.unpark();
        loop {
            if flush.durable >= mine {
                return Ok(());
            }
            if flush.tried >= mine {
                return Err(flush.error.clone().unwrap_or(Error::Stopped));
            }
            self.shared.flushed.wait(&mut flush);
        }
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        self.shared.closing.store(true, Ordering::Release);
        self.wake.unpark();
        if let Some(writer) = self.writer.take()
            && writer.join().is_err()
        {
            tracing::error!("the writer of the history panicked: what it had not written is lost");
        }
    }
}

/// The writer's side.
struct Writer {
    store: Arc<dyn Store>,
    receiver: Receiver<Entry>,
    shared: Arc<Shared>,
    /// Events taken from the queue and not written yet. They stay when writing fails.
    batch: Vec<Entry>,
    gaps: BTreeMap<RunId, Gap>,
    failing: bool,
}

impl Writer {
    fn work(&mut self) {
        // Even after a panic, no flush waits for ever.
        let _answer = AnswerAll(self.shared.clone());
        loop {
            let closing = self.shared.closing.load(Ordering::Acquire);
            let asked = self.shared.flush.lock().asked;
            let outcome = self.round();
            let failed = outcome.is_err();
            self.report(&outcome);
            self.answer(asked, outcome);
            if closing && (failed || self.shared.waiting.load(Ordering::Acquire) <= 0) {
                break;
            }
            // While writing fails, even a full queue waits for the next period.
            if failed || self.shared.waiting.load(Ordering::Relaxed) < WAKE_AT {
                thread::park_timeout(PERIOD);
            }
        }
        self.give_up();
    }

    /// Writes the events that could not be written before, then those that wait. Takes no more than fit in the queue: all
    /// that were there at the beginning, and so all that a flush covers.
    fn round(&mut self) -> Result<()> {
        self.write()?;
        self.batch.extend(self.receiver.try_iter().take(QUEUE));
        self.shared.waiting.fetch_sub(self.batch.len() as isize, Ordering::AcqRel);
        self.close_gaps();
        self.write()
    }

    fn write(&mut self) -> Result<()> {
        if self.batch.is_empty() && self.gaps.is_empty() {
            return Ok(());
        }
        let gaps: Vec<_> = self.gaps.iter().map(|(run, gap)| (*run, *gap)).collect();
        self.store.append(&self.batch, &gaps)?;
        self.gaps.clear();
        let tallies = self.shared.tallies.lock();
        for entries in self.batch.chunk_by(|a, b| a.run == b.run) {
            if let Some(tally) = tallies.get(&entries[0].run) {
                tally.written.fetch_add(entries.len() as u64, Ordering::Relaxed);
            }
        }
        let bytes = self.batch.iter().map(|entry| entry.stamped.event.bytes()).sum();
        self.shared.bytes.fetch_sub(bytes, Ordering::Relaxed);
        self.batch.clear();
        Ok(())
    }

    /// Drops the events that cannot be written at the end, and records them as a gap where there is room for that.
    fn give_up(&mut self) {
        self.batch.extend(self.receiver.try_iter());
        self.close_gaps();
        if self.batch.is_empty() && self.gaps.is_empty() {
            return;
        }
        let events = self.batch.len();
        for Entry { run, stamped } in self.batch.drain(..) {
            let gap = Gap { from: stamped.at, until: stamped.at, events: 1 };
            self.gaps.entry(run).and_modify(|before| *before = before.with(gap)).or_insert(gap);
        }
        let gaps_written = self.write().is_ok();
        tracing::error!(events, gaps_written, "the history ends without the last events: see above");
    }

    /// Adds events lost since the last round to the gaps to write.
    fn close_gaps(&mut self) {
        for (run, tally) in self.shared.tallies.lock().iter() {
            let before = self.gaps.get(run).copied();
            let Some(gap) = tally.gap.close(before) else { continue };
            self.gaps.insert(*run, before.map_or(gap, |before| before.with(gap)));
        }
    }

    /// Logs once when writing begins to fail, and once when it works again.
    fn report(&mut self, outcome: &Result<()>) {
        match outcome {
            Err(error) if !self.failing => {
                tracing::error!(%error, "the history cannot be written; events are kept while there is room");
            }
            Ok(()) if self.failing => tracing::info!("the history is written again"),
            _ => {}
        }
        self.failing = outcome.is_err();
    }

    fn answer(&self, asked: u64, outcome: Result<()>) {
        let mut flush = self.shared.flush.lock();
        flush.tried = asked;
        match outcome {
            Ok(()) => flush.durable = asked,
            Err(error) => flush.error = Some(error),
        }
        drop(flush);
        self.shared.flushed.notify_all();
    }
}

/// Answers all flushes, present and future, when the writer's thread ends.
struct AnswerAll(Arc<Shared>);

impl Drop for AnswerAll {
    fn drop(&mut self) {
        let mut flush = self.0.flush.lock();
        flush.tried = u64::MAX;
        flush.error = Some(Error::Stopped);
        drop(flush);
        self.0.flushed.notify_all();
    }
}

#[cfg(test)]
mod tests;
