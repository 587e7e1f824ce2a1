//! Starts VNFs as processes of this machine.

use std::{
    env,
    io::{self, Read, Write},
    os::{
        fd::OwnedFd,
        unix::{net::UnixStream, process::CommandExt},
    },
    path::PathBuf,
    process::{Child, ChildStdout, Command, ExitStatus},
    sync::Arc,
};

use cotorra_engine::{Launcher, Process, program_of_others};
use cotorra_graph::{Granted, NodeId, Program, Rights, Vnf};

use crate::{environments::Environments, files::TESTBED, holder, options::Options, wake::Wake};

/// The file of this process, even if it was replaced on the disk since.
pub(crate) const SELF: &str = "/proc/self/exe";

/// Starts VNFs of one run as processes of this machine. Each has a [`holder`].
pub(crate) struct MachineLauncher {
    options: Options,
    /// Folder of the run, with its files.
    folder: PathBuf,
    environments: Arc<Environments>,
    wake: Wake,
}

impl MachineLauncher {
    pub(crate) fn new(
        options: &Options,
        folder: PathBuf,
        environments: Arc<Environments>,
        wake: Wake,
    ) -> Self {
        Self { options: options.clone(), folder, environments, wake }
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

impl Launcher for MachineLauncher {
    fn launch(
        &self,
        _vnf: &Vnf,
        _replica: u32,
        _node: &NodeId,
        mut command: Command,
        cgroup_procs: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>> {
        let (lifeline, agents_end) = UnixStream::pair()?;
        // In a group of its own: Ctrl-C in a terminal is for the agent alone, which then ends the VNF.
        command.stdin(OwnedFd::from(lifeline)).current_dir(&self.folder).process_group(0);
        command.env(holder::GROUPS, env::join_paths(cgroup_procs).map_err(io::Error::other)?);
        let mut held = Held { holder: command.spawn()?, lifeline: Some(agents_end) };
        // Only the holder has its end now: this one reads no byte if the holder dies.
        drop(command);
        held.started()?;
        Ok(Box::new(held))
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
            Program::RosNavigation => {
                return Err("the brain in ROS runs in the emulated network's own nodes only".to_owned());
            }
            Program::PolicyServer(_) => {
                return Err("a policy server runs in virtual time only".to_owned());
            }
            _ => drop(command.args([SELF, "vnf", "navigation"])),
        }
        command.envs(self.environments.of(&vnf.id, replica));
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
    /// The holder kills the VNF when this end closes.
    lifeline: Option<UnixStream>,
}

impl Held {
    /// Waits until the VNF's program runs.
    ///
    /// # Errors
    /// The holder's reason for which it does not.
    fn started(&mut self) -> io::Result<()> {
        let mut lifeline = self.lifeline.as_ref().ok_or(io::ErrorKind::BrokenPipe)?;
        let mut first = [0];
        lifeline.read_exact(&mut first).map_err(|_| io::Error::other("its holder ended"))?;
        if first == [holder::STARTED] {
            return Ok(());
        }
        let mut reason = String::from_utf8_lossy(&first).into_owned();
        lifeline.read_to_string(&mut reason)?;
        Err(io::Error::other(reason))
    }
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
