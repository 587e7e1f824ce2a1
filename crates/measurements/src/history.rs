//! The way out: questions to a history, and their answers.

mod retain;

use std::{
    ops::{Bound, RangeBounds},
    path::Path,
    sync::Arc,
};

use cotorra_graph::{
    Direction, Event, Figure, Handover, LinkContext, LinkId, MachineContext, NodeId, Placement, RadioContext,
    RobotContext, SensorReading, ServiceId, ServiceTime, Stamped, Timestamp, VirtualLinkMapping,
};
use serde::{Deserialize, Serialize};

use crate::{
    curve::{Curve, CurveRequest, Drawing},
    difference::{Difference, Targets, difference},
    error::Result,
    figure::kept,
    kind::{Kind, Series},
    location::Location,
    memory::Memory,
    paced::PacedRecorder,
    page::{Page, PageRequest, pages},
    recorder::{Queue, Recorder},
    regret::{ServiceRegret, regrets},
    run::{Gap, Run, RunId, RunInfo},
    silence::{Silence, silences},
    sqlite::Sqlite,
    store::{Selection, Span, Store},
};

/// The history of every embedding of G, over any number of runs. Clones share the history, and may be used from any
/// thread. Reading never waits for recording, nor recording for reading.
///
/// An answer holds the events that are durable, which may be 100 ms behind those recorded. Call [`Recorder::flush`] first
/// where that matters.
///
/// Every question fails if the run does not exist, or if the engine fails (see [`crate::Error`]).
#[derive(Clone)]
pub struct History {
    pub(crate) store: Arc<dyn Store>,
    queue: Arc<Queue>,
}

/// A value and its time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Sample<T> {
    /// Nanoseconds since the run began.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// The value.
    #[serde(flatten)]
    pub value: T,
}

/// State of the whole graph at a time: the last value of everything.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct GraphState {
    /// Time of the state, nanoseconds since the run began.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// κ(r), by robot.
    pub robots: Vec<Sample<RobotContext>>,
    /// ι(R), by radio unit.
    pub radio_units: Vec<Sample<RadioContext>>,
    /// d, λ, ψ, δ, by link and direction.
    pub links: Vec<Sample<LinkContext>>,
    /// a(n), by VNF.
    pub placements: Vec<Sample<Placement>>,
    /// a(n1,n2), by the ends of the virtual link.
    pub virtual_links: Vec<Sample<VirtualLinkMapping>>,
    /// Readings of sensors, by robot and sensor; left out where there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sample<SensorReading>>,
    /// Contexts of machines, by node; left out where there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub machines: Vec<Sample<MachineContext>>,
}

impl History {
    /// Opens the SQLite database at `path`, or creates one. Any SQLite can read it; its schema, with units, is
    /// `schema/1.sql` in this crate.
    ///
    /// # Errors
    /// When the file cannot be created or written, is not a history, is damaged, or is of a newer cotorra.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::of(Arc::new(Sqlite::open(path.as_ref())?))
    }

    /// Opens the history at a location, or creates one there. A missing database of a server is created, if the user
    /// may. During a server's outage, events are kept in a file, up to 256 MB. They are written to the server when it
    /// is back, or when the history is opened again.
    ///
    /// # Errors
    /// When the history cannot be opened, created or written, is not a history, is damaged, or is of a newer cotorra;
    /// when a server does not answer, or this cotorra was built without servers.
    pub fn connect(location: &Location) -> Result<Self> {
        match location {
            Location::File(path) => Self::open(path),
            #[cfg(feature = "databases")]
            Location::Server(server) => Self::of(Arc::new(crate::server::Remote::open(server)?)),
            #[cfg(not(feature = "databases"))]
            server @ Location::Server(_) => Err(server.unsupported()),
        }
    }

    /// Opens a history to read it. Read-only ones open, too; recording to them fails.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_to_read(location: &Location) -> Result<Self> {
        match location {
            Location::File(path) => Self::of(Arc::new(Sqlite::open_to_read(path)?)),
            server => Self::connect(server),
        }
    }

    /// Creates a history in memory, which ends with the process and grows until then.
    ///
    /// # Errors
    /// When the system refuses a thread.
    pub fn in_memory() -> Result<Self> {
        Self::of(Arc::new(Memory::default()))
    }

    pub(crate) fn of(store: Arc<dyn Store>) -> Result<Self> {
        Ok(Self { queue: Arc::new(Queue::new(store.clone())?), store })
    }

    /// Begins a run, which is durable when this returns.
    ///
    /// # Errors
    /// When the history cannot be written.
    pub fn begin_run(&self, info: &RunInfo) -> Result<RunId> {
        self.store.begin_run(info)
    }

    /// Returns a recorder for the events of a run.
    ///
    /// # Errors
    /// When there is no such run.
    pub fn recorder(&self, run: RunId) -> Result<Recorder> {
        self.store.run(run)?;
        Ok(self.queue.recorder(run))
    }

    /// Returns a recorder that writes only when it is flushed, as virtual time needs it.
    ///
    /// # Errors
    /// When there is no such run.
    pub fn paced_recorder(&self, run: RunId) -> Result<PacedRecorder> {
        self.store.run(run)?;
        Ok(PacedRecorder::new(self.store.clone(), run))
    }

    /// Makes recorded events durable and notes when the run ended. A run that was killed has no end.
    ///
    /// # Errors
    /// When the history cannot be written, or there is no such run.
    pub fn end_run(&self, run: RunId, at: Timestamp) -> Result<()> {
        self.queue.flush()?;
        self.store.end_run(run, at)
    }

    /// Sets whether a history in a file is kept from growing, as by a full disk, for tests. Ignored by histories
    /// elsewhere.
    ///
    /// # Errors
    /// When the engine fails.
    pub fn set_full(&self, full: bool) -> Result<()> {
        self.store.set_full(full)
    }

    /// Returns one run.
    ///
    /// # Errors
    /// See [`History`].
    pub fn run(&self, run: RunId) -> Result<Run> {
        self.store.run(run)
    }

    /// Returns at most `limit` runs after a given one, or from the first, oldest first.
    ///
    /// # Errors
    /// See [`History`].
    pub fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
        self.store.runs(after, limit.clamp(1, PageRequest::MAX))
    }

    /// Returns κ(r) over a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn robot_series(
        &self,
        run: RunId,
        robot: &NodeId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<RobotContext>>> {
        self.select(run, &Selection::Series(Series::new(Kind::Robot, robot, ())), range, page)
    }

    /// Returns d, λ, ψ, δ of one direction of a link over a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn link_series(
        &self,
        run: RunId,
        link: &LinkId,
        direction: Direction,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<LinkContext>>> {
        self.select(run, &Selection::Series(Series::new(Kind::Link, link, direction)), range, page)
    }

    /// Returns the context of a node's machine over a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn machine_series(
        &self,
        run: RunId,
        node: &NodeId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<MachineContext>>> {
        self.select(run, &Selection::Series(Series::new(Kind::Machine, node, ())), range, page)
    }

    /// Returns changes of a(n) in a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn placements(
        &self,
        run: RunId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<Placement>>> {
        self.select(run, &Selection::Kinds(&[Kind::Placement]), range, page)
    }

    /// Returns service times that were recorded in a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn service_times(
        &self,
        run: RunId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<ServiceTime>>> {
        self.select(run, &Selection::Kinds(&[Kind::ServiceTime]), range, page)
    }

    /// Returns handovers in a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn handovers(
        &self,
        run: RunId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<Handover>>> {
        self.select(run, &Selection::Kinds(&[Kind::Handover]), range, page)
    }

    /// Returns events of some kinds in a range of time; of all kinds for an empty list.
    ///
    /// # Errors
    /// See [`History`].
    pub fn events(
        &self,
        run: RunId,
        kinds: &[Kind],
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Stamped>> {
        let kinds = if kinds.is_empty() { &Kind::ALL } else { kinds };
        self.store.events(run, &Selection::Kinds(kinds), span(&range), page)
    }

    /// Returns all events of some kinds; of all kinds for an empty list.
    ///
    /// # Errors
    /// See [`History`].
    pub fn all_events(&self, run: RunId, kinds: &[Kind]) -> Result<Vec<Stamped>> {
        let mut events = Vec::new();
        pages(|page| self.events(run, kinds, .., page), |event| events.push(event))?;
        Ok(events)
    }

    /// Returns gaps that begin in a range of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn gaps(
        &self,
        run: RunId,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Gap>> {
        self.store.gaps(run, span(&range), page)
    }

    /// Returns the time up to which all lost events are in [`Self::gaps`]: the run's end, or the time of its last event if
    /// it has no end. It is unknown what such a run lost later.
    ///
    /// # Errors
    /// See [`History`].
    pub fn known_until(&self, run: RunId) -> Result<Timestamp> {
        if let Some(ended) = self.store.run(run)?.ended {
            return Ok(ended);
        }
        let ever = Span { from: 0, until: i64::MAX };
        let mut last = 0;
        for kind in Kind::ALL {
            last = self.store.extent(run, kind, ever)?.map_or(last, |(_, end)| last.max(end));
        }
        Ok(Timestamp::from_nanos(last.cast_unsigned()))
    }

    /// Returns when services had no samples in a range of time, and when nothing was recorded at all. `expected` are the
    /// services of the testbed that should have samples; others count from their first sample in the range.
    ///
    /// # Errors
    /// See [`History`].
    pub fn silences(
        &self,
        run: RunId,
        expected: impl IntoIterator<Item = (ServiceId, NodeId)>,
        range: impl RangeBounds<Timestamp>,
    ) -> Result<Vec<Silence>> {
        let Span { from, until } = span(&range);
        silences(&*self.store, run, expected, Span { from, until: until.min(nanos(self.known_until(run)?)) })
    }

    /// Returns the state of the whole graph: the last value of everything at a time or before.
    ///
    /// # Errors
    /// See [`History`].
    pub fn state_at(&self, run: RunId, at: Timestamp) -> Result<GraphState> {
        let mut latest: Vec<(Series, Stamped)> = self
            .store
            .latest(run, nanos(at))?
            .into_iter()
            .filter_map(|stamped| Some((stamped.event.series()?, stamped)))
            .collect();
        latest.sort_by(|a, b| a.0.cmp(&b.0));
        let mut state = GraphState { at, ..GraphState::default() };
        for (_, Stamped { at, event }) in latest {
            match event {
                Event::Robot(value) => state.robots.push(Sample { at, value }),
                Event::Radio(value) => state.radio_units.push(Sample { at, value }),
                Event::Link(value) => state.links.push(Sample { at, value }),
                Event::Placement(value) => state.placements.push(Sample { at, value }),
                Event::VirtualLink(value) => state.virtual_links.push(Sample { at, value }),
                Event::Sensor(value) => state.sensors.push(Sample { at, value }),
                Event::Machine(value) => state.machines.push(Sample { at, value }),
                _ => unreachable!("only these kinds make series"),
            }
        }
        Ok(state)
    }

    /// Returns a figure over a range of time, in a bounded number of points, with its gaps. An open end of the range is
    /// the time of the first or last such sample.
    ///
    /// # Errors
    /// See [`History`].
    pub fn curve(
        &self,
        run: RunId,
        figure: &Figure,
        range: impl RangeBounds<Timestamp>,
        request: &CurveRequest,
    ) -> Result<Curve> {
        let asked = span(&range);
        let samples = self.store.extent(run, kept(figure).kind, asked)?;
        let (mut first, last) = samples.unwrap_or((asked.from, asked.until));
        // Of a rolled-up step, only the last sample is left: the curve begins where the step began.
        let thinned = self.store.retained(run)?.into_iter().find(|its| its.kind == kept(figure).kind);
        if let Some(its) = thinned.filter(|its| first < nanos(its.rolled_up_to) && !its.step.is_zero()) {
            first -= first % i64::try_from(its.step.as_nanos()).unwrap_or(i64::MAX);
        }
        let from = if asked.from == 0 { first } else { asked.from };
        let until = if asked.until >= i64::MAX - 1 { last } else { asked.until };
        let gaps = self.gaps_over(run, Span { from, until })?;
        if until < from || (samples.is_none() && gaps.is_empty()) {
            let points = Vec::new();
            let quantiles = request.quantiles.clone();
            return Ok(Curve { unit: figure.unit().to_owned(), figure: figure.clone(), quantiles, points });
        }
        let mut drawing = Drawing::new(from, until, request, gaps);
        self.store.values(run, figure, Span { from, until }, &mut |t, reading| drawing.read(t, reading))?;
        Ok(drawing.finish(figure.clone(), until))
    }

    /// Returns all gaps that overlap with a span.
    fn gaps_over(&self, run: RunId, span: Span) -> Result<Vec<Gap>> {
        let before = Span { from: 0, until: span.until };
        let mut gaps = Vec::new();
        let mut request = PageRequest::first(PageRequest::MAX);
        loop {
            let page = self.store.gaps(run, before, request)?;
            gaps.extend(page.items.into_iter().filter(|gap| nanos(gap.until) >= span.from));
            let Some(next) = page.next else { return Ok(gaps) };
            request = PageRequest::after(next, PageRequest::MAX);
        }
    }

    /// Compares two runs, whose services have these targets.
    ///
    /// # Errors
    /// See [`History`].
    pub fn difference(&self, a: RunId, b: RunId, targets: [Targets; 2]) -> Result<Difference> {
        self.difference_with(a, self, b, targets)
    }

    /// Compares a run with one of another history.
    ///
    /// # Errors
    /// See [`History`].
    pub fn difference_with(
        &self,
        a: RunId,
        other: &Self,
        b: RunId,
        targets: [Targets; 2],
    ) -> Result<Difference> {
        difference((&*self.store, a), (&*other.store, b), targets)
    }

    /// Compares the services of a run with those of a run of another history, with the same seed and these targets, and gives
    /// intervals over blocks of time.
    ///
    /// # Errors
    /// See [`History`].
    pub fn regrets_with(
        &self,
        run: RunId,
        other: &Self,
        without: RunId,
        targets: &Targets,
    ) -> Result<Vec<ServiceRegret>> {
        regrets((&*self.store, run), (&*other.store, without), targets)
    }

    fn select<T: FromEvent>(
        &self,
        run: RunId,
        what: &Selection<'_>,
        range: impl RangeBounds<Timestamp>,
        page: PageRequest,
    ) -> Result<Page<Sample<T>>> {
        let found = self.store.events(run, what, span(&range), page)?;
        Ok(found.map(|Stamped { at, event }| Sample { at, value: T::from_event(event) }))
    }
}

fn nanos(t: Timestamp) -> i64 {
    i64::try_from(t.as_nanos()).unwrap_or(i64::MAX)
}

/// Returns a range with both ends included. An empty range stays empty.
fn span(range: &impl RangeBounds<Timestamp>) -> Span {
    let from = match range.start_bound() {
        Bound::Unbounded => 0,
        Bound::Included(t) => nanos(*t),
        Bound::Excluded(t) => nanos(*t).saturating_add(1),
    };
    let until = match range.end_bound() {
        Bound::Unbounded => i64::MAX,
        Bound::Included(t) => nanos(*t),
        Bound::Excluded(t) => nanos(*t) - 1,
    };
    Span { from, until }
}

/// The content of the one requested kind of events.
trait FromEvent {
    fn from_event(event: Event) -> Self;
}

macro_rules! from_event {
    ($($kind:ident($value:ty)),*) => {$(
        impl FromEvent for $value {
            fn from_event(event: Event) -> Self {
                match event {
                    Event::$kind(value) => value,
                    other => unreachable!("{other:?} was not requested"),
                }
            }
        }
    )*};
}

from_event!(
    Robot(RobotContext),
    Radio(RadioContext),
    Link(LinkContext),
    Machine(MachineContext),
    Placement(Placement),
    ServiceTime(ServiceTime),
    Handover(Handover)
);

#[cfg(test)]
mod tests {
    use cotorra_graph_testing as base;

    use super::*;
    use crate::{
        LatenessQuantity,
        testing::{notice, placement, run_info},
    };

    fn recorded(events: &[Stamped]) -> (History, RunId) {
        let history = History::in_memory().unwrap();
        let run = history.begin_run(&run_info("asked")).unwrap();
        let recorder = history.recorder(run).unwrap();
        events.iter().for_each(|stamped| recorder.record(stamped.clone()));
        recorder.flush().unwrap();
        (history, run)
    }

    #[test]
    fn ranges_mean_what_they_say() {
        let (history, run) = recorded(&[0, 1, 2, 3].map(|t| notice(t, "")));
        let t = Timestamp::from_nanos;
        let times = |page: Result<Page<Stamped>>| -> Vec<u64> {
            page.unwrap().items.iter().map(|stamped| stamped.at.as_nanos()).collect()
        };
        let page = PageRequest::default();
        assert_eq!(times(history.events(run, &[], .., page)), [0, 1, 2, 3]);
        assert_eq!(times(history.events(run, &[], t(1)..t(3), page)), [1, 2]);
        assert_eq!(times(history.events(run, &[], t(1)..=t(3), page)), [1, 2, 3]);
        assert!(times(history.events(run, &[], ..t(0), page)).is_empty());
        assert!(times(history.events(run, &[], t(3)..t(1), page)).is_empty());
        assert_eq!(times(history.events(run, &[], t(2)..=Timestamp::MAX, page)), [2, 3]);
        let behind = (Bound::Excluded(t(1)), Bound::Unbounded);
        assert_eq!(times(history.events(run, &[], behind, page)), [2, 3]);
    }

    #[test]
    fn no_page_is_without_bound() {
        let events: Vec<_> = (0..PageRequest::MAX as u64 + 1).map(|t| notice(t, "")).collect();
        let (history, run) = recorded(&events);
        let page = history.events(run, &[], .., PageRequest::first(usize::MAX)).unwrap();
        assert_eq!(page.items.len(), PageRequest::MAX);
        let rest = history.events(run, &[], .., PageRequest::after(page.next.unwrap(), 0)).unwrap();
        assert_eq!((rest.items.len(), rest.next), (1, None));
        assert_eq!(history.all_events(run, &[]).unwrap(), events);
        assert_eq!(history.all_events(run, &[Kind::Robot]).unwrap(), []);
    }

    #[test]
    fn a_state_goes_through_json() {
        let (history, run) = recorded(&[
            placement(1, "map", "fog"),
            placement(2, "brain", "fog"),
            placement(3, "brain", "edge"),
        ]);
        let state = history.state_at(run, Timestamp::from_nanos(9)).unwrap();
        let json = serde_json::to_value(&state).unwrap();
        let placements = serde_json::json!([
            { "at_ns": 3, "vnf": "brain", "node": "edge" },
            { "at_ns": 1, "vnf": "map", "node": "fog" },
        ]);
        assert_eq!(json["placements"], placements);
        assert_eq!(serde_json::from_value::<GraphState>(json).unwrap(), state);
    }

    fn lateness(seconds: u64, p99_us: f64) -> Stamped {
        let lateness = cotorra_graph::Lateness { frames: 1, p50_us: 1.0, p99_us, max_us: 100.0 };
        Stamped { at: Timestamp::from_nanos(seconds * 1_000_000_000), event: Event::Lateness(lateness) }
    }

    #[test]
    fn a_curve_has_the_selected_samples() {
        let (history, run) = recorded(&[10, 20, 30, 40].map(|t| lateness(t, t as f64)));
        let figure = Figure::Lateness(LatenessQuantity::P99);
        let s = |seconds: u64| Timestamp::from_nanos(seconds * 1_000_000_000);
        let request = CurveRequest { points: 2, quantiles: vec![0.5] };
        let means = |curve: &Curve| -> Vec<f64> {
            curve.points.iter().map(|point| point.values.as_ref().unwrap().mean).collect()
        };
        let curve = history.curve(run, &figure, .., &request).unwrap();
        assert_eq!(means(&curve), [15.0, 35.0]);
        assert_eq!((curve.unit.as_str(), curve.points[0].from), ("µs", s(10)));
        assert_eq!(means(&history.curve(run, &figure, s(15)..s(40), &request).unwrap()), [20.0, 30.0]);
        // Ends that are given are the ends, so that curves of two runs have the same points.
        let curve = history.curve(run, &figure, s(1)..s(101), &request).unwrap();
        assert_eq!((means(&curve), curve.points[0].from), (vec![25.0], s(1)));
        assert_eq!(curve.points[0].until, s(51));
        let none = history.curve(run, &figure, s(50)..s(60), &request).unwrap();
        assert!(none.points.is_empty());
        assert!(history.curve(run, &figure, s(60)..s(50), &request).unwrap().points.is_empty());
        let other = Figure::Load(NodeId::new("ap1").unwrap());
        assert!(history.curve(run, &other, .., &request).unwrap().points.is_empty());
    }

    #[test]
    fn a_curve_reports_lost_samples() {
        let (history, run) =
            recorded(&[lateness(1, 1.0), notice(u64::MAX, "after 584 years"), lateness(2, 2.0)]);
        let request = CurveRequest::default();
        let figure = Figure::Lateness(LatenessQuantity::P99);
        let curve = history.curve(run, &figure, .., &request).unwrap();
        assert!(curve.points.iter().all(|point| !point.gap), "it was lost after the end of the curve");
        let curve =
            history.curve(run, &figure, ..=Timestamp::from_nanos(u64::MAX / 2 - 2), &request).unwrap();
        assert!(!curve.points[0].gap);
    }

    #[test]
    fn the_diff_shows_runs_side_by_side() {
        use cotorra_graph::{Decision, Handover, Instruction, PluginId, VnfId};
        let node = |name: &str| NodeId::new(name).unwrap();
        let s = |seconds: u64| Timestamp::from_nanos(seconds * 1_000_000_000);
        let service = |at: u64, unit: &str, took: Option<u64>| Stamped {
            at: s(at),
            event: Event::ServiceTime(ServiceTime {
                robot: node("r1"),
                attachment: Some(node(unit)),
                ..base::service_time("fog", s(at), took.map(std::time::Duration::from_millis))
            }),
        };
        let handover = Event::Handover(Handover {
            robot: node("r1"),
            from: Some(node("ap1")),
            to: node("ap2"),
            fast: true,
            gap: std::time::Duration::from_millis(40),
        });
        let decision = Event::Decision(Decision {
            plugin: PluginId::new("okpi").unwrap(),
            instruction: Instruction::Place { vnf: VnfId::new("brain").unwrap(), node: node("edge").into() },
            reason: Some("delay".to_owned()),
            refused: None,
        });
        let second = 1_000_000_000;
        let (history, a) = recorded(&[
            placement(0, "brain", "fog"),
            service(1, "ap1", Some(10)),
            service(2, "ap1", Some(30)),
            service(3, "ap2", None),
            Stamped { at: s(4), event: handover },
            lateness(5, 7.0),
        ]);
        history.end_run(a, s(10)).unwrap();
        let b = history.begin_run(&run_info("other")).unwrap();
        let recorder = history.recorder(b).unwrap();
        for stamped in [
            placement(0, "brain", "fog"),
            service(1, "ap1", Some(20)),
            Stamped { at: s(2), event: decision },
            placement(3 * second, "brain", "edge"),
        ] {
            recorder.record(stamped);
        }
        history.end_run(b, s(10)).unwrap();

        let target = Targets::from([("navigation".parse().unwrap(), std::time::Duration::from_millis(20))]);
        let difference = history.difference(a, b, [target.clone(), target]).unwrap();
        assert_eq!(difference.runs.each_ref().map(|run| run.id), [a, b]);
        let services = |entry: &[Option<crate::difference::Services>; 2]| {
            entry.each_ref().map(|side| {
                side.as_ref()
                    .map(|s| (s.unanswered, s.service_time_ms.as_ref().map(|took| took.quantiles[0])))
            })
        };
        assert_eq!(services(&difference.services[0].runs), [Some((1, Some(20.0))), Some((0, Some(20.0)))]);
        let shares = |entry: &[Option<crate::difference::Services>; 2]| {
            entry.each_ref().map(|side| side.as_ref().map(|s| (s.samples, s.kept)))
        };
        assert_eq!(shares(&difference.services[0].runs), [Some((3, Some(1.0 / 3.0))), Some((1, Some(1.0)))]);
        assert_eq!(shares(&difference.regions[1].runs), [Some((1, Some(0.0))), None]);
        let without = history.difference(a, b, Default::default()).unwrap();
        assert_eq!(
            shares(&without.services[0].runs),
            [Some((3, None)), Some((1, None))],
            "no target is known"
        );
        assert_eq!(difference.regions.len(), 2);
        assert_eq!(services(&difference.regions[1].runs), [Some((1, None)), None]);
        let handovers = difference.handovers[0].runs[0].as_ref().unwrap();
        assert_eq!((handovers.count, handovers.fast, handovers.gap_ms.as_ref().unwrap().max), (1, 1, 40.0));
        assert_eq!(difference.handovers[0].runs[1], None);
        let stays: Vec<_> = difference
            .placements
            .iter()
            .map(|entry| {
                (entry.of.node.as_str(), entry.runs.each_ref().map(|p| p.as_ref().map(|p| p.duration_ms)))
            })
            .collect();
        assert_eq!(stays, [("edge", [None, Some(7e3)]), ("fog", [Some(10e3), Some(3e3)])]);
        assert_eq!(difference.decisions[0].of.instruction, "place");
        assert_eq!(difference.decisions[0].runs[1].as_ref().unwrap().count, 1);
        assert_eq!(difference.doubts[0].lateness_p99_us, Some(7.0));
        let json = serde_json::to_string(&difference).unwrap();
        assert_eq!(serde_json::from_str::<Difference>(&json).unwrap(), difference);
    }

    #[test]
    fn of_several_instances_each_node_has_the_time_of_its_own() {
        use cotorra_graph::{Nodes, VnfId};
        let placed = |seconds: u64, nodes: &[&str]| Stamped {
            at: Timestamp::from_nanos(seconds * 1_000_000_000),
            event: Event::Placement(Placement {
                vnf: VnfId::new("brain").unwrap(),
                node: Nodes::new(nodes.iter().map(|name| NodeId::new(name).unwrap()).collect()).unwrap(),
            }),
        };
        let last = placed(6, &["edge", "cloud"]);
        let (history, run) =
            recorded(&[placed(0, &["fog"]), placed(2, &["fog", "edge"]), placed(5, &["edge"]), last.clone()]);
        history.end_run(run, Timestamp::from_nanos(10_000_000_000)).unwrap();
        let difference = history.difference(run, run, Default::default()).unwrap().placements;
        let times = difference.iter().map(|entry| {
            let of = entry.runs[0].as_ref().unwrap();
            (entry.of.node.as_str(), of.count, of.duration_ms)
        });
        assert_eq!(times.collect::<Vec<_>>(), [("cloud", 1, 4e3), ("edge", 1, 8e3), ("fog", 1, 5e3)]);
        let state = history.state_at(run, Timestamp::from_nanos(7_000_000_000)).unwrap();
        let Event::Placement(value) = last.event else { unreachable!() };
        assert_eq!(state.placements.iter().map(|sample| &sample.value).collect::<Vec<_>>(), [&value]);
    }
}
