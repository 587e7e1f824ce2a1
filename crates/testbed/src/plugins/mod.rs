//! The plug-ins of a testbed: how they are made and started, and what runs them so that none can harm the testbed. One that
//! panics, hangs, floods or dies is cut off and reported, and the testbed goes on.
//!
//! [`host::PluginHost`] decides; it is the same in real time, in virtual time and in a replay. [`running`] calls plug-ins
//! in real time. [`lockstep`] and [`apart`] do where time waits for them: those in process, and programs.

pub(crate) mod apart;
pub(crate) mod host;
pub(crate) mod lockstep;
pub(crate) mod running;

use std::{
    env,
    fs::File,
    io,
    path::Path,
    process::{Child, Stdio},
    sync::Arc,
    time::Duration,
};

use cotorra_federation::{Federation, LedgerChoice, Ledgers, Settings};
use cotorra_graph::{PluginId, PluginProgram, PluginSpec, Testbed, Timestamp};
use cotorra_network_control::program_of_others;
use cotorra_okpi::Okpi;
use cotorra_pace::Pace;
use cotorra_plugin::Plugin;
use cotorra_probing::Probing;

use self::host::Fault;
use crate::api::{Server, Token};

/// Where time waits for plug-ins, one that says nothing for longer counts as hung.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// The time now, wherever it comes from.
pub(crate) type Now = Arc<dyn Fn() -> Timestamp + Send + Sync>;

/// Why a plug-in cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum PluginError {
    /// No such plug-in is bundled.
    #[error("plug-in `{plugin}`: `{name}` is not bundled; bundled are: federation, okpi, pace, probing")]
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
            "pace" => Ok(Box::new(Pace::from_settings(&spec.settings).map_err(|e| settings(&e))?)),
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
pub fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message")
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

/// Looks whether a run could make the plug-ins. What only a run uses, a real ledger, is left alone.
pub(crate) fn rehearse(testbed: &Testbed) -> Result<(), PluginError> {
    check_programs(testbed)?;
    let mut maker = Bundled::new(testbed, testbed.seed, Ledgers::default());
    for spec in &testbed.plugins {
        let PluginProgram::Bundled(name) = &spec.program else { continue };
        if name == "federation" && has_real_ledger(spec) {
            let mut modelled = spec.clone();
            modelled.settings.remove("ledger");
            Bundled::new(testbed, testbed.seed, Ledgers::default()).make(&modelled, name)?;
        } else {
            maker.make(spec, name)?;
        }
    }
    Ok(())
}

/// Whether an orchestrator would reach for a ledger outside of this process. Wrong settings reach for nothing.
fn has_real_ledger(spec: &PluginSpec) -> bool {
    let is_real = |choice| !matches!(choice, LedgerChoice::Modelled { .. });
    cfg!(feature = "ethereum") && Settings::decode(&spec.settings).is_ok_and(|set| is_real(set.ledger))
}

/// The program of a plug-in, and its arguments.
fn program<'a>(spec: &PluginSpec, words: &'a [String]) -> Result<(&'a String, &'a [String]), PluginError> {
    words.split_first().ok_or_else(|| PluginError::Settings {
        plugin: spec.id.clone(),
        reason: "its command is empty".to_owned(),
    })
}

/// A plug-in that is a program, and runs; killed when this is dropped, or this process is killed.
struct Process(Child);

impl Process {
    /// Starts it.
    fn start(spec: &PluginSpec, words: &[String], api: &Server, logs: &Path) -> Result<Self, PluginError> {
        let (program, arguments) = program(spec, words)?;
        let start = || {
            let log = File::create(logs.join(format!("plugin-{}.log", spec.id)))?;
            let mut command = program_of_others(program, &spec.env);
            cotorra_datapath::end_with_us(&mut command);
            command
                .args(arguments)
                .env("COTORRA_API", format!("http://{}", api.address()))
                .env("COTORRA_PLUGIN", spec.id.as_str())
                // In place of the operator's.
                .env("COTORRA_TOKEN", api.plugins().of(&spec.id).map_or("", Token::secret))
                .env("COTORRA_SETTINGS", serde_json::Value::Object(spec.settings.clone()).to_string())
                .stdin(Stdio::null())
                .stdout(log.try_clone()?)
                .stderr(log)
                .spawn()
        };
        start().map(Self).map_err(|source| PluginError::Start {
            plugin: spec.id.clone(),
            program: program.clone(),
            source,
        })
    }

    /// Why it does not run any more.
    fn fault(&mut self) -> Option<Fault> {
        match self.0.try_wait() {
            Ok(status) => status.map(Fault::Ended),
            Err(error) => Some(Fault::Lost(error)),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(test)]
mod tests;
