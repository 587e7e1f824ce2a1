//! The init of a program in a node: the first process of its process namespace, running between fork and exec. It
//! waits for the program, passes signals on and reaps orphans. It ends when the program ends or its parent is gone,
//! and the kernel then kills everything left in the namespace.
//!
//! This code runs in a copy of a process with several threads. Only async-signal-safe calls are allowed: no
//! allocation, no lock, no destructor.

use std::{
    fs::File,
    io, mem,
    os::{
        fd::{AsRawFd, RawFd},
        unix::process::CommandExt,
    },
    process::Command,
    ptr,
};

use libc::{c_int, c_long, c_ulong, pid_t};

use crate::{confine::Restrictions, sys::check};

/// State of the init, prepared before the fork.
pub(crate) struct Init {
    /// Control groups to join, open for writing: inside, their paths may not resolve.
    pub(crate) cgroups: Vec<File>,
    /// The end of a pipe that hangs up when the parent is gone.
    pub(crate) lifeline: RawFd,
    /// Descriptor of another process (pidfd) that the program ends with; -1 if there is none.
    pub(crate) other: RawFd,
    /// The signals that the program begins with as blocked if it keeps this process's terminal; `None` gives it a session of its
    /// own, and what the calling thread blocks.
    pub(crate) with_terminal: Option<libc::sigset_t>,
    /// The program's limit of open files. A program that uses select(2) must not get descriptors above 1024.
    pub(crate) open_files: Option<libc::rlimit>,
    /// Whether the program's process number inside is that of its init outside.
    pub(crate) unique_number: bool,
    /// Maps of the user and the group of a user namespace in which this process makes the process namespace, because it has
    /// no right to make one outside.
    pub(crate) user_maps: Option<[String; 2]>,
    /// Confinement of the program. The spawning thread is already in its root folder.
    pub(crate) restrictions: Option<Restrictions>,
}

impl Init {
    /// Inserts an init before a command. Its next spawn must happen on a thread that unshared `CLONE_NEWPID`.
    pub(crate) fn before_exec_of(self, command: &mut Command) {
        // SAFETY: `split` keeps to async-signal-safe calls, as its own comments say.
        unsafe { command.pre_exec(move || self.split()) };
    }

    /// Forks. Returns in the program's process; the init never returns.
    ///
    /// # Safety
    /// To be called between fork and exec.
    unsafe fn split(&self) -> io::Result<()> {
        for group in &self.cgroups {
            // SAFETY: the pointer is to one live byte; write is async-signal-safe.
            check(unsafe { libc::write(group.as_raw_fd(), c"0".as_ptr().cast(), 1) } as c_int)?;
        }
        // SAFETY: as for this function.
        let number = if self.unique_number { unsafe { own_number() } } else { None };
        // SAFETY: a sigset_t is integers, for which zero is a value; the calls fill and apply a live one. Signals are
        // blocked because blocked signals reach signalfd even where the kernel would not deliver them to an init.
        let (signals, before) = unsafe {
            let mut signals: libc::sigset_t = mem::zeroed();
            let mut before: libc::sigset_t = mem::zeroed();
            libc::sigfillset(&mut signals);
            libc::sigprocmask(libc::SIG_SETMASK, &signals, &mut before);
            (signals, before)
        };
        if let Some(maps) = &self.user_maps {
            // SAFETY: as for this function. A process that unshares its process namespace stays outside: it waits for
            // the first one inside.
            unsafe {
                enter_user_namespace(maps)?;
                match fork(None)? {
                    0 => check(libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL as c_ulong))?,
                    inside => attend(inside, [self.lifeline, -1], &signals),
                };
            }
        }
        match &self.restrictions {
            // SAFETY: as for this function.
            Some(restrictions) => unsafe { close(restrictions)? },
            // SAFETY: all strings end in a zero. Where `/proc` cannot be mounted because parts of it are hidden
            // (containers), the program merely sees the processes outside.
            None => unsafe {
                if libc::unshare(libc::CLONE_NEWNS) == 0 {
                    let none = c"none".as_ptr();
                    libc::mount(none, c"/".as_ptr(), ptr::null(), libc::MS_REC | libc::MS_SLAVE, ptr::null());
                    mount_proc(0);
                }
            },
        }
        // SAFETY: this process has one thread; both sides go on with async-signal-safe calls only.
        match unsafe { fork(number)? } {
            0 => {
                // SAFETY: async-signal-safe, with live arguments.
                unsafe {
                    if self.with_terminal.is_none() {
                        check(libc::setsid())?;
                    }
                    let blocked = self.with_terminal.as_ref().unwrap_or(&before);
                    libc::sigprocmask(libc::SIG_SETMASK, blocked, std::ptr::null_mut());
                    if let Some(limit) = &self.open_files {
                        libc::setrlimit(libc::RLIMIT_NOFILE, limit);
                    }
                    if let Some(restrictions) = &self.restrictions {
                        restrict(restrictions)?;
                    }
                }
                Ok(())
            }
            // SAFETY: we are the parent of that process and have no other thread.
            program => unsafe {
                if self.with_terminal.is_some() {
                    // The program gets the terminal's signals itself.
                    libc::setpgid(0, 0);
                }
                attend(program, [self.lifeline, self.other], &signals)
            },
        }
    }
}

/// Enters a user namespace that maps the user and the group to themselves, and makes its children's process namespace.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn enter_user_namespace([user, group]: &[String; 2]) -> io::Result<()> {
    let files =
        [(c"/proc/self/setgroups", "deny"), (c"/proc/self/uid_map", user), (c"/proc/self/gid_map", group)];
    // SAFETY: async-signal-safe system calls, with paths that end in a zero and texts that are live and as long as stated.
    unsafe {
        check(libc::unshare(libc::CLONE_NEWUSER | libc::CLONE_NEWPID))?;
        for (path, text) in files {
            let file = check(libc::open(path.as_ptr(), libc::O_WRONLY | libc::O_CLOEXEC))?;
            check(libc::write(file, text.as_ptr().cast(), text.len()) as c_int)?;
            check(libc::close(file))?;
        }
    }
    Ok(())
}

/// Returns the number of this process outside of its process namespace, as long as it sees the old `/proc`.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn own_number() -> Option<pid_t> {
    let mut digits = [0u8; 16];
    // SAFETY: the path ends in a zero, and the array is live and as long as stated.
    let length = unsafe { libc::readlink(c"/proc/self".as_ptr(), digits.as_mut_ptr().cast(), digits.len()) };
    let digits = digits.get(..usize::try_from(length).ok()?)?;
    digits.iter().try_fold(0, |number: pid_t, digit| {
        let digit = pid_t::from(digit.checked_sub(b'0').filter(|digit| *digit < 10)?);
        number.checked_mul(10)?.checked_add(digit)
    })
}

/// Forks by the bare system call. The C library's fork takes its locks, which another thread may have held when this
/// process was made. The child gets the number, if it is given and the kernel can do that.
///
/// # Safety
/// Both sides may only make async-signal-safe calls.
unsafe fn fork(number: Option<pid_t>) -> io::Result<pid_t> {
    if let Some(number) = number {
        // SAFETY: the structure is integers, for which zero is a value.
        let mut arguments: libc::clone_args = unsafe { mem::zeroed() };
        arguments.exit_signal = libc::SIGCHLD as u64;
        arguments.set_tid = (&raw const number) as u64;
        arguments.set_tid_size = 1;
        let size = mem::size_of::<libc::clone_args>();
        // SAFETY: the arguments are live and as long as stated. Without CLONE_VM the child has a stack of its own.
        let forked = unsafe { libc::syscall(libc::SYS_clone3, &raw mut arguments, size) } as pid_t;
        if forked >= 0 {
            return Ok(forked);
        }
    }
    // SAFETY: without CLONE_VM the child has a stack of its own, so that none is given.
    check(unsafe { libc::syscall(libc::SYS_clone, libc::SIGCHLD as c_ulong, 0usize, 0usize, 0usize, 0usize) }
        as pid_t)
}

/// # Safety
/// To be called between fork and exec.
unsafe fn mount_proc(more_flags: c_ulong) {
    let flags = libc::MS_NOSUID | libc::MS_NODEV | libc::MS_NOEXEC | more_flags;
    let proc = c"proc".as_ptr();
    // SAFETY: all strings end in a zero.
    unsafe { libc::mount(proc, c"/proc".as_ptr(), proc, flags, ptr::null()) };
}

/// Unmounts the old root folder. `/proc` is an empty folder where the kernel rejects mounting it. It is read-only
/// because root needs no capability to write to `/proc/sys`.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn close(restrictions: &Restrictions) -> io::Result<()> {
    // SAFETY: async-signal-safe, with strings that end in a zero and open descriptors. Users with their own
    // namespaces may mount /proc only while they still see the old one.
    unsafe {
        // The init has a copy of our memory and stays visible to the program. For the program itself, exec undoes
        // this.
        check(libc::prctl(libc::PR_SET_DUMPABLE, 0 as c_ulong))?;
        mount_proc(libc::MS_RDONLY);
        let here = check(libc::open(c".".as_ptr(), libc::O_PATH | libc::O_CLOEXEC))?;
        check(libc::fchdir(restrictions.outside.as_raw_fd()))?;
        check(libc::umount2(c".".as_ptr(), libc::MNT_DETACH))?;
        check(libc::fchdir(here))?;
        check(libc::close(here))?;
    }
    Ok(())
}

/// Drops the calling process's rights for good.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn restrict(restrictions: &Restrictions) -> io::Result<()> {
    /// As `struct __user_cap_header_struct` and two of `struct __user_cap_data_struct`.
    #[repr(C)]
    struct Header {
        version: u32,
        pid: c_int,
    }
    const VERSION_3: u32 = 0x2008_0522;
    const MOST: u32 = 63;
    let system_call = |result: c_long| check(result as c_int);
    let has = |capability: u32| restrictions.capabilities & 1 << capability != 0;
    // SAFETY: async-signal-safe system calls, with live arguments of the layout that each takes.
    unsafe {
        let limit = |most: u64| libc::rlimit { rlim_cur: most, rlim_max: most };
        check(libc::setrlimit(libc::RLIMIT_CORE, &limit(0)))?;
        // Whoever started this process may have left descriptors inheritable.
        let (first, last) = (3u32, u32::MAX);
        system_call(libc::syscall(libc::SYS_close_range, first, last, libc::CLOSE_RANGE_CLOEXEC))?;
        if let Some([processes, bytes]) = restrictions.limits {
            check(libc::setrlimit(libc::RLIMIT_NPROC, &limit(processes)))?;
            check(libc::setrlimit(libc::RLIMIT_DATA, &limit(bytes)))?;
        }
        // Not permitted in a user namespace, and not needed there.
        libc::syscall(libc::SYS_setgroups, 0usize, ptr::null::<libc::gid_t>());
        for capability in (0..=MOST).filter(|capability| !has(*capability)) {
            match check(libc::prctl(libc::PR_CAPBSET_DROP, c_ulong::from(capability))) {
                // The kernel has no capability of that number.
                Err(error) if error.raw_os_error() == Some(libc::EINVAL) => break,
                done => done?,
            };
        }
        if let Some(user) = restrictions.user {
            become_user(user)?;
        }
        let halves = [restrictions.capabilities as u32, (restrictions.capabilities >> 32) as u32];
        let sets = halves.map(|half| [half; 3]);
        let header = Header { version: VERSION_3, pid: 0 };
        system_call(libc::syscall(libc::SYS_capset, &raw const header, sets.as_ptr()))?;
        for capability in (0..=MOST).filter(|capability| has(*capability)) {
            let raise = libc::PR_CAP_AMBIENT_RAISE as c_ulong;
            check(libc::prctl(
                libc::PR_CAP_AMBIENT,
                raise,
                c_ulong::from(capability),
                0 as c_ulong,
                0 as c_ulong,
            ))?;
        }
        let (on, none) = (1 as c_ulong, 0 as c_ulong);
        check(libc::prctl(libc::PR_SET_NO_NEW_PRIVS, on, none, none, none))?;
        if let Some(access) = &restrictions.access {
            system_call(libc::syscall(libc::SYS_landlock_restrict_self, access.as_raw_fd(), 0))?;
        }
        let program = libc::sock_fprog {
            len: restrictions.filter.len() as u16,
            filter: restrictions.filter.as_ptr().cast_mut(),
        };
        let set = libc::SECCOMP_SET_MODE_FILTER;
        system_call(libc::syscall(libc::SYS_seccomp, set, 0, &raw const program))?;
    }
    Ok(())
}

/// Becomes another user and group, and keeps the right to capabilities. The C library's calls would look for threads that
/// this process does not have.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn become_user(user: u32) -> io::Result<()> {
    // SAFETY: async-signal-safe system calls, with live arguments.
    unsafe {
        // Else the program could not open `/dev/stdout` and `/dev/stderr` by their names.
        for fd in 0..3 {
            let mut its: libc::stat = mem::zeroed();
            if libc::fstat(fd, &mut its) == 0 && its.st_mode & libc::S_IFMT == libc::S_IFIFO {
                libc::fchown(fd, user, user);
            }
        }
        check(libc::prctl(libc::PR_SET_KEEPCAPS, 1 as c_ulong, 0 as c_ulong, 0 as c_ulong, 0 as c_ulong))?;
        check(libc::syscall(libc::SYS_setresgid, user, user, user) as c_int)?;
        check(libc::syscall(libc::SYS_setresuid, user, user, user) as c_int)?;
    }
    Ok(())
}

/// Waits on the program's behalf.
///
/// # Safety
/// `program` is the calling process's child; the process has one thread and nothing to clean up.
unsafe fn attend(program: pid_t, [lifeline, other]: [RawFd; 2], signals: &libc::sigset_t) -> ! {
    const LIFELINE: RawFd = 0;
    const SIGNALS: RawFd = 1;
    const OTHER: RawFd = 2;
    // SAFETY: async-signal-safe calls with live arguments. All other descriptors are closed, above all the pipe
    // through which the standard library learns that exec succeeded, and copies of other lifelines.
    unsafe {
        libc::prctl(libc::PR_SET_NAME, c"cotorra-init".as_ptr());
        let from = libc::signalfd(-1, signals, 0);
        let free = from.max(lifeline).max(other) + 1;
        for (place, file) in (free..).zip([lifeline, from, other]) {
            libc::dup2(file, place);
        }
        // Without another process, poll skips the descriptor.
        let other = if other == -1 { -1 } else { OTHER };
        for (place, file) in (free..).zip([LIFELINE, SIGNALS, other]) {
            libc::dup2(place, file);
        }
        let (first, last) = (if other == -1 { OTHER } else { OTHER + 1 } as u32, u32::MAX);
        libc::syscall(libc::SYS_close_range, first, last, 0u32);
        loop {
            let mut wait =
                [LIFELINE, SIGNALS, other].map(|fd| libc::pollfd { fd, events: libc::POLLIN, revents: 0 });
            libc::poll(wait.as_mut_ptr(), wait.len() as libc::nfds_t, -1);
            if wait[0].revents != 0 || wait[2].revents != 0 {
                end_group(program);
                libc::_exit(128 + libc::SIGKILL);
            }
            let mut signal: libc::signalfd_siginfo = mem::zeroed();
            let size = mem::size_of::<libc::signalfd_siginfo>();
            if wait[1].revents == 0 || libc::read(SIGNALS, (&raw mut signal).cast(), size) != size as isize {
                continue;
            }
            if signal.ssi_signo as c_int == libc::SIGCHLD {
                reap(program);
            } else {
                // The program has no process group of its own at first.
                let signal = signal.ssi_signo as c_int;
                if libc::kill(-program, signal) == -1 {
                    libc::kill(program, signal);
                }
            }
        }
    }
}

/// Reaps every ended process, and exits with the program.
///
/// # Safety
/// As [`attend`].
unsafe fn reap(program: pid_t) {
    loop {
        let mut status = 0;
        // SAFETY: async-signal-safe calls with live arguments.
        unsafe {
            let ended = libc::waitpid(-1, &mut status, libc::WNOHANG);
            if ended <= 0 {
                return;
            }
            if ended == program {
                end_group(program);
            }
            if ended == program && libc::WIFSIGNALED(status) {
                libc::_exit(128 + libc::WTERMSIG(status));
            }
            if ended == program && libc::WIFEXITED(status) {
                libc::_exit(libc::WEXITSTATUS(status));
            }
        }
    }
}

/// Kills what the program started in its own process group. Without a process namespace, nothing else ends it.
///
/// # Safety
/// To be called between fork and exec.
unsafe fn end_group(program: pid_t) {
    // SAFETY: async-signal-safe, and takes no pointer. It fails if the program has no group, or nothing is left of it.
    unsafe { libc::kill(-program, libc::SIGKILL) };
}

/// Sends a signal to a child process that has not been waited for.
pub(crate) fn send(child: u32, signal: c_int) -> io::Result<()> {
    // SAFETY: takes no pointer.
    check(unsafe { libc::kill(child as pid_t, signal) }).map(drop)
}
