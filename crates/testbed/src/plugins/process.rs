//! The process of a plug-in that is a program.

use std::{
    fs::File,
    io,
    os::unix::process::{CommandExt as _, ExitStatusExt as _},
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
};

use cotorra_engine::program_of_others;
use cotorra_graph::PluginSpec;

use super::{error::PluginError, host::Fault, programs::program};
use crate::api::{Server, Token};

/// The running program of a plug-in. It is killed with all that it started when this is dropped.
///
/// It has a session of its own. The signals of a terminal do not reach it: Ctrl-C ends the run, and the run ends it.
pub(super) enum Process {
    /// In a process namespace: the kernel kills all that it started, also when this process is killed.
    Contained(cotorra_datapath::Child),
    /// Where the kernel allows this user no such namespace, as an ordinary user in virtual time: all of its process group are
    /// killed, and when this process is killed, it alone.
    Grouped(Child),
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
        let failed =
            |source| PluginError::Start { plugin: spec.id.clone(), program: program.clone(), source };
        let log = File::create(logs.join(format!("plugin-{}.log", spec.id))).map_err(failed)?;
        let command = || -> io::Result<Command> {
            let mut command = program_of_others(program, &spec.env);
            command
                .args(arguments)
                .current_dir(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
                .env("COTORRA_API", format!("http://{}", api.dashboard().address()))
                .env("COTORRA_PLUGIN", spec.id.as_str())
                // Replaces the operator's token.
                .env("COTORRA_TOKEN", api.plugins().of(&spec.id).map_or("", Token::secret))
                .env("COTORRA_SETTINGS", serde_json::Value::Object(spec.settings.clone()).to_string())
                .stdin(Stdio::null())
                .stdout(log.try_clone()?)
                .stderr(log.try_clone()?);
            Ok(command)
        };
        match cotorra_datapath::spawn_outside(command().map_err(failed)?) {
            Ok(child) => Ok(Self::Contained(child)),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                let mut command = command().map_err(failed)?;
                cotorra_datapath::end_with_us(&mut command);
                command.process_group(0).spawn().map(Self::Grouped).map_err(failed)
            }
            Err(error) => Err(failed(error)),
        }
    }

    /// Returns the fault if the process does not run any more.
    pub(super) fn fault(&mut self) -> Option<Fault> {
        let ended = match self {
            Self::Contained(child) => child.try_wait().map(|status| status.map(of_signal)),
            Self::Grouped(child) => child.try_wait(),
        };
        match ended {
            Ok(status) => status.map(Fault::Ended),
            Err(error) => Some(Fault::Lost(error)),
        }
    }
}

/// Returns the status of a program from that of its init, which ends with 128 and the number of a signal.
fn of_signal(status: ExitStatus) -> ExitStatus {
    match status.code() {
        Some(code @ 129..=192) => ExitStatus::from_raw(code - 128),
        _ => status,
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Self::Grouped(child) = self {
            // Before it is waited for, so that the group's number is not used again.
            cotorra_datapath::kill_group(child);
            let _ = child.wait();
        }
    }
}
