//! Programs in a node: each runs in the node's network namespace with a process namespace of its own, and ends, with
//! every process that it started, when its [`Child`] is dropped or this process dies.

use std::{
    env,
    ffi::CStr,
    fmt::Write,
    fs::{self, File},
    io::{self, PipeWriter},
    os::{
        fd::{AsFd, AsRawFd, OwnedFd},
        unix::{fs::PermissionsExt, process::ExitStatusExt},
    },
    path::{Path, PathBuf},
    process::{self, Command, ExitStatus},
};

use cotorra_graph::{HardwareGraph, HostAddress};

use crate::{
    confine::Confinement,
    error::{Action, Error},
    init::{self, Init},
    namespace::{Namespace, on_a_thread},
    sys,
};

/// Lets this process open as many files as its hard limit allows, and returns how many those are. Programs in nodes keep
/// the limit that it had at first.
///
/// # Errors
/// [`Error::Kernel`] if the kernel does not say.
pub fn raise_open_files() -> Result<u64, Error> {
    sys::raise_open_files();
    sys::open_files_limit().action("read the limit of open files")
}

/// What a program gets beside its namespaces.
#[derive(Debug, Default)]
pub struct SpawnOptions<'a> {
    /// Names that it can use for other nodes.
    pub hosts: Option<&'a HostsFile>,
    /// What it finds its host to be called.
    pub hostname: Option<&'a str>,
    /// `cgroup.procs` (v2) or `tasks`/`cgroup.procs` (v1) files of the control groups that it joins before it runs.
    pub cgroups: Vec<PathBuf>,
    /// What keeps it from this machine. Without it, it may do what this process may.
    pub confinement: Option<&'a Confinement>,
}

/// A program in a node. Dropping it kills the program and all that it started.
#[derive(Debug)]
pub struct Child {
    init: process::Child,
    /// The init ends with all else when this end of the pipe closes, which the kernel sees to if we are killed.
    _lifeline: PipeWriter,
}

impl Child {
    /// The process that stands for the program, and for all that it starts, from outside.
    pub fn id(&self) -> u32 {
        self.init.id()
    }

    /// Waits for the program to end. Its descendants end with it. A program that was killed by signal n gives
    /// exit code 128 + n, as a shell has it.
    ///
    /// # Errors
    /// As [`process::Child::wait`].
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        self.init.wait().map(as_a_shell)
    }

    /// Its exit status, if it has ended; as [`Self::wait`].
    ///
    /// # Errors
    /// As [`process::Child::try_wait`].
    pub fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        Ok(self.init.try_wait()?.map(as_a_shell))
    }

    /// Asks the program and its process group to end (SIGTERM). Does nothing if it has.
    ///
    /// # Errors
    /// [`Error::Kernel`] if the signal cannot be sent.
    pub fn terminate(&mut self) -> Result<(), Error> {
        match self.try_wait() {
            Ok(None) => init::terminate(self.init.id()).action("end a program"),
            _ => Ok(()),
        }
    }

    /// Kills the program and all that it started, and waits until they are gone. Does nothing if they are.
    ///
    /// # Errors
    /// As [`process::Child::kill`].
    pub fn kill(&mut self) -> io::Result<()> {
        self.init.kill()?;
        self.init.wait().map(drop)
    }

    /// Its standard input, output and error, where the command asked for pipes.
    pub fn pipes(
        &mut self,
    ) -> (Option<process::ChildStdin>, Option<process::ChildStdout>, Option<process::ChildStderr>) {
        (self.init.stdin.take(), self.init.stdout.take(), self.init.stderr.take())
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        let _ = self.kill();
    }
}

/// The init says 128 + n by itself; only if it is killed, all of them are.
fn as_a_shell(status: ExitStatus) -> ExitStatus {
    match status.signal() {
        Some(signal) => ExitStatus::from_raw((128 + signal) << 8),
        None => status,
    }
}

impl Namespace {
    /// Starts a program inside: in process and mount namespaces of its own, in a session of its own, with `/proc`
    /// telling of its own processes where the kernel allows that.
    ///
    /// # Errors
    /// [`Error::Spawn`] when there is no such program, a control group refuses it, or the kernel refuses one of the
    /// namespaces.
    pub fn spawn(&self, mut command: Command, options: SpawnOptions<'_>) -> Result<Child, Error> {
        let program = command.get_program().to_string_lossy().into_owned();
        self.try_spawn(&mut command, &options).map_err(|source| Error::Spawn { program, source })
    }

    fn try_spawn(&self, command: &mut Command, options: &SpawnOptions<'_>) -> io::Result<Child> {
        let (hold, lifeline) = io::pipe()?;
        let join = |path: &PathBuf| File::options().write(true).open(path);
        let cgroups = options.cgroups.iter().map(join).collect::<io::Result<Vec<_>>>()?;
        if let Some(confinement) = options.confinement {
            command.env("HOME", &confinement.home).env("TMPDIR", &confinement.home);
        }
        // Entering a mount namespace goes to its root.
        let start = match (command.get_current_dir(), options.confinement) {
            (Some(folder), _) => folder.to_owned(),
            (None, Some(confinement)) => confinement.home.clone(),
            (None, None) => env::current_dir()?,
        };
        command.current_dir(&start);
        let open_files = sys::raise_open_files();
        let lifeline_end = hold.as_fd().as_raw_fd();
        // What a thread unshares it cannot get back, so that one is used up; nothing is tied to its life.
        let init = on_a_thread(|| {
            self.enter()?;
            sys::unshare(libc::CLONE_NEWPID)?;
            if let Some(name) = options.hostname {
                sys::unshare(libc::CLONE_NEWUTS)?;
                sys::set_hostname(name)?;
            }
            if let Some(hosts) = options.hosts {
                sys::unshare(libc::CLONE_FS)?;
                sys::setns(hosts.mounts.as_fd(), libc::CLONE_NEWNS)?;
            }
            let walls = match options.confinement {
                Some(confinement) => {
                    sys::unshare(libc::CLONE_NEWNS | libc::CLONE_NEWIPC)?;
                    sys::mount(c"none", c"/", None, libc::MS_REC | libc::MS_SLAVE)?;
                    let program = Path::new(command.get_program());
                    let program = (program.components().count() > 1).then(|| start.join(program));
                    Some(confinement.build(program.as_deref(), !cgroups.is_empty())?)
                }
                None => None,
            };
            Init { cgroups, lifeline: lifeline_end, open_files, walls }.before_exec_of(command);
            command.spawn()
        })?;
        Ok(Child { init, _lifeline: lifeline })
    }
}

/// The text of `/etc/hosts` in every host.
fn names(graph: &HardwareGraph) -> String {
    let mut text = String::from("127.0.0.1 localhost\n::1 localhost ip6-localhost ip6-loopback\n");
    for (i, node) in graph.hosts().enumerate() {
        let HostAddress { ipv4, ipv6, .. } = HostAddress::of(i);
        writeln!(text, "{ipv4} {id}\n{ipv6} {id}", id = node.id).expect("a string takes all");
    }
    text
}

/// An `/etc/hosts` for programs in nodes: a mount namespace, held by a descriptor alone, that differs from ours in
/// that file. Nothing of it is left on disk.
#[derive(Debug)]
pub struct HostsFile {
    mounts: OwnedFd,
}

impl HostsFile {
    /// One with the names of a graph's hosts.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of(graph: &HardwareGraph) -> Result<Self, Error> {
        Self::new(&names(graph))
    }

    /// One with this text.
    ///
    /// # Errors
    /// [`Error::Kernel`] where mount namespaces are forbidden or there is no `/etc/hosts` to cover.
    pub fn new(text: &str) -> Result<Self, Error> {
        on_a_thread(|| Self::on_this_thread(text)).action("cover /etc/hosts in a mount namespace")
    }

    fn on_this_thread(text: &str) -> io::Result<Self> {
        sys::unshare(libc::CLONE_NEWNS)?;
        // What others mount later is still seen; what is mounted here is not seen elsewhere.
        sys::mount(c"none", c"/", None, libc::MS_REC | libc::MS_SLAVE)?;
        // In a folder that nobody else sees: over one that is always there, for a moment.
        const FOLDER: &CStr = c"/proc";
        const FILE: &CStr = c"/proc/hosts";
        sys::mount_tmpfs(Path::new("/proc"), "size=1m,mode=755")?;
        let file = Path::new("/proc/hosts");
        fs::write(file, text)?;
        fs::set_permissions(file, fs::Permissions::from_mode(0o644))?;
        sys::mount(FILE, c"/etc/hosts", None, libc::MS_BIND)?;
        // What is mounted keeps the file alive.
        sys::unmount(FOLDER)?;
        Ok(Self { mounts: File::open("/proc/thread-self/ns/mnt")?.into() })
    }

    /// Moves the calling thread to where it is seen. What it runs next (`exec`) sees it.
    ///
    /// # Errors
    /// [`Error::Kernel`] without the right to do so: see [`crate::enter`].
    pub fn enter(&self) -> Result<(), Error> {
        let here = env::current_dir().action("find the working directory")?;
        // Who shares root and working directory with another thread may not; one that was joined may not be gone yet.
        sys::unshare(libc::CLONE_FS).action("have a working directory of its own")?;
        sys::setns(self.mounts.as_fd(), libc::CLONE_NEWNS).action("enter a mount namespace")?;
        // Entering a mount namespace goes to its root.
        env::set_current_dir(here).action("go back to the working directory")
    }
}
