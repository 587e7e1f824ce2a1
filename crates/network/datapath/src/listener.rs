//! The process that listens on a Unix socket, to end it.

use std::{
    io,
    os::{
        fd::{AsFd, OwnedFd},
        unix::net::UnixStream,
    },
};

use crate::sys;

/// A process that listens on a Unix socket. No other process is ever taken for it, even if it ends and another gets its
/// number.
#[derive(Debug)]
pub struct Listening {
    process: OwnedFd,
}

impl Listening {
    /// Finds the process on whose socket `connect` arrives.
    ///
    /// # Errors
    /// The system's error, as when the process ended, or is in another PID namespace.
    pub fn on(connect: impl Fn() -> io::Result<UnixStream>) -> io::Result<Self> {
        let number = || sys::listening_process(connect()?.as_fd());
        let before = number()?;
        if before == 0 {
            return Err(io::Error::new(io::ErrorKind::NotFound, "its process is in another PID namespace"));
        }
        let process = sys::open_process(before)?;
        // It still listens, so the number was its own all the time.
        match number()? {
            after if after == before => Ok(Self { process }),
            _ => Err(io::ErrorKind::NotFound.into()),
        }
    }

    /// Sends it SIGINT, as Ctrl-C does.
    ///
    /// # Errors
    /// The system's error, as when the process ended.
    pub fn interrupt(&self) -> io::Result<()> {
        sys::send_signal(self.process.as_fd(), libc::SIGINT)
    }

    /// Waits until it has ended.
    ///
    /// # Errors
    /// The system's error.
    pub fn wait(&self) -> io::Result<()> {
        // The descriptor becomes readable when the process ends.
        sys::wait_readable(self.process.as_fd())
    }
}
