//! The engines of this crate keep the contract: plain processes of this machine, and the one in memory.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs, io,
    os::unix::{fs::symlink, process::CommandExt},
    path::PathBuf,
    process::{Child, ChildStdout, Command, ExitStatus},
    sync::{Arc, mpsc},
};

use cotorra_engine::{
    Cgroups, Engine, EngineEvent, InMemoryEngine, InstanceId, Launcher, Process, ProcessEngine,
    contract::{self, Mark, Promise, Subject},
    program_of, program_of_others,
};
use cotorra_graph::{Image, NodeId, Program, Vnf, VnfId};
use cotorra_graph_testing as base;
use rustix::process::{Pid, Signal, kill_process_group};

fn nodes() -> [NodeId; 2] {
    ["left", "right"].map(|name| name.parse().unwrap())
}

/// A process of this machine, with its process group.
struct Group(Child);

impl Group {
    fn signal(&self, signal: Signal) {
        let leader = Pid::from_child(&self.0);
        // It fails once the group is empty.
        let _ = kill_process_group(leader, signal);
    }
}

impl Process for Group {
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        let ended = self.0.try_wait()?;
        if ended.is_some() {
            self.signal(Signal::KILL);
        }
        Ok(ended)
    }

    fn terminate(&mut self) {
        self.signal(Signal::TERM);
    }

    fn kill(&mut self) {
        self.signal(Signal::KILL);
        self.0.wait().unwrap();
    }

    fn stdout(&mut self) -> Option<ChildStdout> {
        self.0.stdout.take()
    }

    fn id(&self) -> Option<u32> {
        Some(self.0.id())
    }
}

/// Starts processes on this machine, for any node.
struct Here {
    wakes: mpsc::Sender<()>,
}

impl Launcher for Here {
    fn launch(
        &self,
        _vnf: &Vnf,
        _replica: u32,
        _node: &NodeId,
        mut command: Command,
        cgroup_procs: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>> {
        let program = command.get_program().to_string_lossy().into_owned();
        let child = command.process_group(0).spawn();
        let child = child.map_err(|error| io::Error::other(format!("{program}: {error}")))?;
        for procs in cgroup_procs {
            // It may have ended.
            let _ = fs::write(procs, child.id().to_string());
        }
        Ok(Box::new(Group(child)))
    }

    fn command(&self, vnf: &Vnf, _replica: u32, _node: &NodeId) -> Result<Command, String> {
        match &vnf.program {
            Program::Command(words) => program_of(words, &vnf.env),
            _ => {
                let mut command = program_of_others("sh", &[]);
                command.args(["-c", "exit 3"]);
                Ok(command)
            }
        }
    }

    fn wake(&self) {
        let _ = self.wakes.send(());
    }
}

struct Processes {
    launcher: Arc<Here>,
    wakes: mpsc::Receiver<()>,
    logs: tempfile::TempDir,
}

impl Subject for Processes {
    type Engine = ProcessEngine<Here>;

    fn engine(&self) -> Self::Engine {
        ProcessEngine::new(Arc::clone(&self.launcher), self.logs.path().to_owned(), Cgroups::new().ok())
    }

    fn wait(&self) {
        self.wakes.recv().unwrap();
    }

    fn nodes(&self) -> [NodeId; 2] {
        nodes()
    }

    fn image(&self) -> Option<Image> {
        None
    }

    fn log(&self, name: &str) -> String {
        fs::read_to_string(self.logs.path().join(format!("{name}.log"))).unwrap_or_default()
    }

    fn fill_disk(&self, log: &str) -> bool {
        symlink("/dev/full", self.logs.path().join(format!("{log}.log"))).is_ok()
    }

    fn ends_before_ready(&self, id: VnfId) -> Option<Vnf> {
        let [node, _] = nodes();
        Some(Vnf { id, node: node.into(), ..base::vnf("vnf", "server") })
    }

    fn omitted(&self) -> Vec<(Promise, String)> {
        let daemons = "a process group does not hold them; the namespaces of a datapath do".to_owned();
        let limits = Cgroups::new().err().map(|error| (Promise::MemoryLimit, error.to_string()));
        limits.into_iter().chain([(Promise::Daemons, daemons)]).collect()
    }
}

#[test]
fn processes_keep_the_contract() {
    let (sender, wakes) = mpsc::channel();
    let launcher = Arc::new(Here { wakes: sender });
    contract::check(&Processes { launcher, wakes, logs: tempfile::tempdir().unwrap() });
}

struct InMemory;

impl Subject for InMemory {
    type Engine = InMemoryEngine;

    fn engine(&self) -> Self::Engine {
        InMemoryEngine::default()
    }

    fn wait(&self) {
        panic!("an engine in memory reports events at once");
    }

    fn nodes(&self) -> [NodeId; 2] {
        nodes()
    }

    fn image(&self) -> Option<Image> {
        None
    }

    fn log(&self, _name: &str) -> String {
        String::new()
    }

    fn running(&self, engine: &InMemoryEngine, _mark: Mark) -> usize {
        engine.running().count()
    }

    fn omitted(&self) -> Vec<(Promise, String)> {
        use Promise::{
            Children, Daemons, Ends, EndsBeforeReady, Environment, FullDisk, Log, MemoryLimit, Missing,
        };
        let runs_nothing =
            [Ends, EndsBeforeReady, Children, Daemons, Log, Environment, MemoryLimit, FullDisk];
        let runs_nothing = runs_nothing.map(|promise| (promise, "it runs nothing"));
        let others = [(Missing, "a start fails only on nodes that a test chooses")];
        let all = runs_nothing.into_iter().chain(others);
        all.map(|(promise, reason)| (promise, reason.to_owned())).collect()
    }
}

#[test]
fn an_engine_in_memory_keeps_the_contract() {
    contract::check(&InMemory);
}

/// A mistake of an engine.
#[derive(Clone, Copy)]
enum Mistake {
    ReadyTwice,
    GoesOnAfterShutDown,
    OneInstancePerVnf,
}

/// An engine in memory that makes a mistake.
struct Wrong {
    inner: InMemoryEngine,
    mistake: Mistake,
    repeated: Vec<EngineEvent>,
}

impl Engine for Wrong {
    fn start(&mut self, id: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        if let Mistake::OneInstancePerVnf = self.mistake {
            let others: Vec<_> = self.inner.running().map(|(id, ..)| id).collect();
            others.into_iter().for_each(|other| self.inner.kill(other, "replaced"));
        }
        self.inner.start(id, vnf, replica, node)
    }

    fn stop(&mut self, id: InstanceId) {
        self.inner.stop(id);
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        if let Some(again) = self.repeated.pop() {
            return Some(again);
        }
        let event = self.inner.poll();
        if let Mistake::ReadyTwice = self.mistake {
            self.repeated.extend(event.clone());
        }
        event
    }

    fn shut_down(&mut self) {
        if !matches!(self.mistake, Mistake::GoesOnAfterShutDown) {
            self.inner.shut_down();
        }
    }
}

impl Subject for Mistake {
    type Engine = Wrong;

    fn engine(&self) -> Wrong {
        Wrong { inner: InMemoryEngine::default(), mistake: *self, repeated: Vec::new() }
    }

    fn wait(&self) {
        InMemory.wait();
    }

    fn nodes(&self) -> [NodeId; 2] {
        nodes()
    }

    fn image(&self) -> Option<Image> {
        None
    }

    fn log(&self, name: &str) -> String {
        InMemory.log(name)
    }

    fn running(&self, engine: &Wrong, mark: Mark) -> usize {
        InMemory.running(&engine.inner, mark)
    }

    fn omitted(&self) -> Vec<(Promise, String)> {
        InMemory.omitted()
    }
}

#[test]
#[should_panic(expected = "Ready of InstanceId(1) after [Ready]")]
fn a_second_ready_is_found() {
    Promise::Starts.check(&Mistake::ReadyTwice);
}

#[test]
#[should_panic(expected = "instances run after `shut_down`")]
fn instances_that_outlive_their_engine_are_found() {
    Promise::ShutsDown.check(&Mistake::GoesOnAfterShutDown);
}

#[test]
#[should_panic(expected = "instance 1 ended without a stop: [Ready, Died(\"replaced\")]")]
fn a_migration_with_a_gap_is_found() {
    // The old instance ends before the new one is ready.
    Promise::Migration.check(&Mistake::OneInstancePerVnf);
}
