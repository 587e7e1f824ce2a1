//! The process of a plug-in that is a program.

use std::{
    fs::{self, File},
    io,
    os::unix::process::ExitStatusExt as _,
    path::Path,
    process::{ExitStatus, Stdio},
    time::Duration,
};

use cotorra_datapath::{Child, spawn_outside};
use cotorra_engine::program_of_others;
use cotorra_graph::PluginSpec;

use super::{error::PluginError, host::Fault, programs::program};
use crate::api::{Server, Token};

/// The running program of a plug-in. It is killed, with everything that it started, when this is dropped, or when this
/// process is killed. It has a session of its own: Ctrl-C of a terminal reaches the run alone.
pub(super) struct Process {
    child: Child,
}

impl Process {
    /// Starts the program in the testbed file's folder.
    pub(super) fn start(
        spec: &PluginSpec,
        words: &[String],
        folder: &Path,
        api: &Server,
        logs: &Path,
    ) -> Result<Self, PluginError> {
        let (program, arguments) = program(spec, words)?;
        let start = || {
            let logs = logs.join("plugins");
            fs::create_dir_all(&logs)?;
            let log = File::create(logs.join(format!("{}.log", spec.id)))?;
            let mut command = program_of_others(program, &spec.env);
            command
                .args(arguments)
                .current_dir(folder)
                .env("COTORRA_API", format!("http://{}", api.dashboard().address()))
                .env("COTORRA_PLUGIN", spec.id.as_str())
                // Replaces the operator's token.
                .env("COTORRA_TOKEN", api.plugins().of(&spec.id).map_or("", Token::secret))
                .env("COTORRA_SETTINGS", serde_json::Value::Object(spec.settings.clone()).to_string())
                .stdin(Stdio::null())
                .stdout(log.try_clone()?)
                .stderr(log);
            spawn_outside(command).map_err(|error| match error {
                cotorra_datapath::Error::Spawn { source, .. } => source,
                other => io::Error::other(other),
            })
        };
        start().map(|child| Self { child }).map_err(|source| PluginError::Start {
            plugin: spec.id.clone(),
            program: program.clone(),
            source,
        })
    }

    /// Returns the CPU time that it and everything that it started have used.
    pub(super) fn cpu_time(&self) -> io::Result<Duration> {
        self.child.cpu_time()
    }

    /// Returns the fault if the process does not run any more.
    pub(super) fn fault(&mut self) -> Option<Fault> {
        match self.child.try_wait().map(|status| status.map(by_signal)) {
            Ok(status) => status.map(Fault::Ended),
            Err(error) => Some(Fault::Lost(error)),
        }
    }
}

/// Returns the status of a program from the one that a shell would give it: 128 + n after the signal n.
fn by_signal(status: ExitStatus) -> ExitStatus {
    match status.code() {
        Some(code @ 129..=192) => ExitStatus::from_raw(code - 128),
        _ => status,
    }
}
