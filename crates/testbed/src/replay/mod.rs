//! A recorded run, played through the API as if it went on, for developing plug-ins. Recorded decisions are played, too.
//! New instructions are rejected and reported, and change nothing.

use std::{
    collections::{BTreeMap, VecDeque},
    net::SocketAddr,
    ops::Bound,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use cotorra_federation::Ledgers;
use cotorra_graph::{Event, NodeId, PluginId, PluginProgram, Stamped, Testbed, Timestamp};
use cotorra_measurements::{GraphState, History, PageRequest, RunId, Sample};
use cotorra_network_control::InstructionError;
use cotorra_plugin::runs::Runs;
use cotorra_recording::{Pace, Recording, RecordingError, Wanted};

use crate::{
    api::{self, ApiError, Dashboard, Encryption, Listener, Lockstep as Waiting, Tokens},
    clock::{Clock, wall_clock},
    domain::Domains,
    events::{fanout::Fanout, live::Live, stream::EventStream},
    given::Given,
    history::{
        keeping::Keeper,
        links::RunHistory,
        run_info::{about, epoch},
    },
    plugins::{
        Bundled, PluginError,
        external::{ExternalPlugins, Stage, Waited},
        host::{Controlled, Fault, PluginHost},
        lockstep::{Call, Guarded, Locals, Lockstep, PATIENCE, Returned},
        programs,
    },
    report::{Fidelity, ServiceKpis},
    virtual_time::time_control::{Speed, TimeControl},
};

/// Interval between questions whether to go on.
const LOOK: Duration = Duration::from_millis(50);
/// Events per query of the history.
const STEP: usize = 1000;
const REFUSAL: &str = "this is a replay: what was recorded is played, and nothing can change it";

/// Options of a replay.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// Address of the API; by default 127.0.0.1:7700, or the next free port if that is taken.
    pub api: Option<SocketAddr>,
    /// Folder through which this user's tools find the replay, and its description there; `None` if they need not find it.
    pub known: Option<(Runs, String)>,
    /// Tokens of the API's callers.
    pub tokens: Tokens,
    /// Protection of the API on an address beyond loopback.
    pub encryption: Encryption,
    /// The run's folder with large data of its sensors; `None` if unknown.
    pub folder: Option<PathBuf>,
    /// Speed at first; the API can change it. `None`: nothing is played, and the run is served as it was at the beginning.
    /// With [`Speed::Max`], time waits for followers with a name, by the marks of virtual time.
    pub speed: Option<Speed>,
    /// Number of followers, each with a name, that must follow before the replay begins.
    pub followers: usize,
    /// Beginning; the state before it is known from the start.
    pub from: Timestamp,
    /// End, exclusive.
    pub to: Option<Timestamp>,
    /// Address at which the replay is also served to Foxglove.
    pub foxglove: Option<SocketAddr>,
    /// Whether the replay is played to the testbed's plug-ins, too. All of them must be bundled.
    pub to_plugins: bool,
}

/// Progress of a replay.
#[derive(Debug)]
pub enum Played<'a> {
    /// The time of the run.
    Time(Timestamp),
    /// An instruction was given, and rejected.
    Refused(&'a Stamped),
    /// A plug-in was cut off; the replay does not wait for it any more.
    CutOff(&'a Stamped),
}

/// The end of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplayEnd {
    /// Everything was played.
    Played,
    /// All followers left.
    Alone,
    /// The caller stopped it.
    Stopped,
}

/// A run that is ready to be played.
pub struct Replay {
    programs: ExternalPlugins,
    audience: Guarded<Audience>,
    wall: Clock,
    history: Arc<History>,
    run: RunId,
    options: ReplayOptions,
    watched: Option<Recording>,
    fanout: Fanout,
}

/// The plug-ins that a run is played to.
struct Audience {
    host: PluginHost,
    locals: Locals,
    /// Ledgers that bundled plug-ins share.
    _ledgers: Ledgers,
    record: Record,
    now: Timestamp,
}

/// A recorded run as the object of instructions: it rejects all of them.
#[derive(Default)]
struct Record {
    /// Events about plug-ins that were not published yet.
    events: VecDeque<Stamped>,
}

impl Controlled for Record {
    fn instruct(&mut self, now: Timestamp, given: Given) -> Result<(), InstructionError> {
        self.events.push_back(Stamped { at: now, event: given.decided(Some(REFUSAL.to_owned())) });
        Err(InstructionError(REFUSAL.to_owned()))
    }

    fn cut_off(&mut self, now: Timestamp, plugin: PluginId, fault: &Fault, _robots: &[NodeId]) {
        let event = Event::PluginFault { plugin, reason: fault.to_string() };
        self.publish(Stamped { at: now, event });
    }

    fn publish(&mut self, event: Stamped) {
        self.events.push_back(event);
    }
}

impl Audience {
    fn new(testbed: &Testbed, now: Timestamp) -> Self {
        Self {
            host: PluginHost::new([], PATIENCE).with_limits(&testbed.plugins),
            locals: Locals::default(),
            _ledgers: Ledgers::default(),
            record: Record::default(),
            now,
        }
    }

    /// Makes the plug-ins of a testbed.
    fn invite(&mut self, testbed: &Arc<Testbed>, seed: u64, history: RunHistory) -> Result<(), ReplayError> {
        if let Some(program) = programs(testbed).next() {
            return Err(ReplayError::Program(program.clone()));
        }
        let domains = Domains::new(testbed);
        let mut bundled = Bundled::new(testbed, seed, Ledgers::in_virtual_time()).reading(Some(history));
        for spec in &testbed.plugins {
            if let PluginProgram::Bundled(name) = &spec.program {
                let (plugin, view) = (bundled.make(spec, name)?, domains.of_plugin(&spec.id).cloned());
                self.host.add(spec.id.clone());
                self.locals.add(spec.id.clone(), plugin, testbed, view);
            }
        }
        self._ledgers = bundled.into_ledgers();
        Ok(())
    }

    /// Returns the next wake-up time of a plug-in.
    fn next_wake(&self) -> Option<Timestamp> {
        let wake = self.host.next_wake().into_iter().chain(self.locals.next_deadline(&self.host)).min();
        // A wake-up that was met must not come again at the same time.
        wake.map(|wake| wake.max(self.now + Duration::from_nanos(1)))
    }
}

impl Lockstep for Audience {
    fn patience(&self) -> Duration {
        self.host.patience()
    }

    fn next_call(&mut self) -> Option<Call> {
        self.locals.next_call(self.now, &mut self.host)
    }

    fn returned(&mut self, returned: Returned) {
        let (plugin, outcome) = self.locals.returned(returned);
        self.host.returned(self.now, &plugin, outcome, &mut self.record);
        self.locals.end_cut_off(&self.host);
    }

    fn go_on(&mut self) -> bool {
        false
    }
}

impl Replay {
    /// Serves the API of a run that is about to be played.
    ///
    /// # Errors
    /// [`ApiError`] if the API cannot be served; [`PluginError`] if a plug-in cannot be made; errors of the history.
    pub fn new(
        testbed: Testbed,
        history: History,
        run: RunId,
        options: ReplayOptions,
    ) -> Result<Self, ReplayError> {
        Self::by_the_clock(testbed, history, run, options, wall_clock())
    }

    /// Creates a replay that measures the calls of plug-ins by the clock `wall`.
    pub(crate) fn by_the_clock(
        testbed: Testbed,
        history: History,
        run: RunId,
        options: ReplayOptions,
        wall: Clock,
    ) -> Result<Self, ReplayError> {
        let address = options.api.unwrap_or(api::DEFAULT_ADDRESS);
        let listener = Listener::bind(address, options.api.is_none(), &options.tokens, &options.encryption)?;
        let listener = match &options.known {
            Some((runs, what)) => listener.announced(Some(runs), &testbed.name, what),
            None => listener,
        };
        let (history, testbed) = (Arc::new(history), Arc::new(testbed));
        let wanted = Wanted { file: None, foxglove: options.foxglove };
        let info = history.run(run)?.info;
        let mut audience = Audience::new(&testbed, options.from);
        if options.to_plugins {
            let read = RunHistory::default();
            read.begin(&history, run, || Ok(()));
            audience.invite(&testbed, info.seed, read)?;
        }
        let watched = Recording::begin(&wanted, Path::new(""), &testbed, about(&info), Pace::Live)?;
        let tap = watched.as_ref().map(Recording::tap);
        let waits = options.speed == Some(Speed::Max);
        let (live, events) = (Live::default(), EventStream::default());
        let mut fanout = Fanout { api: Some((live.clone(), events.clone())), tap, ..Fanout::default() };
        let before = Timestamp::from_nanos(options.from.as_nanos().saturating_sub(1));
        if options.from > Timestamp::ZERO {
            know(&mut fanout, history.state_at(run, before)?);
            live.reach(before);
        }
        // Others choose whether to follow: in a replay, the user starts plug-ins that are programs.
        let hosted = if options.to_plugins {
            testbed.plugins.iter().map(|spec| spec.id.clone()).collect()
        } else {
            Default::default()
        };
        let context = |core| api::Context {
            hosted: Arc::new(hosted),
            testbed,
            live,
            history: Arc::clone(&history),
            run,
            events,
            core,
            namespaces: Arc::new(BTreeMap::new()),
            lockstep: waits.then_some(Waiting { plugins: None, recorder: None }),
            distant: Arc::default(),
            replay: true,
            paced: options.speed.is_some(),
            // A run that was killed has none.
            verdict: options.folder.as_deref().and_then(|folder| Fidelity::of_folder(folder).ok()),
            kpis: options
                .folder
                .as_deref()
                .and_then(|folder| ServiceKpis::of_folder(folder).ok())
                .unwrap_or_default(),
            keeper: options.folder.as_ref().map(|folder| Keeper::of_folder(folder, Pace::Live)),
            wais: api::WaisOptions { epoch: epoch(&info), ..Default::default() },
            logs: None,
            wiretap: None,
        };
        let programs = ExternalPlugins::serve(listener, options.tokens.clone(), Arc::clone(&wall), context)?;
        let audience = Guarded::new(audience, Arc::clone(&wall));
        Ok(Self { programs, audience, wall, history, run, options, watched, fanout })
    }

    /// Adds a plug-in in process.
    #[cfg(test)]
    pub(crate) fn to(
        mut self,
        id: PluginId,
        plugin: Box<dyn cotorra_plugin::Plugin>,
        testbed: &Arc<Testbed>,
        patience: Duration,
    ) -> Self {
        self.audience.host.set_patience(patience);
        self.audience.host.add(id.clone());
        self.audience.locals.add(id, plugin, testbed, None);
        self
    }

    /// Returns the API's address.
    pub fn api_address(&self) -> SocketAddr {
        self.dashboard().address()
    }

    /// Returns the dashboard.
    pub fn dashboard(&self) -> &Dashboard {
        self.programs.dashboard()
    }

    /// Returns the address for Foxglove, if it is served.
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.watched.as_ref().and_then(Recording::foxglove)
    }

    /// Plays the run. `report` receives the progress, at least several times a second, and returns whether to go on.
    ///
    /// # Errors
    /// Errors of the history.
    pub fn play(self, report: impl FnMut(Played<'_>) -> bool) -> Result<ReplayEnd, ReplayError> {
        let Self { mut programs, audience, wall, history, run, options, watched: _watched, fanout } = self;
        let time = TimeControl::new(options.speed.unwrap_or(Speed::Max), options.from, wall);
        let mut playing = Playing { audience, time, fanout, report, stopped: false };
        let awaited = options.followers;
        while options.speed.is_none() || playing.host().followers() < awaited {
            if !programs.listen(LOOK, &mut playing) {
                return Ok(ReplayEnd::Stopped);
            }
        }
        let end = options.to.map_or(Bound::Unbounded, Bound::Excluded);
        let mut request = PageRequest::first(STEP);
        let mut moment: VecDeque<Stamped> = VecDeque::new();
        loop {
            let page = history.events(run, &[], (Bound::Included(options.from), end), request)?;
            moment.extend(page.items);
            // The last moment of a page may continue in the next page.
            let open = page.next.and(moment.back().map(|last| last.at));
            while let Some(at) = moment.front().map(|event| event.at).filter(|at| Some(*at) != open) {
                // Plug-ins may want to be woken before.
                let wake = playing.audience.next_wake().filter(|wake| *wake < at);
                let next = wake.unwrap_or(at);
                match programs.wait_until(next, &mut playing) {
                    Waited::Due => {}
                    Waited::NotYet => continue,
                    Waited::Stopped => return Ok(ReplayEnd::Stopped),
                }
                playing.audience.now = next;
                while let Some(event) = moment.pop_front_if(|event| event.at <= next) {
                    playing.publish(Arc::new(event));
                }
                if !playing.settle(&mut programs) {
                    return Ok(ReplayEnd::Stopped);
                }
                if awaited > 0 && playing.is_alone() {
                    return Ok(ReplayEnd::Alone);
                }
            }
            let Some(next) = page.next else { return Ok(ReplayEnd::Played) };
            request = PageRequest::after(next, STEP);
        }
    }
}

/// A replay in progress.
struct Playing<T> {
    audience: Guarded<Audience>,
    time: TimeControl,
    fanout: Fanout,
    report: T,
    /// Set once the caller returned false, because it may not do so again.
    stopped: bool,
}

impl<T: FnMut(Played<'_>) -> bool> Playing<T> {
    fn publish(&mut self, event: Arc<Stamped>) {
        let Self { audience, fanout, .. } = self;
        let Audience { host, locals, now, .. } = &mut **audience;
        fanout.publish(event, |event| {
            host.publish(*now, event);
            locals.publish(*now, event, host);
        });
    }

    /// Lets plug-ins handle all events up to now, first those in process. Returns whether to go on.
    fn settle(&mut self, programs: &mut ExternalPlugins) -> bool {
        self.audience.locals.wake();
        let now = self.audience.now;
        self.stopped |= !self.audience.run(&mut || (self.report)(Played::Time(now)));
        self.tell_decisions();
        // Handles at least the messages that have arrived.
        !self.stopped && programs.listen(Duration::ZERO, self) && programs.settle(self)
    }

    fn tell_decisions(&mut self) {
        while let Some(event) = self.audience.record.events.pop_front() {
            let played = match event.event {
                Event::PluginFault { .. } => Played::CutOff(&event),
                _ => Played::Refused(&event),
            };
            self.stopped |= !(self.report)(played);
        }
    }

    /// Whether all followers left.
    fn is_alone(&mut self) -> bool {
        self.audience.host.forget_gone();
        self.audience.host.followers() == 0 && self.audience.locals.is_empty()
    }
}

impl<T: FnMut(Played<'_>) -> bool> Stage for Playing<T> {
    fn now(&self) -> Timestamp {
        self.audience.now
    }

    fn host(&mut self) -> &mut PluginHost {
        &mut self.audience.host
    }

    fn instruct(&mut self, given: Given) -> Result<(), InstructionError> {
        let audience = &mut *self.audience;
        let done = audience.host.instruct(audience.now, given, &mut audience.record);
        self.tell_decisions();
        done
    }

    fn cut_off(&mut self, plugin: &PluginId, fault: &Fault) {
        let audience = &mut *self.audience;
        audience.host.cut_off(audience.now, plugin, fault, &mut audience.record);
        self.tell_decisions();
    }

    fn time_control(&mut self) -> &mut TimeControl {
        &mut self.time
    }

    fn goes_on(&mut self) -> bool {
        let now = self.audience.now;
        self.stopped = self.stopped || !(self.report)(Played::Time(now));
        !self.stopped
    }
}

/// Publishes a state as the last known one.
fn know(fanout: &mut Fanout, state: GraphState) {
    fn each<T>(fanout: &mut Fanout, samples: Vec<Sample<T>>, event: impl Fn(T) -> Event) {
        for Sample { at, value } in samples {
            fanout.publish(Arc::new(Stamped { at, event: event(value) }), |_| {});
        }
    }
    each(fanout, state.placements, Event::Placement);
    each(fanout, state.virtual_links, Event::VirtualLink);
    each(fanout, state.robots, Event::Robot);
    each(fanout, state.radio_units, Event::Radio);
    each(fanout, state.links, Event::Link);
    each(fanout, state.sensors, Event::Sensor);
    each(fanout, state.machines, Event::Machine);
}

/// Error of playing a run.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The API cannot be served.
    #[error(transparent)]
    Api(#[from] ApiError),
    /// A plug-in cannot be made.
    #[error(transparent)]
    Plugin(#[from] PluginError),
    /// A plug-in that is a program has to be started by the user.
    #[error(
        "plug-in `{0}` is a program: start it beside the replay, with COTORRA_API and COTORRA_PLUGIN set"
    )]
    Program(PluginId),
    /// The live viewers cannot be served.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The history cannot be read.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
}
