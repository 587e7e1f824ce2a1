//! Ways in which a program may try to get out of its node. Each is tried in a process of its own, so that its damage
//! affects no other. A process that is killed for it has not got out.

use std::{
    env,
    ffi::{CString, OsString},
    fs::{self, File, OpenOptions},
    io, mem,
    os::{
        fd::AsRawFd,
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            fs::{FileTypeExt, OpenOptionsExt, PermissionsExt, symlink},
            net::{SocketAddr, UnixStream},
        },
    },
    path::{Path, PathBuf},
    process::ExitCode,
    ptr,
};

use libc::{c_int, c_long, c_ulong};

pub const HELPER: &str = "COTORRA_TEST_ESCAPES";
const SECRET: &[u8] = super::SECRET.as_bytes();

/// Facts about the outside that an attacker might know.
pub struct Facts {
    pub core: u32,
    pub bystander: u32,
    pub history: PathBuf,
    pub testbed: PathBuf,
    pub home: PathBuf,
    pub socket: PathBuf,
    pub abstract_socket: String,
    pub shared_memory: c_int,
    pub network: PathBuf,
}

impl Facts {
    pub fn to_environment(&self) -> Vec<(String, OsString)> {
        let paths = [&self.history, &self.testbed, &self.home, &self.socket, &self.network];
        let numbers = [self.core.to_string(), self.bystander.to_string(), self.shared_memory.to_string()];
        let paths = paths.into_iter().map(|path| path.clone().into_os_string());
        let all = paths.chain(numbers.map(OsString::from)).chain([self.abstract_socket.clone().into()]);
        all.enumerate().map(|(i, value)| (format!("FACT_{i}"), value)).collect()
    }

    fn from_environment() -> Self {
        let fact = |i: usize| env::var(format!("FACT_{i}")).unwrap();
        Self {
            history: fact(0).into(),
            testbed: fact(1).into(),
            home: fact(2).into(),
            socket: fact(3).into(),
            network: fact(4).into(),
            core: fact(5).parse().unwrap(),
            bystander: fact(6).parse().unwrap(),
            shared_memory: fact(7).parse().unwrap(),
            abstract_socket: fact(8),
        }
    }
}

/// Whether it harms a machine that does not prevent it.
#[derive(Clone, Copy, PartialEq)]
pub enum Harm {
    None,
    Some,
}

/// Returns whether it got out.
type Way = fn(&Facts) -> bool;

pub const WAYS: &[(&str, Harm, Way)] = &[
    ("enter another network by /proc/*/ns/net", Harm::None, |facts| {
        processes().any(|pid| enter(&format!("/proc/{pid}/ns/net"), libc::CLONE_NEWNET, &facts.network))
    }),
    ("enter a node by /proc/*/fd", Harm::None, |_| {
        let own = fs::read_link("/proc/self/ns/net").unwrap_or_default();
        let open = |pid: u32| fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        let other = |path: &PathBuf| {
            fs::read_link(path).is_ok_and(|to| to.to_string_lossy().starts_with("net:") && to != own)
        };
        processes().any(|pid| {
            open(pid).map(|fd| fd.path()).filter(other).any(|path| set_namespace(&path, libc::CLONE_NEWNET))
        })
    }),
    ("enter another mount namespace by /proc/*/ns/mnt", Harm::None, |_| {
        let own = fs::read_link("/proc/self/ns/mnt").unwrap_or_default();
        let other = |path: &PathBuf| fs::read_link(path).is_ok_and(|to| to != own);
        let paths = processes().map(|pid| PathBuf::from(format!("/proc/{pid}/ns/mnt")));
        paths.filter(other).any(|path| set_namespace(&path, libc::CLONE_NEWNS))
    }),
    ("set a namespace by a descriptor of a process", Harm::None, |facts| {
        [facts.core, facts.bystander].into_iter().any(|pid| {
            let fd = call(libc::SYS_pidfd_open, [pid.into(), 0, 0, 0, 0]);
            fd >= 0 && call(libc::SYS_setns, [fd, libc::CLONE_NEWNET.into(), 0, 0, 0]) == 0
        })
    }),
    ("open the history", Harm::None, |facts| File::open(&facts.history).is_ok()),
    ("write the history", Harm::None, |facts| OpenOptions::new().append(true).open(&facts.history).is_ok()),
    ("open the history from the folder beside", Harm::None, |facts| {
        File::open(facts.home.join("../../history.sqlite")).is_ok()
    }),
    ("open the history through a symbolic link", Harm::None, |facts| {
        let link = facts.home.join("symbolic");
        symlink(&facts.history, &link).is_ok() && File::open(link).is_ok()
    }),
    ("link the history into its own folder", Harm::None, |facts| {
        fs::hard_link(&facts.history, facts.home.join("hard")).is_ok()
    }),
    ("link a file of the testbed's into its own folder", Harm::None, |facts| {
        fs::hard_link(facts.testbed.join("data"), facts.home.join("hard2")).is_ok()
    }),
    ("move a file over the history", Harm::Some, |facts| {
        let own = facts.home.join("own");
        fs::write(&own, "forged").is_ok() && fs::rename(own, &facts.history).is_ok()
    }),
    ("move its own folder away", Harm::Some, |facts| {
        fs::rename(&facts.home, facts.home.with_extension("away")).is_ok()
    }),
    ("put a link in the place of its own folder", Harm::Some, |facts| {
        fs::remove_dir_all(&facts.home).is_ok() && symlink("/etc", &facts.home).is_ok()
    }),
    ("write into the testbed file's folder", Harm::None, |facts| {
        let file = facts.testbed.join("written");
        fs::write(&file, "").is_ok() && fs::remove_file(file).is_ok()
    }),
    ("change a file of the testbed's by its mode, owner or time", Harm::Some, |facts| {
        let data = facts.testbed.join("data");
        let open = fs::set_permissions(&data, fs::Permissions::from_mode(0o777)).is_ok();
        open || File::open(&data).is_ok_and(|file| file.set_modified(std::time::UNIX_EPOCH).is_ok())
    }),
    ("write to the system's folders", Harm::Some, |_| {
        ["/etc", "/usr", "/usr/bin", "/opt", "/", "/dev", "/run", "/var", "/proc", "/home", "/root"]
            .iter()
            .any(|folder| {
                let file = Path::new(folder).join("cotorra-escaped");
                fs::write(&file, "").is_ok() || fs::create_dir(file).is_ok()
            })
    }),
    ("write to its own program", Harm::Some, |_| {
        let program = env::current_exe().unwrap();
        OpenOptions::new().append(true).open(program).is_ok()
    }),
    ("read what only root may", Harm::None, |_| {
        reads_what_only_root_may(Path::new("/etc")) || fs::read_dir("/root").is_ok()
    }),
    ("make a program that runs as its owner", Harm::None, |facts| {
        let file = facts.home.join("as-owner");
        let at = path(&file);
        let is_made = || fs::metadata(&file).is_ok_and(|file| file.permissions().mode() & 0o6000 != 0);
        let made = fs::write(&file, "").is_ok()
            && (fs::set_permissions(&file, fs::Permissions::from_mode(0o4755)).is_ok() || is_made());
        let _ = fs::remove_file(&file);
        // SAFETY: the string ends in a zero.
        let opened = unsafe { libc::open(at.as_ptr(), libc::O_CREAT | libc::O_WRONLY, 0o6755) };
        made || opened >= 0 && is_made()
    }),
    ("find another's files in /tmp, /home or /root", Harm::None, |_| {
        ["/tmp", "/var/tmp", "/home", "/root", "/mnt", "/srv", "/run"].iter().any(|folder| {
            fs::read_dir(folder)
                .into_iter()
                .flatten()
                .flatten()
                .any(|entry| entry.file_type().is_ok_and(|t| t.is_file() || t.is_socket()))
        })
    }),
    ("mount something", Harm::Some, |facts| {
        let home = path(&facts.home);
        // SAFETY: the strings end in a zero.
        unsafe { libc::mount(c"none".as_ptr(), home.as_ptr(), c"tmpfs".as_ptr(), 0, ptr::null()) == 0 }
    }),
    ("mount what is read-only so that it can be written", Harm::Some, |_| {
        let flags = libc::MS_REMOUNT | libc::MS_BIND;
        ["/", "/usr", "/proc"].iter().any(|at| {
            let at = CString::new(*at).unwrap();
            // SAFETY: the strings end in a zero.
            unsafe { libc::mount(ptr::null(), at.as_ptr(), ptr::null(), flags, ptr::null()) == 0 }
        })
    }),
    ("unmount what covers the runs", Harm::Some, |facts| {
        let runs = path(&facts.testbed.join("runs"));
        // SAFETY: the string ends in a zero.
        unsafe { libc::umount2(runs.as_ptr(), libc::MNT_DETACH) == 0 }
    }),
    ("mount by the new calls", Harm::Some, |_| {
        let tree = call(libc::SYS_open_tree, [libc::AT_FDCWD.into(), address(c"/"), 1, 0, 0]);
        let new = call(libc::SYS_fsopen, [address(c"tmpfs"), 0, 0, 0, 0]);
        tree >= 0 || new >= 0
    }),
    ("make a user namespace", Harm::None, |_| {
        call(libc::SYS_unshare, [libc::CLONE_NEWUSER.into(), 0, 0, 0, 0]) == 0
    }),
    ("start a process in a user namespace", Harm::None, |_| {
        let flags = c_long::from(libc::CLONE_NEWUSER | libc::SIGCHLD);
        // SAFETY: without a stack of its own the new process goes on as after fork, and ends at once.
        unsafe {
            match libc::syscall(libc::SYS_clone, flags, 0, 0, 0, 0) {
                0 => libc::_exit(0),
                pid => pid > 0,
            }
        }
    }),
    ("start a process in a user namespace by clone3", Harm::None, |_| {
        let arguments: [u64; 8] = [libc::CLONE_NEWUSER as u64, 0, 0, 0, libc::SIGCHLD as u64, 0, 0, 0];
        // SAFETY: the pointer is to a live `struct clone_args` of the size given; the new process ends at once.
        unsafe {
            match libc::syscall(libc::SYS_clone3, arguments.as_ptr(), mem::size_of_val(&arguments)) {
                0 => libc::_exit(0),
                pid => pid > 0,
            }
        }
    }),
    ("trace the core", Harm::Some, |facts| {
        [facts.core, facts.bystander, 1]
            .into_iter()
            .any(|pid| call(libc::SYS_ptrace, [libc::PTRACE_SEIZE.into(), pid.into(), 0, 0, 0]) == 0)
    }),
    ("read the memory of the core", Harm::None, |facts| {
        let mut byte = 0u8;
        let local = libc::iovec { iov_base: (&raw mut byte).cast(), iov_len: 1 };
        let from = env::current_exe as *const () as usize;
        let remote = libc::iovec { iov_base: from as *mut _, iov_len: 1 };
        [facts.core, facts.bystander, 1].into_iter().any(|pid| {
            // SAFETY: the pointers are to live vectors.
            unsafe { libc::process_vm_readv(pid as i32, &local, 1, &remote, 1, 0) == 1 }
        })
    }),
    ("look into the init, which has a copy of the core's memory", Harm::None, |_| {
        let files = ["mem", "maps", "environ", "auxv"].map(|name| format!("/proc/1/{name}"));
        // Descriptors can be counted, but not opened.
        let folders = ["fd/0", "ns/net", "root", "cwd", "exe"].map(|name| format!("/proc/1/{name}"));
        files
            .iter()
            .any(|file| File::open(file).is_ok_and(|mut file| io::Read::read(&mut file, &mut [0]).is_ok()))
            || folders.iter().any(|link| fs::read_link(link).is_ok() || fs::metadata(link).is_ok())
    }),
    ("find a secret in another's environment", Harm::None, |_| {
        processes().any(|pid| {
            let all = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
            all.windows(SECRET.len()).any(|part| part == SECRET)
        })
    }),
    ("signal the core", Harm::None, |facts| {
        // SAFETY: takes no pointer, and signal 0 does nothing.
        [facts.core, facts.bystander].into_iter().any(|pid| unsafe { libc::kill(pid as i32, 0) == 0 })
    }),
    ("signal the init", Harm::None, |_| {
        // SAFETY: takes no pointer, and signal 0 does nothing.
        unsafe { libc::kill(1, 0) == 0 && !is_outermost() }
    }),
    ("load a module", Harm::Some, |_| {
        let loaded = call(libc::SYS_init_module, [address(c"x"), 1, address(c""), 0, 0]);
        let removed = call(libc::SYS_delete_module, [address(c"cotorra_escaped"), 0, 0, 0, 0]);
        got_through(loaded) || got_through(removed)
    }),
    ("open devices of the machine", Harm::None, |_| {
        let known =
            ["mem", "kmem", "port", "kmsg", "kvm", "vda", "sda", "nvme0n1", "fuse", "net/tun", "ptmx", "tty"];
        let listed = fs::read_dir("/dev").into_iter().flatten().flatten();
        let is_device = |entry: &fs::DirEntry| {
            let usual =
                ["null", "zero", "full", "random", "urandom"].iter().any(|usual| entry.file_name() == *usual);
            !usual && entry.file_type().is_ok_and(|kind| kind.is_char_device() || kind.is_block_device())
        };
        let listed = listed.filter(is_device).map(|entry| entry.path());
        let open =
            |path: PathBuf| OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path).is_ok();
        known.iter().map(|name| Path::new("/dev").join(name)).chain(listed).any(open)
    }),
    ("make a device", Harm::Some, |facts| {
        ["block", "character"].iter().zip([libc::S_IFBLK, libc::S_IFCHR]).any(|(name, kind)| {
            let at = path(&facts.home.join(name));
            // SAFETY: the string ends in a zero.
            unsafe { libc::mknod(at.as_ptr(), kind | 0o600, libc::makedev(1, 1)) == 0 }
        })
    }),
    ("change the root folder", Harm::Some, |facts| {
        let home = path(&facts.home);
        // SAFETY: the string ends in a zero.
        unsafe { libc::chroot(home.as_ptr()) == 0 }
    }),
    ("get rights from a program's bits", Harm::Some, |_| {
        // SAFETY: takes no pointer.
        unsafe {
            libc::prctl(libc::PR_GET_NO_NEW_PRIVS, 0 as c_ulong, 0 as c_ulong, 0 as c_ulong, 0 as c_ulong)
                != 1
        }
    }),
    ("have a capability", Harm::None, |_| {
        // SAFETY: takes no pointer.
        (0..41).any(|number: c_ulong| unsafe { libc::prctl(libc::PR_CAPBSET_READ, number) == 1 })
            || fs::read_to_string("/proc/self/status").is_ok_and(|status| {
                status.lines().any(|line| line.starts_with("CapEff:") && !line.ends_with("0000000000000000"))
            })
    }),
    ("become another user", Harm::Some, |_| {
        // SAFETY: takes no pointer.
        unsafe { libc::setresuid(1, 1, 1) == 0 || libc::setresgid(1, 1, 1) == 0 }
    }),
    ("give a file to another user", Harm::Some, |facts| {
        let file = facts.home.join("given");
        let made = fs::write(&file, "").is_ok();
        let file = path(&file);
        // SAFETY: the string ends in a zero.
        made && unsafe { libc::chown(file.as_ptr(), 1, 1) == 0 }
    }),
    ("use keys of the user", Harm::None, |_| {
        const USER_SESSION: c_long = -5;
        let got = call(libc::SYS_keyctl, [0, USER_SESSION, 1, 0, 0]);
        let added =
            call(libc::SYS_add_key, [address(c"user"), address(c"cotorra-escaped"), address(c"x"), 1, -2]);
        got >= 0 || added >= 0
    }),
    ("load a program of the kernel's", Harm::None, |_| {
        let mut attributes = [0u32; 32];
        attributes[..4].copy_from_slice(&[2, 4, 8, 1]);
        call(libc::SYS_bpf, [0, attributes.as_ptr() as c_long, 128, 0, 0]) >= 0
    }),
    ("count events of the machine", Harm::None, |_| {
        let mut attributes = [0u32; 32];
        attributes[..2].copy_from_slice(&[1, 128]);
        call(libc::SYS_perf_event_open, [attributes.as_ptr() as c_long, 0, -1, -1, 0]) >= 0
    }),
    ("handle page faults", Harm::None, |_| call(libc::SYS_userfaultfd, [1, 0, 0, 0, 0]) >= 0),
    ("use io_uring", Harm::None, |_| {
        let mut parameters = [0u8; 120];
        call(libc::SYS_io_uring_setup, [1, parameters.as_mut_ptr() as c_long, 0, 0, 0]) >= 0
    }),
    ("connect to an abstract socket of the host", Harm::None, |facts| {
        let address = SocketAddr::from_abstract_name(&facts.abstract_socket).unwrap();
        UnixStream::connect_addr(&address).is_ok()
    }),
    ("connect to a socket of the host", Harm::None, |facts| UnixStream::connect(&facts.socket).is_ok()),
    ("attach shared memory of the host", Harm::None, |facts| {
        // SAFETY: no address is asked for.
        unsafe { libc::shmat(facts.shared_memory, ptr::null(), 0) as isize != -1 }
    }),
    ("write to settings of the kernel", Harm::None, |_| {
        [
            "/proc/sys/kernel/panic",
            "/proc/sys/kernel/core_pattern",
            "/proc/sysrq-trigger",
            "/proc/sys/vm/drop_caches",
        ]
        .iter()
        .any(|path| OpenOptions::new().write(true).open(path).is_ok())
    }),
    ("change control groups", Harm::None, |_| {
        ["/sys/fs/cgroup", "/sys/fs/cgroup/memory", "/sys/fs/cgroup/pids", "/sys/fs/cgroup/unified"]
            .iter()
            .any(|group| {
                let new = Path::new(group).join("cotorra-escaped");
                let made = fs::create_dir(&new).is_ok() && fs::remove_dir(&new).is_ok();
                made || OpenOptions::new().write(true).open(Path::new(group).join("cgroup.procs")).is_ok()
            })
    }),
    ("type into a terminal", Harm::None, |_| {
        // SAFETY: the pointer is to a live byte. The terminal is not read.
        let typed = unsafe { libc::ioctl(0, libc::TIOCSTI, c"x".as_ptr()) };
        got_through(typed.into()) || File::open("/dev/tty").is_ok()
    }),
    ("start another kernel", Harm::Some, |_| got_through(call(libc::SYS_kexec_load, [0, 0, 0, 0, 0]))),
    ("restart the machine", Harm::Some, |_| {
        const KEYS_OFF: c_long = 0;
        call(libc::SYS_reboot, [0xfee1_dead, 672_274_793, KEYS_OFF, 0, 0]) == 0
    }),
    ("set the clock", Harm::Some, |_| {
        // SAFETY: a timespec is integers; the pointers are to a live one.
        unsafe {
            let mut now: libc::timespec = mem::zeroed();
            libc::clock_gettime(libc::CLOCK_REALTIME, &mut now);
            libc::clock_settime(libc::CLOCK_REALTIME, &now) == 0
        }
    }),
    ("slow the clock", Harm::Some, |_| {
        // SAFETY: a timex is integers, which say that nothing is to change; the pointer is to a live one.
        unsafe {
            let mut change: libc::timex = mem::zeroed();
            change.modes = libc::ADJ_TICK;
            change.tick = 10_000;
            libc::adjtimex(&mut change) >= 0
        }
    }),
    ("account for processes", Harm::Some, |_| got_through(call(libc::SYS_acct, [0, 0, 0, 0, 0]))),
    ("swap to a file of its own", Harm::Some, |_| {
        got_through(call(libc::SYS_swapon, [address(c"x"), 0, 0, 0, 0]))
    }),
    ("read the kernel's log", Harm::None, |_| call(libc::SYS_syslog, [10, 0, 0, 0, 0]) >= 0),
    ("open a file by its handle", Harm::Some, |_| {
        let handle = [8u32, 1, 2, 0];
        got_through(call(libc::SYS_open_by_handle_at, [0, handle.as_ptr() as c_long, 0, 0, 0]))
    }),
    ("watch all files", Harm::None, |_| call(libc::SYS_fanotify_init, [0, 0, 0, 0, 0]) >= 0),
    ("open a socket to the host beneath", Harm::None, |_| socket(libc::AF_VSOCK, libc::SOCK_STREAM)),
    ("open a socket to the kernel's ciphers", Harm::None, |_| socket(libc::AF_ALG, libc::SOCK_SEQPACKET)),
    ("open a packet socket", Harm::None, |_| socket(libc::AF_PACKET, libc::SOCK_RAW)),
    ("open a raw socket", Harm::None, |_| socket(libc::AF_INET, libc::SOCK_RAW)),
    ("take a port of the system", Harm::None, |_| std::net::UdpSocket::bind("0.0.0.0:7").is_ok()),
    ("keep others from the processor", Harm::Some, |_| {
        let param = libc::sched_param { sched_priority: 50 };
        // SAFETY: the pointer is to a live sched_param.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &param) == 0 }
    }),
    ("rename the host", Harm::Some, |_| {
        // SAFETY: the pointer is to so many live bytes.
        unsafe { libc::sethostname(c"escaped".as_ptr(), 7) == 0 }
    }),
    ("use the machine's ports", Harm::None, |_| {
        #[cfg(target_arch = "x86_64")]
        return call(libc::SYS_iopl, [3, 0, 0, 0, 0]) == 0 || call(libc::SYS_ioperm, [0x80, 1, 1, 0, 0]) == 0;
        #[cfg(not(target_arch = "x86_64"))]
        return false;
    }),
    ("use a descriptor that was left open", Harm::None, |_| {
        // SAFETY: takes no pointer.
        (3..1024).any(|fd| unsafe { libc::fcntl(fd, libc::F_GETFD) } != -1)
    }),
];

/// Tries all ways, or only the harmless ones, and prints the result of each.
pub fn attempt_all(harmful: bool) -> ExitCode {
    let facts = Facts::from_environment();
    for (name, harm, way) in WAYS.iter().filter(|(_, harm, _)| harmful || *harm == Harm::None) {
        let _ = harm;
        // SAFETY: this process has one thread.
        let escaped = unsafe {
            match libc::fork() {
                0 => libc::_exit(c_int::from(way(&facts))),
                child => {
                    let mut status = 0;
                    libc::waitpid(child, &mut status, 0);
                    libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 1
                }
            }
        };
        println!("{name}: {}", if escaped { "ESCAPED" } else { "held" });
    }
    println!("all were tried");
    ExitCode::SUCCESS
}

/// Creates a segment in this process's own IPC namespace.
pub fn make_shared_memory() -> c_int {
    // SAFETY: takes no pointer.
    let id = unsafe { libc::shmget(libc::IPC_PRIVATE, 4096, 0o666) };
    assert!(id != -1, "{}", io::Error::last_os_error());
    id
}

pub fn remove_shared_memory(id: c_int) {
    // SAFETY: this command takes no pointer.
    unsafe { libc::shmctl(id, libc::IPC_RMID, ptr::null_mut()) };
}

/// Whether there is a file beneath that others may not read and this process may.
fn reads_what_only_root_may(folder: &Path) -> bool {
    fs::read_dir(folder).into_iter().flatten().flatten().any(|entry| {
        let Ok(its) = entry.metadata() else { return false };
        let is_own = its.permissions().mode() & 0o4 == 0;
        (its.is_file() && is_own && its.len() > 0 && File::open(entry.path()).is_ok())
            || (its.is_dir() && reads_what_only_root_may(&entry.path()))
    })
}

fn path(path: &Path) -> CString {
    CString::new(path.as_os_str().as_bytes()).unwrap()
}

fn address(text: &'static std::ffi::CStr) -> c_long {
    text.as_ptr() as c_long
}

/// Makes a system call whose arguments are live, or none.
fn call(number: c_long, [a, b, c, d, e]: [c_long; 5]) -> c_long {
    // SAFETY: what each takes is given where it is called.
    unsafe { libc::syscall(number, a, b, c, d, e) }
}

/// Whether the kernel processed the request instead of rejecting the caller.
fn got_through(result: c_long) -> bool {
    let error = io::Error::last_os_error().raw_os_error();
    result >= 0 || !matches!(error, Some(libc::EPERM | libc::EACCES | libc::ENOSYS))
}

fn socket(family: c_int, kind: c_int) -> bool {
    // SAFETY: takes no pointer.
    unsafe { libc::socket(family, kind, 0) >= 0 }
}

/// Returns the visible processes except for this one.
fn processes() -> impl Iterator<Item = u32> {
    let all = fs::read_dir("/proc").into_iter().flatten().flatten();
    all.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).filter(|pid| *pid != std::process::id())
}

/// Whether this process sees those of the whole machine: then process 1 is not the node's init.
fn is_outermost() -> bool {
    fs::read_to_string("/proc/1/comm").is_ok_and(|name| name.trim() != "cotorra-init")
}

fn enter(path: &str, kind: c_int, wanted: &Path) -> bool {
    fs::read_link(path).is_ok_and(|to| to == wanted) && set_namespace(Path::new(path), kind)
}

fn set_namespace(path: &Path, kind: c_int) -> bool {
    // SAFETY: takes no pointer.
    File::open(path).is_ok_and(|file| unsafe { libc::setns(file.as_raw_fd(), kind) == 0 })
}
