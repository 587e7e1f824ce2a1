//! What runs between fork and exec of a program in a node: the first process of its process namespace. It waits for
//! the program, passes signals on, reaps orphans, and ends when the program does or its parent is gone, whereupon the
//! kernel kills whatever is left in the namespace.
//!
//! A copy of a process with several threads runs here, so that only async-signal-safe calls are allowed: no
//! allocation, no lock, no destructor.

use std::{
    ffi::CString,
    io, mem,
    os::{fd::RawFd, unix::process::CommandExt},
    process::Command,
};

use libc::{c_int, pid_t};

use crate::sys::check;

/// What the init needs, made before the fork.
pub(crate) struct Init {
    pub(crate) cgroups: Vec<CString>,
    /// The end of a pipe that hangs up when the parent is gone.
    pub(crate) lifeline: RawFd,
    /// The limit that the program gets: a program that uses select(2) must not see descriptors above 1024.
    pub(crate) open_files: Option<libc::rlimit>,
}

impl Init {
    /// Puts an init in front of a command, whose next spawn must happen on a thread that unshared `CLONE_NEWPID`.
    pub(crate) fn before_exec_of(self, command: &mut Command) {
        // SAFETY: `split` keeps to async-signal-safe calls, as its own comments say.
        unsafe { command.pre_exec(move || self.split()) };
    }

    /// Returns in the program's process; the init stays inside for ever.
    ///
    /// # Safety
    /// To be called between fork and exec.
    unsafe fn split(&self) -> io::Result<()> {
        for group in &self.cgroups {
            // SAFETY: the path ends in a zero; open, write and close are async-signal-safe.
            unsafe {
                let file = check(libc::open(group.as_ptr(), libc::O_WRONLY | libc::O_CLOEXEC))?;
                let written = libc::write(file, c"0".as_ptr().cast(), 1);
                check(written as c_int)?;
                libc::close(file);
            }
        }
        // SAFETY: a sigset_t is integers, for which zero is a value; the calls fill and apply a live one. Blocked,
        // signals wait for signalfd even where the kernel would not deliver them to an init.
        let (signals, before) = unsafe {
            let mut signals: libc::sigset_t = mem::zeroed();
            let mut before: libc::sigset_t = mem::zeroed();
            libc::sigfillset(&mut signals);
            libc::sigprocmask(libc::SIG_SETMASK, &signals, &mut before);
            (signals, before)
        };
        // SAFETY: all strings end in a zero. That /proc cannot be mounted where parts of it are hidden (containers)
        // only means that the program sees the processes outside.
        unsafe {
            if libc::unshare(libc::CLONE_NEWNS) == 0 {
                libc::mount(
                    c"none".as_ptr(),
                    c"/".as_ptr(),
                    std::ptr::null(),
                    libc::MS_REC | libc::MS_SLAVE,
                    std::ptr::null(),
                );
                let flags = libc::MS_NOSUID | libc::MS_NODEV | libc::MS_NOEXEC;
                libc::mount(c"proc".as_ptr(), c"/proc".as_ptr(), c"proc".as_ptr(), flags, std::ptr::null());
            }
        }
        // SAFETY: this process has one thread; both sides go on with async-signal-safe calls only.
        match check(unsafe { libc::fork() })? {
            0 => {
                // SAFETY: async-signal-safe, with live arguments.
                unsafe {
                    check(libc::setsid())?;
                    libc::sigprocmask(libc::SIG_SETMASK, &before, std::ptr::null_mut());
                    if let Some(limit) = &self.open_files {
                        libc::setrlimit(libc::RLIMIT_NOFILE, limit);
                    }
                }
                Ok(())
            }
            // SAFETY: we are the parent of that process and have no other thread.
            program => unsafe { attend(program, self.lifeline, &signals) },
        }
    }
}

/// Waits on a program's behalf.
///
/// # Safety
/// `program` is the calling process's child; the process has one thread and nothing to clean up.
unsafe fn attend(program: pid_t, lifeline: RawFd, signals: &libc::sigset_t) -> ! {
    const LIFELINE: RawFd = 0;
    const SIGNALS: RawFd = 1;
    // SAFETY: async-signal-safe calls with live arguments. Descriptors from 2 on are closed, above all the pipe
    // through which the standard library learns that exec succeeded, and copies of other lifelines.
    unsafe {
        libc::prctl(libc::PR_SET_NAME, c"cotorra-init".as_ptr());
        let from = libc::signalfd(-1, signals, 0);
        libc::dup2(from, from.max(lifeline) + 1);
        libc::dup2(lifeline, LIFELINE);
        libc::dup2(from.max(lifeline) + 1, SIGNALS);
        libc::syscall(libc::SYS_close_range, 2u32, u32::MAX, 0u32);
        loop {
            let mut wait = [
                libc::pollfd { fd: LIFELINE, events: libc::POLLIN, revents: 0 },
                libc::pollfd { fd: SIGNALS, events: libc::POLLIN, revents: 0 },
            ];
            libc::poll(wait.as_mut_ptr(), 2, -1);
            if wait[0].revents != 0 {
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
                // Until the program leads a group of its own, there is only itself.
                let signal = signal.ssi_signo as c_int;
                if libc::kill(-program, signal) == -1 {
                    libc::kill(program, signal);
                }
            }
        }
    }
}

/// Collects every process that ended, and ends with the program.
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
            if ended == program && libc::WIFSIGNALED(status) {
                libc::_exit(128 + libc::WTERMSIG(status));
            }
            if ended == program && libc::WIFEXITED(status) {
                libc::_exit(libc::WEXITSTATUS(status));
            }
        }
    }
}

/// Sends SIGTERM to a process that is our child and has not been waited for.
pub(crate) fn terminate(child: u32) -> io::Result<()> {
    // SAFETY: takes no pointer.
    check(unsafe { libc::kill(child as pid_t, libc::SIGTERM) }).map(drop)
}
