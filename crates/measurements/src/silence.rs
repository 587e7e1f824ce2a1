//! Times in which services had no samples, though they had some before or should have had some, and in which nothing was
//! recorded at all.

use std::collections::BTreeMap;

use cotorra_graph::{Event, NodeId, ServiceId, Timestamp};

use crate::{
    error::Result,
    kind::Kind,
    page::pages,
    run::RunId,
    store::{Selection, Span, Store},
};

/// A time without samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Silence {
    /// The service and its robot; `None` if nothing was recorded at all.
    pub service: Option<(ServiceId, NodeId)>,
    /// Time of the last sample before, or the beginning of the range.
    pub from: Timestamp,
    /// Time of the next sample, or the end of the range.
    pub until: Timestamp,
}

/// Times without samples of a service count if they are longer than this, ns,
const SHORTEST: i64 = 1_000_000_000;
/// and than so many usual times between two samples of the service.
const INTERVALS: i64 = 5;
/// Times without any sample count if they are longer than this, ns: a run records the emulator's lateness each second.
const NOTHING: i64 = 2_000_000_000;
/// More than the time from a sample's emission until it is recorded, ns: a scan waits for 3 s.
const RECORDED_WITHIN: i64 = 10_000_000_000;

/// The samples of a service so far.
struct Heard {
    samples: i64,
    /// Time of the latest emission.
    latest: i64,
    /// Times without an emission, longer than [`SHORTEST`].
    holes: Vec<(i64, i64)>,
}

impl Heard {
    fn nothing_since(from: i64) -> Self {
        Self { samples: 0, latest: from, holes: Vec::new() }
    }

    /// Adds a sample. One without an answer comes after later ones, and may divide a hole.
    fn add(&mut self, emitted: i64) {
        self.samples += 1;
        if emitted > self.latest {
            self.push(self.latest, emitted);
            self.latest = emitted;
        } else if let Some(place) =
            self.holes.iter().rposition(|(from, until)| (*from..*until).contains(&emitted))
        {
            let (from, until) = self.holes.remove(place);
            self.push(from, emitted);
            self.push(emitted, until);
        }
    }

    fn push(&mut self, from: i64, until: i64) {
        if until - from > SHORTEST {
            self.holes.push((from, until));
        }
    }

    /// Returns the holes in order that are long for this service, whose robot ended its walk at a time or did not.
    fn finish(mut self, span: Span, walked: Option<i64>) -> Vec<(i64, i64)> {
        // A service that goes on after the walk is expected to go on until the end.
        let end = walked.filter(|at| at.saturating_add(SHORTEST) >= self.latest).unwrap_or(span.until);
        let end = end.min(span.until);
        self.push(self.latest, end);
        let (mut time, mut intervals) = (end - span.from, self.samples);
        let holes = i64::try_from(self.holes.len()).unwrap_or(i64::MAX);
        // A slow service has holes only, which are then its usual intervals.
        if holes * 2 < self.samples {
            time -= self.holes.iter().map(|(from, until)| until - from).sum::<i64>();
            intervals -= holes;
        }
        let usual = time / intervals.max(1);
        let long = SHORTEST.max(usual.saturating_mul(INTERVALS));
        self.holes.retain(|(from, until)| self.samples == 0 || until - from > long);
        self.holes.sort_unstable();
        self.holes
    }
}

/// Returns the silences of a run in a span, in order. Its memory is bounded by the number of services and the
/// length of the span.
pub(crate) fn silences(
    store: &dyn Store,
    run: RunId,
    expected: impl IntoIterator<Item = (ServiceId, NodeId)>,
    span: Span,
) -> Result<Vec<Silence>> {
    let Span { from, until } = span;
    if until <= from {
        return Ok(Vec::new());
    }
    let expected = expected.into_iter().map(|of| (of, Heard::nothing_since(from)));
    let mut heard: BTreeMap<(ServiceId, NodeId), Heard> = expected.collect();
    let mut walked: BTreeMap<NodeId, i64> = BTreeMap::new();
    let read = Span { from, until: until.saturating_add(RECORDED_WITHIN) };
    let selected = Selection::Kinds(&[Kind::ServiceTime, Kind::WalkFinished, Kind::Lateness]);
    // Histories of other origins may have no lateness.
    let observed = store.extent(run, Kind::Lateness, Span { from: 0, until: i64::MAX })?;
    let mut last = observed.map_or(until, |(first, _)| first.clamp(from, until));
    let mut nothing = Vec::new();
    let mut record = |at: i64| {
        if at - last > NOTHING {
            nothing.push((last, at));
        }
        last = last.max(at);
    };
    let nanos = |at: Timestamp| i64::try_from(at.as_nanos()).unwrap_or(i64::MAX);
    pages(
        |page| store.events(run, &selected, read, page),
        |stamped| {
            record(nanos(stamped.at).min(until));
            match stamped.event {
                Event::ServiceTime(sample) => {
                    let emitted = nanos(sample.emitted);
                    if (from..=until).contains(&emitted) {
                        let of = (sample.service, sample.robot);
                        heard.entry(of).or_insert_with(|| Heard::nothing_since(emitted)).add(emitted);
                    }
                }
                Event::WalkFinished { robot } => drop(walked.insert(robot, nanos(stamped.at))),
                _ => {}
            }
        },
    )?;
    record(until);
    let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());
    let silences = heard.into_iter().flat_map(|((service, robot), heard)| {
        let holes = heard.finish(span, walked.get(&robot).copied());
        holes.into_iter().map(move |hole| (Some((service.clone(), robot.clone())), hole))
    });
    let silences = nothing.into_iter().map(|hole| (None, hole)).chain(silences);
    let silence = |(service, (from, until))| Silence { service, from: time(from), until: time(until) };
    let mut silences: Vec<_> = silences.map(silence).collect();
    silences.sort_by_key(|silence| (silence.from, silence.until));
    Ok(silences)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Lateness, Stamped};
    use cotorra_graph_testing as base;

    use super::*;
    use crate::{History, testing::run_info};

    const MS: u64 = 1_000_000;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * MS)
    }

    /// A sample that was emitted and recorded at these times, ms.
    fn sample(emitted: u64, recorded: u64) -> Stamped {
        let event = Event::ServiceTime(base::service_time("edge", at(emitted), None));
        Stamped { at: at(recorded), event }
    }

    fn recorded(events: impl IntoIterator<Item = Stamped>, ended: Option<u64>) -> (History, RunId) {
        let history = History::in_memory().unwrap();
        let run = history.begin_run(&run_info("silent")).unwrap();
        let recorder = history.paced_recorder(run).unwrap();
        events.into_iter().for_each(|event| recorder.record(event));
        recorder.flush().unwrap();
        if let Some(ended) = ended {
            history.end_run(run, at(ended)).unwrap();
        }
        (history, run)
    }

    fn expected() -> [(ServiceId, NodeId); 1] {
        [(ServiceId::new("navigation").unwrap(), NodeId::new("robot").unwrap())]
    }

    /// Returns the silences of a run, ms.
    fn found(events: impl IntoIterator<Item = Stamped>, ended: Option<u64>) -> Vec<(u64, u64)> {
        let (history, run) = recorded(events, ended);
        let silences = history.silences(run, expected(), ..).unwrap();
        silences.iter().map(|its| (its.from.as_nanos() / MS, its.until.as_nanos() / MS)).collect()
    }

    fn each_100_ms(range: std::ops::Range<u64>) -> impl Iterator<Item = Stamped> {
        range.step_by(100).map(|ms| sample(ms, ms + 20))
    }

    #[test]
    fn a_service_without_samples_for_seconds_is_silent() {
        assert_eq!(found(each_100_ms(0..20_000), Some(20_000)), []);
        let hole = each_100_ms(0..5000).chain(each_100_ms(11_200..20_000));
        assert_eq!(found(hole, Some(20_000)), [(4900, 11_200)]);
        assert_eq!(found(each_100_ms(8000..20_000), Some(20_000)), [(0, 8000)]);
        assert_eq!(found(each_100_ms(0..5000), Some(20_000)), [(4900, 20_000)]);
        assert_eq!(found([], Some(2000)), [(0, 2000)]);
    }

    #[test]
    fn a_run_that_records_nothing_for_seconds_is_silent_though_robots_catch_up() {
        let lateness = |seconds: std::ops::Range<u64>| {
            seconds.map(|s| Stamped { at: at(s * 1000 + 500), event: Event::Lateness(Lateness::default()) })
        };
        let caught_up = (5000..11_200).step_by(100).map(|ms| sample(ms, 11_200));
        let events = each_100_ms(0..5000).chain(caught_up).chain(each_100_ms(11_200..20_000));
        let (history, run) = recorded(events.chain(lateness(0..5)).chain(lateness(12..20)), Some(20_000));
        let nothing = |from, until| Silence { service: None, from: at(from), until: at(until) };
        assert_eq!(history.silences(run, expected(), ..).unwrap(), [nothing(4920, 11_200)]);
        let inside = history.silences(run, [], at(6000)..=at(9000)).unwrap();
        assert_eq!(inside, [nothing(6000, 9000)]);
        let (history, run) = recorded(lateness(0..9), Some(20_000));
        assert_eq!(history.silences(run, [], ..).unwrap(), [nothing(8500, 20_000)]);
    }

    #[test]
    fn samples_that_are_recorded_late_divide_a_silence() {
        let late = [4000, 5000].map(|ms| sample(ms, ms + 3000));
        let events = each_100_ms(0..3000).chain(each_100_ms(6000..10_000)).chain(late);
        assert_eq!(found(events, Some(10_000)), [(2900, 4000)]);
    }

    #[test]
    fn slow_services_are_silent_after_some_of_their_own_intervals() {
        let each_4_s = |range: std::ops::Range<u64>| range.step_by(4000).map(|ms| sample(ms, ms));
        assert_eq!(found(each_4_s(0..100_000), Some(100_000)), []);
        let hole = each_4_s(0..40_000).chain(each_4_s(80_000..160_000));
        assert_eq!(found(hole, Some(160_000)), [(36_000, 80_000)]);
    }

    #[test]
    fn a_robot_at_the_end_of_its_walk_needs_no_samples() {
        let robot = NodeId::new("robot").unwrap();
        let arrived = Stamped { at: at(5000), event: Event::WalkFinished { robot } };
        assert_eq!(found(each_100_ms(0..5000).chain([arrived.clone()]), Some(20_000)), []);
        assert_eq!(found(each_100_ms(0..3000).chain([arrived.clone()]), Some(20_000)), [(2900, 5000)]);
        assert_eq!(found(each_100_ms(0..9000).chain([arrived]), Some(20_000)), [(8900, 20_000)]);
    }

    #[test]
    fn a_run_without_an_end_is_known_up_to_its_last_event() {
        let (history, run) = recorded(each_100_ms(0..5000), None);
        assert_eq!(history.known_until(run).unwrap(), at(4920));
        assert_eq!(history.silences(run, expected(), ..).unwrap(), []);
        history.end_run(run, at(9000)).unwrap();
        assert_eq!(history.known_until(run).unwrap(), at(9000));
        assert_eq!(history.silences(run, expected(), at(1000)..at(2000)).unwrap(), []);
        assert_eq!(history.silences(run, expected(), at(6000)..at(8000)).unwrap().len(), 1);
    }
}
