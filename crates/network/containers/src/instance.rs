//! The life of one instance: its image is pulled, its container is created, started, watched, stopped and removed.

use std::{
    fs::{self, File},
    io::Write as _,
    path::Path,
    time::Duration,
};

use bollard::models::ContainerCreateBody;
use cotorra_engine::Outcome;
use cotorra_graph::{ListenPort, Pull};
use futures_util::StreamExt as _;
use tokio::sync::oneshot;

use crate::{
    daemon::{Daemon, DaemonError, Retries, State},
    ready,
};

/// Time from SIGTERM until a container is killed, as for processes.
const GRACE: Duration = Duration::from_millis(500);
/// Longest wait for the last output of a container that has ended.
const LAST_OUTPUT: Duration = Duration::from_secs(2);
/// Interval of checks whether an instance listens at its ports.
const READY_INTERVAL: Duration = Duration::from_millis(5);

/// An instance to run.
pub(crate) struct Instance {
    /// Name of its container.
    pub(crate) name: String,
    pub(crate) container: ContainerCreateBody,
    pub(crate) pull: Pull,
    pub(crate) ports: Vec<ListenPort>,
    pub(crate) memory_bytes: u64,
    pub(crate) log: File,
}

/// Reports what became of an instance.
pub(crate) type Report<'a> = &'a dyn Fn(Outcome);

impl Instance {
    /// Runs until the container ends or `stop` resolves. Nothing is left then.
    pub(crate) async fn run(mut self, daemon: &Daemon, mut stop: oneshot::Receiver<()>, report: Report<'_>) {
        let failed = |error: String| report(Outcome::Failed(error));
        // Only a pull takes long. The other requests are not cancelled, because the engine would carry them out all the same.
        let pulled = tokio::select! {
            biased;
            _ = &mut stop => return,
            pulled = pull(daemon, self.reference(), self.pull) => pulled,
        };
        if let Err(error) = pulled {
            return failed(error);
        }
        let container = std::mem::take(&mut self.container);
        let mut started = daemon.create(&self.name, container).await;
        if started.is_ok() {
            started = daemon.start(&self.name).await;
        }
        match started {
            Ok(()) => self.watch(daemon, stop, report).await,
            Err(error) => failed(format!("cannot start its container: {error}")),
        }
        let mut retries = Retries::default();
        while let Err(error) = daemon.remove(&self.name).await {
            match error {
                // Nothing else removes it once the engine is back.
                DaemonError::Lost(_) => retries.wait().await,
                DaemonError::Rejected { .. } => return tracing::warn!("{} is left: {error}", self.name),
            }
        }
    }

    fn reference(&self) -> &str {
        self.container.image.as_deref().unwrap_or_default()
    }

    /// Watches a started container until it ends or is stopped.
    async fn watch(&mut self, daemon: &Daemon, mut stop: oneshot::Receiver<()>, report: Report<'_>) {
        let Self { name, ports, memory_bytes, log, .. } = self;
        let copying = copy_output(daemon, name, log);
        let mut copying = std::pin::pin!(copying);
        let ended = ended(daemon, name);
        let mut ended = std::pin::pin!(ended);
        let serving = listens(daemon, name, ports);
        let mut serving = std::pin::pin!(serving);
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
            Some(state) => {
                let end = state.end(*memory_bytes);
                let outcome = if is_ready {
                    Outcome::Died(end)
                } else {
                    Outcome::Failed(format!("{end} before it listened at its ports"))
                };
                report(outcome);
            }
            None => terminate(daemon, name, &mut ended).await,
        }
        if !is_copied {
            // A full disk or a lost engine must not hold up the end.
            let _ = tokio::time::timeout(LAST_OUTPUT, copying).await;
        }
    }
}

async fn pull(daemon: &Daemon, reference: &str, policy: Pull) -> Result<(), String> {
    let missing = |error: DaemonError| format!("there is no image `{reference}`: {error}");
    let is_there = daemon.has_image(reference).await.map_err(|e| e.to_string())?;
    match policy {
        Pull::Missing if is_there => Ok(()),
        Pull::Never if is_there => Ok(()),
        Pull::Never => Err(format!(
            "there is no image `{reference}` on this machine, and `pull: never` forbids to pull it"
        )),
        Pull::Missing | Pull::Always => daemon.pull(reference).await.map_err(missing),
    }
}

/// Returns when a container listens at its ports, at once if it has none.
async fn listens(daemon: &Daemon, name: &str, ports: &[ListenPort]) {
    if ports.is_empty() {
        return;
    }
    loop {
        if let Ok(State { process: Some(process), .. }) = daemon.state(name).await {
            while fs::exists(Path::new("/proc").join(process.to_string())).unwrap_or_default() {
                if ready::are_served(process, ports) {
                    return;
                }
                tokio::time::sleep(READY_INTERVAL).await;
            }
        }
        tokio::time::sleep(READY_INTERVAL).await;
    }
}

/// Waits for the end of a container. While the engine is away, the container may go on.
async fn ended(daemon: &Daemon, name: &str) -> State {
    let mut retries = Retries::default();
    let mut process = daemon.state(name).await.ok().and_then(|state| state.process);
    loop {
        if daemon.wait(name).await.is_err_and(|error| !error.is_missing()) {
            retries.wait().await;
        }
        match daemon.state(name).await {
            Ok(state @ State { process: None, .. }) => return state,
            Ok(state) => process = state.process,
            // Somebody removed it.
            Err(error) if error.is_missing() => return State::default(),
            Err(_) => {
                let is_gone = |process: &u32| !fs::exists(format!("/proc/{process}")).unwrap_or(true);
                if process.as_ref().is_some_and(is_gone) {
                    return State { exit_code: 137, ..State::default() };
                }
            }
        }
    }
}

/// Ends a container, by SIGTERM first.
async fn terminate(daemon: &Daemon, name: &str, ended: &mut (impl Future<Output = State> + Unpin)) {
    // It may have ended by itself.
    let _ = daemon.signal(name, "SIGTERM").await;
    if tokio::time::timeout(GRACE, &mut *ended).await.is_err() {
        let _ = daemon.signal(name, "SIGKILL").await;
    }
}

/// Copies the output of a container to its log until the container ends. When the engine was away, it begins again after what
/// is in the log already.
async fn copy_output(daemon: &Daemon, name: &str, log: &mut File) {
    let mut retries = Retries::default();
    let mut copied: u64 = 0;
    loop {
        let mut skipped = copied;
        let output = daemon.output(name);
        let mut output = std::pin::pin!(output);
        let error = loop {
            match output.next().await {
                Some(Ok(part)) => {
                    let old = usize::try_from(skipped).unwrap_or(usize::MAX).min(part.len());
                    skipped -= old as u64;
                    copied += (part.len() - old) as u64;
                    // A full disk must not stop the VNF.
                    let _ = log.write_all(&part[old..]);
                }
                Some(Err(error)) => break error,
                None => match daemon.state(name).await {
                    Ok(State { process: Some(_), .. }) => break DaemonError::Lost(String::new()),
                    Err(error) if !error.is_missing() => break error,
                    _ => return,
                },
            }
        };
        if error.is_missing() {
            return;
        }
        retries.wait().await;
    }
}
