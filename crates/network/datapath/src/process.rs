//! Programs in a node. Each runs in the node's network namespace with a process namespace of its own. It ends, with
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

/// Raises this process's limit of open files to the hard limit, and returns that. Programs in nodes keep the original
/// limit.
///
/// # Errors
/// [`Error::Kernel`] if the limit cannot be read.
pub fn raise_open_files() -> Result<u64, Error> {
    sys::raise_open_files();
    sys::open_files_limit().action("read the limit of open files")
}

/// Settings of a program beside its namespaces.
#[derive(Debug, Default)]
pub struct SpawnOptions<'a> {
    /// Names of other nodes.
    pub hosts: Option<&'a HostsFile>,
    /// Host name that the program sees.
    pub hostname: Option<&'a str>,
    /// `cgroup.procs` (v2) or `tasks`/`cgroup.procs` (v1) files of the control groups that it joins before it runs.
    pub cgroups: Vec<PathBuf>,
    /// Whether the program gets a process number that no other program on this machine has, if the kernel can do that: that of
    /// its init outside. hostapd and wpa_supplicant name their netlink sockets by it, and the kernel takes the end of a socket
    /// for that of all with the same name, in whatever network namespace: it stops their access points and stations.
    pub unique_number: bool,
    /// Confinement; without it the program has this process's rights.
    pub confinement: Option<&'a Confinement>,
}

/// A program in a node. Dropping it kills the program and everything that it started.
#[derive(Debug)]
pub struct Child {
    init: process::Child,
    /// The init ends with everything in its namespace when this end of the pipe closes. The kernel closes it if this
    /// process is killed.
    _lifeline: PipeWriter,
}

impl Child {
    /// Returns the ID of the init process, which stands for the program and its descendants.
    pub fn id(&self) -> u32 {
        self.init.id()
    }

    /// Waits for the program to end. Its descendants end with it. A program killed by signal n has exit code 128 + n,
    /// as in a shell.
    ///
    /// # Errors
    /// As [`process::Child::wait`].
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        self.init.wait().map(as_a_shell)
    }

    /// Returns the exit status if the program has ended; see [`Self::wait`].
    ///
    /// # Errors
    /// As [`process::Child::try_wait`].
    pub fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        Ok(self.init.try_wait()?.map(as_a_shell))
    }

    /// Sends SIGTERM to the program and its process group. Does nothing if it has ended.
    ///
    /// # Errors
    /// [`Error::Kernel`] if the signal cannot be sent.
    pub fn terminate(&mut self) -> Result<(), Error> {
        match self.try_wait() {
            Ok(None) => init::terminate(self.init.id()).action("end a program"),
            _ => Ok(()),
        }
    }

    /// Kills the program and everything that it started, and waits for their end. Does nothing if they have ended.
    ///
    /// # Errors
    /// As [`process::Child::kill`].
    pub fn kill(&mut self) -> io::Result<()> {
        self.init.kill()?;
        self.init.wait().map(drop)
    }

    /// Takes standard input, output and error, as far as the command requested pipes.
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

/// The init itself exits with 128 + n. A status with a signal means that the init was killed, and with it everything
/// inside.
fn as_a_shell(status: ExitStatus) -> ExitStatus {
    match status.signal() {
        Some(signal) => ExitStatus::from_raw((128 + signal) << 8),
        None => status,
    }
}

impl Namespace {
    /// Starts a program inside, in process and mount namespaces and a session of its own. `/proc` shows its own
    /// processes, where the kernel allows that.
    ///
    /// # Errors
    /// [`Error::Spawn`] if there is no such program, or a control group or the kernel rejects it.
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
        // Entering a mount namespace changes the working directory to its root.
        let start = match (command.get_current_dir(), options.confinement) {
            (Some(folder), _) => folder.to_owned(),
            (None, Some(confinement)) => confinement.home.clone(),
            (None, None) => env::current_dir()?,
        };
        command.current_dir(&start);
        let open_files = sys::raise_open_files();
        let lifeline_end = hold.as_fd().as_raw_fd();
        // A thread cannot undo an unshare, so use a throw-away one. Nothing depends on its lifetime.
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
            let restrictions = match options.confinement {
                Some(confinement) => {
                    sys::unshare(libc::CLONE_NEWNS | libc::CLONE_NEWIPC)?;
                    sys::mount(c"none", c"/", None, libc::MS_REC | libc::MS_SLAVE)?;
                    let program = Path::new(command.get_program());
                    let program = (program.components().count() > 1).then(|| start.join(program));
                    Some(confinement.build(program.as_deref(), !cgroups.is_empty())?)
                }
                None => None,
            };
            let unique_number = options.unique_number;
            Init { cgroups, lifeline: lifeline_end, open_files, unique_number, restrictions }
                .before_exec_of(command);
            command.spawn()
        })?;
        Ok(Child { init, _lifeline: lifeline })
    }
}

/// Returns the text of `/etc/hosts` in every host.
fn names(graph: &HardwareGraph) -> String {
    let mut text = String::from("127.0.0.1 localhost\n::1 localhost ip6-localhost ip6-loopback\n");
    for (i, node) in graph.hosts().enumerate() {
        let HostAddress { ipv4, ipv6, .. } = HostAddress::of(i);
        match node.real_server() {
            Some(real) => writeln!(text, "{} {}", real.address, node.id),
            None => writeln!(text, "{ipv4} {id}\n{ipv6} {id}", id = node.id),
        }
        .expect("a string takes all");
    }
    for (name, address) in graph.gateways().flat_map(|(_, gateway)| &gateway.machines) {
        writeln!(text, "{address} {name}").expect("a string takes all");
    }
    text
}

/// An `/etc/hosts` for programs in nodes: a mount namespace that differs from ours in that file. A descriptor alone
/// holds it; nothing is left on disk.
#[derive(Debug)]
pub struct HostsFile {
    mounts: OwnedFd,
}

impl HostsFile {
    /// Makes one with the names of a graph's hosts, and of the real machines behind its gateways.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of(graph: &HardwareGraph) -> Result<Self, Error> {
        Self::new(&Self::text(graph))
    }

    /// Returns the text of [`Self::of`].
    pub fn text(graph: &HardwareGraph) -> String {
        names(graph)
    }

    /// Makes one with this text.
    ///
    /// # Errors
    /// [`Error::Kernel`] if mount namespaces are forbidden or there is no `/etc/hosts` to cover.
    pub fn new(text: &str) -> Result<Self, Error> {
        on_a_thread(|| Self::on_this_thread(text)).action("cover /etc/hosts in a mount namespace")
    }

    fn on_this_thread(text: &str) -> io::Result<Self> {
        sys::unshare(libc::CLONE_NEWNS)?;
        // Mounts made elsewhere later stay visible here; mounts made here are not visible elsewhere.
        sys::mount(c"none", c"/", None, libc::MS_REC | libc::MS_SLAVE)?;
        // The file needs a private folder for a moment: mount one over a folder that always exists.
        const FOLDER: &CStr = c"/proc";
        const FILE: &CStr = c"/proc/hosts";
        sys::mount_tmpfs(Path::new("/proc"), "size=1m,mode=755")?;
        let file = Path::new("/proc/hosts");
        fs::write(file, text)?;
        fs::set_permissions(file, fs::Permissions::from_mode(0o644))?;
        sys::mount(FILE, c"/etc/hosts", None, libc::MS_BIND)?;
        // The bind mount keeps the file alive.
        sys::unmount(FOLDER)?;
        Ok(Self { mounts: File::open("/proc/thread-self/ns/mnt")?.into() })
    }

    /// Moves the calling thread to the mount namespace with this file. A program that it executes next sees the file.
    ///
    /// # Errors
    /// [`Error::Kernel`] without the right to do so: see [`crate::enter`].
    pub fn enter(&self) -> Result<(), Error> {
        let here = env::current_dir().action("find the working directory")?;
        // A thread that shares root and working directory with another one cannot enter. A joined thread may not be
        // gone yet.
        sys::unshare(libc::CLONE_FS).action("have a working directory of its own")?;
        sys::setns(self.mounts.as_fd(), libc::CLONE_NEWNS).action("enter a mount namespace")?;
        // Entering a mount namespace changes the working directory to its root.
        env::set_current_dir(here).action("go back to the working directory")
    }
}
