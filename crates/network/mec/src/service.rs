//! A service that is served: a state machine on surveys of the testbed, its WebSockets, and the sender of its
//! notifications.

use std::{sync::Arc, time::Duration};

use cotorra_graph::Timestamp;
use parking_lot::Mutex;
use tokio::sync::Notify;

use crate::{
    callback::Allowed,
    delivery::{Dispatch, Notifier, post, resolve},
    outbox::Outcome,
    sockets::Sockets,
    subscribing::{RequestError, Resource},
    subscriptions::{Scheduled, Subscribed, Subscriptions, Target},
};

/// Interval of surveys while there are subscriptions. The testbed changes without notice.
const LOOK: Duration = Duration::from_millis(50);

/// The state machine of a service, without a clock or a socket: surveys and requests go in with the time, answers and
/// notifications come out.
pub trait Machine: Send + 'static {
    /// The fixed part of the testbed.
    type Site: Send + Sync;
    /// The state of the testbed at a time.
    type Survey;
    /// A subscription.
    type Subscription: Subscribed;

    /// Returns the fixed part of the testbed.
    fn site(&self) -> &Arc<Self::Site>;

    /// Replaces the survey.
    fn observe(&mut self, survey: Self::Survey);

    /// Checks that a subscription is about something that the service has.
    ///
    /// # Errors
    /// [`RequestError`].
    fn check(&self, subscription: &Self::Subscription) -> Result<(), RequestError>;

    /// Starts the schedule of a subscription's notifications.
    fn schedule(
        &self,
        now: Timestamp,
        subscription: &Self::Subscription,
    ) -> <Self::Subscription as Subscribed>::Schedule;

    /// Returns the subscriptions.
    fn subscriptions(&mut self) -> &mut Subscriptions<Self::Subscription>;

    /// Composes due notifications, and returns those to send now.
    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>>;

    /// Creates a subscription. `base` is the URI under which the consumer sees the service.
    ///
    /// # Errors
    /// [`RequestError`]; then there is none.
    fn subscribe(
        &mut self,
        now: Timestamp,
        base: &str,
        subscription: Self::Subscription,
    ) -> Result<Resource<Self::Subscription>, RequestError> {
        let scheduled = scheduled(self, now, subscription)?;
        self.subscriptions().add(now, base, scheduled)
    }

    /// Replaces a subscription by another of its type. Waiting notifications are kept if the target stays the same.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    fn resubscribe(
        &mut self,
        now: Timestamp,
        base: &str,
        id: &str,
        if_match: Option<&str>,
        subscription: Self::Subscription,
    ) -> Result<Resource<Self::Subscription>, RequestError> {
        let scheduled = scheduled(self, now, subscription)?;
        self.subscriptions().replace(now, base, id, if_match, scheduled)
    }
}

/// Checks a subscription, and starts its schedule.
fn scheduled<M: Machine + ?Sized>(
    machine: &M,
    now: Timestamp,
    subscription: M::Subscription,
) -> Result<Scheduled<M::Subscription>, RequestError> {
    subscription.check()?;
    machine.check(&subscription)?;
    Ok(Scheduled { schedule: machine.schedule(now, &subscription), subscription })
}

/// The testbed of a service.
pub trait Testbed<M: Machine>: Send + Sync + 'static {
    /// Returns the time of the run.
    fn now(&self) -> Timestamp;

    /// Surveys a site.
    fn survey(&self, site: &Arc<M::Site>) -> M::Survey;

    /// Returns the maximum age of a survey from which a query may be answered.
    fn freshness(&self) -> Duration;

    /// Reports a message to the operator.
    fn tell(&self, message: String);
}

/// A service that is ready to be served.
pub struct Service<M: Machine>(Arc<Shared<M>>);

impl<M: Machine> Clone for Service<M> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

struct Shared<M: Machine> {
    testbed: Arc<dyn Testbed<M>>,
    /// The service, and the time of its last survey.
    state: Mutex<(M, Option<Timestamp>)>,
    allowed: Allowed,
    prefix: String,
    wake: Notify,
    sockets: Sockets,
}

impl<M: Machine> Service<M> {
    /// Serves a state machine below the path `prefix`, such as `/wai/v2`. Notifications go to `allowed` networks.
    pub fn new(testbed: Arc<dyn Testbed<M>>, machine: M, allowed: Allowed, prefix: String) -> Self {
        let state = Mutex::new((machine, None));
        let (wake, sockets) = (Notify::new(), Sockets::default());
        Self(Arc::new(Shared { testbed, state, allowed, prefix, wake, sockets }))
    }

    /// Returns the path of the service.
    pub fn prefix(&self) -> &str {
        &self.0.prefix
    }

    /// Returns the time of the run.
    pub fn now(&self) -> Timestamp {
        self.0.testbed.now()
    }

    /// Runs a closure with the service, after a new survey if the last one is too old.
    pub fn with<R>(&self, act: impl FnOnce(&mut M) -> R) -> R {
        let mut state = self.0.state.lock();
        let (machine, known) = &mut *state;
        let now = self.now();
        let freshness = self.0.testbed.freshness();
        let is_fresh = known.is_some_and(|known| known <= now && now.since(known) < freshness);
        if !is_fresh {
            machine.observe(self.0.testbed.survey(machine.site()));
            *known = Some(now);
        }
        let result = act(machine);
        let complaints = machine.subscriptions().take_complaints();
        drop(state);
        for complaint in complaints {
            self.0.testbed.tell(complaint);
        }
        result
    }

    /// Sends notifications that may have become due.
    pub fn wake(&self) {
        self.0.wake.notify_one();
    }

    pub(crate) fn sockets(&self) -> &Sockets {
        &self.0.sockets
    }

    /// Rejects an invalid subscription, and one whose callback could never be called.
    ///
    /// # Errors
    /// [`RequestError`].
    pub async fn check(&self, subscription: &M::Subscription) -> Result<(), RequestError> {
        subscription.check()?;
        if let Target::Callback(callback) = Target::of(subscription.notifying())? {
            resolve(&callback, &self.0.allowed).await?;
        }
        Ok(())
    }

    pub(crate) fn set_websocket_open(&self, subscription: u64, open: bool) {
        self.with(|machine| machine.subscriptions().set_websocket_open(subscription, open));
        self.wake();
    }
}

impl<M: Machine> Notifier for Service<M> {
    type Target = Target;

    fn poll(&self) -> (Vec<Dispatch<Target>>, Option<Duration>) {
        let now = self.now();
        self.with(|machine| {
            let dispatches = machine.poll(now);
            let subscriptions = machine.subscriptions();
            self.0.sockets.keep(|subscription| subscriptions.has_websocket(subscription));
            let wait = subscriptions.next_deadline().map_or(LOOK, |deadline| deadline.since(now).min(LOOK));
            // In virtual time a deadline may stand still: this must not become a busy loop.
            let wait = wait.max(Duration::from_millis(1));
            (dispatches, (!subscriptions.is_empty()).then_some(wait))
        })
    }

    async fn woken(&self) {
        self.0.wake.notified().await;
    }

    async fn send(&self, Dispatch { subscription, target, body, .. }: Dispatch<Target>) -> Outcome {
        match target {
            Target::WebSocket => self.0.sockets.send(subscription, body).await,
            Target::Callback(callback) => post(&callback, &self.0.allowed, body).await,
        }
    }

    fn done(&self, subscription: u64, attempt: u64, outcome: Outcome) {
        let now = self.now();
        self.with(|machine| machine.subscriptions().done(now, subscription, attempt, outcome));
        self.wake();
    }
}
