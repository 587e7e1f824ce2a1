//! The engine's interface, as far as containers of VNFs need it: HTTP over a Unix socket, as Docker and podman serve it.

use std::{cell::Cell, path::Path, rc::Rc, time::Duration};

use bytes::{Buf as _, Bytes, BytesMut};
use hyper::{Method, StatusCode};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use serde::Deserialize;
use serde_json::json;

use crate::{
    container::Container,
    daemon_error::DaemonError,
    http::{self, Answer, Content},
    spec::RUN,
};

/// The newest version of the interface that this was tried with. Engines reject those that are newer than their own.
const NEWEST: (u32, u32) = (1, 53);
/// Characters that are escaped in paths and queries: not those of images' names.
const ESCAPED: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'/').remove(b':').remove(b'@').remove(b'_');
/// Longest time of a request until its answer. 50 containers that start at the same time on two cores take 11 s, and podman
/// waits 10 s for the end of a container that it removes. Output that is followed has no limit: a container may be quiet.
pub(crate) const ANSWER: Duration = Duration::from_secs(20);
/// Longest time of a pull without progress. Engines say nothing while they unpack a layer, which can have gigabytes.
pub(crate) const PULL_PROGRESS: Duration = Duration::from_secs(300);
/// Bytes of the header of a frame of output.
const HEADER: usize = 8;
/// Time from one attempt to connect to the next.
const RETRY: Duration = Duration::from_millis(20);
const LONGEST_RETRY: Duration = Duration::from_secs(1);

/// State of a container.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct State {
    /// Its process, while it runs.
    pub(crate) process: Option<u32>,
    pub(crate) exit_code: i64,
    /// Whether the kernel killed it for its use of memory.
    pub(crate) out_of_memory: bool,
}

/// A container's state, as the engine reports it. Names of states are left out: podman has some of its own.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "PascalCase", default)]
struct InspectedState {
    running: Option<bool>,
    pid: Option<i64>,
    exit_code: Option<i64>,
    #[serde(rename = "OOMKilled")]
    oom_killed: Option<bool>,
}

impl State {
    fn of(state: InspectedState) -> Self {
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
    socket: Rc<Path>,
    /// Of the interface.
    version: (u32, u32),
    /// Whether it hung at the last request.
    is_silent: Rc<Cell<bool>>,
}

impl Daemon {
    /// Connects to the engine at a socket.
    pub(crate) async fn connect(socket: &Path) -> Result<Self, DaemonError> {
        #[derive(Deserialize)]
        #[serde(rename_all = "PascalCase")]
        struct Version {
            api_version: String,
        }
        let asked = async {
            let answer = accepted(http::send(socket, Method::GET, "/version", None).await?).await?;
            answer.json::<Version>().await
        };
        let Version { api_version } = within(ANSWER, asked).await?;
        let version = api_version.split_once('.');
        let version = version.and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)));
        let unknown = || DaemonError::Lost(format!("its interface has the version `{api_version}`"));
        let version = version.ok_or_else(unknown)?.min(NEWEST);
        Ok(Self { socket: socket.into(), version, is_silent: Rc::default() })
    }

    /// Whether it hung at the last request.
    pub(crate) fn is_silent(&self) -> bool {
        self.is_silent.get()
    }

    /// Waits for an answer, within the limit.
    pub(crate) async fn answer<T>(
        &self,
        request: impl Future<Output = Result<T, DaemonError>>,
    ) -> Result<T, DaemonError> {
        let answer = within(ANSWER, request).await;
        self.is_silent.set(matches!(answer, Err(DaemonError::Silent(_))));
        answer
    }

    /// Sends a request. The answer is one of success, whose body is not read yet.
    async fn send(
        &self,
        method: Method,
        path: &str,
        query: &[(&str, &str)],
        content: Option<Content>,
    ) -> Result<Answer, DaemonError> {
        let (major, minor) = self.version;
        let escaped = |text| utf8_percent_encode(text, ESCAPED);
        let mut target = format!("/v{major}.{minor}{}", escaped(path));
        for (place, (key, value)) in query.iter().enumerate() {
            target += &format!("{}{key}={}", if place == 0 { '?' } else { '&' }, escaped(value));
        }
        accepted(http::send(&self.socket, method, &target, content).await?).await
    }

    /// Sends a request, and waits within the limit until it is carried out.
    async fn order(&self, method: Method, path: &str, query: &[(&str, &str)]) -> Result<(), DaemonError> {
        let ordered = async { self.send(method, path, query, None).await?.bytes().await.map(drop) };
        self.answer(ordered).await
    }

    /// Whether the engine has an image.
    pub(crate) async fn has_image(&self, reference: &str) -> Result<bool, DaemonError> {
        match self.order(Method::GET, &format!("/images/{reference}/json"), &[]).await {
            Ok(()) => Ok(true),
            Err(error) if error.is_missing() => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Pulls an image from its registry.
    pub(crate) async fn pull(&self, reference: &str) -> Result<(), DaemonError> {
        let is_digest = reference.contains('@');
        let has_tag = reference.rsplit('/').next().is_some_and(|name| name.contains(':'));
        // Without a tag, Docker pulls all tags.
        let query = [("fromImage", reference), ("tag", "latest")];
        let query = if is_digest || has_tag { &query[..1] } else { &query[..] };
        let request = self.send(Method::POST, "/images/create", query, None);
        let mut steps = within(PULL_PROGRESS, request).await?;
        while within(PULL_PROGRESS, step(&mut steps)).await?.is_some() {}
        Ok(())
    }

    /// Makes an image of the files in a tar archive.
    pub(crate) async fn import(&self, name: &str, tag: &str, tar: Vec<u8>) -> Result<(), DaemonError> {
        let query = [("fromSrc", "-"), ("repo", name), ("tag", tag)];
        let content = ("application/x-tar", Bytes::from(tar));
        let imported = async {
            let mut steps = self.send(Method::POST, "/images/create", &query, Some(content)).await?;
            while step(&mut steps).await?.is_some() {}
            Ok(())
        };
        self.answer(imported).await
    }

    /// Removes an image.
    pub(crate) async fn remove_image(&self, reference: &str) -> Result<(), DaemonError> {
        self.order(Method::DELETE, &format!("/images/{reference}"), &[]).await
    }

    /// Creates a container.
    pub(crate) async fn create(&self, name: &str, container: Container) -> Result<(), DaemonError> {
        let content = serde_json::to_vec(&container).expect("a container is JSON");
        let content = ("application/json", Bytes::from(content));
        let query = [("name", name)];
        let created = async {
            let answer = self.send(Method::POST, "/containers/create", &query, Some(content)).await?;
            answer.bytes().await.map(drop)
        };
        self.answer(created).await
    }

    /// Starts a container.
    pub(crate) async fn start(&self, name: &str) -> Result<(), DaemonError> {
        self.order(Method::POST, &format!("/containers/{name}/start"), &[]).await
    }

    /// Returns the state of a container.
    pub(crate) async fn state(&self, name: &str) -> Result<State, DaemonError> {
        #[derive(Deserialize)]
        #[serde(rename_all = "PascalCase")]
        struct Inspected {
            state: Option<InspectedState>,
        }
        let path = format!("/containers/{name}/json");
        let inspected = async { self.send(Method::GET, &path, &[], None).await?.json::<Inspected>().await };
        Ok(self.answer(inspected).await?.state.map(State::of).unwrap_or_default())
    }

    /// Returns the output of a container from its beginning: what there is, or until the container ends.
    pub(crate) fn output<'a>(&'a self, name: &'a str, follow: bool) -> Output<'a> {
        Output { daemon: self, name, follow, answer: None, unread: BytesMut::new(), left: 0 }
    }

    /// Sends a signal to a container's first process.
    pub(crate) async fn signal(&self, name: &str, signal: &str) -> Result<(), DaemonError> {
        self.order(Method::POST, &format!("/containers/{name}/kill"), &[("signal", signal)]).await
    }

    /// Kills and removes a container. Does nothing if there is none.
    pub(crate) async fn remove(&self, name: &str) -> Result<(), DaemonError> {
        let query = [("force", "true"), ("v", "true")];
        match self.order(Method::DELETE, &format!("/containers/{name}"), &query).await {
            Err(error) if error.is_missing() => Ok(()),
            done => done,
        }
    }

    /// Returns the IDs of a run's containers.
    pub(crate) async fn containers_of(&self, run: &str) -> Result<Vec<String>, DaemonError> {
        #[derive(Deserialize)]
        #[serde(rename_all = "PascalCase")]
        struct Listed {
            id: String,
        }
        let filters = json!({ "label": [format!("{RUN}={run}")] }).to_string();
        let query = [("all", "true"), ("filters", &filters)];
        let listed = async {
            self.send(Method::GET, "/containers/json", &query, None).await?.json::<Vec<Listed>>().await
        };
        Ok(self.answer(listed).await?.into_iter().map(|container| container.id).collect())
    }
}

/// Returns an answer of success, or the reason for which the engine rejects the request.
async fn accepted(answer: Answer) -> Result<Answer, DaemonError> {
    #[derive(Deserialize)]
    struct Failure {
        message: String,
    }
    let status = answer.status();
    // NOT_MODIFIED: it is already as wanted.
    if status.is_success() || status == StatusCode::NOT_MODIFIED {
        return Ok(answer);
    }
    let text = answer.bytes().await?;
    let failure = serde_json::from_slice(&text).map(|failure: Failure| failure.message);
    let message = failure.unwrap_or_else(|_| String::from_utf8_lossy(&text).into_owned());
    Err(DaemonError::Rejected { status: status.as_u16(), message })
}

/// A step of making an image.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Step {
    error_detail: Option<StepError>,
}

#[derive(Deserialize)]
struct StepError {
    message: Option<String>,
}

/// Returns the next step of making an image, or the error that ended it.
async fn step(steps: &mut Answer) -> Result<Option<Step>, DaemonError> {
    let step: Option<Step> = steps.value().await?;
    match step.as_ref().and_then(|step| step.error_detail.as_ref()?.message.clone()) {
        Some(message) => Err(DaemonError::Rejected { status: 500, message }),
        None => Ok(step),
    }
}

/// The output of a container, as it arrives.
#[derive(Debug)]
pub(crate) struct Output<'a> {
    daemon: &'a Daemon,
    name: &'a str,
    follow: bool,
    /// `None` until the first part is asked for.
    answer: Option<Answer>,
    unread: BytesMut,
    /// Bytes of the frame whose header was read last, which are still to come.
    left: usize,
}

impl Output<'_> {
    /// Returns the next part of the output; `None` at its end.
    pub(crate) async fn next(&mut self) -> Result<Option<Bytes>, DaemonError> {
        loop {
            if self.left > 0 && !self.unread.is_empty() {
                let part = self.unread.split_to(self.left.min(self.unread.len()));
                self.left -= part.len();
                return Ok(Some(part.freeze()));
            }
            // Each frame begins with a stream's number, three zeros, and its length.
            if self.left == 0 && self.unread.len() >= HEADER {
                self.unread.advance(HEADER - size_of::<u32>());
                self.left = self.unread.get_u32() as usize;
                continue;
            }
            let answer = match &mut self.answer {
                Some(answer) => answer,
                None => {
                    let path = format!("/containers/{}/logs", self.name);
                    let query = [
                        ("follow", if self.follow { "true" } else { "false" }),
                        ("stdout", "true"),
                        ("stderr", "true"),
                    ];
                    let answer = self.daemon.send(Method::GET, &path, &query, None).await?;
                    self.answer.insert(answer)
                }
            };
            match answer.part().await? {
                Some(part) => self.unread.extend_from_slice(&part),
                None => return Ok(None),
            }
        }
    }
}

/// Waits for an answer within a time.
async fn within<T>(
    time: Duration,
    request: impl Future<Output = Result<T, DaemonError>>,
) -> Result<T, DaemonError> {
    tokio::time::timeout(time, request).await.map_err(|_| DaemonError::Silent(time))?
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
