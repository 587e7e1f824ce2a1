//! `cotorra selftest`: runs testbeds whose right answers are known, and compares.
//!
//! Each scene is a run of this program, as a user would start it. Its files and its exit status are compared with closed forms.

mod check;
mod observed;
mod peer;
mod scene;
mod scenes;

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{Child, Command, ExitCode, ExitStatus, Stdio},
    time::Duration,
};

use clap::Args;
use console::style;
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    approval::TRUST_VARIABLE,
    exit::Status,
    output,
    progress::Progress,
    signals,
    table::{Table, columns, wrap},
    temporary::TemporaryFolder,
    words::count,
};
use check::Check;
use observed::{Observed, World};
use scene::{Dies, Scene};

/// Number of tries of a run with real packets, if the machine was too slow for it.
const ATTEMPTS: usize = 3;
/// Number of runs at the same time. They wait for packets most of the time.
const TOGETHER: usize = 2;
/// Duration of a stop, and of the run before it.
const STOPPED: Duration = Duration::from_secs(2);

/// Run small testbeds whose right answers are known, and compare
///
/// Each scene is run in virtual time and with real packets, by this program, as `cotorra run` does it. Its figures are compared
/// with closed forms: sums of delays, binomial intervals, queues, traces, phases of handovers. So you know whether to trust this
/// program on this machine. Two runs go on at the same time. With real packets it takes about two minutes.
///
/// Random figures are right within four standard deviations. Times of real packets may be as late as a valid run can be. A run
/// that says itself that it is not valid is made again by itself, three times at most; after that, the machine is too slow or too
/// busy, and the scene is neither right nor wrong.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra selftest
  cotorra selftest --simulate               only in virtual time, in seconds
  cotorra selftest loss bursts corruption   only these scenes
  cotorra selftest --list
  cotorra selftest --keep /tmp/selftest     keep the folders of all runs

Exit status: 0 all is right, 1 something is wrong, 2 wrong usage, 3 nothing is wrong, but the machine was too slow for some scenes.")]
pub struct SelftestArgs {
    /// The scenes; default: all
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// List the scenes
    #[arg(long, conflicts_with = "names")]
    pub list: bool,
    /// Run them in virtual time only
    #[arg(long)]
    pub simulate: bool,
    /// Keep testbed files and folders of runs in this new folder
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Write plain lines instead of the live view
    #[arg(long)]
    pub headless: bool,
    /// Be this host of the scene `mesh`, whose hosts are the names
    #[arg(long, value_name = "HOST", hide = true, requires = "names")]
    pub peer: Option<String>,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error("there is no scene `{name}`")]
    #[diagnostic(help("`cotorra selftest --list` lists them"))]
    Unknown { name: String },
    #[error("cannot start this program again: {0}")]
    Program(io::Error),
    #[error("cannot write {}: {source}", path.display())]
    #[diagnostic(help("--keep takes a folder that does not exist yet"))]
    Folder { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Temporary(#[from] cotorra_testbed::FolderError),
    #[error("cannot talk to the other hosts: {0}")]
    Peer(io::Error),
    #[error("stopped")]
    Stopped,
}

/// Outcome of a scene in one kind of time.
#[derive(Debug)]
enum Outcome {
    /// Its figures, which may be wrong.
    Compared(Vec<Check>),
    /// The machine was too slow, as the run says.
    TooSlow(String),
    /// The run left nothing to compare.
    Failed(String),
}

impl Outcome {
    fn is_wrong(&self) -> bool {
        match self {
            Self::Compared(checks) => !checks.iter().all(Check::holds),
            Self::Failed(_) => true,
            Self::TooSlow(_) => false,
        }
    }
}

/// Runs the scenes, and prints a table.
pub fn selftest(args: &SelftestArgs) -> miette::Result<ExitCode> {
    if let Some(own) = &args.peer {
        peer::peer(own, &args.names).map_err(Error::Peer)?;
        return Ok(ExitCode::SUCCESS);
    }
    let path = env::current_exe().map_err(Error::Program)?;
    let scenes = choose(scenes::scenes(&path), &args.names)?;
    if args.list {
        let mut table = Table::new("<<");
        scenes.iter().for_each(|scene| table.row([scene.name, scene.promise]));
        output::print(&table.render(""))?;
        return Ok(ExitCode::SUCCESS);
    }
    let worlds: &[World] = if args.simulate { &[World::Virtual] } else { &[World::Virtual, World::Real] };
    let temporary;
    let folder = match &args.keep {
        Some(folder) => {
            fs::create_dir_all(folder.parent().unwrap_or(Path::new("")))
                .and_then(|()| fs::create_dir(folder))
                .map_err(|source| Error::Folder { path: folder.clone(), source })?;
            folder
        }
        None => {
            temporary = TemporaryFolder::new().map_err(Error::from)?;
            temporary.path()
        }
    };
    let program = Program { path, folder: folder.to_owned(), interrupts: signals::listen()? };
    let planned: Vec<_> = worlds
        .iter()
        .flat_map(|world| scenes.iter().map(move |scene| (scene, *world)))
        .filter(|(scene, world)| *world == World::Real || scene.virtual_seconds.is_some())
        .collect();
    let mut progress = Progress::new(args.headless);
    let mut outcomes = Vec::new();
    let mut repeated = 0;
    for group in groups(&planned) {
        progress.show(outcomes.len(), planned.len());
        for (&(scene, world), (outcome, attempts)) in group.iter().zip(program.outcomes(group)?) {
            repeated += attempts - 1;
            outcomes.push((scene, world, outcome));
        }
    }
    progress.close();
    output::print(&describe(&scenes, &outcomes, repeated))?;
    let is_any = |of: fn(&Outcome) -> bool| outcomes.iter().any(|(.., outcome)| of(outcome));
    let status = if is_any(Outcome::is_wrong) {
        Status::Error
    } else if is_any(|outcome| matches!(outcome, Outcome::TooSlow(_))) {
        Status::NotValid
    } else {
        Status::Done
    };
    Ok(status.into())
}

fn choose(all: Vec<Scene>, names: &[String]) -> Result<Vec<Scene>, Error> {
    if let Some(name) = names.iter().find(|name| all.iter().all(|scene| scene.name != *name)) {
        return Err(Error::Unknown { name: name.clone() });
    }
    Ok(all
        .into_iter()
        .filter(|scene| names.is_empty() || names.iter().any(|name| scene.name == name))
        .collect())
}

/// Divides runs into those that are made at the same time.
fn groups<'a, 'b>(planned: &'a [(&'b Scene, World)]) -> impl Iterator<Item = &'a [(&'b Scene, World)]> {
    planned
        .chunk_by(|a, b| a.1 == b.1 && !a.0.is_alone() && !b.0.is_alone())
        .flat_map(|of| of.chunks(TOGETHER))
}

/// This program, and where its runs leave their folders.
struct Program {
    path: PathBuf,
    folder: PathBuf,
    interrupts: std::sync::mpsc::Receiver<()>,
}

impl Program {
    /// Runs scenes at the same time, and one again by itself if the machine was too slow. Returns how often each ran, too.
    fn outcomes(&self, group: &[(&Scene, World)]) -> Result<Vec<(Outcome, usize)>, Error> {
        let started = group.iter().map(|(scene, world)| self.start(scene, *world, 1));
        let started = started.collect::<Result<Vec<_>, _>>()?;
        let first =
            started.into_iter().map(|running| self.outcome(running)).collect::<Result<Vec<_>, _>>()?;
        let again = group.iter().zip(first).map(|(&(scene, world), mut outcome)| {
            let (mut attempt, most) = (1, if world == World::Real { ATTEMPTS } else { 1 });
            while matches!(outcome, Outcome::TooSlow(_)) && attempt < most {
                attempt += 1;
                outcome = self.outcome(self.start(scene, world, attempt)?)?;
            }
            Ok((outcome, attempt))
        });
        again.collect()
    }

    fn start<'a>(&self, scene: &'a Scene, world: World, attempt: usize) -> Result<Running<'a>, Error> {
        let name = match world {
            World::Virtual => format!("{}-virtual", scene.name),
            World::Real => format!("{}-real-{attempt}", scene.name),
        };
        let folder = self.folder.join(name);
        let cannot = |source| Error::Folder { path: folder.clone(), source };
        fs::create_dir(&folder).map_err(cannot)?;
        let file = scene.write(&folder).map_err(cannot)?;
        let log = fs::File::create(folder.join("output.txt")).map_err(cannot)?;
        let virtual_seconds = scene.virtual_seconds.filter(|_| world == World::Virtual);
        let seconds = virtual_seconds.unwrap_or(scene.seconds);
        let mut command = Command::new(&self.path);
        command.args([
            "run",
            "--headless",
            "--api",
            "127.0.0.1:0",
            "--until",
            &format!("{seconds}s"),
            "--out",
        ]);
        command.arg(folder.join("runs")).arg(&file).env_remove(crate::history::HISTORY_VARIABLE);
        // The scenes are this program's own.
        command.env(TRUST_VARIABLE, "1");
        if world == World::Virtual {
            command.arg("--simulate");
        }
        let errors = log.try_clone().map_err(cannot)?;
        let child =
            command.stdin(Stdio::null()).stdout(log).stderr(errors).spawn().map_err(Error::Program)?;
        Ok(Running { scene, world, folder, child })
    }

    fn outcome(&self, mut running: Running<'_>) -> Result<Outcome, Error> {
        let status = self.wait(&mut running)?;
        let Running { scene, world, folder, .. } = &running;
        let output = || fs::read_to_string(folder.join("output.txt")).unwrap_or_default();
        let Some(run) = run_folder(&folder.join("runs")) else {
            return Ok(Outcome::Failed(output().trim().to_owned()));
        };
        let observed = match Observed::read(*world, status.code(), &run) {
            Ok(observed) => observed,
            Err(error) => return Ok(Outcome::Failed(format!("{error}\n{}", output().trim()))),
        };
        if let (Dies::Not | Dies::Missed, Some(fidelity)) = (scene.dies, &observed.report.fidelity)
            && !fidelity.valid
        {
            return Ok(Outcome::TooSlow(fidelity.reason.clone()));
        }
        Ok(Outcome::Compared((scene.check)(&observed)))
    }

    /// Waits for the end of a run, and stops its process meanwhile if the scene wants that.
    fn wait(&self, running: &mut Running<'_>) -> Result<ExitStatus, Error> {
        if running.scene.dies == Dies::Stopped {
            let id = Pid::from_child(&running.child);
            self.pause(STOPPED)?;
            let signal = |signal| kill_process(id, signal).map_err(|error| Error::Program(error.into()));
            signal(Signal::STOP)?;
            let paused = self.pause(STOPPED);
            signal(Signal::CONT)?;
            paused?;
        }
        loop {
            if let Some(status) = running.child.try_wait().map_err(Error::Program)? {
                return Ok(status);
            }
            self.pause(Duration::from_millis(20))?;
        }
    }

    /// Waits, unless a user stops it.
    fn pause(&self, time: Duration) -> Result<(), Error> {
        match self.interrupts.recv_timeout(time) {
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => Ok(()),
            _ => Err(Error::Stopped),
        }
    }
}

/// A run of a scene, which is ended on drop.
struct Running<'a> {
    scene: &'a Scene,
    world: World,
    folder: PathBuf,
    child: Child,
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        // A run that a user stops got the same signal, if that came from a terminal.
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
            let _ = self.child.wait();
        }
    }
}

/// Returns the only folder in a folder of runs.
fn run_folder(runs: &Path) -> Option<PathBuf> {
    fs::read_dir(runs).ok()?.filter_map(|entry| Some(entry.ok()?.path())).find(|path| path.is_dir())
}

/// Returns a table of all figures, and a sentence.
fn describe(scenes: &[Scene], outcomes: &[(&Scene, World, Outcome)], repeated: usize) -> String {
    let mut table = Table::new("<<>>>");
    table.row(["scene", "figure", "right", "virtual time", "real packets"]);
    let mut text = String::new();
    for scene in scenes {
        let of = |world| {
            outcomes
                .iter()
                .find(|(its, at, _)| its.name == scene.name && *at == world)
                .map(|(.., outcome)| outcome)
        };
        let worlds = [of(World::Virtual), of(World::Real)];
        let compared = |outcome: Option<&Outcome>| match outcome {
            Some(Outcome::Compared(checks)) => checks.clone(),
            _ => Vec::new(),
        };
        let checks = worlds.map(compared);
        let rows = checks.iter().max_by_key(|checks| checks.len()).cloned().unwrap_or_default();
        for (place, row) in rows.iter().enumerate() {
            let cell = |world: usize| match (worlds[world], checks[world].get(place)) {
                (None, _) => "-".to_owned(),
                (_, Some(check)) => cell(check),
                (_, None) => "?".to_owned(),
            };
            let name = if place == 0 { scene.name } else { "" };
            table.row([name.to_owned(), row.figure.to_owned(), figure(row.expected), cell(0), cell(1)]);
        }
        for (world, outcome) in ["in virtual time", "with real packets"].iter().zip(worlds) {
            match outcome {
                Some(Outcome::TooSlow(reason)) => {
                    text += &wrap(
                        &format!("{} {world}: the machine was too slow: {reason}", scene.name),
                        "  ",
                        columns(),
                    );
                }
                Some(Outcome::Failed(reason)) => text += &format!("  {} {world}: {reason}\n", scene.name),
                _ => {}
            }
        }
        for (world, checks) in ["in virtual time", "with real packets"].iter().zip(&checks) {
            for check in checks.iter().filter(|check| !check.holds()) {
                let (low, high) = check.within;
                let measured = check.measured.map_or("missing".to_owned(), figure);
                text += &wrap(
                    &format!(
                        "{} {world}: {} is {measured}, right is {} to {}: {}",
                        scene.name,
                        check.figure,
                        figure(low),
                        figure(high),
                        scene.promise
                    ),
                    "  ",
                    columns(),
                );
            }
        }
    }
    let count_of = |of: fn(&Outcome) -> bool| outcomes.iter().filter(|(.., outcome)| of(outcome)).count();
    let wrong = count_of(Outcome::is_wrong);
    let slow = count_of(|outcome| matches!(outcome, Outcome::TooSlow(_)));
    let mut sentence = format!("{} of {}", outcomes.len() - wrong - slow, count(outcomes.len(), "run"));
    sentence += " right";
    if wrong > 0 {
        sentence += &format!(", {} WRONG", style(wrong).red());
    }
    if slow > 0 {
        sentence += &format!(", {slow} not judged, because the machine was too slow or too busy");
    }
    if repeated > 0 {
        sentence += &format!("; {} repeated", count(repeated, "run"));
    }
    let gap = if text.is_empty() { "" } else { "\n" };
    format!("{}{gap}{text}\n{sentence}\n", table.render(""))
}

/// Formats a figure and whether it is right.
fn cell(check: &Check) -> String {
    let measured = check.measured.map_or("missing".to_owned(), figure);
    if check.holds() { measured } else { format!("{measured} {}", style("WRONG").red()) }
}

/// Formats a figure with three digits, or fewer for whole ones.
fn figure(value: f64) -> String {
    if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.3}") }
}
