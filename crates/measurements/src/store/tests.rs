//! Checks that every engine answers as an ordered list would.

use cotorra_graph::{Decision, Event, Instruction};
#[cfg(feature = "databases")]
use cotorra_testing::mariadb::MariaDb;
use proptest::{collection::vec, prelude::*};

use super::*;
use std::sync::Arc;

use crate::{
    Figure, LinkQuantity, RobotQuantity,
    error::Error,
    memory::Memory,
    rolled::Reading,
    sqlite::Sqlite,
    testing::{figure, run_info, stamped, time},
};
#[cfg(feature = "databases")]
use crate::{location::Location, server::Remote};

/// All engines, shared by the cases of a test.
struct Engines {
    folder: tempfile::TempDir,
    /// Shared by all cases, because creating a server's tables takes long.
    #[cfg(feature = "databases")]
    remote: Option<(Arc<Remote>, Arc<MariaDb>)>,
}

impl Engines {
    fn new() -> Self {
        #[cfg(feature = "databases")]
        let remote = MariaDb::shared().map(|server| {
            let Location::Server(place) = server.fresh().parse().unwrap() else { panic!("it is a server") };
            (Arc::new(Remote::open(&place).unwrap()), server)
        });
        Self {
            folder: tempfile::tempdir().unwrap(),
            #[cfg(feature = "databases")]
            remote,
        }
    }

    /// Returns each engine with two runs. Questions are about the first; the second must not interfere.
    fn fresh(&self) -> Vec<(Arc<dyn Store>, RunId, RunId)> {
        let path = self.folder.path().join("history.sqlite");
        for name in ["history.sqlite", "history.sqlite-wal", "history.sqlite-shm"] {
            let _ = std::fs::remove_file(path.with_file_name(name));
        }
        let local: [Arc<dyn Store>; 2] = [Arc::<Memory>::default(), Arc::new(Sqlite::open(&path).unwrap())];
        #[cfg(feature = "databases")]
        let remote = self.remote.iter().map(|(remote, _)| remote.clone() as Arc<dyn Store>);
        #[cfg(not(feature = "databases"))]
        let remote = [];
        let prepared = local.into_iter().chain(remote).map(|store| {
            let run = store.begin_run(&run_info("asked")).unwrap();
            let other = store.begin_run(&run_info("other")).unwrap();
            (store, run, other)
        });
        prepared.collect()
    }

    /// Opens the history of an engine other than memory a second time.
    fn again(&self, store: &Arc<dyn Store>) -> Box<dyn Store> {
        #[cfg(feature = "databases")]
        if let Some((remote, _)) = &self.remote
            && Arc::ptr_eq(store, &(remote.clone() as Arc<dyn Store>))
        {
            return Box::new(Remote::open(remote.place()).unwrap());
        }
        let _ = store;
        Box::new(Sqlite::open(&self.folder.path().join("history.sqlite")).unwrap())
    }
}

/// Runs a property with many cases against all engines.
fn check<S: Strategy>(
    what: S,
    property: impl Fn(&dyn Store, RunId, RunId, &S::Value) -> std::result::Result<(), TestCaseError>,
) where
    S::Value: Clone,
{
    let engines = Engines::new();
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig {
        source_file: Some(file!()),
        ..ProptestConfig::with_cases(48)
    });
    let outcome = runner.run(&what, |value| {
        engines.fresh().into_iter().try_for_each(|(store, run, other)| property(&*store, run, other, &value))
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

fn append(store: &dyn Store, run: RunId, other: RunId, events: &[Stamped], batch: usize) {
    for batch in events.chunks(batch) {
        let entries: Vec<_> = batch
            .iter()
            .flat_map(|stamped| [other, run].map(|run| Entry { run, stamped: stamped.clone() }))
            .collect();
        store.append(&entries, &[]).unwrap();
    }
}

/// Returns the items of all pages of an answer.
fn pages<T>(limit: usize, ask: impl Fn(PageRequest) -> Page<T>) -> Vec<T> {
    let mut all = Vec::new();
    let mut request = PageRequest::first(limit);
    loop {
        let page = ask(request);
        assert!(page.items.len() <= limit);
        all.extend(page.items);
        match page.next {
            Some(next) => request = PageRequest::after(next, limit),
            None => return all,
        }
    }
}

fn sorted(events: &[Stamped]) -> Vec<Stamped> {
    let mut events = events.to_vec();
    events.sort_by_key(|stamped| stamped.at);
    events
}

const ALL: Span = Span { from: 0, until: i64::MAX };

/// Events come back equal, in the order of time and then of recording, for any clock, batch size and page size.
#[test]
fn recorded_events_come_back_in_order() {
    check((vec(stamped(), 0..60), 1..20_usize, 1..20_usize), |store, run, other, (events, batch, limit)| {
        append(store, run, other, events, *batch);
        let what = Selection::Kinds(&Kind::ALL);
        let all = pages(*limit, |page| store.events(run, &what, ALL, page).unwrap());
        prop_assert_eq!(all, sorted(events));
        Ok(())
    });
}

/// Names differ by case, by the encoding of accents, and by spaces at the end.
#[test]
fn names_that_differ_in_one_byte_are_different() {
    let longest = "\u{1f916}".repeat(128);
    let steps = ["a", "a ", "a  ", "A", "á", "a\u{301}", " ", "  ", &longest];
    let decision = |step: &str| Decision {
        plugin: "p".parse().unwrap(),
        instruction: Instruction::Note { process: "q".to_owned(), step: step.to_owned(), ago: None },
        reason: None,
        refused: None,
    };
    let events =
        steps.map(|step| Stamped { at: Timestamp::from_nanos(0), event: Event::Decision(decision(step)) });
    for (store, run, other) in Engines::new().fresh() {
        append(&*store, run, other, &events, events.len());
        let found = pages(20, |page| store.events(run, &Selection::Kinds(&Kind::ALL), ALL, page).unwrap());
        assert_eq!(found, events);
    }
}

fn span(from: Timestamp, until: Timestamp) -> Span {
    Span { from: from.as_nanos() as i64, until: until.as_nanos() as i64 }
}

#[test]
fn selects_kinds_and_times() {
    let kinds = proptest::sample::subsequence(Kind::ALL.to_vec(), 1..5);
    let what = (vec(stamped(), 0..60), kinds, time(), time(), 1..20_usize);
    check(what, |store, run, other, (events, kinds, from, until, limit)| {
        append(store, run, other, events, 10);
        let what = Selection::Kinds(kinds);
        let found = pages(*limit, |page| store.events(run, &what, span(*from, *until), page).unwrap());
        let mut wanted = sorted(events);
        wanted.retain(|s| *from <= s.at && s.at <= *until && kinds.contains(&Kind::of(&s.event)));
        prop_assert_eq!(found, wanted);
        Ok(())
    });
}

#[test]
fn selects_series_and_times() {
    let what = (vec(stamped(), 0..60), time(), time(), 1..5_usize);
    check(what, |store, run, other, (events, from, until, limit)| {
        append(store, run, other, events, 10);
        for series in events.iter().filter_map(|s| s.event.series()) {
            let what = Selection::Series(series.clone());
            let found = pages(*limit, |page| store.events(run, &what, span(*from, *until), page).unwrap());
            let mut wanted = sorted(events);
            wanted.retain(|s| *from <= s.at && s.at <= *until && s.event.series().as_ref() == Some(&series));
            prop_assert_eq!(found, wanted);
        }
        Ok(())
    });
}

/// The state at a time holds the last of every series, and nothing else.
#[test]
fn knows_the_latest_of_every_series() {
    check((vec(stamped(), 0..60), time(), 1..20_usize), |store, run, other, (events, at, batch)| {
        let wanted: std::collections::BTreeMap<Series, Stamped> = sorted(events)
            .into_iter()
            .filter(|stamped| stamped.at <= *at)
            .filter_map(|stamped| Some((stamped.event.series()?, stamped)))
            .collect();
        append(store, run, other, events, *batch);
        let mut found = store.latest(run, at.as_nanos() as i64).unwrap();
        found.sort_by_key(|stamped| stamped.event.series());
        prop_assert_eq!(found, wanted.values().cloned().collect::<Vec<_>>());
        Ok(())
    });
}

#[test]
fn gaps_come_back_in_order() {
    check((vec((time(), time(), 1..u64::MAX), 0..10), 1..5_usize), |store, run, other, (gaps, limit)| {
        let gap = |(a, b, events): &(Timestamp, Timestamp, u64)| Gap {
            from: *a.min(b),
            until: *a.max(b),
            events: *events,
        };
        let mut wanted: Vec<Gap> = gaps.iter().map(gap).collect();
        let entries: Vec<_> = wanted.iter().flat_map(|gap| [(run, *gap), (other, *gap)]).collect();
        store.append(&[], &entries).unwrap();
        wanted.sort_by_key(|gap| gap.from);
        prop_assert_eq!(pages(*limit, |page| store.gaps(run, ALL, page).unwrap()), wanted);
        Ok(())
    });
}

/// Figures equal those of the events, whether they come from rows or from chunks.
#[test]
fn figures_equal_those_of_events() {
    let figures = vec(figure(), 1..6);
    check((vec(stamped(), 0..80), figures, time(), time(), 1..40_usize), |store, run, other, value| {
        let (events, figures, from, until, batch) = value;
        append(store, run, other, events, *batch);
        let own = events.iter().filter_map(|stamped| match &stamped.event {
            Event::Link(link) => {
                Some(Figure::Link(link.link.clone(), link.direction, LinkQuantity::Throughput))
            }
            Event::Robot(robot) => Some(Figure::Robot(robot.robot.clone(), RobotQuantity::NearestObstacle)),
            _ => None,
        });
        for figure in figures.iter().cloned().chain(own) {
            let mut wanted = Vec::new();
            for stamped in sorted(events).iter().filter(|s| *from <= s.at && s.at <= *until) {
                figure.of(&stamped.event, |value| wanted.push((stamped.at.as_nanos() as i64, value)));
            }
            let mut found = Vec::new();
            store
                .values(run, &figure, span(*from, *until), &mut |t, value| found.push((t, raw(value))))
                .unwrap();
            prop_assert_eq!(found, wanted, "{}", figure);
        }
        for kind in Kind::ALL {
            let mut wanted = sorted(events);
            wanted.retain(|s| *from <= s.at && s.at <= *until && Kind::of(&s.event) == kind);
            let times = wanted.first().zip(wanted.last());
            let times = times.map(|(first, last)| (first.at.as_nanos() as i64, last.at.as_nanos() as i64));
            prop_assert_eq!(store.extent(run, kind, span(*from, *until)).unwrap(), times);
        }
        Ok(())
    });
}

/// Returns a sample that was not rolled up.
fn raw(reading: Reading) -> f64 {
    match reading {
        Reading::Sample(value) => value,
        Reading::RolledUp(summary) => panic!("nothing was rolled up, but {summary:?}"),
    }
}

/// Processes that record the same series of a run write no chunk that lacks the other's samples.
#[test]
fn two_processes_that_record_one_run_lose_nothing() {
    let engines = Engines::new();
    for (store, run, _) in engines.fresh().into_iter().skip(1) {
        let other = engines.again(&store);
        let load = |n: u64| Stamped {
            at: Timestamp::from_nanos(n * 700_000_000),
            event: Event::Radio(cotorra_graph::RadioContext {
                radio_unit: cotorra_graph::NodeId::new("ap1").unwrap(),
                channel: 1,
                load: Some(n as f64),
                stations: Vec::new(),
            }),
        };
        for n in 0..100_u64 {
            // Long turns and short ones.
            let store = if (n / 20).is_multiple_of(2) || n.is_multiple_of(3) { &*store } else { &*other };
            store.append(&[Entry { run, stamped: load(n) }], &[]).unwrap();
        }
        let figure = Figure::Load(cotorra_graph::NodeId::new("ap1").unwrap());
        for store in [&*store, &*other] {
            let mut found = Vec::new();
            store.values(run, &figure, ALL, &mut |_, value| found.push(raw(value))).unwrap();
            assert_eq!(found, (0..100).map(f64::from).collect::<Vec<_>>());
        }
    }
}

#[test]
fn lists_runs_and_rejects_unknown_ones() {
    let engines = Engines::new();
    for (store, first, second) in engines.fresh() {
        store.end_run(first, Timestamp::from_nanos(7)).unwrap();
        let runs = store.runs(None, 10).unwrap();
        assert_eq!(runs.iter().map(|run| run.id).collect::<Vec<_>>(), [first, second]);
        assert_eq!(runs[0].info, run_info("asked"));
        assert_eq!(runs[0].ended, Some(Timestamp::from_nanos(7)));
        assert_eq!(runs[1].ended, None);
        assert_eq!(store.runs(Some(first), 10).unwrap(), runs[1..]);
        assert_eq!(store.runs(None, 1).unwrap(), runs[..1]);

        let nobody = RunId(99);
        assert!(matches!(store.run(nobody), Err(Error::NoSuchRun(_))));
        assert!(matches!(store.end_run(nobody, Timestamp::ZERO), Err(Error::NoSuchRun(_))));
        assert!(matches!(store.latest(nobody, 0), Err(Error::NoSuchRun(_))));
        assert!(matches!(store.gaps(nobody, ALL, PageRequest::default()), Err(Error::NoSuchRun(_))));
    }
}
