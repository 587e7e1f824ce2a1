//! Plug-ins in real time, which never waits. Each bundled plug-in has a thread; the others are processes.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_federation::Ledgers;
use cotorra_graph::{PluginId, PluginProgram, PluginSpec, Stamped, Testbed, Timestamp, Way};
use cotorra_network_control::InstructionError;
use cotorra_plugin::{Actions, Plugin};

use super::{
    bundled::Bundled,
    error::PluginError,
    host::{Controlled, Fault, PluginHost},
    lockstep::{Call, Occasion},
    process::Process,
    programs::check_programs,
    travel::{Datagram, Travel},
};
use crate::{
    api::Server,
    clock::Clock,
    core::message::Message,
    domain::{self, DomainView, Domains},
    events::distant::DistantStream,
    given::Given,
    history::{links::RunHistory, previous_run::PreviousRun},
};

/// Longest duration of a call. A longer one counts as hung.
const LONGEST_CALL: Duration = Duration::from_secs(2);
/// Events that wait for a plug-in. One that is further behind misses the oldest.
const QUEUE: usize = 4096;
const IDLE: u64 = u64::MAX;

/// The plug-ins of a testbed, checked and made before anything else of the run. A mistake in a testbed file or an
/// unreachable ledger then leaves nothing behind.
pub(crate) struct PreparedPlugins {
    bundled: BTreeMap<PluginId, Box<dyn Plugin>>,
    ledgers: Ledgers,
    history: RunHistory,
    distant: Arc<DistantPrograms>,
}

/// The streams of programs that are away from the core.
pub(crate) type DistantPrograms = BTreeMap<PluginId, DistantStream>;

impl PreparedPlugins {
    /// Makes the bundled plug-ins, and checks that the programs of the others exist.
    pub(crate) fn of(testbed: &Testbed, seed: u64) -> Result<Self, PluginError> {
        check_programs(testbed)?;
        let history = RunHistory::default();
        let mut maker = Bundled::new(testbed, seed, Ledgers::default()).reading(Some(history.clone()));
        let mut bundled = BTreeMap::new();
        for spec in &testbed.plugins {
            if let PluginProgram::Bundled(name) = &spec.program {
                bundled.insert(spec.id.clone(), maker.make(spec, name)?);
            }
        }
        let ledgers = maker.into_ledgers();
        Ok(Self { bundled, ledgers, history, distant: Arc::new(distant_programs(testbed)) })
    }

    /// Returns the streams of programs that are away from the core, for the API.
    pub(crate) fn distant(&self) -> Arc<DistantPrograms> {
        Arc::clone(&self.distant)
    }

    /// Returns the history that they read, which has to begin before they start.
    pub(crate) fn history(&self) -> &RunHistory {
        &self.history
    }

    /// Gives bundled plug-ins the notes that they took in the previous run.
    pub(crate) fn resume(&mut self, earlier: &PreviousRun) {
        self.bundled.iter_mut().for_each(|(id, plugin)| plugin.resume(earlier.noted_by(id)));
    }

    /// Starts all plug-ins. Those in process send their instructions to `messages`.
    pub(crate) fn start(
        mut self,
        testbed: &Arc<Testbed>,
        now: &Clock,
        api: &Server,
        logs: &Path,
        messages: &mpsc::Sender<Message>,
    ) -> Result<RunningPlugins, PluginError> {
        let domains = Domains::new(testbed);
        let members = testbed.plugins.iter().map(|spec| spec.id.clone());
        let mut plugins = RunningPlugins::new(
            PluginHost::new(members, LONGEST_CALL)
                .with_limits(&testbed.plugins)
                .with_domains(&testbed.graph.domains)
                .with_travel(Travel::in_real_time(&testbed.plugins)),
            self.ledgers,
        );
        for spec in &testbed.plugins {
            match &spec.program {
                PluginProgram::Command(words) => {
                    let process = Process::start(spec, words, &testbed.folder, api, logs)?;
                    let distant = self.distant.get(&spec.id).cloned();
                    plugins.places.insert(spec.id.clone(), Place::Process { process, distant });
                }
                PluginProgram::Bundled(_) => {
                    let plugin = self.bundled.remove(&spec.id).expect("every bundled plug-in was made");
                    let view = domains.of_plugin(&spec.id).cloned();
                    plugins.spawn(spec.id.clone(), plugin, testbed, view, now, messages.clone());
                }
            }
        }
        Ok(plugins)
    }
}

/// Returns a stream for each program that is away from the core.
fn distant_programs(testbed: &Testbed) -> DistantPrograms {
    let is_far = |spec: &&PluginSpec| {
        matches!(spec.program, PluginProgram::Command(_)) && spec.distance.way != Way::None
    };
    testbed.plugins.iter().filter(is_far).map(|spec| (spec.id.clone(), DistantStream::default())).collect()
}

/// The thread or process of a plug-in.
enum Place {
    Thread {
        /// The plug-in's view, if it is bound to a domain.
        view: Option<Arc<DomainView>>,
        events: mpsc::SyncSender<Arc<Stamped>>,
        /// Beginning of the current call, nanoseconds; [`IDLE`] between calls.
        busy_since: Arc<AtomicU64>,
        /// Set when the plug-in is cut off. Its instructions are dropped from then on.
        cut: Arc<AtomicBool>,
    },
    Process {
        process: Process,
        /// Its stream of events, if it is away from the core.
        distant: Option<DistantStream>,
    },
}

/// The plug-ins of a run in real time. Threads end when their channel closes; a hung one ends with the process.
pub(crate) struct RunningPlugins {
    host: PluginHost,
    places: BTreeMap<PluginId, Place>,
    missed: u64,
    /// Ledgers that bundled plug-ins share. They end with them.
    _ledgers: Ledgers,
}

impl RunningPlugins {
    /// Creates an empty set of plug-ins.
    pub(crate) fn new(host: PluginHost, ledgers: Ledgers) -> Self {
        Self { host, places: BTreeMap::new(), missed: 0, _ledgers: ledgers }
    }

    /// Starts a plug-in on a thread of its own.
    pub(crate) fn spawn(
        &mut self,
        id: PluginId,
        plugin: Box<dyn Plugin>,
        testbed: &Arc<Testbed>,
        view: Option<Arc<DomainView>>,
        now: &Clock,
        messages: mpsc::Sender<Message>,
    ) {
        let (events, inbox) = mpsc::sync_channel(QUEUE);
        let busy_since = Arc::new(AtomicU64::new(IDLE));
        let cut = Arc::new(AtomicBool::new(false));
        let guard = Guard {
            id: id.clone(),
            now: Arc::clone(now),
            busy_since: Arc::clone(&busy_since),
            is_away: self.host.is_away(&id),
            cut: Arc::clone(&cut),
            messages,
        };
        let start = Occasion::Start(Arc::clone(testbed), view.clone());
        thread::Builder::new()
            .name(format!("plugin-{id}"))
            .spawn(move || guard.run(plugin, start, &inbox))
            .expect("a thread can be started");
        self.places.insert(id, Place::Thread { view, events, busy_since, cut });
    }

    /// Passes an event on to the plug-ins in process, or sends it to plug-ins that are away. Programs beside the core follow the
    /// API's stream.
    pub(crate) fn publish(&mut self, now: Timestamp, event: &Arc<Stamped>) {
        for (id, place) in &self.places {
            match place {
                Place::Thread { view, events, .. } => {
                    if let Some(seen) = domain::seen(view.as_deref(), event)
                        && let Some(seen) = self.host.send_context(now, id, seen)
                    {
                        self.missed += u64::from(events.try_send(seen).is_err());
                    }
                }
                Place::Process { distant: Some(stream), .. } if stream.wants(event) => {
                    self.host.send_context(now, id, Arc::clone(event));
                }
                Place::Process { .. } => {}
            }
        }
    }

    /// Passes contexts on that have arrived at plug-ins, and applies instructions that have arrived at the core.
    pub(crate) fn travel(&mut self, now: Timestamp, core: &mut impl Controlled) {
        for (id, place) in &self.places {
            match place {
                Place::Thread { events, .. } => {
                    if let Some(event) = self.host.hand_over(now, id) {
                        // It has handled the one before: there is room, unless it has just ended.
                        let _ = events.try_send(event);
                    }
                }
                Place::Process { distant: Some(stream), .. } => {
                    while let Some(event) = self.host.next_context(now, id) {
                        stream.arrive(event);
                    }
                }
                Place::Process { distant: None, .. } => {}
            }
        }
        self.host.apply_arrived(now, core);
        self.end_cut_off();
    }

    /// Returns the next datagram between the core and a plug-in on a node.
    pub(crate) fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        self.host.poll_transmit(now)
    }

    /// Handles a datagram that arrived at its node at `at`.
    pub(crate) fn receive(&mut self, at: Timestamp, datagram: &Datagram) {
        self.host.receive(at, datagram);
    }

    /// Notes that a plug-in in process has handled a context.
    pub(crate) fn handled(&mut self, plugin: &PluginId) {
        self.host.handled(plugin);
    }

    /// Returns when something arrives next.
    pub(crate) fn next_travel(&self) -> Option<Timestamp> {
        self.host.next_travel()
    }

    /// Returns the number of events that plug-ins missed because they were too far behind, without readers of the API's stream.
    pub(crate) fn missed(&self) -> u64 {
        self.missed + self.host.missed()
    }

    /// Applies an instruction, if it is admitted.
    pub(crate) fn instruct(
        &mut self,
        now: Timestamp,
        given: Given,
        core: &mut impl Controlled,
    ) -> Result<(), InstructionError> {
        let done = self.host.instruct(now, given, core);
        self.end_cut_off();
        done
    }

    /// Applies the outcome of a call of a plug-in in process, which returned at `at`.
    pub(crate) fn returned(
        &mut self,
        at: Timestamp,
        plugin: &PluginId,
        outcome: Result<Actions, Fault>,
        core: &mut impl Controlled,
    ) {
        self.host.returned(at, plugin, outcome, core);
        self.end_cut_off();
    }

    /// Cuts off plug-ins that hang or whose process ended.
    pub(crate) fn check(&mut self, now: Timestamp, core: &mut impl Controlled) {
        let patience = self.host.patience();
        for (id, place) in &mut self.places {
            let fault = match place {
                Place::Thread { busy_since, .. } => {
                    let since = busy_since.load(Ordering::Acquire);
                    let hung = since != IDLE && now.since(Timestamp::from_nanos(since)) > patience;
                    hung.then_some(Fault::Hung(patience))
                }
                Place::Process { process, .. } => process.fault(),
            };
            if let Some(fault) = fault {
                self.host.cut_off(now, id, &fault, core);
            }
        }
        self.end_cut_off();
    }

    fn end_cut_off(&mut self) {
        for (_, place) in self.places.extract_if(.., |id, _| self.host.is_cut_off(id)) {
            if let Place::Thread { cut, .. } = place {
                cut.store(true, Ordering::Release);
            }
        }
    }
}

/// Calls a plug-in so that its faults affect no other.
struct Guard {
    id: PluginId,
    now: Clock,
    busy_since: Arc<AtomicU64>,
    /// Whether the core waits for the end of each call with a context.
    is_away: bool,
    cut: Arc<AtomicBool>,
    messages: mpsc::Sender<Message>,
}

impl Guard {
    fn run(self, plugin: Box<dyn Plugin>, start: Occasion, inbox: &mpsc::Receiver<Arc<Stamped>>) {
        let mut going = self.call(plugin, start);
        while let Some((plugin, next_deadline)) = going {
            let received = match next_deadline {
                None => inbox.recv().map_err(|_| mpsc::RecvTimeoutError::Disconnected),
                Some(deadline) => inbox.recv_timeout(deadline.since((self.now)())),
            };
            going = match received {
                Ok(event) => self.call(plugin, Occasion::Event(event)),
                Err(mpsc::RecvTimeoutError::Timeout) => self.call(plugin, Occasion::Deadline),
                Err(mpsc::RecvTimeoutError::Disconnected) => None,
            };
        }
    }

    /// Makes a call. Returns the plug-in with its next deadline, unless this was its last call.
    fn call(
        &self,
        plugin: Box<dyn Plugin>,
        occasion: Occasion,
    ) -> Option<(Box<dyn Plugin>, Option<Timestamp>)> {
        let now = (self.now)();
        let handled = self.is_away && matches!(occasion, Occasion::Event(_));
        self.busy_since.store(now.as_nanos(), Ordering::Release);
        let called = Call { plugin, now, occasion }.make();
        self.busy_since.store(IDLE, Ordering::Release);
        if self.cut.load(Ordering::Acquire) {
            return None;
        }
        let (going, outcome) = match called {
            Ok(answer) => {
                let going = Some((answer.plugin, answer.next_deadline));
                if answer.actions.is_empty() && !handled {
                    return going;
                }
                (going, Ok(answer.actions))
            }
            Err(fault) => (None, Err(fault)),
        };
        let (id, at) = (self.id.clone(), (self.now)());
        self.messages.send(Message::Returned { plugin: id, at, handled, outcome }).ok()?;
        going
    }
}

#[cfg(test)]
mod tests;
