//! Their side: finds or installs ns-3, compiles the program against it once, and runs scenarios.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use cotorra_numbers::Quantiles;
use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::{
    Carried, Measured, Ours, Run, Scenario,
    scenario::{Load, Traffic},
};

/// The wheel of ns-3, as pip names it.
pub const WHEEL: &str = "ns3==3.44.post0";
/// The program.
const SOURCE: &str = include_str!("../ns3/scenario.cc");
/// Libraries of ns-3 that it uses.
const LIBRARIES: [&str; 11] = [
    "core",
    "network",
    "internet",
    "mobility",
    "wifi",
    "point-to-point",
    "traffic-control",
    "propagation",
    "antenna",
    "spectrum",
    "stats",
];
/// Lines of a compiler's errors that are shown.
const LINES: usize = 12;

/// The compiled program.
#[derive(Debug, Clone)]
pub struct Ns3 {
    program: PathBuf,
}

/// The reason for which ns-3 cannot be had, or did not run.
#[derive(Debug, thiserror::Error)]
pub enum Ns3Error {
    /// A program could not be started.
    #[error("cannot start {program}: {reason}")]
    Missing {
        /// Its name.
        program: String,
        /// The system's error.
        reason: io::Error,
    },
    /// A program failed.
    #[error("{what} failed:\n{output}")]
    Failed {
        /// What it was to do.
        what: String,
        /// The end of what it printed.
        output: String,
    },
    /// A file or folder cannot be written or read.
    #[error("{path}: {reason}", path = path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        reason: io::Error,
    },
    /// An environment that holds no ns-3.
    #[error("{path} holds no ns-3: expected a Python environment with the package `{WHEEL}`", path = .0.display())]
    NoNs3(PathBuf),
    /// An output that is no result.
    #[error("ns-3 printed what is no result: {0}")]
    Unreadable(#[from] serde_json::Error),
}

impl Ns3 {
    /// Finds ns-3 in a Python environment, or installs it into `cache`, and compiles the program unless that was done before.
    /// `say` gets a line before what takes long.
    ///
    /// # Errors
    /// [`Ns3Error`].
    pub fn prepare(
        environment: Option<&Path>,
        cache: &Path,
        mut say: impl FnMut(&str),
    ) -> Result<Self, Ns3Error> {
        let own = cache.join("ns3");
        let environment = match environment {
            Some(environment) => environment.to_owned(),
            None => {
                if package(&own).is_none() {
                    say("installing ns-3 (400 MB) with pip");
                    install(&own)?;
                }
                own
            }
        };
        let package = package(&environment).ok_or_else(|| Ns3Error::NoNs3(environment.clone()))?;
        let mut hash = Sha256::new();
        [SOURCE, WHEEL].iter().for_each(|part| hash.update(part));
        hash.update(package.as_os_str().as_encoded_bytes());
        let key: String = hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        let program = cache.join(format!("ns3-scenario-{key}"));
        if !program.exists() {
            say("compiling the scenario program of ns-3 (half a minute)");
            compile(&package, cache, &program)?;
        }
        Ok(Self { program })
    }

    /// Runs a scenario with a seed, in a folder that it writes `scenario-SEED.json` into.
    ///
    /// # Errors
    /// [`Ns3Error`].
    pub fn run(&self, ours: &Ours, seed: u64, folder: &Path) -> Result<Run, Ns3Error> {
        let path = folder.join(format!("scenario-{seed}.json"));
        fs::write(&path, serde_json::to_vec(&ours.scenario)?)
            .map_err(|reason| Ns3Error::File { path: path.clone(), reason })?;
        let mut command = Command::new(&self.program);
        let output = run(command.arg(&path).arg(seed.to_string()), "the scenario in ns-3")?;
        let printed: Printed = serde_json::from_slice(&output.stdout)?;
        Ok(printed.measured(&ours.scenario))
    }
}

/// What the program prints.
#[derive(Deserialize)]
struct Printed {
    senders: Vec<PrintedSender>,
    robots: Vec<PrintedRobot>,
    traffic: Vec<PrintedTraffic>,
}

#[derive(Deserialize)]
struct PrintedTraffic {
    sent: u64,
    bytes: u64,
    last_s: f64,
    took_s: Vec<f64>,
}

impl PrintedTraffic {
    fn measured(self, traffic: &Traffic) -> Carried {
        let seconds = match traffic.load {
            Load::Tcp { bytes: Some(all), .. } if self.bytes == all => self.last_s - traffic.start_s,
            _ => traffic.seconds(),
        };
        let arrived = self.took_s.len() as f64;
        Carried {
            mbps: self.bytes as f64 * 8e-6 / seconds,
            lost: matches!(traffic.load, Load::Udp { .. })
                .then(|| 100.0 * (1.0 - arrived / (self.sent as f64).max(1.0))),
            delay_ms: Quantiles::of(self.took_s.iter().map(|took| took * 1e3).collect()),
        }
    }
}

#[derive(Deserialize)]
struct PrintedRobot {
    name: String,
    bytes: u64,
}

#[derive(Deserialize)]
struct PrintedSender {
    name: String,
    sent: u32,
    took_s: Vec<(u32, f64)>,
}

impl Printed {
    fn measured(self, scenario: &Scenario) -> Run {
        let mbps = |bytes: u64| bytes as f64 * 8e-6 / scenario.seconds();
        let senders = self.senders.into_iter().map(|printed| {
            let took_ms = printed.took_s.into_iter().map(|(number, took)| (number, took * 1e3)).collect();
            (printed.name, Measured { took_ms, sent: printed.sent })
        });
        let robots = self.robots.into_iter().map(|robot| (robot.name, mbps(robot.bytes)));
        let traffic = scenario.traffic.iter().zip(self.traffic);
        let traffic = traffic.map(|(source, printed)| (source.name.clone(), printed.measured(source)));
        Run { senders: senders.collect(), mbps: robots.collect(), traffic: traffic.collect() }
    }
}

/// Returns the folder of the package in a Python environment.
fn package(environment: &Path) -> Option<PathBuf> {
    let versions = fs::read_dir(environment.join("lib")).ok()?;
    let packages = versions.flatten().map(|version| version.path().join("site-packages/ns3"));
    packages.into_iter().find(|package| package.join("include/ns3/wifi-module.h").exists())
}

fn install(environment: &Path) -> Result<(), Ns3Error> {
    let mut python = Command::new("python3");
    run(python.args(["-m", "venv", "--clear"]).arg(environment), "python3 -m venv")?;
    let mut pip = Command::new(environment.join("bin/pip"));
    let pip = pip.args(["install", "--quiet", "--disable-pip-version-check", WHEEL]);
    run(pip, &format!("pip install {WHEEL}")).map(drop)
}

/// Compiles the program beside its place, and moves it there: another process may do the same.
fn compile(package: &Path, cache: &Path, program: &Path) -> Result<(), Ns3Error> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |reason| Ns3Error::File { path, reason }
    };
    fs::create_dir_all(cache).map_err(failed(cache))?;
    let folder = tempfile::tempdir_in(cache).map_err(failed(cache))?;
    let (source, made) = (folder.path().join("scenario.cc"), folder.path().join("scenario"));
    fs::write(&source, SOURCE).map_err(failed(&source))?;
    let libraries = package.join("lib64");
    let compiler = env::var_os("CXX").unwrap_or_else(|| "g++".into());
    let mut compile = Command::new(compiler);
    compile.args(["-std=c++23", "-O2"]).arg("-I").arg(package.join("include"));
    compile.arg(&source).arg("-o").arg(&made).arg("-L").arg(&libraries);
    compile.arg(format!("-Wl,-rpath,{}", libraries.display()));
    compile.args(LIBRARIES.map(|library| format!("-lns3.44-{library}")));
    run(&mut compile, "compiling against ns-3")?;
    fs::rename(&made, program).map_err(failed(program))
}

fn run(command: &mut Command, what: &str) -> Result<Output, Ns3Error> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.output().map_err(|reason| Ns3Error::Missing { program, reason })?;
    if output.status.success() {
        return Ok(output);
    }
    let printed = String::from_utf8_lossy(&output.stderr);
    let errors: Vec<_> = printed.lines().filter(|line| line.contains("error")).take(LINES).collect();
    let last: Vec<_> = printed.lines().rev().take(LINES).collect();
    let shown = if errors.is_empty() { last.into_iter().rev().collect() } else { errors };
    Err(Ns3Error::Failed { what: what.to_owned(), output: shown.join("\n") })
}
