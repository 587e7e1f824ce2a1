//! Runs each VNF as a process in its node's namespace, with limits if cgroups are available, and its output in a log.
//!
//! One thread watches each process, because the thread that starts a process must live until its end.

use std::{
    collections::BTreeMap,
    fs::{File, OpenOptions},
    io::{self, BufRead, BufReader, PipeReader, Write},
    path::PathBuf,
    process::{ChildStdout, Command, ExitStatus, Stdio},
    sync::{Arc, Weak, mpsc},
    thread,
    time::Duration,
};

use cotorra_graph::{NodeId, Program, Vnf, VnfId};
use parking_lot::Mutex;

use crate::{
    cgroup::Cgroups,
    computed::VnfComputed,
    engine::{Engine, EngineEvent, InstanceId, Outcome},
    processor_waits::{InstanceWaits, Reading, Readings, throttled_in},
    tally::Tally,
};

/// Interval of checks whether a process has ended.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);
/// Checks after SIGTERM until a process is killed.
const GRACE_CHECKS: u32 = 10;
/// Checks from one reading of a process's waits to the next.
const READING_CHECKS: u32 = 20;
/// First line of a bundled VNF's output, once it serves.
pub const READY: &str = "ready";

/// Variable with the number of a replica's starts so far, from 1.
pub const START: &str = "COTORRA_START";

/// A process of a VNF, with its descendants.
pub trait Process: Send {
    /// Returns the exit status, if the process has ended.
    ///
    /// # Errors
    /// The error of the system.
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>>;

    /// Sends SIGTERM.
    fn terminate(&mut self);

    /// Kills the process and waits for its end.
    fn kill(&mut self);

    /// Takes the standard output, if the command has a pipe for it.
    fn stdout(&mut self) -> Option<ChildStdout>;

    /// Returns the ID of the process, if its [waits](Engine::processor_waits) are to be read.
    fn id(&self) -> Option<u32> {
        None
    }
}

/// Starts processes of VNFs: on their node, in cgroups, and killed with this process.
pub trait Launcher: Send + Sync + 'static {
    /// Starts a process with the rights of its VNF.
    ///
    /// # Errors
    /// The error of the system if the process cannot be started.
    fn launch(
        &self,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
        command: Command,
        cgroup_procs: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>>;

    /// Returns the command of a VNF's instance, with its environment. A bundled VNF, navigation or localization, prints
    /// [`READY`] once it serves.
    ///
    /// # Errors
    /// The reason for which it cannot run there, for people.
    fn command(&self, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<Command, String>;

    /// Signals a new event of [`Engine::poll`]. Called from other threads.
    fn wake(&self);
}

/// Returns a file name for a VNF's replica: the VNF's name for the first, `<vnf>@<replica>` for others. No VNF's name has
/// an `@`.
pub fn replica_name(vnf: &VnfId, replica: u32) -> String {
    if replica == 0 { vnf.to_string() } else { format!("{vnf}@{replica}") }
}

/// Runs VNFs as processes.
pub struct ProcessEngine<L> {
    launcher: Arc<L>,
    logs: PathBuf,
    cgroups: Option<Arc<Cgroups>>,
    watched: BTreeMap<InstanceId, Watched>,
    events: mpsc::Receiver<EngineEvent>,
    report: mpsc::Sender<EngineEvent>,
    /// Readings of all instances without a demand so far. Others have waits of which the file says how long they are.
    waits: Vec<(VnfId, NodeId, Arc<Mutex<Readings>>)>,
    /// Requests of VNFs with a demand so far.
    computed: BTreeMap<(VnfId, NodeId), Computed>,
    /// Number of starts of each replica of a VNF.
    starts: BTreeMap<(VnfId, u32), u32>,
}

/// Requests of a VNF's instances on a node.
struct Computed {
    limit: f64,
    tally: Arc<Mutex<Tally>>,
}

impl<L> std::fmt::Debug for ProcessEngine<L> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ProcessEngine").field("watched", &self.watched.len()).finish_non_exhaustive()
    }
}

struct Watched {
    stop: mpsc::Sender<()>,
    is_stopped: bool,
    /// Upgrades until the instance has ended and is cleaned up.
    alive: Weak<()>,
    thread: thread::JoinHandle<()>,
}

impl Watched {
    fn stop(&mut self) {
        self.is_stopped = true;
        // Fails only if it has ended.
        let _ = self.stop.send(());
    }
}

impl<L: Launcher> ProcessEngine<L> {
    /// Creates an engine. Processes append their output to `logs/<vnf>.log`, or `logs/<vnf>@<replica>.log` for replicas
    /// from 1. Without cgroups they have no limits.
    pub fn new(launcher: Arc<L>, logs: PathBuf, cgroups: Option<Cgroups>) -> Self {
        let (report, events) = mpsc::channel();
        let cgroups = cgroups.map(Arc::new);
        Self {
            launcher,
            logs,
            cgroups,
            watched: BTreeMap::new(),
            events,
            report,
            waits: Vec::new(),
            computed: BTreeMap::new(),
            starts: BTreeMap::new(),
        }
    }

    /// Returns the number of instances that were stopped and have not ended yet. The owner is woken when one has.
    pub fn stopping(&self) -> usize {
        let is_stopping = |its: &&Watched| its.is_stopped && its.alive.strong_count() > 0;
        self.watched.values().filter(is_stopping).count()
    }

    fn command(&mut self, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<Command, String> {
        if vnf.program == Program::RobotDriver {
            return Err("the robot's driver runs in the Robot Middleware".to_owned());
        }
        let mut command = self.launcher.command(vnf, replica, node)?;
        command.env("COTORRA_VNF", vnf.id.as_str()).env("COTORRA_NODE", node.as_str());
        command.env("COTORRA_REPLICA", replica.to_string());
        let starts = self.starts.entry((vnf.id.clone(), replica)).or_default();
        *starts += 1;
        command.env(START, starts.to_string());
        Ok(command)
    }
}

impl<L: Launcher> Engine for ProcessEngine<L> {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        let mut command = self.command(vnf, replica, node)?;
        let path = self.logs.join(format!("{}.log", replica_name(&vnf.id, replica)));
        let in_log = |e: io::Error| format!("cannot write {}: {e}", path.display());
        let mut log = OpenOptions::new().create(true).append(true).open(&path).map_err(in_log)?;
        // A full disk must not stop the VNF.
        let _ = writeln!(log, "--- instance {} on {node}", instance.0);
        let output = match vnf.program {
            Program::Command(_) => {
                // A pipe rather than the log itself, so that the VNF cannot change what is written there.
                let (output, stdout) = io::pipe().map_err(in_log)?;
                command.stderr(stdout.try_clone().map_err(in_log)?).stdout(stdout);
                Some(output)
            }
            _ => {
                command.stderr(log.try_clone().map_err(in_log)?).stdout(Stdio::piped());
                None
            }
        };
        command.stdin(Stdio::null());
        let procs = match &self.cgroups {
            Some(groups) => {
                groups.limit(instance, node, vnf.most_cpus(), vnf.memory_bytes).map_err(|e| e.to_string())?
            }
            None => Vec::new(),
        };
        let (stop, stopped) = mpsc::channel();
        let (launcher, events) = (Arc::clone(&self.launcher), self.report.clone());
        let (node, vnf) = (node.clone(), vnf.clone());
        let cgroups = self.cgroups.clone();
        let readings = Arc::<Mutex<Readings>>::default();
        if vnf.computing.is_none() {
            self.waits.push((vnf.id.clone(), node.clone(), Arc::clone(&readings)));
        }
        let tally = vnf.computing.is_some().then(|| {
            let key = (vnf.id.clone(), node.clone());
            let limit = vnf.most_cpus();
            let computed =
                self.computed.entry(key).or_insert_with(|| Computed { limit, tally: Arc::default() });
            Arc::clone(&computed.tally)
        });
        let lives = Arc::new(());
        let alive = Arc::downgrade(&lives);
        let thread = thread::Builder::new()
            .name(format!("vnf-{}", vnf.id))
            .spawn(move || {
                let reporter = Reporter::new(|outcome| {
                    // Fails only while the engine is dropped.
                    let _ = events.send(EngineEvent { instance, outcome });
                    launcher.wake();
                });
                match launcher.launch(&vnf, replica, &node, command, procs) {
                    Ok(mut child) => {
                        let cpu_stats = cgroups.as_ref().map(|groups| groups.cpu_stats(instance, &node));
                        let cpu_stats = cpu_stats.unwrap_or_default();
                        let read = |process: u32| {
                            let reading = Reading::of(process, throttled_in(&cpu_stats));
                            readings.lock().add(reading);
                        };
                        let output =
                            output.map_or(Output::OfBundled(instance, tally.as_deref()), Output::OfOthers);
                        watch(&mut *child, log, output, &stopped, &reporter, &read);
                    }
                    Err(error) => reporter.ended(format!("cannot start: {error}")),
                }
                if let Some(groups) = cgroups {
                    groups.release(instance, &node);
                }
                drop(lives);
                launcher.wake();
            })
            .map_err(|e| format!("cannot start a thread: {e}"))?;
        self.watched.insert(instance, Watched { stop, is_stopped: false, alive, thread });
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        if let Some(watched) = self.watched.get_mut(&instance) {
            watched.stop();
        }
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        let event = self.events.try_recv().ok();
        self.watched.retain(|_, watched| watched.alive.strong_count() > 0);
        event
    }

    fn shut_down(&mut self) {
        self.watched.values_mut().for_each(Watched::stop);
        for (_, watched) in std::mem::take(&mut self.watched) {
            let _ = watched.thread.join();
        }
    }

    fn processor_waits(&self) -> Vec<InstanceWaits> {
        let waits = |(vnf, node, readings): &(VnfId, NodeId, Arc<Mutex<Readings>>)| InstanceWaits {
            vnf: vnf.clone(),
            node: node.clone(),
            waits: readings.lock().waits(),
        };
        self.waits.iter().map(waits).collect()
    }

    fn computed(&self) -> Vec<VnfComputed> {
        #[allow(clippy::disallowed_types, reason = "instances serve in real time")]
        let now = std::time::Instant::now();
        let so_far = |((vnf, node), its): (&(VnfId, NodeId), &Computed)| {
            let (requests, ran) = its.tally.lock().so_far(now);
            VnfComputed { vnf: vnf.clone(), node: node.clone(), limit: its.limit, ran, requests }
        };
        self.computed.iter().map(so_far).collect()
    }
}

impl<L> Drop for ProcessEngine<L> {
    fn drop(&mut self) {
        for (_, mut watched) in std::mem::take(&mut self.watched) {
            watched.stop();
            let _ = watched.thread.join();
        }
    }
}

/// Reports the outcomes of an instance in the order of [`Engine`].
struct Reporter<F> {
    report: F,
    /// The stage after the last outcome.
    stage: Mutex<Stage>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Starting,
    Ready,
    Ended,
}

impl<F: Fn(Outcome)> Reporter<F> {
    fn new(report: F) -> Self {
        Self { report, stage: Mutex::new(Stage::Starting) }
    }

    fn ready(&self) {
        let mut stage = self.stage.lock();
        if *stage == Stage::Starting {
            *stage = Stage::Ready;
            (self.report)(Outcome::Ready);
        }
    }

    fn is_ready(&self) -> bool {
        *self.stage.lock() == Stage::Ready
    }

    fn ended(&self, reason: String) {
        let mut stage = self.stage.lock();
        match *stage {
            Stage::Starting => (self.report)(Outcome::Failed(reason)),
            Stage::Ready => (self.report)(Outcome::Died(reason)),
            Stage::Ended => {}
        }
        *stage = Stage::Ended;
    }
}

/// Standard output of a process.
enum Output<'a> {
    /// That of a program of others, which goes to the log.
    OfOthers(PipeReader),
    /// That of a bundled program, which reports when it serves, and its requests if it has a demand.
    OfBundled(InstanceId, Option<&'a Mutex<Tally>>),
}

/// Watches a process until it ends or is stopped. `read` reads the waits of a process that serves.
fn watch(
    child: &mut dyn Process,
    mut log: File,
    output: Output<'_>,
    stopped: &mpsc::Receiver<()>,
    reporter: &Reporter<impl Fn(Outcome) + Sync>,
    read: &impl Fn(u32),
) {
    thread::scope(|scope| {
        match output {
            Output::OfOthers(mut output) => {
                reporter.ready();
                scope.spawn(move || {
                    // A full disk must not block the VNF.
                    let _ =
                        io::copy(&mut output, &mut log).or_else(|_| io::copy(&mut output, &mut io::sink()));
                });
            }
            Output::OfBundled(instance, tally) => {
                if let Some(stdout) = child.stdout() {
                    scope.spawn(move || copy_output(stdout, log, reporter, instance, tally));
                }
            }
        }
        let mut checks: u32 = 0;
        loop {
            match stopped.recv_timeout(CHECK_INTERVAL) {
                Err(mpsc::RecvTimeoutError::Timeout) => match child.try_wait() {
                    Ok(None) if reporter.is_ready() => {
                        checks = checks.wrapping_add(1);
                        if checks.is_multiple_of(READING_CHECKS) {
                            child.id().into_iter().for_each(read);
                        }
                    }
                    Ok(None) => {}
                    Ok(Some(status)) => return reporter.ended(describe(status)),
                    Err(error) => return reporter.ended(error.to_string()),
                },
                // Stopped, or the engine is gone.
                Ok(()) | Err(mpsc::RecvTimeoutError::Disconnected) => {
                    if checks >= READING_CHECKS {
                        child.id().into_iter().for_each(read);
                    }
                    return terminate(child);
                }
            }
        }
    });
}

/// Copies the output of a bundled VNF to its log. The line [`READY`] reports that it serves. Lines of requests are counted.
#[allow(clippy::disallowed_types, reason = "an instance serves in real time")]
fn copy_output(
    stdout: impl io::Read,
    mut log: File,
    reporter: &Reporter<impl Fn(Outcome)>,
    instance: InstanceId,
    tally: Option<&Mutex<Tally>>,
) {
    let tally = |change: &dyn Fn(&mut Tally)| tally.into_iter().for_each(|tally| change(&mut tally.lock()));
    for line in BufReader::new(stdout).lines().map_while(Result::ok) {
        if let Ok(line) = line.parse() {
            tally(&|its| its.add(instance, line));
            continue;
        }
        if line == READY {
            tally(&|its| its.begin(instance, std::time::Instant::now()));
            reporter.ready();
        }
        // A full disk must not stop the VNF.
        let _ = writeln!(log, "{line}");
    }
    tally(&|its| its.end(instance, std::time::Instant::now()));
}

fn terminate(child: &mut dyn Process) {
    child.terminate();
    let (_keep, never) = mpsc::channel::<()>();
    for _ in 0..GRACE_CHECKS {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        let _ = never.recv_timeout(CHECK_INTERVAL);
    }
    child.kill();
}

fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exited with status {code}"),
        (_, Some(signal)) => format!("was killed by signal {signal}"),
        _ => status.to_string(),
    }
}
