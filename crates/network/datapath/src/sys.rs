//! System calls missing from the standard library, each behind a safe signature. All unsafe code of the project is
//! here and in [`crate::init`]. This module knows nothing of the fabric.

mod packet;

use std::{
    ffi::{CStr, CString},
    fs::File,
    io, mem,
    os::{
        fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd},
        unix::{fs::OpenOptionsExt, process::ExitStatusExt},
    },
    path::Path,
    process::ExitStatus,
    sync::OnceLock,
    time::Duration,
};

use libc::{c_int, c_short, c_uint, c_ulong, c_void};

pub(crate) use packet::{
    Interface, bind_filtered, interface, overflows, packet_socket, read_datagram_with_age,
    read_frame_with_age, read_with_age, stamp_arrivals, stamped_packet_socket, unbound_packet_socket,
};

/// Turns the -1 of a system call into its error.
pub(crate) fn check(result: c_int) -> io::Result<c_int> {
    if result == -1 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

fn check_len(result: isize) -> io::Result<usize> {
    usize::try_from(result).map_err(|_| io::Error::last_os_error())
}

/// # Safety
/// `result` is the return value of a system call that makes a descriptor.
unsafe fn own(result: c_int) -> io::Result<OwnedFd> {
    // SAFETY: the descriptor is new, so that no other value owns it.
    check(result).map(|fd| unsafe { OwnedFd::from_raw_fd(fd) })
}

/// Converts a path for the kernel.
pub(crate) fn c_path(path: &Path) -> io::Result<CString> {
    use std::os::unix::ffi::OsStrExt;
    Ok(CString::new(path.as_os_str().as_bytes())?)
}

/// `geteuid`, `getegid`.
pub(crate) fn effective_ids() -> (u32, u32) {
    // SAFETY: both only return a number, and cannot fail.
    unsafe { (libc::geteuid(), libc::getegid()) }
}

/// Sets the rights that new files do not get, for the threads that share the caller's root folder, and returns the former
/// ones.
pub(crate) fn set_umask(mode: u32) -> u32 {
    // SAFETY: takes no pointer, and cannot fail.
    unsafe { libc::umask(mode) }
}

/// `unshare` for the calling thread.
pub(crate) fn unshare(flags: c_int) -> io::Result<()> {
    // SAFETY: takes no pointer.
    check(unsafe { libc::unshare(flags) }).map(drop)
}

/// `setns` for the calling thread.
pub(crate) fn setns(namespace: BorrowedFd<'_>, kind: c_int) -> io::Result<()> {
    // SAFETY: takes no pointer, and the descriptor is open.
    check(unsafe { libc::setns(namespace.as_raw_fd(), kind) }).map(drop)
}

/// Returns the process that listens on the other end of a connected Unix socket, by its number here (`SO_PEERCRED`); 0 if
/// this PID namespace does not show it.
pub(crate) fn listening_process(socket: BorrowedFd<'_>) -> io::Result<c_int> {
    let mut peer = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut length = mem::size_of_val(&peer) as libc::socklen_t;
    let to = (&raw mut peer).cast();
    // SAFETY: the kernel writes at most `length` bytes, which is the size of `peer`.
    check(unsafe {
        libc::getsockopt(socket.as_raw_fd(), libc::SOL_SOCKET, libc::SO_PEERCRED, to, &mut length)
    })?;
    Ok(peer.pid)
}

/// `pidfd_open`.
pub(crate) fn open_process(process: c_int) -> io::Result<OwnedFd> {
    // SAFETY: takes no pointer, and makes a descriptor.
    unsafe { own(libc::syscall(libc::SYS_pidfd_open, process, 0) as c_int) }
}

/// `clock_getcpuclockid` and `clock_gettime`: the CPU time of all threads of a process.
pub(crate) fn cpu_time(process: c_int) -> io::Result<Duration> {
    let mut clock = 0;
    // SAFETY: writes to `clock`, which outlives the call.
    match unsafe { libc::clock_getcpuclockid(process, &raw mut clock) } {
        0 => {}
        error => return Err(io::Error::from_raw_os_error(error)),
    }
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: writes to `time`, which outlives the call.
    check(unsafe { libc::clock_gettime(clock, &raw mut time) })?;
    Ok(Duration::new(time.tv_sec.cast_unsigned(), time.tv_nsec as u32))
}

/// `sysconf(_SC_CLK_TCK)`.
pub(crate) fn ticks_per_second() -> u32 {
    // SAFETY: takes no pointer, and cannot fail for this name.
    unsafe { libc::sysconf(libc::_SC_CLK_TCK) as u32 }
}

/// `pidfd_send_signal`.
pub(crate) fn send_signal(process: BorrowedFd<'_>, signal: c_int) -> io::Result<()> {
    let nothing = std::ptr::null::<c_void>();
    // SAFETY: the descriptor is open, and without a `siginfo_t` the kernel makes its own.
    let sent = unsafe { libc::syscall(libc::SYS_pidfd_send_signal, process.as_raw_fd(), signal, nothing, 0) };
    check(sent as c_int).map(drop)
}

/// Signals to this process that mean another one, and SIGCHLD. While this lives, they wait for [`Self::wait`].
pub(crate) struct Signals {
    blocked: libc::sigset_t,
    before: libc::sigset_t,
}

/// A signal to this process.
pub(crate) struct Signal {
    pub(crate) number: c_int,
    /// Whether a process sent it. Else the kernel did, to a whole process group, as at Ctrl-C.
    pub(crate) is_sent: bool,
}

impl Signals {
    const NUMBERS: [c_int; 8] = [
        libc::SIGCHLD,
        libc::SIGHUP,
        libc::SIGINT,
        libc::SIGQUIT,
        libc::SIGTERM,
        libc::SIGUSR1,
        libc::SIGUSR2,
        // Else it would stop whoever takes the terminal back.
        libc::SIGTTOU,
    ];

    /// Blocks them for the calling thread, which must be the only one.
    pub(crate) fn block() -> io::Result<Self> {
        // SAFETY: a sigset_t is integers, for which zero is a value; the calls fill and apply live ones.
        unsafe {
            let (mut blocked, mut before): (libc::sigset_t, libc::sigset_t) = (mem::zeroed(), mem::zeroed());
            libc::sigemptyset(&mut blocked);
            for number in Self::NUMBERS {
                libc::sigaddset(&mut blocked, number);
            }
            check(libc::sigprocmask(libc::SIG_BLOCK, &blocked, &mut before))?;
            Ok(Self { blocked, before })
        }
    }

    /// Returns what was blocked before. No thread may unblock the others while it starts a program: a signal to this process
    /// would end it.
    pub(crate) fn before(&self) -> libc::sigset_t {
        self.before
    }

    /// Waits for the next one.
    pub(crate) fn wait(&self) -> io::Result<Signal> {
        loop {
            // SAFETY: a siginfo_t is integers, for which zero is a value; both pointers are to live structures.
            let (waited, info) = unsafe {
                let mut info: libc::siginfo_t = mem::zeroed();
                (check(libc::sigwaitinfo(&self.blocked, &mut info)), info)
            };
            match waited {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                number => return Ok(Signal { number: number?, is_sent: info.si_code <= 0 }),
            }
        }
    }
}

impl Drop for Signals {
    fn drop(&mut self) {
        // SAFETY: the set is live.
        unsafe { libc::sigprocmask(libc::SIG_SETMASK, &self.before, std::ptr::null_mut()) };
    }
}

/// The terminal at standard input, if this process is in its foreground.
pub(crate) struct Terminal(());

impl Terminal {
    pub(crate) fn of_foreground() -> Option<Self> {
        // SAFETY: these calls take no pointers.
        unsafe { libc::tcgetpgrp(libc::STDIN_FILENO) == libc::getpgrp() }.then_some(Self(()))
    }

    /// Brings this process back to the foreground. It must have blocked SIGTTOU.
    pub(crate) fn take_back(&self) {
        // SAFETY: these calls take no pointers. It fails if the terminal is gone.
        unsafe { libc::tcsetpgrp(libc::STDIN_FILENO, libc::getpgrp()) };
    }
}

/// Waits until a descriptor can be read, or was closed on the other side (`poll`).
pub(crate) fn wait_readable(file: BorrowedFd<'_>) -> io::Result<()> {
    let mut wait = libc::pollfd { fd: file.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    loop {
        // SAFETY: the array has one element, and the descriptor is open.
        match check(unsafe { libc::poll(&raw mut wait, 1, -1) }) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            done => return done.map(drop),
        }
    }
}

/// Returns the user namespace that owns a namespace (`NS_GET_USERNS`).
pub(crate) fn owner_of(namespace: BorrowedFd<'_>) -> io::Result<OwnedFd> {
    const NS_GET_USERNS: c_ulong = 0xb701;
    // SAFETY: this request takes no argument and makes a descriptor.
    unsafe { own(libc::ioctl(namespace.as_raw_fd(), NS_GET_USERNS)) }
}

/// `mount` without data.
pub(crate) fn mount(source: &CStr, target: &CStr, kind: Option<&CStr>, flags: c_ulong) -> io::Result<()> {
    let kind = kind.map_or(std::ptr::null(), CStr::as_ptr);
    // SAFETY: all strings end in a zero and outlive the call; no file system here takes data.
    check(unsafe { libc::mount(source.as_ptr(), target.as_ptr(), kind, flags, std::ptr::null()) }).map(drop)
}

/// Mounts an empty in-memory file system with these options.
pub(crate) fn mount_tmpfs(on: &Path, options: &str) -> io::Result<()> {
    let (on, options) = (c_path(on)?, CString::new(options)?);
    let tmpfs = c"tmpfs".as_ptr();
    let flags = libc::MS_NOSUID | libc::MS_NODEV;
    // SAFETY: all strings end in a zero and outlive the call.
    check(unsafe { libc::mount(tmpfs, on.as_ptr(), tmpfs, flags, options.as_ptr().cast()) }).map(drop)
}

/// Unmounts a file system at once from the path, and for good when its last user is gone.
pub(crate) fn unmount(path: &CStr) -> io::Result<()> {
    // SAFETY: the path ends in a zero.
    check(unsafe { libc::umount2(path.as_ptr(), libc::MNT_DETACH) }).map(drop)
}

/// Returns a detached copy of the mount at a path, including mounts below (`open_tree`).
pub(crate) fn open_tree(path: &Path) -> io::Result<OwnedFd> {
    let path = c_path(path)?;
    let flags = libc::OPEN_TREE_CLONE
        | libc::OPEN_TREE_CLOEXEC
        | libc::AT_RECURSIVE as c_uint
        | libc::AT_SYMLINK_NOFOLLOW as c_uint;
    // SAFETY: the path ends in a zero; the call makes a descriptor.
    unsafe { own(libc::syscall(libc::SYS_open_tree, libc::AT_FDCWD, path.as_ptr(), flags) as c_int) }
}

/// Mounts a copy made by [`open_tree`].
pub(crate) fn move_mount(tree: BorrowedFd<'_>, to: &Path) -> io::Result<()> {
    const FROM_DESCRIPTOR: c_uint = 0x4;
    let to = c_path(to)?;
    // SAFETY: the strings end in a zero, and the descriptor is open.
    let moved = unsafe {
        let nothing = c"".as_ptr();
        let here = libc::AT_FDCWD;
        libc::syscall(libc::SYS_move_mount, tree.as_raw_fd(), nothing, here, to.as_ptr(), FROM_DESCRIPTOR)
    };
    check(moved as c_int).map(drop)
}

/// Restrictions of a mount (`MOUNT_ATTR_…`).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attributes(u64);

impl Attributes {
    pub(crate) const READ_ONLY: Self = Self(0x1);
    pub(crate) const NO_SUID: Self = Self(0x2);
    pub(crate) const NO_DEV: Self = Self(0x4);
    pub(crate) const NO_EXEC: Self = Self(0x8);
}

impl std::ops::BitOr for Attributes {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Adds restrictions to a mount and all mounts below: a detached one, or the one at the path.
pub(crate) fn set_mount_attributes(
    tree: Option<BorrowedFd<'_>>,
    path: &Path,
    attributes: Attributes,
) -> io::Result<()> {
    let path = c_path(path)?;
    let change = libc::mount_attr { attr_set: attributes.0, attr_clr: 0, propagation: 0, userns_fd: 0 };
    let (at, below) = match tree {
        Some(tree) => (tree.as_raw_fd(), libc::AT_EMPTY_PATH | libc::AT_RECURSIVE),
        None => (libc::AT_FDCWD, 0),
    };
    let size = mem::size_of_val(&change);
    // SAFETY: the path ends in a zero, and the pointer is to a live mount_attr of the size given.
    check(
        unsafe { libc::syscall(libc::SYS_mount_setattr, at, path.as_ptr(), below, &raw const change, size) }
            as c_int,
    )
    .map(drop)
}

/// Makes the working directory, which is a mount, the root. The old root stays mounted over it.
pub(crate) fn pivot_root_here() -> io::Result<()> {
    // SAFETY: the strings end in a zero.
    check(unsafe { libc::syscall(libc::SYS_pivot_root, c".".as_ptr(), c".".as_ptr()) } as c_int).map(drop)
}

/// File access rules for a thread (Landlock, Linux 5.13).
pub(crate) struct Access {
    rules: OwnedFd,
    version: c_int,
}

impl Access {
    const EXECUTE: u64 = 1;
    const WRITE_FILE: u64 = 1 << 1;
    const READ_FILE: u64 = 1 << 2;
    const READ_FOLDER: u64 = 1 << 3;
    const MAKE_CHARACTER_DEVICE: u64 = 1 << 6;
    const MAKE_BLOCK_DEVICE: u64 = 1 << 11;
    const IOCTL: u64 = 1 << 15;
    /// Signals to processes outside.
    const SCOPE_SIGNAL: u64 = 1 << 1;

    /// Creates rules that allow nothing; `None` if the kernel has no Landlock.
    pub(crate) fn new() -> io::Result<Option<Self>> {
        const VERSION: c_uint = 1;
        let none = std::ptr::null::<c_void>();
        // SAFETY: with this flag the call takes no attributes.
        let version =
            unsafe { libc::syscall(libc::SYS_landlock_create_ruleset, none, 0usize, VERSION) } as c_int;
        if version < 1 {
            return Ok(None);
        }
        let scoped = if version >= 6 { Self::SCOPE_SIGNAL } else { 0 };
        // Files, network, scopes. Older kernels know the first, or the first two.
        let attributes = [Self::files(version), 0, scoped];
        let size = mem::size_of::<u64>() * if version >= 6 { 3 } else { 1 };
        // SAFETY: the pointer is to that many live bytes at least; the call makes a descriptor.
        let rules = unsafe {
            own(libc::syscall(libc::SYS_landlock_create_ruleset, attributes.as_ptr(), size, 0) as c_int)?
        };
        Ok(Some(Self { rules, version }))
    }

    /// Returns all file rights that a Landlock version knows.
    fn files(version: c_int) -> u64 {
        let count = match version {
            1 => 13,
            2 => 14,
            3 | 4 => 15,
            _ => 16,
        };
        (1 << count) - 1
    }

    fn allow(&self, path: &Path, access: u64) -> io::Result<()> {
        #[repr(C, packed)]
        struct PathBeneath {
            access: u64,
            parent: RawFd,
        }
        const PATH_BENEATH: c_uint = 1;
        let parent = File::options().read(true).custom_flags(libc::O_PATH).open(path)?;
        let rule = PathBeneath { access: access & Self::files(self.version), parent: parent.as_raw_fd() };
        // SAFETY: the pointer is to a live attribute of that kind, whose descriptor is open.
        check(unsafe {
            let (rules, rule) = (self.rules.as_raw_fd(), &raw const rule);
            libc::syscall(libc::SYS_landlock_add_rule, rules, PATH_BENEATH, rule, 0)
        } as c_int)
        .map(drop)
    }

    /// Allows reading and executing everything beneath a folder.
    pub(crate) fn allow_reading(&self, folder: &Path) -> io::Result<()> {
        self.allow(folder, Self::EXECUTE | Self::READ_FILE | Self::READ_FOLDER)
    }

    /// Allows writing beneath a folder, except for devices.
    pub(crate) fn allow_writing(&self, folder: &Path) -> io::Result<()> {
        self.allow(folder, !(Self::MAKE_CHARACTER_DEVICE | Self::MAKE_BLOCK_DEVICE | Self::IOCTL))
    }

    /// Allows reading and writing a file.
    pub(crate) fn allow_using(&self, file: &Path) -> io::Result<()> {
        self.allow(file, Self::READ_FILE | Self::WRITE_FILE)
    }
}

impl From<Access> for OwnedFd {
    fn from(access: Access) -> Self {
        access.rules
    }
}

/// Hides this process's memory from other processes of the same user, and keeps the kernel from dumping it to disk.
pub(crate) fn set_not_dumpable() -> io::Result<()> {
    // SAFETY: takes no pointer.
    check(unsafe { libc::prctl(libc::PR_SET_DUMPABLE, 0 as c_ulong) }).map(drop)
}

/// Sets the host name of the calling thread's UTS namespace.
pub(crate) fn set_hostname(name: &str) -> io::Result<()> {
    // SAFETY: the pointer is to so many live bytes.
    check(unsafe { libc::sethostname(name.as_ptr().cast(), name.len()) }).map(drop)
}

/// Returns the index of an interface in the calling thread's network namespace.
pub(crate) fn interface_index(name: &str) -> io::Result<u32> {
    let name = CString::new(name)?;
    // SAFETY: the name ends in a zero.
    match unsafe { libc::if_nametoindex(name.as_ptr()) } {
        0 => Err(io::Error::last_os_error()),
        index => Ok(index),
    }
}

/// Raises the limit of open files to the hard limit, and returns the original limit.
pub(crate) fn raise_open_files() -> Option<libc::rlimit> {
    static AT_FIRST: OnceLock<Option<libc::rlimit>> = OnceLock::new();
    *AT_FIRST.get_or_init(|| {
        // SAFETY: an rlimit is two integers, for which zero is a value.
        let mut limit: libc::rlimit = unsafe { mem::zeroed() };
        // SAFETY: the pointer is to a live rlimit.
        check(unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) }).ok()?;
        let raised = libc::rlimit { rlim_cur: limit.rlim_max, ..limit };
        // SAFETY: as above.
        check(unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &raised) }).ok()?;
        Some(limit)
    })
}

/// Returns the limit of open files.
pub(crate) fn open_files_limit() -> io::Result<u64> {
    // SAFETY: an rlimit is two integers, for which zero is a value.
    let mut limit: libc::rlimit = unsafe { mem::zeroed() };
    // SAFETY: the pointer is to a live rlimit.
    check(unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) })?;
    Ok(limit.rlim_cur)
}

/// Tries an `unshare` in a process of its own, without effect on this one.
pub(crate) fn try_unshare(flags: c_int) -> io::Result<()> {
    // SAFETY: the new process makes two async-signal-safe calls and ends.
    let child = check(unsafe {
        match libc::fork() {
            0 if libc::unshare(flags) == 0 => libc::_exit(0),
            0 => libc::_exit(*libc::__errno_location()),
            child => child,
        }
    })?;
    let mut status = 0;
    // SAFETY: the pointer is to a live integer.
    check(unsafe { libc::waitpid(child, &mut status, 0) })?;
    test_result(ExitStatus::from_raw(status))
}

/// Converts the exit status of a process that test_result something. Its exit code is the error's number.
fn test_result(status: ExitStatus) -> io::Result<()> {
    match status.code() {
        Some(0) => Ok(()),
        Some(error) => Err(io::Error::from_raw_os_error(error)),
        None => Err(io::Error::other("the process that tested it was killed")),
    }
}

/// Lets the calling thread's timers fire to the nanosecond.
pub(crate) fn set_least_timer_slack() -> io::Result<()> {
    // SAFETY: takes no pointer.
    check(unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1 as c_ulong) }).map(drop)
}

/// Sets `SCHED_FIFO` for the calling thread at this priority. Threads and processes that it starts do not inherit it.
pub(crate) fn set_fifo(priority: c_int) -> io::Result<()> {
    let param = libc::sched_param { sched_priority: priority };
    // SAFETY: the pointer is to a live sched_param; 0 is the calling thread.
    check(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, &param) })
        .map(drop)
}

/// Sets `SCHED_IDLE` for the calling thread: it runs only on otherwise idle cores. Always permitted.
pub(crate) fn set_idle() -> io::Result<()> {
    let param = libc::sched_param { sched_priority: 0 };
    // SAFETY: the pointer is to a live sched_param; 0 is the calling thread.
    check(unsafe { libc::sched_setscheduler(0, libc::SCHED_IDLE, &param) }).map(drop)
}

/// Returns the cores that the calling thread may run on.
pub(crate) fn allowed_cores() -> io::Result<Vec<usize>> {
    // SAFETY: a set of no cores is all zeros.
    let mut set: libc::cpu_set_t = unsafe { mem::zeroed() };
    // SAFETY: the pointer is to a live set of that size; 0 is the calling thread.
    check(unsafe { libc::sched_getaffinity(0, mem::size_of_val(&set), &mut set) })?;
    let most = 8 * mem::size_of_val(&set);
    // SAFETY: every number is within the set.
    Ok((0..most).filter(|&core| unsafe { libc::CPU_ISSET(core, &set) }).collect())
}

/// Keeps the calling thread on one core.
pub(crate) fn pin(core: usize) -> io::Result<()> {
    // SAFETY: a set of no cores is all zeros.
    let mut set: libc::cpu_set_t = unsafe { mem::zeroed() };
    if core >= 8 * mem::size_of_val(&set) {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    // SAFETY: the number is within the set.
    unsafe { libc::CPU_SET(core, &mut set) };
    // SAFETY: the pointer is to a live set of that size; 0 is the calling thread.
    check(unsafe { libc::sched_setaffinity(0, mem::size_of_val(&set), &set) }).map(drop)
}

/// Asks the fair scheduler for the shortest slice, so that the calling thread runs soon after it wakes. Linux 6.12
/// and later; earlier ones ignore it. Always permitted.
pub(crate) fn set_short_slice() -> io::Result<()> {
    #[repr(C)]
    struct SchedAttr {
        size: u32,
        policy: u32,
        flags: u64,
        nice: i32,
        priority: u32,
        runtime: u64,
        deadline: u64,
        period: u64,
    }
    let attr = SchedAttr {
        size: mem::size_of::<SchedAttr>() as u32,
        policy: libc::SCHED_OTHER as u32,
        flags: 0,
        nice: 0,
        priority: 0,
        runtime: 100_000,
        deadline: 0,
        period: 0,
    };
    // SAFETY: the pointer is to a live sched_attr of the size that it states; 0 is the calling thread.
    check(unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attr, 0) } as c_int).map(drop)
}

/// Makes a TAP from an open `/dev/net/tun`, in the network namespace in which that was opened. Its frames carry a
/// `virtio_net_hdr`, and it has all offloads that the kernel knows.
pub(crate) fn make_tap(device: &File, name: &CStr) -> io::Result<()> {
    const TUNSETOFFLOAD: c_ulong = 0x4004_54d0;
    const TUNSETIFF: c_ulong = 0x4004_54ca;
    const TUNSETPERSIST: c_ulong = 0x4004_54cb;
    const CSUM: c_uint = 0x01;
    const TSO4: c_uint = 0x02;
    const TSO6: c_uint = 0x04;
    const TSO_ECN: c_uint = 0x08;
    const USO4: c_uint = 0x20;
    const USO6: c_uint = 0x40;

    // SAFETY: an ifreq is integers and bytes, for which zero is a value.
    let mut request: libc::ifreq = unsafe { mem::zeroed() };
    for (to, from) in request.ifr_name.iter_mut().zip(name.to_bytes()) {
        *to = *from as libc::c_char;
    }
    request.ifr_ifru.ifru_flags = (libc::IFF_TAP | libc::IFF_NO_PI | libc::IFF_VNET_HDR) as c_short;
    // SAFETY: the request takes a pointer to an ifreq, and this one lives.
    check(unsafe { libc::ioctl(device.as_raw_fd(), TUNSETIFF, &mut request) })?;
    // The kernel removes a TAP that closes with its descriptor alone, in 30 ms. A persistent one is removed with its
    // namespace, many at a time. No other process holds the namespace, so no TAP outlives the process.
    // SAFETY: the request takes an integer.
    check(unsafe { libc::ioctl(device.as_raw_fd(), TUNSETPERSIST, 1 as c_ulong) })?;
    let tso = CSUM | TSO4 | TSO6 | TSO_ECN;
    // UDP segmentation came with Linux 6.2. Without it the kernel segments before it hands frames over.
    for offloads in [tso | USO4 | USO6, tso] {
        // SAFETY: the request takes an integer.
        match check(unsafe { libc::ioctl(device.as_raw_fd(), TUNSETOFFLOAD, c_ulong::from(offloads)) }) {
            Err(e) if e.raw_os_error() == Some(libc::EINVAL) => {}
            result => return result.map(drop),
        }
    }
    Err(io::Error::from_raw_os_error(libc::EINVAL))
}

/// Restricts an interface in the calling thread's network namespace to the transmit offloads named in `keep`, as
/// `ethtool -K` does. `socket` is any socket opened there.
pub(crate) fn restrict_offloads(socket: BorrowedFd<'_>, interface: &CStr, keep: &[&str]) -> io::Result<()> {
    const SIOCETHTOOL: c_ulong = 0x8946;
    const GSSET_INFO: u32 = 0x37;
    const GSTRINGS: u32 = 0x1b;
    const SFEATURES: u32 = 0x3b;
    const FEATURES: u32 = 4;
    const NAME: usize = 32;

    let ethtool = |request: &mut [u32]| {
        // SAFETY: an ifreq is integers and bytes, for which zero is a value.
        let mut message: libc::ifreq = unsafe { mem::zeroed() };
        for (to, from) in message.ifr_name.iter_mut().zip(interface.to_bytes()) {
            *to = *from as libc::c_char;
        }
        message.ifr_ifru.ifru_data = request.as_mut_ptr().cast();
        // SAFETY: the request points to a live ifreq, and that to a live buffer. The buffer has room for all that the
        // command in its first word reads and writes, as stated where it is made.
        check(unsafe { libc::ioctl(socket.as_raw_fd(), SIOCETHTOOL, &mut message) })
    };
    // Command, reserved, mask of sets (64 bits), then one length for the requested set.
    let mut length = [GSSET_INFO, 0, 1 << FEATURES, 0, 0];
    ethtool(&mut length)?;
    let count = length[4] as usize;
    // Command, set, count, then as many names of 32 bytes.
    let mut names = vec![0; 3 + count * NAME / 4];
    names[..3].copy_from_slice(&[GSTRINGS, FEATURES, count as u32]);
    ethtool(&mut names)?;
    // Command, blocks, then for each block of 32 features a mask of those to change and a mask of their values.
    let blocks = count.div_ceil(32);
    let mut change = vec![0; 2 + blocks * 2];
    change[..2].copy_from_slice(&[SFEATURES, blocks as u32]);
    for (i, name) in names[3..].chunks_exact(NAME / 4).enumerate() {
        let bytes: Vec<u8> = name.iter().flat_map(|word| word.to_ne_bytes()).collect();
        let name = CStr::from_bytes_until_nul(&bytes).unwrap_or_default().to_string_lossy();
        // Before Linux 6.12 this was listed as a feature but could not be changed.
        if name.starts_with("tx-") && name != "tx-lockless" && !keep.contains(&name.as_ref()) {
            change[2 + i / 32 * 2] |= 1 << (i % 32);
        }
    }
    ethtool(&mut change).map(drop)
}

fn set_option<T>(socket: &impl AsRawFd, level: c_int, option: c_int, value: &T) -> io::Result<()> {
    let size = mem::size_of::<T>() as libc::socklen_t;
    // SAFETY: the pointer is to a live value of the size given.
    check(unsafe {
        libc::setsockopt(socket.as_raw_fd(), level, option, std::ptr::from_ref(value).cast::<c_void>(), size)
    })
    .map(drop)
}

/// Waits for many descriptors at once, with nanosecond timeouts (`epoll_pwait2`, Linux 5.11).
pub(crate) struct Epoll {
    fd: OwnedFd,
    ready: Vec<libc::epoll_event>,
    was_interrupted: bool,
}

/// State of a descriptor found by [`Epoll`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ready {
    pub(crate) token: usize,
    pub(crate) readable: bool,
    pub(crate) writable: bool,
}

impl Epoll {
    pub(crate) fn new() -> io::Result<Self> {
        // SAFETY: takes no pointer and makes a descriptor.
        let fd = unsafe { own(libc::epoll_create1(libc::EPOLL_CLOEXEC))? };
        let ready = vec![libc::epoll_event { events: 0, u64: 0 }; 256];
        Ok(Self { fd, ready, was_interrupted: false })
    }

    fn control(&self, operation: c_int, fd: RawFd, token: usize, writable: bool) -> io::Result<()> {
        let events = (libc::EPOLLIN | if writable { libc::EPOLLOUT } else { 0 }) as u32;
        let mut event = libc::epoll_event { events, u64: token as u64 };
        // SAFETY: the pointer is to a live epoll_event.
        check(unsafe { libc::epoll_ctl(self.fd.as_raw_fd(), operation, fd, &mut event) }).map(drop)
    }

    /// Starts waiting for a descriptor to be readable.
    pub(crate) fn add(&self, fd: BorrowedFd<'_>, token: usize) -> io::Result<()> {
        self.control(libc::EPOLL_CTL_ADD, fd.as_raw_fd(), token, false)
    }

    /// Starts or stops waiting for it to be writable, too.
    pub(crate) fn set_writable(&self, fd: BorrowedFd<'_>, token: usize, writable: bool) -> io::Result<()> {
        self.control(libc::EPOLL_CTL_MOD, fd.as_raw_fd(), token, writable)
    }

    /// Stops waiting for it.
    pub(crate) fn remove(&self, fd: BorrowedFd<'_>) -> io::Result<()> {
        self.control(libc::EPOLL_CTL_DEL, fd.as_raw_fd(), 0, false)
    }

    /// Whether a signal ended the last wait, such as a stop and its end (signal(7)).
    pub(crate) fn was_interrupted(&self) -> bool {
        self.was_interrupted
    }

    /// Waits for at most `timeout`, for ever without one. A signal ends the wait with nothing ready.
    pub(crate) fn wait(&mut self, timeout: Option<Duration>) -> io::Result<impl Iterator<Item = Ready> + '_> {
        let timeout = timeout.map(|t| libc::timespec {
            tv_sec: t.as_secs().min(i32::MAX as u64) as libc::time_t,
            tv_nsec: t.subsec_nanos().into(),
        });
        let timeout = timeout.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
        // SAFETY: the array is live and as long as stated, the timeout is live or null, no signal mask is given.
        let count = check(unsafe {
            libc::syscall(
                libc::SYS_epoll_pwait2,
                self.fd.as_raw_fd(),
                self.ready.as_mut_ptr(),
                self.ready.len() as c_int,
                timeout,
                std::ptr::null::<libc::sigset_t>(),
                0usize,
            )
        } as c_int);
        self.was_interrupted = matches!(&count, Err(e) if e.kind() == io::ErrorKind::Interrupted);
        let count = if self.was_interrupted { 0 } else { count? as usize };
        Ok(self.ready[..count].iter().map(|event| Ready {
            token: event.u64 as usize,
            readable: event.events & !(libc::EPOLLOUT as u32) != 0,
            writable: event.events & libc::EPOLLOUT as u32 != 0,
        }))
    }
}

/// Wakes an [`Epoll`] from another thread.
pub(crate) struct Waker(File);

impl Waker {
    pub(crate) fn new() -> io::Result<Self> {
        // SAFETY: takes no pointer and makes a descriptor.
        unsafe { own(libc::eventfd(0, libc::EFD_CLOEXEC | libc::EFD_NONBLOCK)) }.map(|fd| Self(fd.into()))
    }

    /// Makes it readable. Only fails when it is readable already, 2^64 times.
    pub(crate) fn wake(&self) {
        use io::Write;
        let _ = (&self.0).write(&1u64.to_ne_bytes());
    }

    /// Makes it unreadable.
    pub(crate) fn clear(&self) {
        use io::Read;
        let _ = (&self.0).read(&mut [0; 8]);
    }
}

impl AsFd for Waker {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

/// Reads one frame behind its header: into the buffer up to its capacity, the rest into `spill`. Returns the frame's
/// length, which is above 0. A frame that fits neither is truncated.
pub(crate) fn read_frame(
    fd: BorrowedFd<'_>,
    header: &mut [u8],
    buffer: &mut Vec<u8>,
    spill: &mut [u8],
) -> io::Result<usize> {
    // SAFETY: the parts are live memory of the lengths stated; the kernel only writes to them.
    // The C library's function checks for thread cancellation first, which takes 4 % of the thread's time.
    fill_frame(header, buffer, spill, |parts| {
        check_len(unsafe {
            libc::syscall(libc::SYS_readv, fd.as_raw_fd(), parts.as_ptr(), parts.len()) as isize
        })
    })
}

/// Lets `receive` fill a header, the buffer up to its capacity, and `spill`, in this order. It returns the number of bytes
/// that it filled. Returns the length of the frame behind the header.
fn fill_frame(
    header: &mut [u8],
    buffer: &mut Vec<u8>,
    spill: &mut [u8],
    receive: impl FnOnce(&mut [libc::iovec]) -> io::Result<usize>,
) -> io::Result<usize> {
    buffer.clear();
    let room = buffer.capacity();
    let mut parts = [
        libc::iovec { iov_base: header.as_mut_ptr().cast(), iov_len: header.len() },
        libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: room },
        libc::iovec { iov_base: spill.as_mut_ptr().cast(), iov_len: spill.len() },
    ];
    let read = receive(&mut parts)?;
    let length = read.checked_sub(header.len()).filter(|l| *l > 0).ok_or(io::ErrorKind::UnexpectedEof)?;
    // SAFETY: the kernel filled the parts in order, so that this many bytes of the buffer are initialised.
    unsafe { buffer.set_len(length.min(room)) };
    Ok(length)
}

/// Writes one frame behind its header.
pub(crate) fn write_frame(fd: BorrowedFd<'_>, header: &[u8], frame: &[u8]) -> io::Result<()> {
    let part = |bytes: &[u8]| libc::iovec { iov_base: bytes.as_ptr() as *mut c_void, iov_len: bytes.len() };
    let parts = [part(header), part(frame)];
    // SAFETY: the parts are live memory of the lengths stated; the kernel only reads them.
    check_len(unsafe {
        libc::syscall(libc::SYS_writev, fd.as_raw_fd(), parts.as_ptr(), parts.len()) as isize
    })
    .map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn killed_tests_of_a_capability_do_not_succeed() {
        const EXITED_WITH_EPERM: c_int = libc::EPERM << 8;
        assert!(test_result(ExitStatus::from_raw(0)).is_ok());
        assert_eq!(
            test_result(ExitStatus::from_raw(EXITED_WITH_EPERM)).unwrap_err().raw_os_error(),
            Some(libc::EPERM)
        );
        assert!(test_result(ExitStatus::from_raw(libc::SIGSYS)).is_err());
    }
}
