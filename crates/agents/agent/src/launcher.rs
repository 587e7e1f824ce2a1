//! Starts VNFs as processes of this machine.

use std::{
    collections::BTreeMap,
    env,
    io::{self, PipeWriter, Write},
    os::unix::process::CommandExt,
    path::PathBuf,
    process::{Child, ChildStdout, Command, ExitStatus},
};

use cotorra_engine::{Launcher, Process, program_of_others};
use cotorra_graph::{Granted, NodeId, Program, Rights, Vnf, VnfId};
use parking_lot::Mutex;

use crate::{holder, options::Options};

/// The file of this process, even if it was replaced on the disk since.
pub(crate) const SELF: &str = "/proc/self/exe";
/// The testbed file in a run's folder.
const TESTBED: &str = "testbed.yaml";

/// Starts VNFs of one run as processes of this machine. Each has a [`holder`].
pub(crate) struct MachineLauncher<W> {
    options: Options,
    /// Folder of the run, with its files.
    folder: PathBuf,
    /// Variables of each instance, as the core sent them.
    environments: Mutex<BTreeMap<(VnfId, u32), BTreeMap<String, String>>>,
    wake: W,
}

impl<W: Fn() + Send + Sync + 'static> MachineLauncher<W> {
    pub(crate) fn new(options: Options, folder: PathBuf, wake: W) -> Self {
        Self { options, folder, environments: Mutex::default(), wake }
    }

    /// Sets the variables of an instance that is started next.
    pub(crate) fn set_environment(&self, vnf: &Vnf, replica: u32, environment: BTreeMap<String, String>) {
        let mut all = self.environments.lock();
        all.insert((vnf.id.clone(), replica), environment);
    }

    /// Whether a VNF's program is the agent's user. Bundled VNFs and trusted commands are.
    fn is_trusted(&self, vnf: &Vnf) -> Result<bool, String> {
        match (&vnf.program, &vnf.rights) {
            (Program::Command(_), Rights::Trusted) if !self.options.allow_trusted => {
                Err("the agent runs no trusted commands; start it with `--allow-trusted`".to_owned())
            }
            (Program::Command(_), Rights::Confined(Granted { capabilities, .. }))
                if !capabilities.is_empty() =>
            {
                Err("an agent grants no capabilities; use `trusted: true`".to_owned())
            }
            (Program::Command(_), Rights::Confined(_)) => Ok(false),
            _ => Ok(true),
        }
    }
}

impl<W: Fn() + Send + Sync + 'static> Launcher for MachineLauncher<W> {
    fn launch(
        &self,
        _vnf: &Vnf,
        _replica: u32,
        _node: &NodeId,
        mut command: Command,
        cgroup_procs: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>> {
        let (lifeline, agents_end) = io::pipe()?;
        // In a group of its own: Ctrl-C in a terminal is for the agent alone, which then ends the VNF.
        command.stdin(lifeline).current_dir(&self.folder).process_group(0);
        command.env(holder::GROUPS, env::join_paths(cgroup_procs).map_err(io::Error::other)?);
        Ok(Box::new(Held { holder: command.spawn()?, lifeline: Some(agents_end) }))
    }

    fn command(&self, vnf: &Vnf, replica: u32, _node: &NodeId) -> Result<Command, String> {
        let is_trusted = self.is_trusted(vnf)?;
        let mut command = program_of_others(SELF, &vnf.env);
        command.arg("hold");
        if let (false, Some(user)) = (is_trusted, self.options.user) {
            command.args(["--user", &format!("{}:{}", user.uid, user.gid)]);
        }
        command.arg("--");
        match &vnf.program {
            Program::Command(words) if words.is_empty() => return Err("its command is empty".to_owned()),
            Program::Command(words) => drop(command.args(words)),
            Program::Localization => drop(command.args([SELF, "vnf", "localization"])),
            _ => drop(command.args([SELF, "vnf", "navigation"])),
        }
        let environments = self.environments.lock();
        command.envs(environments.get(&(vnf.id.clone(), replica)).into_iter().flatten());
        command.env(cotorra_vnfs::TESTBED, self.folder.join(TESTBED));
        Ok(command)
    }

    fn wake(&self) {
        (self.wake)();
    }
}

/// A VNF's holder.
struct Held {
    holder: Child,
    /// The holder kills the VNF when this end of the pipe closes.
    lifeline: Option<PipeWriter>,
}

impl Process for Held {
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.holder.try_wait()
    }

    fn terminate(&mut self) {
        if let Some(lifeline) = &mut self.lifeline {
            // Fails only if the holder has ended.
            let _ = lifeline.write_all(&[holder::TERMINATE]);
        }
    }

    fn kill(&mut self) {
        self.lifeline = None;
        if let Err(error) = self.holder.wait() {
            tracing::warn!("cannot wait for the end of a VNF: {error}");
        }
    }

    fn stdout(&mut self) -> Option<ChildStdout> {
        self.holder.stdout.take()
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.kill();
    }
}
