//! Programs in a node. Each runs in the node's network namespace with a process namespace of its own. It ends, with
//! every process that it started, when its [`Child`] is dropped or this process dies.

use std::{
    env,
    ffi::CStr,
    fmt::Write,
    fs::{self, File},
    io::{self, PipeWriter},
    os::{
        fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd},
        unix::{fs::PermissionsExt, process::ExitStatusExt},
    },
    path::{Path, PathBuf},
    process::{self, Command, ExitStatus},
    time::Duration,
};

use cotorra_graph::{HardwareGraph, HostAddress};

use crate::{
    confine::Confinement,
    cpu_time,
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
    /// Another process that the program ends with; see [`open_process`].
    pub ends_with: Option<BorrowedFd<'a>>,
    /// Confinement; without it the program has this process's rights.
    pub confinement: Option<&'a Confinement>,
}

/// Opens a process of that number, to watch whether it lives.
///
/// # Errors
/// The system's error, as when there is none.
pub fn open_process(number: u32) -> io::Result<OwnedFd> {
    sys::open_process(number.cast_signed())
}

/// A program in a node. Dropping it kills the program and everything that it started.
#[derive(Debug)]
pub struct Child {
    init: process::Child,
    /// The init ends with everything in its namespace when this end of the pipe closes. The kernel closes it if this
    /// process is killed.
    lifeline: Option<PipeWriter>,
    /// Whether killing the init kills everything that the program started.
    has_namespace: bool,
}

impl Child {
    /// Returns the ID of the init process, which stands for the program and its descendants.
    pub fn id(&self) -> u32 {
        self.init.id()
    }

    /// Returns the CPU time that the program and its descendants have used, to the nanosecond, but for descendants that have
    /// ended, of which the kernel counts ticks.
    ///
    /// # Errors
    /// The system's error, as if the program has ended, or if the kernel does not tell the children of a process.
    pub fn cpu_time(&self) -> io::Result<Duration> {
        cpu_time::cpu_time_of(self.id())
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
            Ok(None) => init::send(self.init.id(), libc::SIGTERM).action("end a program"),
            _ => Ok(()),
        }
    }

    /// Kills the program and everything that it started, and waits for their end. Does nothing if they have ended.
    ///
    /// # Errors
    /// As [`process::Child::kill`].
    pub fn kill(&mut self) -> io::Result<()> {
        // Without a namespace, the init itself must kill the program.
        self.lifeline = None;
        if self.has_namespace {
            self.init.kill()?;
        }
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

/// Starts a program outside of nodes, in a process namespace and a session of its own. It ends as other programs do, with
/// everything that it started. Where an ordinary user may make no namespaces, only its process group ends with it.
///
/// # Errors
/// [`Error::Spawn`] if there is no such program.
pub fn spawn_outside(mut command: Command) -> Result<Child, Error> {
    let program = command.get_program().to_string_lossy().into_owned();
    let mut start = || {
        let (hold, lifeline) = io::pipe()?;
        let open_files = sys::raise_open_files();
        let mut has_namespace = true;
        let init = on_a_thread(|| {
            let mut user_maps = None;
            if sys::unshare(libc::CLONE_NEWPID).is_err() {
                has_namespace = sys::try_unshare(libc::CLONE_NEWUSER | libc::CLONE_NEWPID).is_ok();
                let (user, group) = sys::effective_ids();
                user_maps = has_namespace.then(|| [user, group].map(|id| format!("{id} {id} 1")));
            }
            Init {
                cgroups: Vec::new(),
                lifeline: hold.as_raw_fd(),
                other: -1,
                with_terminal: None,
                open_files,
                unique_number: false,
                user_maps,
                restrictions: None,
            }
            .before_exec_of(&mut command);
            command.spawn()
        })?;
        Ok(Child { init, lifeline: Some(lifeline), has_namespace })
    };
    start().map_err(|source| Error::Spawn { program, source })
}

impl Namespace {
    /// Starts a program inside, in process and mount namespaces and a session of its own. `/proc` shows its own
    /// processes, where the kernel allows that, and `/sys` its own interfaces, or none.
    ///
    /// # Errors
    /// [`Error::Spawn`] if there is no such program, or a control group or the kernel rejects it.
    pub fn spawn(&self, command: Command, options: SpawnOptions<'_>) -> Result<Child, Error> {
        self.start(command, &options, None)
    }

    /// Runs a program inside in the place of this process, and returns its exit status; see [`Child::wait`]. It uses this
    /// process's terminal, and gets the signals that are sent to this process. It is otherwise as [`Self::spawn`] starts it. This
    /// process must have one thread.
    ///
    /// # Errors
    /// As [`Self::spawn`].
    pub fn run_program(&self, command: Command, options: SpawnOptions<'_>) -> Result<ExitStatus, Error> {
        let terminal = sys::Terminal::of_foreground();
        let signals = sys::Signals::block().action("block signals")?;
        let mut child = self.start(command, &options, Some(&signals))?;
        let status = loop {
            if let Some(status) = child.try_wait().action("wait for a program")? {
                break status;
            }
            let signal = signals.wait().action("wait for signals")?;
            if signal.is_sent && signal.number != libc::SIGCHLD {
                init::send(child.id(), signal.number).action("pass a signal on")?;
            }
        };
        // A shell may have taken it for itself, and be unable to see whom to return it to.
        if let Some(terminal) = terminal {
            terminal.take_back();
        }
        Ok(status)
    }

    /// Starts a program. With blocked signals, it has this process's terminal.
    fn start(
        &self,
        mut command: Command,
        options: &SpawnOptions<'_>,
        blocked: Option<&sys::Signals>,
    ) -> Result<Child, Error> {
        let program = command.get_program().to_string_lossy().into_owned();
        self.try_start(&mut command, options, blocked).map_err(|source| Error::Spawn { program, source })
    }

    fn try_start(
        &self,
        command: &mut Command,
        options: &SpawnOptions<'_>,
        blocked: Option<&sys::Signals>,
    ) -> io::Result<Child> {
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
                None => {
                    show_own_interfaces()?;
                    None
                }
            };
            Init {
                cgroups,
                lifeline: lifeline_end,
                other: options.ends_with.map_or(-1, |process| process.as_raw_fd()),
                with_terminal: blocked.map(sys::Signals::before),
                open_files,
                unique_number: options.unique_number,
                user_maps: None,
                restrictions,
            }
            .before_exec_of(command);
            command.spawn()
        })?;
        Ok(Child { init, lifeline: Some(lifeline), has_namespace: true })
    }
}

/// Lets `/sys` show the interfaces of the calling thread's network namespace, in a mount namespace of its own. Where the kernel
/// forbids that, as in containers that hide parts of `/sys`, it shows none.
fn show_own_interfaces() -> io::Result<()> {
    const SYS: &CStr = c"/sys";
    const INTERFACES: &str = "/sys/class/net";
    if !Path::new(INTERFACES).exists() {
        return Ok(());
    }
    sys::unshare(libc::CLONE_NEWNS)?;
    sys::mount(c"none", c"/", None, libc::MS_REC | libc::MS_SLAVE)?;
    // Control groups and others stay.
    let mounts = mounts_below_sys(&fs::read_to_string("/proc/thread-self/mountinfo")?);
    let mounts: Vec<_> = mounts.iter().filter_map(|path| Some((path, sys::open_tree(path).ok()?))).collect();
    let flags = libc::MS_NOSUID | libc::MS_NODEV | libc::MS_NOEXEC;
    let mount = |more| sys::mount(c"sysfs", SYS, Some(c"sysfs"), flags | more);
    // A user may only mount it as the machine has it, which may be read-only.
    if mount(0).or_else(|_| mount(libc::MS_RDONLY)).is_err() {
        return sys::mount_tmpfs(Path::new(INTERFACES), "size=1m,mode=755");
    }
    for (path, tree) in mounts {
        // Leave out what has no place there.
        let _ = sys::move_mount(tree.as_fd(), path);
    }
    Ok(())
}

/// Returns where something is mounted below `/sys`, without what is below that, from a `mountinfo` (proc_pid_mountinfo(5)).
fn mounts_below_sys(mountinfo: &str) -> Vec<PathBuf> {
    let points = mountinfo.lines().filter_map(|line| line.split(' ').nth(4)).map(Path::new);
    let mut points: Vec<_> =
        points.filter(|point| point.parent().is_some_and(|p| p.starts_with("/sys"))).collect();
    points.sort();
    points.dedup_by(|below, above| below.starts_with(above));
    points.into_iter().map(Path::to_owned).collect()
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mounts_below_sys_are_listed_once_each() {
        let mountinfo = "22 1 0:20 / /sys rw - sysfs sysfs rw\n\
                         30 22 0:26 / /sys/fs/cgroup ro - tmpfs tmpfs ro\n\
                         31 30 0:27 / /sys/fs/cgroup/memory rw - cgroup cgroup rw\n\
                         23 22 0:6 / /sys/kernel/debug rw - debugfs debugfs rw\n\
                         24 1 0:21 / /system rw - tmpfs tmpfs rw\n";
        let paths = ["/sys/fs/cgroup", "/sys/kernel/debug"].map(PathBuf::from);
        assert_eq!(mounts_below_sys(mountinfo), paths);
    }
}
