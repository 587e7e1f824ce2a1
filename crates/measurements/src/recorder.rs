//! The way in. What happens in a testbed is put in a bounded queue, without ever waiting; one thread takes it from
//! there in batches and writes them. What does not fit is counted, and told as a gap.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicIsize, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle, Thread},
    time::Duration,
};

use cotorra_graph::{Stamped, Timestamp};
use serde::{Deserialize, Serialize};

use crate::{
    codec,
    error::{Error, Result},
    store::{Entry, Gap, RunId, Store},
};

/// Events that wait to be written, at most. About 400 bytes each: 13 MB.
const QUEUE: usize = 32_768;

/// The writer is woken early when so many wait. Below that, recording makes no system call.
const WAKE_AT: isize = QUEUE as isize / 2;

/// How often the writer looks at the queue.
const PERIOD: Duration = Duration::from_millis(100);

/// Records the events of one run. Clones share the run and may be used from any thread.
#[derive(Clone)]
pub struct Recorder {
    run: RunId,
    tally: Arc<Tally>,
    queue: Arc<Queue>,
}

/// What a recorder did so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RecorderStats {
    /// Events taken.
    pub recorded: u64,
    /// Of these, events that are durable.
    pub written: u64,
    /// Events lost because the queue was full or no history can hold them; the history tells them as gaps.
    pub dropped: u64,
}

impl Recorder {
    /// Takes an event. Never waits: if the writer cannot keep up for long, the event is dropped and becomes part of
    /// a [`Gap`]. Durable within about 100 ms, or when [`Self::flush`] returns.
    pub fn record(&self, stamped: Stamped) {
        let at = stamped.at;
        if codec::storable(&stamped) && self.queue.push(Entry { run: self.run, stamped }) {
            self.tally.recorded.fetch_add(1, Ordering::Relaxed);
        } else {
            self.tally.drop_one(at);
        }
    }

    /// Waits until everything that this thread recorded before is durable: it survives kill -9 and a loss of power.
    ///
    /// # Errors
    /// When it cannot be written. Nothing is lost by that: the writer keeps what it has and tries again, ten times
    /// a second.
    pub fn flush(&self) -> Result<()> {
        self.queue.flush()
    }

    /// What it did so far, all clones taken together.
    pub fn stats(&self) -> RecorderStats {
        RecorderStats {
            recorded: self.tally.recorded.load(Ordering::Relaxed),
            written: self.tally.written.load(Ordering::Relaxed),
            dropped: self.tally.dropped.load(Ordering::Relaxed),
        }
    }
}

/// What happened to the events of one run.
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

/// A gap that is not written yet. Lock-free, as recording must not wait for the writer.
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

    /// Closes the gap. An event that is lost meanwhile may have its time in this gap and its count in the next:
    /// that one then has no times of its own, and takes those of the one before.
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

/// The queue, and the thread that empties it. Ends the thread when the last recorder and the history are gone,
/// after what waits has been written.
pub(crate) struct Queue {
    sender: SyncSender<Entry>,
    shared: Arc<Shared>,
    writer: Option<JoinHandle<()>>,
    wake: Thread,
}

/// What the writer's thread has in common with those that record.
#[derive(Default)]
struct Shared {
    /// Events in the queue. Below zero for a moment if one is taken before it was counted.
    waiting: AtomicIsize,
    closing: AtomicBool,
    flush: Mutex<Flush>,
    flushed: Condvar,
    tallies: Mutex<BTreeMap<RunId, Arc<Tally>>>,
}

/// Flushes are numbered; each waits for a round of the writer that began after it was asked for.
#[derive(Default)]
struct Flush {
    asked: u64,
    /// The latest that a round served, well or not.
    tried: u64,
    /// The latest that was served well.
    durable: u64,
    /// Why the last round failed.
    error: Option<Error>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing panics while it holds one of these locks.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
        let tally = lock(&self.shared.tallies).entry(run).or_default().clone();
        Recorder { run, tally, queue: self.clone() }
    }

    /// Whether there was room.
    fn push(&self, entry: Entry) -> bool {
        match self.sender.try_send(entry) {
            Ok(()) => {
                if self.shared.waiting.fetch_add(1, Ordering::Relaxed) + 1 == WAKE_AT {
                    self.wake.unpark();
                }
                true
            }
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        }
    }

    pub fn flush(&self) -> Result<()> {
        let mut flush = lock(&self.shared.flush);
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
            flush = self.shared.flushed.wait(flush).unwrap_or_else(PoisonError::into_inner);
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
    /// What was taken from the queue and is not written yet: kept when writing fails.
    batch: Vec<Entry>,
    gaps: BTreeMap<RunId, Gap>,
    failing: bool,
}

impl Writer {
    fn work(&mut self) {
        // However this ends, nobody waits for it for ever.
        let _answer = AnswerAll(self.shared.clone());
        loop {
            let closing = self.shared.closing.load(Ordering::Acquire);
            let asked = lock(&self.shared.flush).asked;
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
        if !self.batch.is_empty() {
            tracing::error!(events = self.batch.len(), "the history ends without the last events: see above");
        }
    }

    /// Writes what could not be written before, then what waits. Takes no more than fits in the queue, which is all
    /// that was there at the beginning, and so all that a flush asked for.
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
        let tallies = lock(&self.shared.tallies);
        for entry in self.batch.drain(..) {
            if let Some(tally) = tallies.get(&entry.run) {
                tally.written.fetch_add(1, Ordering::Relaxed);
            }
        }
        Ok(())
    }

    /// Adds what was lost since the last round to the gaps that are to be written.
    fn close_gaps(&mut self) {
        for (run, tally) in lock(&self.shared.tallies).iter() {
            let before = self.gaps.get(run).copied();
            let Some(gap) = tally.gap.close(before) else { continue };
            let merged = before.map_or(gap, |before| Gap {
                from: before.from.min(gap.from),
                until: before.until.max(gap.until),
                events: before.events + gap.events,
            });
            self.gaps.insert(*run, merged);
        }
    }

    /// Says so once when writing begins to fail, and once when it works again.
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
        let mut flush = lock(&self.shared.flush);
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
        let mut flush = lock(&self.0.flush);
        flush.tried = u64::MAX;
        flush.error = Some(Error::Stopped);
        drop(flush);
        self.0.flushed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, thread};

    use cotorra_graph::{ConditionChange, Decision, Event, Instruction, LinkId, PluginId};

    use super::*;
    use crate::{
        History, Kind, PageRequest,
        memory::Memory,
        store::{Page, Run, RunInfo, Selection, Span},
        testing::{notice, run_info},
    };

    /// What the engine below a recorder does next.
    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Mood {
        Well,
        Stuck,
        Full,
        Panics,
    }

    /// An engine with moods.
    struct Moody {
        memory: Memory,
        mood: Mutex<Mood>,
        /// Signalled when the mood changes, and when a batch arrives.
        changed: Condvar,
        arrived: AtomicBool,
    }

    impl Moody {
        fn history(mood: Mood) -> (Arc<Self>, History, RunId) {
            let store = Arc::new(Self {
                memory: Memory::default(),
                mood: Mutex::new(mood),
                changed: Condvar::new(),
                arrived: AtomicBool::new(false),
            });
            let history = History::of(store.clone()).unwrap();
            let run = history.begin_run(&run_info("moody")).unwrap();
            (store, history, run)
        }

        fn set(&self, mood: Mood) {
            *lock(&self.mood) = mood;
            self.changed.notify_all();
        }

        fn wait_for_a_batch(&self) {
            let mut mood = lock(&self.mood);
            while !self.arrived.load(Ordering::Acquire) {
                mood = self.changed.wait(mood).unwrap();
            }
        }
    }

    impl Store for Moody {
        fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
            let mut mood = lock(&self.mood);
            self.arrived.store(true, Ordering::Release);
            self.changed.notify_all();
            while *mood == Mood::Stuck {
                mood = self.changed.wait(mood).unwrap();
            }
            match *mood {
                Mood::Full => Err(Error::Full { path: std::path::Path::new("history.sqlite").into() }),
                Mood::Panics => {
                    drop(mood);
                    panic!("as the test wants it")
                }
                Mood::Well | Mood::Stuck => self.memory.append(events, gaps),
            }
        }

        fn begin_run(&self, info: &RunInfo) -> Result<RunId> {
            self.memory.begin_run(info)
        }

        fn end_run(&self, run: RunId, at: Timestamp) -> Result<()> {
            self.memory.end_run(run, at)
        }

        fn run(&self, run: RunId) -> Result<Run> {
            self.memory.run(run)
        }

        fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
            self.memory.runs(after, limit)
        }

        fn events(
            &self,
            run: RunId,
            what: &Selection<'_>,
            span: Span,
            page: PageRequest,
        ) -> Result<Page<Stamped>> {
            self.memory.events(run, what, span, page)
        }

        fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
            self.memory.gaps(run, span, page)
        }

        fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
            self.memory.latest(run, at)
        }
    }

    fn all(history: &History, run: RunId) -> Vec<Stamped> {
        let mut all = Vec::new();
        let mut request = PageRequest::first(PageRequest::MAX);
        loop {
            let page = history.events(run, &[], .., request).unwrap();
            all.extend(page.items);
            let Some(next) = page.next else { return all };
            request = PageRequest::after(next, PageRequest::MAX);
        }
    }

    #[test]
    fn what_is_flushed_is_there() {
        let (_, history, run) = Moody::history(Mood::Well);
        let recorder = history.recorder(run).unwrap();
        let events: Vec<_> = (0..100).map(|n| notice(n, &n.to_string())).collect();
        for stamped in &events {
            recorder.record(stamped.clone());
        }
        recorder.flush().unwrap();
        assert_eq!(all(&history, run), events);
        assert_eq!(recorder.stats(), RecorderStats { recorded: 100, written: 100, dropped: 0 });
    }

    #[test]
    fn the_last_one_to_go_writes_what_waits() {
        let (store, history, run) = Moody::history(Mood::Well);
        let recorder = history.recorder(run).unwrap();
        drop(history);
        recorder.record(notice(1, "the last words"));
        drop(recorder);
        let found = store.events(run, &Selection::Kinds(&Kind::ALL), ALL, PageRequest::default()).unwrap();
        assert_eq!(found.items, [notice(1, "the last words")]);
    }

    const ALL: Span = Span { from: 0, until: i64::MAX };

    #[test]
    fn a_stuck_engine_makes_a_gap_and_nobody_wait() {
        let (store, history, run) = Moody::history(Mood::Stuck);
        let recorder = history.recorder(run).unwrap();
        recorder.record(notice(0, "taken by the writer, which is stuck with it"));
        let flush = thread::spawn({
            let recorder = recorder.clone();
            move || recorder.flush()
        });
        store.wait_for_a_batch();

        let room = QUEUE as u64;
        for n in 1..=room + 10 {
            recorder.record(notice(n, ""));
        }
        assert_eq!(recorder.stats(), RecorderStats { recorded: room + 1, written: 0, dropped: 10 });

        store.set(Mood::Well);
        flush.join().unwrap().unwrap();
        recorder.flush().unwrap();
        assert_eq!(all(&history, run).len(), QUEUE + 1);
        let gap = Gap {
            from: Timestamp::from_nanos(room + 1),
            until: Timestamp::from_nanos(room + 10),
            events: 10,
        };
        assert_eq!(history.gaps(run, .., PageRequest::default()).unwrap().items, [gap]);

        recorder.record(notice(room + 11, "room again"));
        recorder.flush().unwrap();
        assert_eq!(all(&history, run).len(), QUEUE + 2);
        assert_eq!(history.gaps(run, .., PageRequest::default()).unwrap().items, [gap]);
    }

    #[test]
    fn a_full_disk_loses_nothing_that_fits_in_the_queue() {
        let (store, history, run) = Moody::history(Mood::Full);
        let recorder = history.recorder(run).unwrap();
        for n in 0..10 {
            recorder.record(notice(n, ""));
            assert!(matches!(recorder.flush(), Err(Error::Full { .. })));
        }
        assert!(all(&history, run).is_empty());
        assert!(matches!(history.end_run(run, Timestamp::ZERO), Err(Error::Full { .. })));

        store.set(Mood::Well);
        recorder.flush().unwrap();
        assert_eq!(all(&history, run), (0..10).map(|n| notice(n, "")).collect::<Vec<_>>());
        assert_eq!(recorder.stats(), RecorderStats { recorded: 10, written: 10, dropped: 0 });
    }

    #[test]
    fn a_writer_that_panicked_is_told_and_nobody_waits_for_it() {
        let (_, history, run) = Moody::history(Mood::Panics);
        let recorder = history.recorder(run).unwrap();
        recorder.record(notice(0, ""));
        assert!(matches!(recorder.flush(), Err(Error::Stopped)));
        recorder.record(notice(1, ""));
        assert!(matches!(recorder.flush(), Err(Error::Stopped)));
        assert!(matches!(history.end_run(run, Timestamp::ZERO), Err(Error::Stopped)));
    }

    #[test]
    fn what_no_history_can_hold_is_a_gap() {
        let (_, history, run) = Moody::history(Mood::Well);
        let recorder = history.recorder(run).unwrap();
        let change = ConditionChange { delay_scale: Some(f64::NAN), ..ConditionChange::default() };
        let decision = Decision {
            plugin: PluginId::new("wild").unwrap(),
            instruction: Instruction::Condition {
                link: LinkId::new("a-b").unwrap(),
                direction: None,
                change,
            },
            reason: None,
            refused: Some("ψ is not a number".to_owned()),
        };
        recorder.record(Stamped { at: Timestamp::from_nanos(5), event: Event::Decision(decision) });
        recorder.record(notice(u64::MAX, "after 584 years"));
        recorder.record(notice(6, "fine"));
        recorder.flush().unwrap();
        assert_eq!(all(&history, run), [notice(6, "fine")]);
        let gaps = history.gaps(run, .., PageRequest::default()).unwrap().items;
        assert_eq!(gaps.iter().map(|gap| gap.events).sum::<u64>(), 2);
        assert_eq!(recorder.stats().dropped, 2);
    }

    #[test]
    fn threads_and_runs_do_not_mix() {
        let (_, history, first) = Moody::history(Mood::Well);
        let second = history.begin_run(&run_info("second")).unwrap();
        thread::scope(|scope| {
            for thread in 0..4_u64 {
                let recorder = history.recorder(if thread < 2 { first } else { second }).unwrap();
                scope.spawn(move || {
                    for n in 0..5000 {
                        recorder.record(notice(n, &thread.to_string()));
                    }
                    recorder.flush().unwrap();
                });
            }
        });
        for (run, threads) in [(first, ["0", "1"]), (second, ["2", "3"])] {
            let mut next = BTreeMap::from(threads.map(|thread| (thread.to_owned(), 0_u64)));
            for stamped in all(&history, run) {
                let Event::Notice { message } = stamped.event else { panic!("only notices were recorded") };
                let expected = next.get_mut(&message).expect("only this run's threads");
                assert_eq!(stamped.at.as_nanos(), *expected);
                *expected += 1;
            }
            assert!(next.values().all(|n| *n == 5000));
        }
    }

    #[test]
    fn a_gap_without_times_of_its_own_takes_those_before() {
        let gap = OpenGap::default();
        assert_eq!(gap.close(None), None);
        gap.extend(Timestamp::from_nanos(7));
        gap.extend(Timestamp::from_nanos(3));
        let first = gap.close(None).unwrap();
        let (from, until) = (Timestamp::from_nanos(3), Timestamp::from_nanos(7));
        assert_eq!(first, Gap { from, until, events: 2 });
        // An event whose times went into the gap before.
        gap.events.fetch_add(1, Ordering::Release);
        assert_eq!(gap.close(Some(first)), Some(Gap { from, until, events: 1 }));
    }
}
