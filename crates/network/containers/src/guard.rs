//! A process that outlives a killed run, to remove its containers. It also serves podman, if no other process does.

use std::{
    fs::OpenOptions,
    io::{self, Read as _},
    os::{fd::AsFd as _, unix::process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::Duration,
};

use cotorra_engine::Backoff;

use crate::{
    address::Address,
    leftovers::{Marker, Record, remove_run, service_folder},
    service::Service,
};

/// Interval of checks whether podman's service still runs.
const CHECK_INTERVAL: Duration = Duration::from_millis(200);

/// Settings of a guard.
#[derive(Debug)]
pub struct GuardSettings {
    /// Command of the program that calls [`guard`](crate::guard()), to which the guard's arguments are added.
    pub command: Vec<String>,
    /// File of its output, outside of the folder of VNFs' logs.
    pub log: PathBuf,
}

/// A guard that runs. Dropping it ends it, once nothing of the run is left.
#[derive(Debug)]
pub(crate) struct Guard(Child);

impl Guard {
    /// Starts the guard of this process.
    pub(crate) fn start(GuardSettings { command, log }: &GuardSettings, marker: &Marker) -> io::Result<Self> {
        let (program, arguments) =
            command.split_first().ok_or_else(|| io::Error::other("the guard has no command"))?;
        let log = OpenOptions::new().create(true).append(true).open(log)?;
        let guard = Command::new(program)
            .args(arguments)
            .arg(marker.path())
            // Ctrl-C must not end it before the run.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(log.try_clone()?)
            .stderr(log)
            .spawn()?;
        Ok(Self(guard))
    }

    /// Returns another end of its lifeline. It removes nothing while one is open.
    pub(crate) fn lifeline(&self) -> io::Result<Stdio> {
        let lifeline = self.0.stdin.as_ref().ok_or(io::ErrorKind::BrokenPipe)?;
        lifeline.as_fd().try_clone_to_owned().map(Stdio::from)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let _ = self.0.wait();
    }
}

/// Guards the containers of the process that started this one: waits for its end, and removes them. `record` is the last
/// argument that the guard's command got.
///
/// # Errors
/// The error of the system or of the engine. `clean` finds the containers later.
pub fn guard(record: &Path) -> io::Result<()> {
    let serves = Record::read(record)?.address == Address::Service;
    let (end, ended) = mpsc::channel::<()>();
    thread::Builder::new().name("lifeline".to_owned()).spawn(move || {
        // The other end closes when the process is gone, however it ended.
        let _ = io::stdin().read_to_end(&mut Vec::new());
        drop(end);
    })?;
    if serves {
        serve(&service_folder(record), &ended)?;
    } else {
        let _ = ended.recv();
    }
    // The record is gone if the process ended in order.
    if record.exists() { remove_run(record).map(drop) } else { Ok(()) }
}

/// Serves podman until the run ends, and starts it again if it dies.
#[allow(clippy::disallowed_types, reason = "a real process runs in real time")]
fn serve(folder: &Path, ended: &mpsc::Receiver<()>) -> io::Result<()> {
    let mut backoff = Backoff::default();
    loop {
        let mut service = Service::start(folder, Stdio::inherit)?;
        let started = std::time::Instant::now();
        while !service.has_ended() {
            if has_ended_within(ended, CHECK_INTERVAL) {
                return Ok(());
            }
        }
        backoff.ran(started.elapsed());
        if has_ended_within(ended, backoff.delay()) {
            return Ok(());
        }
    }
}

/// Waits for the end of the run. Returns whether it ended within a time.
fn has_ended_within(ended: &mpsc::Receiver<()>, time: Duration) -> bool {
    ended.recv_timeout(time) != Err(RecvTimeoutError::Timeout)
}
