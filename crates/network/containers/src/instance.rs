//! The life of one instance: its container is created, started, watched, stopped and removed.

use std::{
    cell::Cell,
    fs::File,
    io::{self, Write as _},
    time::Duration,
};

use cotorra_engine::Outcome;
use cotorra_graph::{ListenPort, Pull};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fd::OwnedFd,
    process::{Pid, PidfdFlags, pidfd_open},
};
use tokio::{
    io::{Interest, unix::AsyncFd},
    sync::oneshot,
};

use crate::{
    container::Container,
    daemon::{Daemon, Retries, State},
    daemon_error::DaemonError,
    ready,
    registries::Registries,
};

/// Time from SIGTERM until a container is killed, as for processes.
const GRACE: Duration = Duration::from_millis(500);
/// Interval of checks whether an instance listens at its ports.
const READY_INTERVAL: Duration = Duration::from_millis(5);
/// Attempts to remove a container at the end of a run, while the engine is away.
const LAST_ATTEMPTS: u32 = 5;

/// An instance to run.
pub(crate) struct Instance {
    /// Name of its container.
    pub(crate) name: String,
    pub(crate) container: Container,
    pub(crate) pull: Pull,
    pub(crate) ports: Vec<ListenPort>,
    pub(crate) memory_bytes: u64,
    pub(crate) log: File,
    /// Registries from which its image may be pulled.
    pub(crate) registries: Registries,
}

/// Reports what became of an instance.
pub(crate) type Report<'a> = &'a dyn Fn(Outcome);

impl Instance {
    /// Runs until the container ends or `stop` resolves. Nothing is left then, unless the engine is away when the run ends.
    pub(crate) async fn run(
        mut self,
        daemon: &Daemon,
        mut stop: oneshot::Receiver<()>,
        is_last: &Cell<bool>,
        report: Report<'_>,
    ) {
        match self.start(daemon, &mut stop).await {
            Ok(true) => self.watch(daemon, stop, report).await,
            Ok(false) => {}
            Err(error) => report(Outcome::Failed(error)),
        }
        let (mut retries, mut last_attempts) = (Retries::default(), 0);
        // The run must end, though the engine hangs.
        while !(is_last.get() && daemon.is_silent()) {
            let Err(error) = daemon.remove(&self.name).await else { return };
            last_attempts += u32::from(is_last.get());
            if !error.is_away() || last_attempts == LAST_ATTEMPTS {
                return tracing::warn!("{} is left: {error}", self.name);
            }
            retries.wait().await;
        }
    }

    /// Creates and starts the container. Returns false if it is stopped before.
    async fn start(&mut self, daemon: &Daemon, stop: &mut oneshot::Receiver<()>) -> Result<bool, String> {
        let cannot = |error: DaemonError| format!("cannot start its container: {error}");
        let reference = self.container.image.clone();
        let container = std::mem::take(&mut self.container);
        if self.pull != Pull::Always {
            // The engine says whether it has the image. That saves a request.
            match daemon.create(&self.name, container.clone()).await {
                Ok(()) => return daemon.start(&self.name).await.map(|()| true).map_err(cannot),
                // The missing object may also be its network.
                Err(error) if !error.is_missing() || daemon.has_image(&reference).await.unwrap_or(true) => {
                    return Err(cannot(error));
                }
                Err(_) if self.pull == Pull::Never => {
                    let never = "on this machine, and `pull: never` forbids to pull it";
                    return Err(format!("there is no image `{reference}` {never}"));
                }
                Err(_) => {}
            }
        }
        self.registries.check(&reference).map_err(|why| format!("there is no image `{reference}`: {why}"))?;
        // Only a pull takes long. The other requests are not cancelled, because the engine would carry them out all the same.
        tokio::select! {
            biased;
            _ = &mut *stop => return Ok(false),
            pulled = daemon.pull(&reference) => {
                pulled.map_err(|error| format!("there is no image `{reference}`: {error}"))?;
            }
        }
        daemon.create(&self.name, container).await.map_err(cannot)?;
        daemon.start(&self.name).await.map(|()| true).map_err(cannot)
    }

    /// Watches a started container until it ends or is stopped.
    async fn watch(&mut self, daemon: &Daemon, mut stop: oneshot::Receiver<()>, report: Report<'_>) {
        let Self { name, ports, memory_bytes, log, .. } = self;
        let mut output = Output { daemon, name, log, copied: 0 };
        let state = {
            let mut copying = std::pin::pin!(output.follow());
            let mut ended = std::pin::pin!(ended(daemon, name));
            let mut serving = std::pin::pin!(listens(daemon, name, ports));
            let (mut is_ready, mut is_copied) = (false, false);
            let state = loop {
                tokio::select! {
                    biased;
                    _ = &mut stop => break None,
                    () = &mut serving, if !is_ready => {
                        is_ready = true;
                        report(Outcome::Ready);
                    }
                    state = &mut ended => break Some(state),
                    () = &mut copying, if !is_copied => is_copied = true,
                }
            };
            match state {
                Some(state) => Some((state, is_ready)),
                None => {
                    terminate(daemon, name, &mut ended).await;
                    None
                }
            }
        };
        // An engine that hangs would only take its time again.
        if state.is_some() || !daemon.is_silent() {
            // The engine may be away.
            let _ = output.finish().await;
        }
        if let Some((state, is_ready)) = state {
            let end = state.end(*memory_bytes);
            report(if is_ready {
                Outcome::Died(end)
            } else {
                Outcome::Failed(format!("{end} before it listened at its ports"))
            });
        }
    }
}

/// Returns when a container listens at its ports, at once if it has none. Never returns if it ends before.
async fn listens(daemon: &Daemon, name: &str, ports: &[ListenPort]) {
    if ports.is_empty() {
        return;
    }
    let mut retries = Retries::default();
    let process = loop {
        match daemon.state(name).await {
            Ok(State { process: Some(process), .. }) => break process,
            _ => retries.wait().await,
        }
    };
    while is_alive(process) {
        if ready::are_served(process, ports) {
            return;
        }
        tokio::time::sleep(READY_INTERVAL).await;
    }
    std::future::pending().await
}

/// Waits for the end of a container. While the engine is away, the container may go on.
pub(crate) async fn ended(daemon: &Daemon, name: &str) -> State {
    let (mut retries, mut process) = (Retries::default(), None);
    loop {
        match daemon.state(name).await {
            Ok(state @ State { process: None, .. }) => return state,
            Ok(state) => process = state.process,
            // Somebody removed it.
            Err(error) if error.is_missing() => return State { exit_code: KILLED, ..State::default() },
            Err(error) if error.is_away() && process.is_some_and(|process| !is_alive(process)) => {
                return State { exit_code: KILLED, ..State::default() };
            }
            Err(_) => {}
        }
        match process {
            Some(process) if is_alive(process) => match exit(process).await {
                Ok(()) => retries = Retries::default(),
                Err(_) => retries.wait().await,
            },
            // The engine has not noticed yet.
            _ => retries.wait().await,
        }
    }
}

/// Exit code of a process that was killed by SIGKILL.
const KILLED: i64 = 137;

/// Returns a descriptor of a process, which can be read once it has exited, even if no process has waited for it yet.
fn open(process: u32) -> io::Result<OwnedFd> {
    let process = i32::try_from(process).ok().and_then(Pid::from_raw).ok_or(io::ErrorKind::InvalidInput)?;
    Ok(pidfd_open(process, PidfdFlags::empty())?)
}

fn is_alive(process: u32) -> bool {
    let has_exited = |process: OwnedFd| {
        let mut processes = [PollFd::new(&process, PollFlags::IN)];
        poll(&mut processes, Some(&Timespec::default())).is_ok_and(|exited| exited > 0)
    };
    open(process).is_ok_and(|process| !has_exited(process))
}

/// Waits until a process has exited.
async fn exit(process: u32) -> io::Result<()> {
    #[allow(
        deprecated,
        reason = "its successor is unsafe, as the descriptor might be closed: this one is owned"
    )]
    let process = AsyncFd::with_interest(open(process)?, Interest::READABLE)?;
    process.readable().await.map(drop)
}

/// Ends a container, by SIGTERM first.
async fn terminate(daemon: &Daemon, name: &str, ended: &mut (impl Future<Output = State> + Unpin)) {
    // It may have ended by itself.
    let _ = daemon.signal(name, "SIGTERM").await;
    if daemon.is_silent() {
        return;
    }
    if tokio::time::timeout(GRACE, &mut *ended).await.is_err() && daemon.signal(name, "SIGKILL").await.is_ok()
    {
        ended.await;
    }
}

/// Copies the output of a container to its log.
struct Output<'a> {
    daemon: &'a Daemon,
    name: &'a str,
    log: &'a mut File,
    /// Bytes that were copied.
    copied: u64,
}

impl Output<'_> {
    /// Copies until the container ends. When the engine was away, this begins again after what is in the log already.
    async fn follow(&mut self) {
        let mut retries = Retries::default();
        while self.copy(true).await.is_err_and(|error| error.is_away()) {
            retries.wait().await;
        }
    }

    /// Copies what a container that has ended wrote and was not copied.
    async fn finish(&mut self) -> Result<(), DaemonError> {
        self.copy(false).await
    }

    async fn copy(&mut self, follow: bool) -> Result<(), DaemonError> {
        let mut skipped = self.copied;
        let mut output = self.daemon.output(self.name, follow);
        loop {
            let next = output.next();
            let Some(part) = (if follow { next.await? } else { self.daemon.answer(next).await? }) else {
                return Ok(());
            };
            let old = usize::try_from(skipped).unwrap_or(usize::MAX).min(part.len());
            skipped -= old as u64;
            self.copied += (part.len() - old) as u64;
            // A full disk must not stop the VNF.
            let _ = self.log.write_all(&part[old..]);
        }
    }
}
