//! A small process between the agent and each VNF. It joins the VNF's control groups, starts the VNF as its user, and ends it with
//! all its descendants when the agent says so, or is gone, however it ended.
//!
//! Its standard input is a socket of the agent. The holder writes the byte [`STARTED`] there, or the reason for which the VNF does
//! not start. The byte [`TERMINATE`] from the agent sends SIGTERM to the VNF; the end of the stream kills it, and so does a signal
//! that would end the holder.

use std::{
    env, fs,
    io::{self, Read, Write},
    os::{
        fd::AsFd,
        unix::{
            net::UnixStream,
            process::{CommandExt, ExitStatusExt},
        },
    },
    process::{Child, Command, ExitCode, Stdio},
    sync::mpsc,
    thread,
};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::options::User;

/// Asks the holder to terminate the VNF.
pub(crate) const TERMINATE: u8 = b'T';

/// Says that the VNF's program runs.
pub(crate) const STARTED: u8 = 0;

/// Variable with the files of the control groups to join, as in `PATH`.
pub(crate) const GROUPS: &str = "COTORRA_CGROUPS";

/// Starts a program and waits until it has ended. Returns its exit status, or 128 and the number of the signal that ended it.
///
/// # Errors
/// The error of the system if the program cannot be started.
pub(crate) fn hold(user: Option<User>, words: &[String]) -> io::Result<ExitCode> {
    // Set first: a signal while the program starts waits in the channel until there is a process to kill.
    let (signals, to_send) = mpsc::channel();
    let ended = signals.clone();
    let handler = move || {
        // Fails only if the holder is about to end.
        let _ = ended.send(Signal::KILL);
    };
    ctrlc::set_handler(handler).map_err(io::Error::other)?;
    let mut agent = UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?);
    let mut child = match start(user, words) {
        Ok(child) => child,
        Err(error) => {
            // Fails only if the agent is gone.
            let _ = agent.write_all(error.to_string().as_bytes());
            return Err(error);
        }
    };
    let _ = agent.write_all(&[STARTED]);
    drop(agent);
    let group = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let signal = move |signal| {
        if let Some(group) = group {
            // Fails only if all have ended.
            let _ = kill_process_group(group, signal);
        }
    };
    thread::spawn(move || to_send.into_iter().for_each(signal));
    thread::spawn(move || {
        let mut byte = [0];
        while matches!(io::stdin().read(&mut byte), Ok(1)) {
            if byte[0] == TERMINATE {
                let _ = signals.send(Signal::TERM);
            }
        }
        let _ = signals.send(Signal::KILL);
    });
    let status = child.wait()?;
    // Its descendants do not outlive it.
    signal(Signal::KILL);
    let code = status.code().or_else(|| Some(128 + status.signal()?)).unwrap_or(1);
    Ok(ExitCode::from(u8::try_from(code).unwrap_or(1)))
}

/// Starts the VNF's program in its control groups.
fn start(user: Option<User>, words: &[String]) -> io::Result<Child> {
    for group in
        env::split_paths(&env::var_os(GROUPS).unwrap_or_default()).filter(|path| !path.as_os_str().is_empty())
    {
        fs::write(group, std::process::id().to_string())?;
    }
    let (program, arguments) = words.split_first().ok_or_else(|| io::Error::other("there is no program"))?;
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).process_group(0).env_remove(GROUPS);
    if let Some(user) = user {
        command.gid(user.gid).uid(user.uid);
    }
    let as_user = user.map(|user| format!(" as user {}:{}", user.uid, user.gid)).unwrap_or_default();
    let named = |e: io::Error| io::Error::new(e.kind(), format!("{program}{as_user}: {e}"));
    command.spawn().map_err(named)
}
