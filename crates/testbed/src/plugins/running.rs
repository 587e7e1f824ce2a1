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
    travel::Travel,
};
use crate::{
    api::Server,
    clock::Clock,
    core::message::Message,
    domain::{self, DomainView, Domains},
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
}

impl PreparedPlugins {
    /// Makes the bundled plug-ins, and checks that the programs of the others exist.
    pub(crate) fn of(testbed: &Testbed, seed: u64) -> Result<Self, PluginError> {
        check_programs(testbed)?;
        check_distances(testbed)?;
        let history = RunHistory::default();
        let mut maker = Bundled::new(testbed, seed, Ledgers::default()).reading(Some(history.clone()));
        let mut bundled = BTreeMap::new();
        for spec in &testbed.plugins {
            if let PluginProgram::Bundled(name) = &spec.program {
                bundled.insert(spec.id.clone(), maker.make(spec, name)?);
            }
        }
        Ok(Self { bundled, ledgers: maker.into_ledgers(), history })
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
                    plugins.places.insert(spec.id.clone(), Place::Process(process));
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

/// Checks that real time has the distances of plug-ins.
fn check_distances(testbed: &Testbed) -> Result<(), PluginError> {
    for PluginSpec { id, program, distance, .. } in &testbed.plugins {
        match (&distance.way, program) {
            (Way::Nodes { .. }, _) => return Err(PluginError::RealNode(id.clone())),
            (Way::Delay { .. }, PluginProgram::Command(_)) => {
                return Err(PluginError::FarProgram(id.clone()));
            }
            _ => {}
        }
    }
    Ok(())
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
    Process(Process),
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

    /// Passes an event on to the plug-ins in process, or sends it to those that are away. Programs follow the API's stream.
    pub(crate) fn publish(&mut self, now: Timestamp, event: &Arc<Stamped>) {
        for (id, place) in &self.places {
            if let Place::Thread { view, events, .. } = place
                && let Some(seen) = domain::seen(view.as_deref(), event)
                && let Some(seen) = self.host.send_context(now, id, seen)
            {
                self.missed += u64::from(events.try_send(seen).is_err());
            }
        }
    }

    /// Passes contexts on that have arrived at plug-ins, and applies instructions that have arrived at the core.
    pub(crate) fn travel(&mut self, now: Timestamp, core: &mut impl Controlled) {
        for (id, place) in &self.places {
            let Place::Thread { events, .. } = place else { continue };
            while let Some(event) = self.host.next_context(now, id) {
                self.missed += u64::from(events.try_send(event).is_err());
            }
        }
        self.host.apply_arrived(now, core);
        self.end_cut_off();
    }

    /// Returns when something arrives next.
    pub(crate) fn next_travel(&self) -> Option<Timestamp> {
        self.host.next_travel()
    }

    /// Returns the number of events that plug-ins in process missed because they were too far behind.
    pub(crate) fn missed(&self) -> u64 {
        self.missed
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
                Place::Process(process) => process.fault(),
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
        self.busy_since.store(now.as_nanos(), Ordering::Release);
        let called = Call { plugin, now, occasion }.make();
        self.busy_since.store(IDLE, Ordering::Release);
        if self.cut.load(Ordering::Acquire) {
            return None;
        }
        let (going, outcome) = match called {
            Ok(answer) => {
                let going = Some((answer.plugin, answer.next_deadline));
                if answer.actions.is_empty() {
                    return going;
                }
                (going, Ok(answer.actions))
            }
            Err(fault) => (None, Err(fault)),
        };
        let (id, at) = (self.id.clone(), (self.now)());
        self.messages.send(Message::Returned { plugin: id, at, outcome }).ok()?;
        going
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cotorra_graph::{DecidesIn, Event, Instruction, NodeId, PluginDistance};
    use cotorra_graph_testing as base;

    struct Scripted(fn(&mut Actions));

    impl Plugin for Scripted {
        fn handle(&mut self, _now: Timestamp, _event: &Event, actions: &mut Actions) {
            (self.0)(actions);
        }
    }

    /// Records faults, and counts instructions.
    #[derive(Default)]
    struct Faults(Vec<(PluginId, String)>, usize);

    impl Controlled for Faults {
        fn instruct(&mut self, _now: Timestamp, _given: Given) -> Result<(), InstructionError> {
            self.1 += 1;
            Ok(())
        }

        fn cut_off(&mut self, _now: Timestamp, plugin: PluginId, fault: &Fault, _robots: &[NodeId]) {
            self.0.push((plugin, fault.to_string()));
        }

        fn publish(&mut self, _event: Stamped) {}
    }

    fn testbed() -> Arc<Testbed> {
        Arc::new(base::testbed(base::graph(Vec::new(), Vec::new())))
    }

    fn id() -> PluginId {
        "scripted".parse().unwrap()
    }

    /// Starts one plug-in in process. Returns its messages, too.
    fn running(script: fn(&mut Actions)) -> (RunningPlugins, mpsc::Receiver<Message>) {
        running_at(script, Way::None)
    }

    fn spec(program: PluginProgram, way: Way) -> PluginSpec {
        PluginSpec {
            id: id(),
            program,
            domain: None,
            optional: false,
            instructions_per_second: Default::default(),
            distance: PluginDistance { way, decides_in: DecidesIn::fixed(Duration::from_secs(9)) },
            env: Vec::new(),
            settings: Default::default(),
        }
    }

    fn running_at(script: fn(&mut Actions), way: Way) -> (RunningPlugins, mpsc::Receiver<Message>) {
        let travel = Travel::in_real_time(&[spec(PluginProgram::Bundled("pace".to_owned()), way)]);
        let host = PluginHost::new([id()], LONGEST_CALL).with_travel(travel);
        let mut plugins = RunningPlugins::new(host, Ledgers::default());
        let (messages, said) = mpsc::channel();
        let now: Clock = Arc::new(|| Timestamp::from_secs_f64(1.0));
        plugins.spawn(id(), Box::new(Scripted(script)), &testbed(), None, &now, messages);
        let event = Event::Notice { message: String::new() };
        plugins.publish(Timestamp::ZERO, &Arc::new(Stamped { at: Timestamp::ZERO, event }));
        (plugins, said)
    }

    #[test]
    fn an_instruction_arrives_with_its_reason() {
        let (_plugins, said) = running(|actions| {
            actions.instruct_because(Instruction::Scan { robot: "robot".parse().unwrap() }, "time to look");
        });
        let Message::Returned { plugin, outcome, .. } = said.recv().unwrap() else { panic!("no call") };
        let reason = outcome.unwrap().drain().next().unwrap().1;
        assert_eq!((plugin, reason.as_deref()), (id(), Some("time to look")));
    }

    #[test]
    fn contexts_and_instructions_take_their_delay_in_real_time() {
        let way = Way::Delay { control_delay: Duration::from_millis(100) };
        let scan =
            |actions: &mut Actions| actions.instruct(Instruction::Scan { robot: "r".parse().unwrap() });
        let (mut plugins, said) = running_at(scan, way);
        let (at, mut core) = (Timestamp::from_secs_f64, Faults::default());
        assert_eq!(plugins.next_travel(), Some(at(0.1)));
        plugins.travel(at(0.1), &mut core);
        assert_eq!(plugins.next_travel(), None);
        let Message::Returned { plugin, outcome, .. } = said.recv().unwrap() else { panic!("no call") };
        plugins.returned(at(0.2), &plugin, outcome, &mut core);
        plugins.travel(at(0.29), &mut core);
        assert_eq!((core.1, plugins.next_travel()), (0, Some(at(0.3))), "the plug-in's own time counts");
        plugins.travel(at(0.3), &mut core);
        assert_eq!((core.1, plugins.next_travel()), (1, None));
    }

    #[test]
    fn distances_that_only_virtual_time_has_are_rejected() {
        let nodes = Way::Nodes { core: "edge".parse().unwrap(), plugin: "cloud".parse().unwrap() };
        let delay = Way::Delay { control_delay: Duration::from_millis(1) };
        let bundled = || PluginProgram::Bundled("pace".to_owned());
        let program = || PluginProgram::Command(vec!["true".to_owned()]);
        let check = |program, way| {
            check_distances(&Testbed { plugins: vec![spec(program, way)], ..Testbed::clone(&testbed()) })
        };
        assert!(matches!(check(bundled(), nodes), Err(PluginError::RealNode(_))));
        assert!(matches!(check(program(), delay.clone()), Err(PluginError::FarProgram(_))));
        assert!(check(bundled(), delay).is_ok() && check(program(), Way::None).is_ok());
    }

    #[test]
    fn a_panic_is_reported_and_ends_only_the_plugin() {
        let (_plugins, said) = running(|_| panic!("by design"));
        let Message::Returned { outcome, .. } = said.recv().unwrap() else { panic!("no report") };
        assert_eq!(outcome.unwrap_err().to_string(), "panicked: by design");
        assert!(said.recv().is_err(), "the plug-in's thread ended");
    }

    #[test]
    fn a_plugin_that_does_not_return_is_cut_off() {
        // The plug-in hangs only later: the call that starts it makes it busy, too, and has to return.
        static HANGS: AtomicBool = AtomicBool::new(false);
        let (mut plugins, _said) = running(|_| {
            HANGS.store(true, Ordering::Release);
            loop {
                thread::park();
            }
        });
        while !HANGS.load(Ordering::Acquire) {
            thread::yield_now();
        }
        let mut told = Faults::default();
        plugins.check(Timestamp::from_secs_f64(2.9), &mut told);
        assert!(told.0.is_empty());
        plugins.check(Timestamp::from_secs_f64(3.1), &mut told);
        assert!(
            matches!(&told.0[..], [(who, why)] if *who == id() && why.contains("within 2 s")),
            "{:?}",
            told.0
        );
        let scan = Instruction::Scan { robot: "robot".parse().unwrap() };
        let refused = plugins.instruct(Timestamp::from_secs_f64(3.2), Given::new(id(), scan), &mut told);
        assert_eq!(refused, Err(InstructionError("this plug-in was cut off".to_owned())));
    }
}
