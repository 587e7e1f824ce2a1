//! The thread that sends notifications. It waits until one is due, and posts it. It is separate from the thread that
//! serves requests, so that a hanging consumer delays no other consumer.

use std::{io, net::SocketAddr, pin::Pin, sync::Arc, time::Duration};

use axum::{
    body::Body,
    http::{Request, StatusCode, header},
};
use hyper_util::rt::TokioIo;
use tokio::{net::TcpStream, sync::oneshot, task::JoinSet};

use crate::{
    callback::{Allowed, Callback, CallbackError},
    outbox::Outcome,
};

/// Longest duration of an attempt.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest duration of a callback's name resolution at subscription.
const LOOK_UP: Duration = Duration::from_secs(2);

/// A notification to send now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dispatch<T> {
    /// ID of the subscription.
    pub subscription: u64,
    /// ID of the attempt.
    pub attempt: u64,
    /// The receiver.
    pub target: T,
    /// A JSON object.
    pub body: Arc<str>,
}

/// A service whose notifications are sent.
pub trait Notifier: Clone + Send + Sync + 'static {
    /// A receiver of notifications.
    type Target: Send;

    /// Returns the notifications to send now, and the time until there is more to do; `None` until woken.
    fn poll(&self) -> (Vec<Dispatch<Self::Target>>, Option<Duration>);

    /// Waits until there may be something to do before the time that [`Self::poll`] returned.
    fn woken(&self) -> impl Future<Output = ()> + Send;

    /// Sends a notification. It is given up after some seconds.
    fn send(&self, dispatch: Dispatch<Self::Target>) -> impl Future<Output = Outcome> + Send;

    /// Records the outcome of an attempt.
    fn done(&self, subscription: u64, attempt: u64, outcome: Outcome);
}

/// A task of the thread that sends notifications. It never ends.
pub type Task = Pin<Box<dyn Future<Output = ()> + Send>>;

/// Runs tasks until it is dropped.
pub struct Delivery {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Delivery {
    /// Starts these tasks.
    ///
    /// # Errors
    /// The system provides no thread or runtime.
    pub fn start(tasks: impl IntoIterator<Item = Task>) -> io::Result<Self> {
        let tasks: Vec<_> = tasks.into_iter().collect();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = std::thread::Builder::new().name("notifications".to_owned()).spawn(move || {
            runtime.block_on(async move {
                let mut tasks: JoinSet<()> = tasks.into_iter().collect();
                tokio::select! {
                    _ = tasks.join_next(), if !tasks.is_empty() => {}
                    _ = stopped => {}
                }
            });
            // A pending name resolution must not keep a finished run alive.
            runtime.shutdown_background();
        })?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Delivery {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Returns the task that sends a service's notifications.
pub fn deliver(service: impl Notifier) -> Task {
    Box::pin(async move {
        loop {
            let (dispatches, wait) = service.poll();
            for dispatch in dispatches {
                tokio::spawn(attempt(service.clone(), dispatch));
            }
            let woken = service.woken();
            match wait {
                Some(wait) => drop(tokio::time::timeout(wait, woken).await),
                None => woken.await,
            }
        }
    })
}

async fn attempt<N: Notifier>(service: N, dispatch: Dispatch<N::Target>) {
    let (subscription, attempt) = (dispatch.subscription, dispatch.attempt);
    let outcome = tokio::time::timeout(PATIENCE, service.send(dispatch)).await;
    let outcome = outcome.unwrap_or_else(|_| Outcome::Failed(format!("no answer within {PATIENCE:?}")));
    service.done(subscription, attempt, outcome);
}

/// Resolves a callback's host, and returns an allowed address.
///
/// # Errors
/// [`CallbackError`] if there is none.
pub async fn resolve(callback: &Callback, allowed: &Allowed) -> Result<SocketAddr, CallbackError> {
    let host = (callback.host.as_str(), callback.port);
    match tokio::time::timeout(LOOK_UP, tokio::net::lookup_host(host)).await {
        Ok(Ok(addresses)) => allowed.choose(&callback.host, addresses),
        _ => Err(CallbackError::Unknown(callback.host.clone())),
    }
}

/// Posts a notification to an allowed address of the callback. Does not follow redirections.
pub async fn post(callback: &Callback, allowed: &Allowed, body: Arc<str>) -> Outcome {
    let address = match resolve(callback, allowed).await {
        Ok(address) => address,
        Err(error @ CallbackError::Unknown(_)) => return Outcome::Failed(error.to_string()),
        Err(error) => return Outcome::Refused(error.to_string()),
    };
    match exchange(callback, address, body).await {
        Ok(status) if status.is_success() => Outcome::Delivered,
        Ok(status) if status.is_server_error() || matches!(status.as_u16(), 408 | 429) => {
            Outcome::Failed(format!("{} answered {status}", callback.uri))
        }
        Ok(status) => Outcome::Refused(format!("{} answered {status}", callback.uri)),
        Err(error) => Outcome::Failed(format!("{}: {error}", callback.uri)),
    }
}

type AnyError = Box<dyn std::error::Error + Send + Sync>;

async fn exchange(callback: &Callback, address: SocketAddr, body: Arc<str>) -> Result<StatusCode, AnyError> {
    let stream = TcpStream::connect(address).await?;
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await?;
    let request = Request::post(&callback.target)
        .header(header::HOST, &callback.authority)
        .header(header::CONTENT_TYPE, "application/json")
        .header(header::CONNECTION, "close")
        .body(Body::from(body.to_string()))?;
    let answer = sender.send_request(request);
    tokio::pin!(connection);
    tokio::pin!(answer);
    // The connection is driven until the head of the answer arrives. Its body is ignored.
    tokio::select! {
        answer = &mut answer => Ok(answer?.status()),
        ended = &mut connection => {
            ended?;
            Ok(answer.await?.status())
        }
    }
}
