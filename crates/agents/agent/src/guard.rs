//! A small process beside the agent while it drives a robot. It leaves the robot at rest if the agent is gone, however it ended:
//! a Kobuki goes on at its last speed when commands stop.
//!
//! Its standard input is a pipe from the agent. The agent writes the robot's ports into it, and the end of the pipe says that
//! the agent is gone.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "waits for the kernel to close ports"
)]

use std::{
    io::{self, PipeWriter, Write},
    os::unix::process::CommandExt,
    process::{Child, Command},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use cotorra_graph::{Kobuki, Timestamp};
use cotorra_turtlebot::{PortError, Turtlebot};

use crate::launcher::SELF;

/// Subcommand of the guard.
const GUARD: &str = "guard";
/// Interval of attempts to open ports, and their number.
const AGAIN: (Duration, u32) = (Duration::from_millis(5), 200);

/// A guard that runs. Dropping it ends it, and the robot stays as it is.
pub(crate) struct Guard {
    process: Child,
    lifeline: PipeWriter,
}

impl Guard {
    /// Starts a guard of a robot with these ports.
    ///
    /// # Errors
    /// The error of the system if it cannot be started.
    pub(crate) fn start(kobuki: &Kobuki) -> io::Result<Self> {
        let (theirs, lifeline) = io::pipe()?;
        // In a group of its own: Ctrl-C in a terminal is for the agent alone.
        let process = Command::new(SELF).arg(GUARD).stdin(theirs).process_group(0).spawn()?;
        let mut guard = Self { process, lifeline };
        guard.lifeline.write_all(&serde_json::to_vec(kobuki)?)?;
        Ok(guard)
    }

    /// Whether it has ended.
    pub(crate) fn has_ended(&mut self) -> bool {
        !matches!(self.process.try_wait(), Ok(None))
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        // Fails only if it has ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Waits until the agent is gone, and leaves the robot at rest then.
///
/// # Errors
/// The reason for which the robot may move.
pub(crate) fn guard() -> io::Result<()> {
    // A service manager signals all processes at once. This one ends after the agent.
    ctrlc::set_handler(|| ()).map_err(io::Error::other)?;
    let kobuki: Kobuki = serde_json::from_str(&io::read_to_string(io::stdin())?)?;
    let began = Instant::now();
    let clock: cotorra_turtlebot::Clock = Arc::new(move || Timestamp::ZERO + began.elapsed());
    let (pause, most) = AGAIN;
    for _ in 1..most {
        match Turtlebot::open("guarded", &kobuki, &clock) {
            // The kernel has not closed the agent's ports yet, or another agent has opened them.
            Err(PortError::Busy(_)) => thread::sleep(pause),
            opened => return opened.map(drop).map_err(io::Error::other),
        }
    }
    // Another agent stops the robot when it opens the ports.
    Ok(())
}
