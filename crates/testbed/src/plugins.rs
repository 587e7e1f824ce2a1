//! Runs plug-ins beside the testbed, so that none can harm it: one that panics, hangs, floods or dies is cut off and
//! reported, and the testbed goes on.

use std::{
    collections::BTreeMap,
    env,
    fs::File,
    io,
    net::SocketAddr,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_federation::{Federation, Ledgers};
use cotorra_graph::{Instruction, NodeId, PluginId, PluginProgram, PluginSpec, Stamped, Testbed, Timestamp};
use cotorra_okpi::Okpi;
use cotorra_plugin::{Actions, Plugin};
use cotorra_probing::Probing;

use crate::{
    domain::{self, DomainView, Domains},
    earlier::Earlier,
};

/// A call that takes longer than this counts as hung.
const LONGEST_CALL: Duration = Duration::from_secs(2);
/// A plug-in may ask for so much in a second; a burst of the same size is allowed.
const INSTRUCTIONS_PER_SECOND: f64 = 1000.0;
/// Events that wait for a plug-in; one that is further behind misses the oldest.
const QUEUE: usize = 4096;
const IDLE: u64 = u64::MAX;

/// The time now, wherever it comes from.
pub(crate) type Now = Arc<dyn Fn() -> Timestamp + Send + Sync>;

/// What plug-ins say.
#[derive(Debug)]
pub(crate) enum Said {
    /// Please do this.
    Instruct {
        /// Who asks.
        plugin: PluginId,
        /// What for.
        instruction: Instruction,
        /// Why.
        reason: Option<String>,
    },
    /// It panicked, or its process ended.
    Failed {
        /// Who.
        plugin: PluginId,
        /// How.
        reason: String,
    },
}

/// Why a plug-in cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum PluginError {
    /// No such plug-in is bundled.
    #[error("plug-in `{plugin}`: `{name}` is not bundled; bundled are: federation, okpi, probing")]
    NotBundled {
        /// Which.
        plugin: PluginId,
        /// The name in the file.
        name: String,
    },
    /// Its settings are wrong.
    #[error("plug-in `{plugin}`: {reason}")]
    Settings {
        /// Which.
        plugin: PluginId,
        /// What is wrong.
        reason: String,
    },
    /// It needs the API, which only a whole run serves.
    #[error("plug-in `{0}` is a program of its own: it takes part in a run, not in a bare simulation")]
    NeedsRun(PluginId),
    /// Its program cannot be started.
    #[error("plug-in `{plugin}`: cannot start `{program}`: {source}")]
    Start {
        /// Which.
        plugin: PluginId,
        /// The program.
        program: String,
        /// What the system says.
        source: io::Error,
    },
}

/// Makes the bundled plug-ins of a testbed, each when it is asked for.
pub(crate) struct Bundled<'a> {
    testbed: &'a Testbed,
    seed: u64,
    ledgers: Ledgers,
}

impl<'a> Bundled<'a> {
    pub(crate) fn new(testbed: &'a Testbed, seed: u64, ledgers: Ledgers) -> Self {
        Self { testbed, seed, ledgers }
    }

    /// What they share, and what is to live as long as they do.
    pub(crate) fn into_ledgers(self) -> Ledgers {
        self.ledgers
    }

    /// The plug-in that a testbed file names.
    pub(crate) fn make(&mut self, spec: &PluginSpec, name: &str) -> Result<Box<dyn Plugin>, PluginError> {
        let settings =
            |e: &dyn ToString| PluginError::Settings { plugin: spec.id.clone(), reason: e.to_string() };
        match name {
            "federation" => {
                let domain = spec.domain.as_ref();
                let orchestrator = Federation::open(&spec.settings, domain, self.seed, &mut self.ledgers);
                Ok(Box::new(orchestrator.map_err(|e| settings(&e))?))
            }
            "okpi" => {
                let okpi =
                    Okpi::from_settings(&spec.settings).and_then(|okpi| okpi.for_testbed(self.testbed));
                Ok(Box::new(okpi.map_err(|e| settings(&e))?))
            }
            "probing" => {
                let probing = Probing::from_settings(&spec.settings, self.seed);
                Ok(Box::new(probing.map_err(|e| settings(&e))?))
            }
            _ => Err(PluginError::NotBundled { plugin: spec.id.clone(), name: name.to_owned() }),
        }
    }
}

/// The plug-ins of a testbed that are programs of their own.
pub(crate) fn programs(testbed: &Testbed) -> impl Iterator<Item = &PluginId> {
    let is_program = |spec: &&PluginSpec| matches!(spec.program, PluginProgram::Command(_));
    testbed.plugins.iter().filter(is_program).map(|spec| &spec.id)
}

/// What a panic says.
pub(crate) fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message")
}

/// How many instructions a plug-in has left; a token bucket.
#[derive(Debug)]
struct Budget {
    left: f64,
    at: Timestamp,
}

impl Budget {
    fn take(&mut self, now: Timestamp) -> bool {
        let earned = now.since(self.at).as_secs_f64() * INSTRUCTIONS_PER_SECOND;
        self.at = self.at.max(now);
        self.left = (self.left + earned).min(INSTRUCTIONS_PER_SECOND);
        let allowed = self.left >= 1.0;
        self.left -= f64::from(u8::from(allowed));
        allowed
    }
}

/// Where a plug-in runs.
enum Place {
    Thread {
        /// What it sees, if that is one domain.
        view: Option<Arc<DomainView>>,
        events: mpsc::SyncSender<Arc<Stamped>>,
        /// When the call that it is in began, in nanoseconds; [`IDLE`] between calls.
        busy_since: Arc<AtomicU64>,
        /// Set when it is cut off: what it still says is not passed on.
        cut: Arc<AtomicBool>,
    },
    Process(Child),
    Cut,
}

/// The plug-ins of a testbed, checked and made, before anything of the run is there: a mistake in a testbed file, or a ledger
/// that cannot be had, leaves nothing behind.
pub(crate) struct Prepared {
    bundled: BTreeMap<PluginId, Box<dyn Plugin>>,
    ledgers: Ledgers,
}

impl Prepared {
    /// Makes what is bundled, and looks for the programs of the others.
    pub(crate) fn of(testbed: &Testbed, seed: u64) -> Result<Self, PluginError> {
        check_programs(testbed)?;
        let mut maker = Bundled::new(testbed, seed, Ledgers::default());
        let mut bundled = BTreeMap::new();
        for spec in &testbed.plugins {
            if let PluginProgram::Bundled(name) = &spec.program {
                bundled.insert(spec.id.clone(), maker.make(spec, name)?);
            }
        }
        Ok(Self { bundled, ledgers: maker.into_ledgers() })
    }

    /// Tells those that are bundled what they noted in an earlier run.
    pub(crate) fn resume(&mut self, earlier: &Earlier) {
        self.bundled.iter_mut().for_each(|(id, plugin)| plugin.resume(earlier.noted_by(id)));
    }

    /// Starts all of them. `say` is called from their threads.
    pub(crate) fn start(
        mut self,
        testbed: &Arc<Testbed>,
        now: &Now,
        api: SocketAddr,
        logs: &Path,
        say: &(impl Fn(Said) + Clone + Send + 'static),
    ) -> Result<PluginHost, PluginError> {
        let domains = Domains::new(testbed);
        let mut host = PluginHost::new();
        host.ledgers = self.ledgers;
        for spec in &testbed.plugins {
            let place = match &spec.program {
                PluginProgram::Command(words) => spawn_process(spec, words, api, logs)?,
                PluginProgram::Bundled(_) => {
                    let plugin = self.bundled.remove(&spec.id).expect("each that is bundled was made");
                    let view = domains.of_plugin(&spec.id).cloned();
                    host.spawn_thread(spec.id.clone(), plugin, testbed, view, now, say.clone())
                }
            };
            host.places.insert(spec.id.clone(), place);
        }
        Ok(host)
    }
}

/// Looks whether the programs of plug-ins are there.
pub(crate) fn check_programs(testbed: &Testbed) -> Result<(), PluginError> {
    for spec in &testbed.plugins {
        let PluginProgram::Command(words) = &spec.program else { continue };
        let program = program(spec, words)?.0;
        let is_there = if program.contains('/') {
            Path::new(program).exists()
        } else {
            let folders = env::var_os("PATH").unwrap_or_default();
            env::split_paths(&folders).any(|folder| folder.join(program).exists())
        };
        if !is_there {
            let source = io::Error::from(io::ErrorKind::NotFound);
            let plugin = spec.id.clone();
            return Err(PluginError::Start { plugin, program: program.to_owned(), source });
        }
    }
    Ok(())
}

/// The program of a plug-in, and its arguments.
fn program<'a>(spec: &PluginSpec, words: &'a [String]) -> Result<(&'a String, &'a [String]), PluginError> {
    words.split_first().ok_or_else(|| PluginError::Settings {
        plugin: spec.id.clone(),
        reason: "its command is empty".to_owned(),
    })
}

/// All plug-ins of a run.
pub(crate) struct PluginHost {
    places: BTreeMap<PluginId, Place>,
    budgets: BTreeMap<PluginId, Budget>,
    movers: BTreeMap<NodeId, PluginId>,
    missed: u64,
    /// What bundled ones share: it ends with them.
    ledgers: Ledgers,
}

impl PluginHost {
    /// A host without plug-ins.
    pub(crate) fn new() -> Self {
        Self {
            places: BTreeMap::new(),
            budgets: BTreeMap::new(),
            movers: BTreeMap::new(),
            missed: 0,
            ledgers: Ledgers::default(),
        }
    }

    /// Starts the plug-ins of a testbed that are programs of their own, and no others; gives which they are.
    pub(crate) fn start_programs(
        &mut self,
        testbed: &Testbed,
        api: SocketAddr,
        logs: &Path,
    ) -> Result<Vec<PluginId>, PluginError> {
        for spec in &testbed.plugins {
            if let PluginProgram::Command(words) = &spec.program {
                self.places.insert(spec.id.clone(), spawn_process(spec, words, api, logs)?);
            }
        }
        Ok(programs(testbed).cloned().collect())
    }

    fn spawn_thread(
        &self,
        id: PluginId,
        plugin: Box<dyn Plugin>,
        testbed: &Arc<Testbed>,
        view: Option<Arc<DomainView>>,
        now: &Now,
        say: impl Fn(Said) + Send + 'static,
    ) -> Place {
        let (events, inbox) = mpsc::sync_channel(QUEUE);
        let busy_since = Arc::new(AtomicU64::new(IDLE));
        let cut = Arc::new(AtomicBool::new(false));
        let guard = Guard {
            id: id.clone(),
            plugin,
            now: Arc::clone(now),
            busy_since: Arc::clone(&busy_since),
            cut: Arc::clone(&cut),
            say,
        };
        let (testbed, part) = (Arc::clone(testbed), view.clone());
        thread::Builder::new()
            .name(format!("plugin-{id}"))
            .spawn(move || guard.run(part.as_ref().map_or(&*testbed, |view| view.testbed()), &inbox))
            .expect("the system has room for a thread a plug-in");
        Place::Thread { view, events, busy_since, cut }
    }

    /// Passes an event on to all plug-ins in process; those apart follow the API's stream.
    pub(crate) fn publish(&mut self, event: &Arc<Stamped>) {
        for place in self.places.values() {
            let Place::Thread { view, events, .. } = place else { continue };
            let Some(seen) = domain::seen(view.as_deref(), event) else { continue };
            if events.try_send(seen).is_err() {
                self.missed += 1;
            }
        }
    }

    /// Plug-ins that hang or whose process ended, with what they did; they are cut off.
    pub(crate) fn check(&mut self, now: Timestamp) -> Vec<(PluginId, String)> {
        let mut faults = Vec::new();
        for (id, place) in &mut self.places {
            let reason = match place {
                Place::Thread { busy_since, .. } => {
                    let since = busy_since.load(Ordering::Acquire);
                    let hung = since != IDLE && now.since(Timestamp::from_nanos(since)) > LONGEST_CALL;
                    hung.then(|| format!("did not return from a call within {} s", LONGEST_CALL.as_secs()))
                }
                Place::Process(child) => match child.try_wait() {
                    Ok(None) => None,
                    Ok(Some(status)) => Some(format!("its program ended: {status}")),
                    Err(error) => Some(format!("its program is lost: {error}")),
                },
                Place::Cut => None,
            };
            faults.extend(reason.map(|reason| (id.clone(), reason)));
        }
        for (id, _) in &faults {
            self.cut_off(id);
        }
        faults
    }

    /// Whether a plug-in may ask for something now. One that is cut off may not; one that asks too often is told so,
    /// and cut off.
    pub(crate) fn admit(&mut self, now: Timestamp, id: &PluginId) -> Result<(), Refusal> {
        if matches!(self.places.get(id), Some(Place::Cut)) {
            return Err(Refusal::CutOff);
        }
        let full = || Budget { left: INSTRUCTIONS_PER_SECOND, at: now };
        if self.budgets.entry(id.clone()).or_insert_with(full).take(now) {
            return Ok(());
        }
        Err(if self.places.contains_key(id) { Refusal::Flood } else { Refusal::TooMany })
    }

    /// Keeps in mind who moves a robot, so that it stops when its mover is cut off.
    pub(crate) fn moved(&mut self, robot: &NodeId, by: &PluginId) {
        if self.movers.get(robot) != Some(by) {
            self.movers.insert(robot.clone(), by.clone());
        }
    }

    /// Cuts a plug-in off and gives the robots that it moved last.
    pub(crate) fn cut_off(&mut self, id: &PluginId) -> Vec<NodeId> {
        match self.places.insert(id.clone(), Place::Cut) {
            Some(Place::Thread { cut, .. }) => cut.store(true, Ordering::Release),
            Some(Place::Process(mut child)) => end(&mut child),
            Some(Place::Cut) | None => {}
        }
        let moved = self.movers.iter().filter(|(_, by)| *by == id).map(|(robot, _)| robot.clone()).collect();
        self.movers.retain(|_, by| by != id);
        moved
    }
}

impl Drop for PluginHost {
    fn drop(&mut self) {
        // Threads end when their channel closes; a hung one ends with the process.
        for place in self.places.values_mut() {
            if let Place::Process(child) = place {
                end(child);
            }
        }
    }
}

fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

/// Why a plug-in may not ask now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("this plug-in was cut off")]
    CutOff,
    #[error("it asked for more than {INSTRUCTIONS_PER_SECOND} things in a second")]
    Flood,
    #[error("no more than {INSTRUCTIONS_PER_SECOND} instructions a second are taken")]
    TooMany,
}

fn spawn_process(
    spec: &PluginSpec,
    words: &[String],
    api: SocketAddr,
    logs: &Path,
) -> Result<Place, PluginError> {
    let (program, arguments) = program(spec, words)?;
    let start = || {
        let log = File::create(logs.join(format!("plugin-{}.log", spec.id)))?;
        Command::new(program)
            .args(arguments)
            // The history's password is nobody's business.
            .env_remove("COTORRA_HISTORY")
            .env_remove("COTORRA_HISTORY_PASSWORD")
            .env_remove("COTORRA_DOMAIN_TOKENS")
            .env("COTORRA_API", format!("http://{api}"))
            .env("COTORRA_PLUGIN", spec.id.as_str())
            .env("COTORRA_SETTINGS", serde_json::Value::Object(spec.settings.clone()).to_string())
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            .spawn()
    };
    start().map(Place::Process).map_err(|source| PluginError::Start {
        plugin: spec.id.clone(),
        program: program.clone(),
        source,
    })
}

/// Calls a plug-in so that what it does wrong stays with it.
struct Guard<S> {
    id: PluginId,
    plugin: Box<dyn Plugin>,
    now: Now,
    busy_since: Arc<AtomicU64>,
    cut: Arc<AtomicBool>,
    say: S,
}

impl<S: Fn(Said)> Guard<S> {
    fn run(mut self, testbed: &Testbed, inbox: &mpsc::Receiver<Arc<Stamped>>) {
        let mut going = self.call(|plugin, now, actions| plugin.start(now, testbed, actions));
        while going {
            let now = (self.now)();
            let received = match self.plugin.next_deadline() {
                None => inbox.recv().map_err(|_| mpsc::RecvTimeoutError::Disconnected),
                Some(deadline) => inbox.recv_timeout(deadline.since(now)),
            };
            going = match received {
                Ok(event) => self.call(|plugin, now, actions| plugin.handle(now, &event.event, actions)),
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    self.call(|plugin, now, actions| plugin.expire(now, actions))
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => false,
            };
        }
    }

    /// One call; false when it was the last.
    fn call(&mut self, call: impl FnOnce(&mut dyn Plugin, Timestamp, &mut Actions)) -> bool {
        let now = (self.now)();
        let mut actions = Actions::default();
        self.busy_since.store(now.as_nanos(), Ordering::Release);
        let returned = catch_unwind(AssertUnwindSafe(|| call(&mut *self.plugin, now, &mut actions)));
        self.busy_since.store(IDLE, Ordering::Release);
        if self.cut.load(Ordering::Acquire) {
            return false;
        }
        if let Err(panic) = returned {
            let reason = format!("panicked: {}", panic_text(&*panic));
            (self.say)(Said::Failed { plugin: self.id.clone(), reason });
            return false;
        }
        for (instruction, reason) in actions.drain() {
            (self.say)(Said::Instruct { plugin: self.id.clone(), instruction, reason });
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cotorra_graph::{Event, HardwareGraph};

    struct Scripted(fn(&mut Actions));

    impl Plugin for Scripted {
        fn handle(&mut self, _now: Timestamp, _event: &Event, actions: &mut Actions) {
            (self.0)(actions);
        }
    }

    fn testbed() -> Arc<Testbed> {
        Arc::new(Testbed {
            name: "test".into(),
            description: String::new(),
            graph: HardwareGraph {
                domains: Vec::new(),
                nodes: Vec::new(),
                links: Vec::new(),
                wireless: BTreeMap::new(),
            },
            services: Vec::new(),
            map: None,
            walks: Vec::new(),
            plugins: Vec::new(),
            wais: Default::default(),
            seed: 1,
            emulation: Default::default(),
            script: Default::default(),
            probes: None,
            retention: Default::default(),
        })
    }

    fn id() -> PluginId {
        "scripted".parse().unwrap()
    }

    /// A host with one plug-in in process, and what it says.
    fn host(script: fn(&mut Actions)) -> (PluginHost, mpsc::Receiver<Said>) {
        let mut host = PluginHost::new();
        let (tell, said) = mpsc::channel();
        let now: Now = Arc::new(|| Timestamp::from_secs_f64(1.0));
        let say = move |s| drop(tell.send(s));
        let place = host.spawn_thread(id(), Box::new(Scripted(script)), &testbed(), None, &now, say);
        host.places.insert(id(), place);
        host.publish(&Arc::new(Stamped {
            at: Timestamp::ZERO,
            event: Event::Notice { message: String::new() },
        }));
        (host, said)
    }

    #[test]
    fn what_a_plugin_asks_for_arrives_with_its_reason() {
        let (_host, said) = host(|actions| {
            actions.instruct_because(Instruction::Scan { robot: "robot".parse().unwrap() }, "time to look");
        });
        let Said::Instruct { plugin, reason, .. } = said.recv().unwrap() else { panic!("no instruction") };
        assert_eq!((plugin, reason.as_deref()), (id(), Some("time to look")));
    }

    #[test]
    fn a_panic_is_reported_and_ends_only_the_plugin() {
        let (_host, said) = host(|_| panic!("by design"));
        let Said::Failed { reason, .. } = said.recv().unwrap() else { panic!("no report") };
        assert_eq!(reason, "panicked: by design");
        assert!(said.recv().is_err(), "the plug-in's thread ended");
    }

    #[test]
    fn a_plugin_that_does_not_return_is_cut_off() {
        // Not as soon as it is busy: the call that starts it is one, too, and returns.
        static HANGS: AtomicBool = AtomicBool::new(false);
        let (mut host, _said) = host(|_| {
            HANGS.store(true, Ordering::Release);
            loop {
                thread::park();
            }
        });
        while !HANGS.load(Ordering::Acquire) {
            thread::yield_now();
        }
        assert!(host.check(Timestamp::from_secs_f64(2.9)).is_empty());
        let faults = host.check(Timestamp::from_secs_f64(3.1));
        assert!(
            matches!(&faults[..], [(who, why)] if *who == id() && why.contains("within 2 s")),
            "{faults:?}"
        );
        assert_eq!(host.admit(Timestamp::from_secs_f64(3.2), &id()), Err(Refusal::CutOff));
    }

    #[test]
    fn a_flood_is_refused_and_the_robots_that_it_moved_are_named() {
        let (mut host, _said) = host(|_| {});
        let (now, robot): (_, NodeId) = (Timestamp::from_secs_f64(1.0), "robot".parse().unwrap());
        host.moved(&robot, &id());
        for _ in 0..1000 {
            host.admit(now, &id()).unwrap();
        }
        assert_eq!(host.admit(now, &id()), Err(Refusal::Flood));
        assert_eq!(host.cut_off(&id()), [robot]);
        // Somebody at the API is not a plug-in: refused, and welcome again later.
        let somebody: PluginId = "somebody".parse().unwrap();
        for _ in 0..1000 {
            host.admit(now, &somebody).unwrap();
        }
        assert_eq!(host.admit(now, &somebody), Err(Refusal::TooMany));
        assert_eq!(host.admit(now + Duration::from_secs(1), &somebody), Ok(()));
    }
}
