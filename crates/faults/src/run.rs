//! One run: a random testbed, a random plan, and a check of all invariants after each step.

use std::{
    collections::BTreeMap,
    env, fs, io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    process,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use cotorra_graph::{PluginId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{Error as HistoryError, History, PacedRecorder, RunId, RunInfo};
use cotorra_testbed::{Given, Mood, Simulation, panic_text};

use super::{
    error::FaultTestError,
    generator::{self, Generated, MAP_PGM, MAP_YAML},
    invariants::{Broken, Invariant, OURS, View, Watch, kept},
    plan::{Fault, Plan},
    saboteur::{Deeds, Misbehaving},
};

/// Number of events in each write to the history.
const BATCH: usize = 500;
/// File name of a history.
const HISTORY: &str = "history.sqlite";

/// The result of a run.
pub(crate) struct Outcome {
    pub(crate) generated: Generated,
    pub(crate) plan: Plan,
    /// All events.
    pub(crate) events: Vec<Stamped>,
    pub(crate) injected: BTreeMap<&'static str, u64>,
    pub(crate) watch: Watch,
    pub(crate) broken: Option<(Timestamp, Broken)>,
}

/// Runs a seed.
pub(crate) fn run(seed: u64) -> Result<Outcome, FaultTestError> {
    let generated = generator::testbed(seed);
    let scratch = Scratch::new()?;
    write_map(&generated, &scratch.0).map_err(|e| FaultTestError::folder(&scratch.0, e))?;
    let testbed = cotorra_testbed_file::parse("testbed.yaml", &generated.text, &scratch.0);
    let testbed = Arc::new(testbed.map_err(|e| FaultTestError::Testbed { seed, reason: e.to_string() })?);
    let plan = Plan::new(seed, &testbed);
    let mut run = Run::new(seed, testbed, &plan, &scratch.0)?;
    let ran = catch_unwind(AssertUnwindSafe(|| run.go(&plan)));
    run.watch.checked[Invariant::Stands as usize].note(true);
    let broken = match ran {
        Ok(ran) => ran.err(),
        Err(panic) => Some(Broken(Invariant::Stands, panic_text(&*panic).to_owned())),
    };
    let broken = broken.map(|broken| (run.now, broken));
    let Run { events, injected, watch, .. } = run;
    Ok(Outcome { generated, plan, events, injected, watch, broken })
}

impl Outcome {
    /// Writes testbed, plan and history of the run. Returns the folder.
    pub(crate) fn keep(&self, seed: u64, folder: &Path) -> Result<PathBuf, FaultTestError> {
        let folder = folder.join(format!("seed-{seed}"));
        let write = || {
            fs::create_dir_all(&folder)?;
            write_map(&self.generated, &folder)?;
            fs::write(folder.join("testbed.yaml"), &self.generated.text)?;
            fs::write(folder.join("plan.txt"), self.plan.to_string())
        };
        write().map_err(|e| FaultTestError::folder(&folder, e))?;
        let history = History::open(folder.join(HISTORY))?;
        let run = history.begin_run(&info(seed, &self.generated.text))?;
        let recorder = history.paced_recorder(run)?;
        self.events.iter().cloned().for_each(|stamped| recorder.record(stamped));
        recorder.flush()?;
        history.end_run(run, self.events.last().map_or(Timestamp::ZERO, |last| last.at))?;
        Ok(folder)
    }
}

fn info(seed: u64, text: &str) -> RunInfo {
    RunInfo { name: format!("faults-{seed}"), seed, started_at_unix_ns: 0, testbed: text.to_owned() }
}

/// A run in progress.
struct Run<'a> {
    testbed: Arc<Testbed>,
    simulation: Simulation,
    watch: Watch,
    deeds: Vec<(PluginId, Deeds)>,
    history: History,
    run: RunId,
    recorder: PacedRecorder,
    folder: &'a Path,
    is_full: bool,
    events: Vec<Stamped>,
    /// Number of events that the history has acknowledged.
    acknowledged: usize,
    injected: BTreeMap<&'static str, u64>,
    given: usize,
    now: Timestamp,
}

impl<'a> Run<'a> {
    fn new(seed: u64, testbed: Arc<Testbed>, plan: &Plan, folder: &'a Path) -> Result<Self, FaultTestError> {
        let mut simulation = Simulation::new(Arc::clone(&testbed), seed)
            .map_err(|e| FaultTestError::Testbed { seed, reason: e.to_string() })?;
        simulation.tap_answers();
        let mut deeds = Vec::new();
        for (at, fault) in &plan.faults {
            let Fault::Sabotage(saboteur) = fault else { continue };
            let does = Deeds::default();
            deeds.push((saboteur.id.clone(), does.clone()));
            let plugin = Misbehaving::new(saboteur.clone(), *at, does);
            simulation = simulation.with_plugin(saboteur.id.clone(), Box::new(plugin), &testbed);
        }
        let history = if plan.on_disk { History::open(folder.join(HISTORY)) } else { History::in_memory() }?;
        let run = history.begin_run(&info(seed, ""))?;
        let recorder = history.paced_recorder(run)?;
        Ok(Self {
            watch: Watch::new(&testbed),
            testbed,
            simulation,
            deeds,
            history,
            run,
            recorder,
            folder,
            is_full: false,
            events: Vec::new(),
            acknowledged: 0,
            injected: BTreeMap::new(),
            given: 0,
            now: Timestamp::ZERO,
        })
    }

    fn go(&mut self, plan: &Plan) -> Result<(), Broken> {
        let mut faults = plan.faults.iter().peekable();
        while self.now < plan.until {
            let next = faults.peek().map_or(plan.until, |(at, _)| *at);
            self.simulation.set_alarm(Some(next.min(plan.until)));
            self.advance(true)?;
            self.check()?;
            while let Some((_, fault)) = faults.next_if(|(at, _)| *at <= self.now) {
                *self.injected.entry(fault.kind()).or_default() += 1;
                self.inject(fault)?;
                self.advance(false)?;
            }
            if self.events.len() - self.acknowledged >= BATCH {
                self.flush()?;
            }
        }
        for (plugin, deeds) in &self.deeds {
            self.watch.decided.all_of(plugin, deeds.given())?;
        }
        self.crash(plan.on_disk)
    }

    /// Makes a step, or only lets plug-ins react. A call that simulates a hang counts as hung.
    fn advance(&mut self, is_step: bool) -> Result<(), Broken> {
        let deeds = &self.deeds;
        let hangs = || deeds.iter().any(|(_, deeds)| deeds.take_hang());
        if is_step {
            self.simulation.step_with(hangs);
        } else {
            self.simulation.settle_with(hangs);
        }
        self.now = self.simulation.now();
        while let Some(stamped) = self.simulation.poll_event() {
            let seen = self.watch.event(&stamped);
            self.recorder.record(stamped.clone());
            self.events.push(stamped);
            seen?;
        }
        Ok(())
    }

    fn check(&mut self) -> Result<(), Broken> {
        self.watch.state(&View {
            now: self.now,
            graph: &self.testbed.graph,
            managed: self.simulation.managed().collect(),
            running: self.simulation.serving().running(),
            packets: self.simulation.packets(),
            reserved: self.simulation.reserved(),
        })
    }

    fn inject(&mut self, fault: &Fault) -> Result<(), Broken> {
        let simulation = &mut self.simulation;
        match fault {
            Fault::Instruct { instruction, .. } => {
                let (who, number) = (PluginId::new(OURS).expect("a valid name"), self.given);
                self.given += 1;
                let told = simulation.instruct(Given {
                    plugin: who.clone(),
                    instruction: instruction.clone(),
                    reason: Some(number.to_string()),
                });
                self.watch.decided.given(&who, number, told.err().map(|refused| refused.0));
            }
            Fault::Kill(vnf) => simulation.serving().kill(vnf),
            Fault::Hang(vnf) => simulation.serving().set_mood(vnf, Mood::Hung),
            Fault::Slow(vnf, later) => simulation.serving().set_mood(vnf, Mood::Slow(*later)),
            Fault::Recover(vnf) => simulation.serving().set_mood(vnf, Mood::Prompt),
            Fault::HoldStarts => simulation.serving().hold_starts(true),
            Fault::ReleaseStarts => simulation.serving().hold_starts(false),
            Fault::Silence(robot) => simulation.set_silent(robot, true),
            Fault::Hear(robot) => simulation.set_silent(robot, false),
            Fault::Replay(robot) => simulation.answer_again(robot, None),
            Fault::Forge(robot, byte) => simulation.answer_again(robot, Some(*byte)),
            Fault::FillDisk | Fault::FreeDisk => {
                self.is_full = *fault == Fault::FillDisk;
                self.history.set_full(self.is_full).map_err(|e| lost(&e))?;
                // A disk may be full for a moment only.
                self.flush()?;
            }
            Fault::Reorganise(depth) => simulation.reorganise_ledger(*depth),
            // The plug-in's own deadline triggers it.
            Fault::Sabotage(_) => {}
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Broken> {
        match self.recorder.flush() {
            Ok(()) => self.acknowledged = self.events.len(),
            Err(HistoryError::Full { .. }) if self.is_full => {}
            Err(error) => return Err(lost(&error)),
        }
        Ok(())
    }

    /// Reads the history as `kill -9` leaves it. It must hold everything that it acknowledged.
    fn crash(&mut self, on_disk: bool) -> Result<(), Broken> {
        let found = if on_disk {
            let copy = self.folder.join("crashed");
            self.copy_history(&copy).map_err(|e| lost(&e))?;
            History::open(copy.join(HISTORY)).and_then(|history| history.all_events(self.run, &[]))
        } else {
            self.history.all_events(self.run, &[])
        };
        let checked = &mut self.watch.checked[Invariant::Kept as usize];
        kept(&self.events[..self.acknowledged], &found.map_err(|e| lost(&e))?, checked)
    }

    /// Copies the history's files while it is open.
    fn copy_history(&self, to: &Path) -> io::Result<()> {
        fs::create_dir(to)?;
        for ending in ["", "-wal"] {
            let name = format!("{HISTORY}{ending}");
            let from = self.folder.join(&name);
            if from.exists() {
                fs::copy(from, to.join(name))?;
            }
        }
        Ok(())
    }
}

fn lost(error: &dyn std::fmt::Display) -> Broken {
    Broken(Invariant::Kept, format!("the history fails: {error}"))
}

/// Writes the map of a testbed, if it has one.
fn write_map(generated: &Generated, folder: &Path) -> io::Result<()> {
    let Some(map) = &generated.map else { return Ok(()) };
    fs::write(folder.join(MAP_YAML), &map.yaml)?;
    fs::write(folder.join(MAP_PGM), &map.pgm)
}

/// A folder that is removed on drop.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self, FaultTestError> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        loop {
            let number = NEXT.fetch_add(1, Ordering::Relaxed);
            let folder = env::temp_dir().join(format!("cotorra-fault-test-{}-{number}", process::id()));
            match fs::create_dir(&folder) {
                Ok(()) => return Ok(Self(folder)),
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
                Err(e) => return Err(FaultTestError::folder(&folder, e)),
            }
        }
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A folder that stays does no harm.
        let _ = fs::remove_dir_all(&self.0);
    }
}
