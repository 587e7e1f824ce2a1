//! HTTP resources and WebSockets around a [`Wais`], and the thread that delivers its notifications.

#[cfg(test)]
mod document;
mod extract;
mod problem;
mod routes;
mod websocket;

use std::{sync::Arc, time::Duration};

use axum::{
    Router,
    http::StatusCode,
    middleware,
    routing::{MethodRouter, get},
};
use cotorra_graph::Timestamp;
use cotorra_mec::{Allowed, Dispatch, Notifier, Outcome, Problem};
use parking_lot::Mutex;
use tokio::sync::Notify;

use self::websocket::Sockets;
use crate::{
    requests::Subscription,
    survey::{Site, Survey},
    types::Epoch,
    wais::{RequestError, Target, Wais},
};

/// Interval of surveys while there are subscriptions. The testbed changes without notice.
const LOOK: Duration = Duration::from_millis(50);

/// The testbed of a service.
pub trait Testbed: Send + Sync + 'static {
    /// Returns the time of the run.
    fn now(&self) -> Timestamp;

    /// Surveys a site.
    fn survey(&self, site: &Arc<Site>) -> Survey;

    /// Returns the maximum age of a survey from which a query may be answered.
    fn freshness(&self) -> Duration;

    /// Reports a message to the operator.
    fn tell(&self, message: String);
}

/// A service that is ready to be served.
#[derive(Clone)]
pub struct Service(Arc<Shared>);

struct Shared {
    testbed: Arc<dyn Testbed>,
    /// The service, and the time of its last survey.
    state: Mutex<(Wais, Option<Timestamp>)>,
    allowed: Allowed,
    prefix: String,
    wake: Notify,
    sockets: Sockets,
}

/// The resources; [`openapi`] describes them.
fn resources() -> [(&'static str, MethodRouter<Service>); 6] {
    [
        ("/queries/ap/ap_information", get(routes::ap_information)),
        ("/queries/sta/sta_information", get(routes::sta_information)),
        ("/subscriptions", get(routes::subscriptions).post(routes::subscribe)),
        (
            "/subscriptions/{subscriptionId}",
            get(routes::subscription).put(routes::resubscribe).delete(routes::unsubscribe),
        ),
        ("/measurements", get(routes::measurements).post(routes::configure)),
        (
            "/measurements/{measurementConfigId}",
            get(routes::measurement).put(routes::reconfigure).delete(routes::unconfigure),
        ),
    ]
}

/// Returns the OpenAPI document of the service, which is checked in. A test derives it from the types and handlers, and compares.
pub fn openapi() -> String {
    include_str!("../../../../../docs/wais.openapi.json").to_owned()
}

impl Service {
    /// Makes the service of a site. `prefix` is the path of [`Service::router`], such as `/wai/v2`.
    pub fn new(
        testbed: Arc<dyn Testbed>,
        site: Site,
        epoch: Epoch,
        allowed: Allowed,
        prefix: String,
    ) -> Self {
        let state = Mutex::new((Wais::new(Arc::new(site), epoch), None));
        let (wake, sockets) = (Notify::new(), Sockets::default());
        Self(Arc::new(Shared { testbed, state, allowed, prefix, wake, sockets }))
    }

    /// Returns the resources. Every answer follows the standard, also for unknown paths and methods.
    pub fn router(&self) -> Router {
        let no_path = || async { Problem::new(StatusCode::NOT_FOUND, "there is no such path here") };
        let no_method =
            || async { Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method not allowed: see `Allow`") };
        resources()
            .into_iter()
            .fold(Router::new(), |router, (path, methods)| router.route(path, methods))
            .route("/subscriptions/{subscriptionId}/websocket", get(websocket::open))
            .fallback(no_path)
            .method_not_allowed_fallback(no_method)
            .layer(middleware::from_fn(extract::check))
            .with_state(self.clone())
    }

    /// Returns the path of the service.
    pub fn prefix(&self) -> &str {
        &self.0.prefix
    }

    fn now(&self) -> Timestamp {
        self.0.testbed.now()
    }

    /// Runs a closure with the service, after a new survey if the last one is too old.
    fn with<R>(&self, act: impl FnOnce(&mut Wais) -> R) -> R {
        let mut state = self.0.state.lock();
        let (wais, known) = &mut *state;
        let now = self.now();
        let freshness = self.0.testbed.freshness();
        let is_fresh = known.is_some_and(|known| known <= now && now.since(known) < freshness);
        if !is_fresh {
            wais.observe(self.0.testbed.survey(wais.site()));
            *known = Some(now);
        }
        let result = act(wais);
        let complaints = wais.take_complaints();
        drop(state);
        for complaint in complaints {
            self.0.testbed.tell(complaint);
        }
        result
    }

    fn wake(&self) {
        self.0.wake.notify_one();
    }

    fn sockets(&self) -> &Sockets {
        &self.0.sockets
    }

    /// Rejects a callback that could never be called.
    async fn check_callback(&self, subscription: &Subscription) -> Result<(), Problem> {
        subscription.check()?;
        if let Target::Callback(callback) = Target::of(subscription)? {
            cotorra_mec::resolve(&callback, &self.0.allowed).await.map_err(RequestError::from)?;
        }
        Ok(())
    }

    fn set_websocket_open(&self, subscription: u64, open: bool) {
        self.with(|wais| wais.set_websocket_open(subscription, open));
        self.wake();
    }
}

impl Notifier for Service {
    type Target = Target;

    fn poll(&self) -> (Vec<Dispatch<Target>>, Option<Duration>) {
        let now = self.now();
        self.with(|wais| {
            let dispatches = wais.poll(now);
            self.0.sockets.keep(|subscription| wais.has_websocket(subscription));
            let wait = wais.next_deadline().map_or(LOOK, |deadline| deadline.since(now).min(LOOK));
            // In virtual time a deadline may stand still: this must not become a busy loop.
            let wait = wait.max(Duration::from_millis(1));
            (dispatches, wais.has_subscriptions().then_some(wait))
        })
    }

    async fn woken(&self) {
        self.0.wake.notified().await;
    }

    async fn send(&self, Dispatch { subscription, target, body, .. }: Dispatch<Target>) -> Outcome {
        match target {
            Target::WebSocket => self.0.sockets.send(subscription, body).await,
            Target::Callback(callback) => cotorra_mec::post(&callback, &self.0.allowed, body).await,
        }
    }

    fn done(&self, subscription: u64, attempt: u64, outcome: Outcome) {
        let now = self.now();
        self.with(|wais| wais.done(now, subscription, attempt, outcome));
        self.wake();
    }
}

#[cfg(test)]
mod tests;
