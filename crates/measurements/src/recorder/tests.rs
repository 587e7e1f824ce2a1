//! Checks a recorder's promises for any behaviour of the engine below it.

use std::{collections::BTreeMap, thread};

use cotorra_graph::{ConditionChange, Decision, Event, Instruction, LinkId, PluginId};

use super::*;
use crate::{
    Figure, History, Kind, Page, PageRequest,
    memory::Memory,
    run::{Run, RunInfo},
    store::{Selection, Span},
    testing::{notice, run_info},
};

/// Next reaction of the engine below a recorder.
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
        *self.mood.lock() = mood;
        self.changed.notify_all();
    }

    fn wait_for_a_batch(&self) {
        let mut mood = self.mood.lock();
        while !self.arrived.load(Ordering::Acquire) {
            self.changed.wait(&mut mood);
        }
    }
}

impl Store for Moody {
    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        let mut mood = self.mood.lock();
        self.arrived.store(true, Ordering::Release);
        self.changed.notify_all();
        while *mood == Mood::Stuck {
            self.changed.wait(&mut mood);
        }
        match *mood {
            Mood::Full => Err(Error::Full { history: "history.sqlite".into() }),
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

    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, crate::rolled::Reading),
    ) -> Result<()> {
        self.memory.values(run, figure, span, each)
    }

    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.memory.extent(run, kind, span)
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
fn flushed_events_are_in_the_history() {
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
fn dropping_the_last_handle_writes_waiting_events() {
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
fn a_stuck_engine_causes_a_gap_and_blocks_no_recorder() {
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
    let gap =
        Gap { from: Timestamp::from_nanos(room + 1), until: Timestamp::from_nanos(room + 10), events: 10 };
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
fn flushes_fail_after_the_writer_panicked() {
    let (_, history, run) = Moody::history(Mood::Panics);
    let recorder = history.recorder(run).unwrap();
    recorder.record(notice(0, ""));
    assert!(matches!(recorder.flush(), Err(Error::Stopped)));
    recorder.record(notice(1, ""));
    assert!(matches!(recorder.flush(), Err(Error::Stopped)));
    assert!(matches!(history.end_run(run, Timestamp::ZERO), Err(Error::Stopped)));
}

#[test]
fn events_that_no_history_can_hold_become_a_gap() {
    let (_, history, run) = Moody::history(Mood::Well);
    let recorder = history.recorder(run).unwrap();
    let change = ConditionChange { delay_scale: Some(f64::NAN), ..ConditionChange::default() };
    let decision = Decision {
        plugin: PluginId::new("wild").unwrap(),
        instruction: Instruction::Condition { link: LinkId::new("a-b").unwrap(), direction: None, change },
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
fn events_that_wait_are_bounded_in_bytes() {
    let (store, history, run) = Moody::history(Mood::Stuck);
    let recorder = history.recorder(run).unwrap();
    let message = "x".repeat(1 << 20);
    (0..200).for_each(|n| recorder.record(notice(n, &message)));
    let waiting = recorder.queue.shared.bytes.load(Ordering::Relaxed);
    assert!(waiting <= QUEUE_BYTES && waiting > QUEUE_BYTES - (2 << 20), "{waiting}");
    store.set(Mood::Well);
    recorder.flush().unwrap();
    let (kept, dropped) = (all(&history, run).len() as u64, recorder.stats().dropped);
    assert_eq!((kept + dropped, kept), (200, 63));
    assert_eq!(recorder.queue.shared.bytes.load(Ordering::Relaxed), 0);
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
