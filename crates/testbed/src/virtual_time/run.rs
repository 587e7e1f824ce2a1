//! A whole run in virtual time, with a folder of results.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{Event, PluginId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{PacedRecorder, RunInfo};
use cotorra_network_control::InstructionError;
use cotorra_recording::{Pace, Recording};

use super::{Altered, Output, Simulation, Stretch, emulated};
use crate::{
    api::{self, Dashboard, Listener, Lockstep},
    capture::CaptureFile,
    clock::{Clock, wall_clock},
    error::{RunError, system},
    events::{fanout::Fanout, live::Live, stream::EventStream},
    finished::Finished,
    folder::{manifest::Time, whole},
    given::Given,
    history::{
        bound::HistoryBound, keeping::Keeping, links::RunHistory, recorded::Recorded, run_info::about,
    },
    options::Options,
    plugins::{
        self,
        external::{ExternalPlugins, Stage, Waited},
        host::{Fault, PluginHost},
        lockstep::{Guarded, PATIENCE},
        programs,
    },
    report::{End, Losses, Report},
    virtual_time::time_control::{Speed, TimeControl},
};

/// Number of events in each write to the history.
const HISTORY_PACE: usize = 10_000;

/// Runs a testbed in virtual time to the end of its walks, or up to `options.until`. Leaves the same folder as a run in
/// real time. `go_on` is called now and then with the time; false stops the run. If a plug-in is a program, the API is
/// served, by default on any free port of 127.0.0.1, and time waits for the program.
///
/// The same testbed, seed and version give the same bytes in every file but the manifest and the log.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end.
pub fn simulate(
    testbed: Testbed,
    text: &str,
    options: &Options,
    go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    simulate_for(None, testbed, text, options, go_on)
}

/// A run in virtual time that people watch and steer by the API.
pub struct Watched<'a> {
    /// Speed at first.
    pub speed: Speed,
    /// Receives the dashboard before the first step.
    pub served: &'a mut dyn FnMut(&Dashboard),
}

/// Runs a testbed as [`simulate`] does, but at a speed that can be changed, and with the API, by default on 127.0.0.1:7700 or
/// the next free port. Unless somebody gives instructions, the results are the same.
///
/// # Errors
/// As of [`simulate`].
pub fn simulate_watched(
    testbed: Testbed,
    text: &str,
    options: &Options,
    watched: Watched<'_>,
    go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    simulate_for(Some(watched), testbed, text, options, go_on)
}

fn simulate_for(
    watched: Option<Watched<'_>>,
    testbed: Testbed,
    text: &str,
    options: &Options,
    go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    let (altered, mut observe) = (Altered::default(), |_: &Stamped| {});
    let (altered, observe) = (&altered, &mut observe);
    let conduct = Conduct { patience: PATIENCE, wall: wall_clock(), altered, observe, watched };
    simulate_with(Arc::new(testbed), text, options, conduct, go_on).map(|(finished, _)| finished)
}

/// Conduct of a run.
pub(super) struct Conduct<'a, 'w> {
    /// Longest wait for plug-ins.
    pub(super) patience: Duration,
    /// The clock that measures it.
    pub(super) wall: Clock,
    /// Differences from the testbed file.
    pub(super) altered: &'a Altered,
    /// Called with each event.
    pub(super) observe: &'a mut dyn FnMut(&Stamped),
    /// The viewer, if there is one.
    pub(super) watched: Option<Watched<'w>>,
}

/// Simulates, and also returns the outcome of a fork's alternative.
pub(super) fn simulate_with(
    testbed: Arc<Testbed>,
    text: &str,
    options: &Options,
    conduct: Conduct<'_, '_>,
    go_on: impl FnMut(Timestamp) -> bool,
) -> Result<(Finished, Option<Result<(), InstructionError>>), RunError> {
    let Conduct { patience, wall, altered, observe, watched } = conduct;
    let seed = options.seed.unwrap_or(testbed.seed);
    let until = options.until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    plugins::check_programs(&testbed)?;
    let testbed = emulated(testbed);
    let read = RunHistory::default();
    let simulation = Simulation::without_programs(Arc::clone(&testbed), seed, Some(read.clone()))?;
    let simulation = simulation.altered(altered).with_patience(patience);
    let wiretap = simulation.network.wiretap();
    let captures = CaptureFile::begin_all(&options.captures, &wiretap)?;
    let mut simulation = Guarded::new(simulation, Arc::clone(&wall));
    let (folder, text) = whole::create(options, &testbed, Time::Virtual, text)?;
    // Calendar time is not part of virtual time.
    let info = RunInfo { name: testbed.name.clone(), seed, started_at_unix_ns: 0, testbed: text };
    let recording =
        Recording::begin(&options.recording, folder.path(), &testbed, about(&info), Pace::Waiting)?;
    let tap = recording.as_ref().map(Recording::tap);
    if tap.is_some() {
        simulation.tap_scans();
    }
    let keeping = Keeping::begin(&testbed, folder.path(), Pace::Waiting)
        .map_err(system("start the thread that keeps large data"))?;
    let keeper = keeping.as_ref().map(Keeping::keeper);
    let (history, run) = Recorded::begin(&folder, options.history.as_ref(), &info)?;
    let history = Arc::new(history);
    let recorder = history.paced_recorder(run)?;
    let records = recorder.clone();
    read.begin(&history, run, move || records.flush());
    let reads_history = plugins::reads_history(&testbed);
    let history_bound = HistoryBound::new(options, &folder);
    let report = Report::new(&testbed, seed).in_virtual_time(&testbed).on_disk(folder.path())?;
    let records = recorder.clone();
    let record = Box::new(move |event| records.record(event));
    let fanout = Fanout { api: None, tap, keeper: keeper.clone(), history: Some(record) };
    let speed = watched.as_ref().map_or(Speed::Max, |watched| watched.speed);
    let time = TimeControl::new(speed, Timestamp::ZERO, Arc::clone(&wall));
    let mut recorded = RecordedSimulation {
        simulation,
        report,
        fanout,
        recorder: recorder.clone(),
        unwritten: 0,
        time,
        observe,
        go_on,
        stopped: false,
    };
    if let Some(message) = plugins::inexact(&testbed) {
        let at = recorded.simulation.now();
        recorded.publish(Arc::new(Stamped { at, event: Event::Notice { message } }));
    }
    let mut external = None;
    if watched.is_some() || programs(&testbed).next().is_some() {
        let any_port = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let default = if watched.is_some() { api::DEFAULT_ADDRESS } else { any_port };
        let (address, any_port) = (options.api.unwrap_or(default), options.api.is_none());
        let listener = Listener::bind(address, any_port, &options.tokens, &options.encryption)?;
        let waited_for = Arc::new(programs(&testbed).cloned().collect());
        let (live, events) = (Live::default(), EventStream::default());
        recorded.fanout.api = Some((live.clone(), events.clone()));
        let context = |core| api::Context {
            testbed: Arc::clone(&testbed),
            live,
            history: Arc::clone(&history),
            run,
            events,
            core,
            namespaces: Arc::new(BTreeMap::new()),
            hosted: Arc::new(testbed.plugins.iter().map(|spec| spec.id.clone()).collect()),
            lockstep: Some(Lockstep { plugins: Some(waited_for), recorder: Some(recorder) }),
            distant: Arc::default(),
            replay: false,
            paced: true,
            verdict: None,
            kpis: Vec::new(),
            keeper,
            wais: api::WaisOptions { callbacks: options.wais_callbacks.clone(), ..Default::default() },
            logs: None,
            wiretap: Some(Arc::clone(&wiretap)),
        };
        let listener =
            listener.announced(options.runs.as_ref(), &testbed.name, &folder.path().to_string_lossy());
        let programs =
            external.insert(ExternalPlugins::serve(listener, options.tokens.clone(), wall, context)?);
        programs.start(&testbed, &folder.logs(), recorded.simulation.host())?;
        if let Some(watched) = watched {
            (watched.served)(programs.dashboard());
        }
    }
    let end = loop {
        // Also before the first step: programs follow when it begins.
        if let Some(programs) = &mut external
            && !programs.settle(&mut recorded)
        {
            break End::Stopped;
        }
        if external.is_some() {
            let alarm = recorded.simulation.host().next_wake();
            recorded.simulation.set_alarm(alarm);
        }
        if recorded.simulation.is_finished() {
            break End::Walked;
        }
        if until.is_some_and(|until| recorded.simulation.now() >= until) {
            break End::Until;
        }
        if until.is_none() && recorded.simulation.is_stuck() {
            recorded.report.stuck(recorded.simulation.stand());
            break End::NoProgress;
        }
        if let Some(programs) = &mut external
            && recorded.time.is_limited()
        {
            let next = recorded.simulation.next_time();
            match programs.wait_until(next, &mut recorded) {
                Waited::Due => {}
                Waited::NotYet => continue,
                Waited::Stopped => break End::Stopped,
            }
        }
        // Programs receive events after each moment with events, and the history has what plug-ins read. The history is written after the same steps each time.
        let stretch = match HISTORY_PACE.saturating_sub(recorded.unwritten) {
            0 => Stretch::Step,
            _ if recorded.time.is_limited() => Stretch::Step,
            _ if external.is_some() || reads_history => Stretch::Events(1, until),
            room => Stretch::Events(room, until),
        };
        if !recorded.advance(stretch) {
            break End::Stopped;
        }
        if recorded.unwritten >= HISTORY_PACE {
            recorded.catch_up()?;
            if history_bound.is_reached() {
                break End::HistoryFull;
            }
            if !recorded.goes_on() {
                break End::Stopped;
            }
        }
    };
    if let Some(programs) = external.as_mut().filter(|_| end != End::Stopped) {
        // One that time did not wait for any more ended before the run did, too.
        programs.cut_off_ended(&mut recorded);
    }
    drop(external);
    let remarks = recorded.simulation.flow_remarks();
    remarks.into_iter().for_each(|remark| recorded.publish(Arc::new(remark)));
    recorded.catch_up()?;
    let RecordedSimulation { simulation, mut report, recorder, .. } = recorded;
    report.localized(simulation.localization_errors());
    report.carried(simulation.traffic());
    report.computed(simulation.computed());
    report.sent(simulation.airtimes());
    report.inferred(simulation.inferred());
    report.migrated(simulation.migrated());
    let recording = recording.map(Recording::finish);
    let mut unrecorded: Vec<_> = keeping.and_then(Keeping::finish).into_iter().collect();
    unrecorded.extend(captures.into_iter().filter_map(CaptureFile::finish));
    if end == End::HistoryFull {
        unrecorded.push(history_bound.what());
    }
    unrecorded.iter().for_each(|what| tracing::error!("not recorded: {what}"));
    let losses = Losses { history_dropped: recorder.dropped(), ..Losses::default() };
    let summary = report.summary(simulation.now(), end.as_str(), losses);
    summary.last_words(simulation.now()).for_each(|notice| recorder.record(notice));
    // The summary is written whatever becomes of the history: the disk may be full.
    let flushed = recorder.flush();
    folder.write_report(&report, &summary)?;
    flushed?;
    history.end_run(run, simulation.now())?;
    let folder = folder.path().to_owned();
    let forked = simulation.forked().cloned();
    Ok((Finished { summary, report, folder, run, recording, unrecorded }, forked))
}

/// A simulation whose events are recorded.
struct RecordedSimulation<'a, G> {
    simulation: Guarded<Simulation>,
    report: Report,
    fanout: Fanout,
    recorder: PacedRecorder,
    /// Number of events since the last write to the history.
    unwritten: usize,
    time: TimeControl,
    observe: &'a mut dyn FnMut(&Stamped),
    go_on: G,
    /// Set once `go_on` returned false, because it may not do so again.
    stopped: bool,
}

impl<G: FnMut(Timestamp) -> bool> RecordedSimulation<'_, G> {
    /// Runs a stretch, and publishes its outputs. Returns whether to go on.
    fn advance(&mut self, stretch: Stretch) -> bool {
        self.simulation.go(stretch);
        let now = self.simulation.now();
        self.stopped |= !self.simulation.run(&mut || (self.go_on)(now));
        while let Some(output) = self.simulation.poll() {
            match output {
                Output::Event(event) => {
                    (self.observe)(&event);
                    self.publish(event);
                }
                Output::Scan(scan) => self.fanout.scan(scan),
                Output::Data(data) => self.fanout.data(data),
            }
        }
        !self.stopped
    }

    fn publish(&mut self, event: Arc<Stamped>) {
        let Self { simulation, report, fanout, .. } = self;
        let now = simulation.now();
        fanout.publish(event, |event| {
            report.absorb(event);
            simulation.host().publish(now, event);
        });
        self.unwritten += 1;
    }

    fn catch_up(&mut self) -> Result<(), cotorra_measurements::Error> {
        self.unwritten = 0;
        self.recorder.flush()
    }
}

impl<G: FnMut(Timestamp) -> bool> Stage for RecordedSimulation<'_, G> {
    fn now(&self) -> Timestamp {
        self.simulation.now()
    }

    fn host(&mut self) -> &mut PluginHost {
        self.simulation.host()
    }

    fn instruct(&mut self, given: Given) -> Result<(), InstructionError> {
        let done = self.simulation.instruct(given);
        self.advance(Stretch::Settle);
        done
    }

    fn cut_off(&mut self, plugin: &PluginId, fault: &Fault) {
        self.simulation.cut_off(plugin, fault);
        self.advance(Stretch::Settle);
    }

    fn time_control(&mut self) -> &mut TimeControl {
        &mut self.time
    }

    fn goes_on(&mut self) -> bool {
        self.stopped = self.stopped || !(self.go_on)(self.simulation.now());
        !self.stopped
    }
}
