//! The engine's interface, as far as containers of VNFs need it: HTTP over a Unix socket, as Docker and podman serve it.

use std::{cell::Cell, collections::HashMap, path::Path, rc::Rc, time::Duration};

use bollard::{
    API_DEFAULT_VERSION, Docker, body_full,
    errors::Error,
    models::{ContainerCreateBody, ContainerState},
    query_parameters::{
        CreateContainerOptionsBuilder, CreateImageOptionsBuilder, KillContainerOptionsBuilder,
        ListContainersOptionsBuilder, LogsOptionsBuilder, RemoveContainerOptionsBuilder, RemoveImageOptions,
    },
};
use bytes::Bytes;
use futures_util::{Stream, TryStreamExt as _};

use crate::spec::RUN;

/// Longest time of a request until its answer. 50 containers that start at the same time on two cores take 11 s, and podman
/// waits 10 s for the end of a container that it removes. Output that is followed has no limit: a container may be quiet.
pub(crate) const ANSWER: Duration = Duration::from_secs(20);
/// Longest time of a pull without progress. Engines say nothing while they unpack a layer, which can have gigabytes.
pub(crate) const PULL_PROGRESS: Duration = Duration::from_secs(300);
/// Limit of the client, which cannot tell requests apart, s.
const NO_LIMIT_S: u64 = 365 * 24 * 3600;
/// Time from one attempt to connect to the next.
const RETRY: Duration = Duration::from_millis(20);
const LONGEST_RETRY: Duration = Duration::from_secs(1);

/// An error of a request.
#[derive(Debug, Clone, thiserror::Error)]
pub(crate) enum DaemonError {
    /// The engine does not answer.
    #[error("the engine does not answer: {0}")]
    Lost(String),
    /// The engine accepts a request, and hangs.
    #[error("the engine hangs: it did not answer within {} s", .0.as_secs())]
    Silent(Duration),
    /// The engine rejects the request.
    #[error("{message}")]
    Rejected {
        /// Status code of HTTP.
        status: u16,
        /// Its reason.
        message: String,
    },
}

impl DaemonError {
    /// Whether the engine has no such container or image.
    pub(crate) fn is_missing(&self) -> bool {
        matches!(self, Self::Rejected { status: 404, .. })
    }

    /// Whether the engine may answer later.
    pub(crate) fn is_away(&self) -> bool {
        matches!(self, Self::Lost(_) | Self::Silent(_))
    }
}

impl From<Error> for DaemonError {
    fn from(error: Error) -> Self {
        match error {
            Error::DockerResponseServerError { status_code: status, message } => {
                Self::Rejected { status, message }
            }
            // podman has states for a moment that the client does not know.
            Error::JsonDataError { message, .. } => Self::Rejected { status: 200, message },
            Error::DockerStreamError { error } => Self::Rejected { status: 500, message: error },
            other => Self::Lost(describe(&other)),
        }
    }
}

/// Returns an error with its causes, which say what the system rejected.
fn describe(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

/// State of a container.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct State {
    /// Its process, while it runs.
    pub(crate) process: Option<u32>,
    pub(crate) exit_code: i64,
    /// Whether the kernel killed it for its use of memory.
    pub(crate) out_of_memory: bool,
}

impl State {
    fn of(state: ContainerState) -> Self {
        let process = state.pid.and_then(|pid| u32::try_from(pid).ok()).filter(|pid| *pid > 0);
        Self {
            process: process.filter(|_| state.running == Some(true)),
            exit_code: state.exit_code.unwrap_or_default(),
            out_of_memory: state.oom_killed.unwrap_or_default(),
        }
    }

    /// Returns how the container ended, for people.
    pub(crate) fn end(&self, memory_bytes: u64) -> String {
        if self.out_of_memory {
            return format!("was killed: it used more than its {} MB of memory", memory_bytes / 1_000_000);
        }
        format!("exited with status {}", self.exit_code)
    }
}

/// An engine that answers.
#[derive(Debug, Clone)]
pub(crate) struct Daemon {
    docker: Docker,
    /// Whether it hung at the last request.
    is_silent: Rc<Cell<bool>>,
}

impl Daemon {
    /// Connects to the engine at a socket.
    pub(crate) async fn connect(socket: &Path) -> Result<Self, DaemonError> {
        let path = socket.to_string_lossy();
        let docker = Docker::connect_with_unix(&path, NO_LIMIT_S, API_DEFAULT_VERSION)?;
        // Engines reject versions that are newer than their own.
        let docker = within(ANSWER, docker.negotiate_version()).await?;
        Ok(Self { docker, is_silent: Rc::default() })
    }

    /// Whether it hung at the last request.
    pub(crate) fn is_silent(&self) -> bool {
        self.is_silent.get()
    }

    /// Waits for an answer, within the limit.
    pub(crate) async fn answer<T, E: Into<DaemonError>>(
        &self,
        request: impl Future<Output = Result<T, E>>,
    ) -> Result<T, DaemonError> {
        let answer = within(ANSWER, request).await;
        self.is_silent.set(matches!(answer, Err(DaemonError::Silent(_))));
        answer
    }

    /// Whether the engine has an image.
    pub(crate) async fn has_image(&self, reference: &str) -> Result<bool, DaemonError> {
        match self.answer(self.docker.inspect_image(reference)).await {
            Ok(_) => Ok(true),
            Err(error) if error.is_missing() => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Pulls an image from its registry.
    pub(crate) async fn pull(&self, reference: &str) -> Result<(), DaemonError> {
        let is_digest = reference.contains('@');
        let has_tag = reference.rsplit('/').next().is_some_and(|name| name.contains(':'));
        // Without a tag, Docker pulls all tags.
        let options = CreateImageOptionsBuilder::default().from_image(reference);
        let options = if is_digest || has_tag { options } else { options.tag("latest") };
        let mut steps = self.docker.create_image(Some(options.build()), None, None);
        while within(PULL_PROGRESS, steps.try_next()).await?.is_some() {}
        Ok(())
    }

    /// Makes an image of the files in a tar archive.
    pub(crate) async fn import(&self, name: &str, tag: &str, tar: Vec<u8>) -> Result<(), DaemonError> {
        let options = CreateImageOptionsBuilder::default().from_src("-").repo(name).tag(tag).build();
        let steps = self.docker.create_image(Some(options), Some(body_full(Bytes::from(tar))), None);
        self.answer(steps.try_for_each(|_| async { Ok(()) })).await
    }

    /// Removes an image.
    pub(crate) async fn remove_image(&self, reference: &str) -> Result<(), DaemonError> {
        self.answer(self.docker.remove_image(reference, None::<RemoveImageOptions>, None)).await.map(drop)
    }

    /// Creates a container.
    pub(crate) async fn create(&self, name: &str, container: ContainerCreateBody) -> Result<(), DaemonError> {
        let options = CreateContainerOptionsBuilder::default().name(name).build();
        self.answer(self.docker.create_container(Some(options), container)).await.map(drop)
    }

    /// Starts a container.
    pub(crate) async fn start(&self, name: &str) -> Result<(), DaemonError> {
        self.answer(self.docker.start_container(name, None)).await
    }

    /// Returns the state of a container.
    pub(crate) async fn state(&self, name: &str) -> Result<State, DaemonError> {
        let found = self.answer(self.docker.inspect_container(name, None)).await?;
        Ok(found.state.map(State::of).unwrap_or_default())
    }

    /// Returns the output of a container from its beginning: what there is, or until the container ends.
    pub(crate) fn output(
        &self,
        name: &str,
        follow: bool,
    ) -> impl Stream<Item = Result<Bytes, DaemonError>> + use<> {
        let options = LogsOptionsBuilder::default().follow(follow).stdout(true).stderr(true).build();
        let output = self.docker.logs(name, Some(options));
        output.map_ok(|part| part.into_bytes()).map_err(DaemonError::from)
    }

    /// Sends a signal to a container's first process.
    pub(crate) async fn signal(&self, name: &str, signal: &str) -> Result<(), DaemonError> {
        let options = KillContainerOptionsBuilder::default().signal(signal).build();
        self.answer(self.docker.kill_container(name, Some(options))).await
    }

    /// Kills and removes a container. Does nothing if there is none.
    pub(crate) async fn remove(&self, name: &str) -> Result<(), DaemonError> {
        let options = RemoveContainerOptionsBuilder::default().force(true).v(true).build();
        match self.answer(self.docker.remove_container(name, Some(options))).await {
            Err(error) if error.is_missing() => Ok(()),
            done => done,
        }
    }

    /// Returns the IDs of a run's containers.
    pub(crate) async fn containers_of(&self, run: &str) -> Result<Vec<String>, DaemonError> {
        let filters = HashMap::from([("label", vec![format!("{RUN}={run}")])]);
        let options = ListContainersOptionsBuilder::default().all(true).filters(&filters).build();
        let found = self.answer(self.docker.list_containers(Some(options))).await?;
        Ok(found.into_iter().filter_map(|container| container.id).collect())
    }
}

/// Waits for an answer within a time.
async fn within<T, E: Into<DaemonError>>(
    time: Duration,
    request: impl Future<Output = Result<T, E>>,
) -> Result<T, DaemonError> {
    tokio::time::timeout(time, request).await.map_err(|_| DaemonError::Silent(time))?.map_err(E::into)
}

/// Delays of attempts: each twice as long as the one before.
#[derive(Debug)]
pub(crate) struct Retries(Duration);

impl Default for Retries {
    fn default() -> Self {
        Self(RETRY)
    }
}

impl Retries {
    /// Waits before the next attempt.
    pub(crate) async fn wait(&mut self) {
        tokio::time::sleep(self.0).await;
        self.0 = (self.0 * 2).min(LONGEST_RETRY);
    }
}

#[cfg(test)]
pub(crate) mod tests;
