//! One promise for every engine: what an ordered list would answer.

use proptest::{collection::vec, prelude::*};

use super::*;
use crate::{
    error::Error,
    memory::Memory,
    sqlite::Sqlite,
    testing::{run_info, stamped, time},
};

/// Both engines, with two runs each: the first is asked, the second is in the way.
fn engines(folder: &tempfile::TempDir) -> Vec<(Box<dyn Store>, RunId, RunId)> {
    let sqlite = Sqlite::open(&folder.path().join("history.sqlite")).unwrap();
    let stores: [Box<dyn Store>; 2] = [Box::<Memory>::default(), Box::new(sqlite)];
    let prepared = stores.into_iter().map(|store| {
        let run = store.begin_run(&run_info("asked")).unwrap();
        let other = store.begin_run(&run_info("other")).unwrap();
        (store, run, other)
    });
    prepared.collect()
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

/// All pages of an answer, one after the other.
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// What was recorded is read back equal, in the order of time and then of recording, whatever the clock did
    /// and whatever the size of batches and pages.
    #[test]
    fn gives_back_what_it_was_given(events in vec(stamped(), 0..60), batch in 1..20_usize, limit in 1..20_usize) {
        let folder = tempfile::tempdir().unwrap();
        for (store, run, other) in engines(&folder) {
            append(&*store, run, other, &events, batch);
            let what = Selection::Kinds(&Kind::ALL);
            let all = pages(limit, |page| store.events(run, &what, ALL, page).unwrap());
            prop_assert_eq!(all, sorted(&events));
        }
    }

    #[test]
    fn selects_kinds_and_times(
        events in vec(stamped(), 0..60),
        kinds in proptest::sample::subsequence(Kind::ALL.to_vec(), 1..5),
        (from, until) in (time(), time()),
        limit in 1..20_usize,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let span = Span { from: from.as_nanos() as i64, until: until.as_nanos() as i64 };
        for (store, run, other) in engines(&folder) {
            append(&*store, run, other, &events, 10);
            let what = Selection::Kinds(&kinds);
            let found = pages(limit, |page| store.events(run, &what, span, page).unwrap());
            let mut wanted = sorted(&events);
            wanted.retain(|s| from <= s.at && s.at <= until && kinds.contains(&Kind::of(&s.event)));
            prop_assert_eq!(found, wanted);
        }
    }

    #[test]
    fn selects_series_and_times(
        events in vec(stamped(), 0..60),
        (from, until) in (time(), time()),
        limit in 1..5_usize,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let span = Span { from: from.as_nanos() as i64, until: until.as_nanos() as i64 };
        for (store, run, other) in engines(&folder) {
            append(&*store, run, other, &events, 10);
            for series in events.iter().filter_map(|s| Series::of(&s.event)) {
                let what = Selection::Series(series.clone());
                let found = pages(limit, |page| store.events(run, &what, span, page).unwrap());
                let mut wanted = sorted(&events);
                wanted.retain(|s| {
                    from <= s.at && s.at <= until && Series::of(&s.event).as_ref() == Some(&series)
                });
                prop_assert_eq!(found, wanted);
            }
        }
    }

    /// The state at a time holds the last of every series, and nothing else.
    #[test]
    fn knows_the_latest_of_every_series(events in vec(stamped(), 0..60), at in time(), batch in 1..20_usize) {
        let folder = tempfile::tempdir().unwrap();
        let wanted: std::collections::BTreeMap<Series, Stamped> = sorted(&events)
            .into_iter()
            .filter(|stamped| stamped.at <= at)
            .filter_map(|stamped| Some((Series::of(&stamped.event)?, stamped)))
            .collect();
        for (store, run, other) in engines(&folder) {
            append(&*store, run, other, &events, batch);
            let mut found = store.latest(run, at.as_nanos() as i64).unwrap();
            found.sort_by_key(|stamped| Series::of(&stamped.event));
            prop_assert_eq!(found, wanted.values().cloned().collect::<Vec<_>>());
        }
    }

    #[test]
    fn tells_gaps(gaps in vec((time(), time(), 1..u64::MAX), 0..10), limit in 1..5_usize) {
        let folder = tempfile::tempdir().unwrap();
        let gaps: Vec<Gap> = gaps
            .into_iter()
            .map(|(a, b, events)| Gap { from: a.min(b), until: a.max(b), events })
            .collect();
        for (store, run, other) in engines(&folder) {
            let entries: Vec<_> = gaps.iter().flat_map(|gap| [(run, *gap), (other, *gap)]).collect();
            store.append(&[], &entries).unwrap();
            let mut wanted = gaps.clone();
            wanted.sort_by_key(|gap| gap.from);
            prop_assert_eq!(pages(limit, |page| store.gaps(run, ALL, page).unwrap()), wanted);
        }
    }
}

#[test]
fn lists_runs_and_knows_none_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    for (store, first, second) in engines(&folder) {
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
