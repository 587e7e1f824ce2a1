//! Subscriptions of consumers to a service, without a clock or a socket: requests go in with the time, notifications
//! come out. The service composes the notifications.

use std::{borrow::Cow, collections::BTreeMap, fmt::Debug, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;
use serde::Serialize;

use crate::{
    callback::Callback,
    conditional::may_change,
    delivery::Dispatch,
    limiter::Limiter,
    outbox::{Outbox, Outcome},
    subscribing::{InvalidRequest, MOST, Notifying, RequestError, Resource, SelfLink, WebsockNotifConfig},
    time::{Epoch, TimeStamp},
};

/// Longest life of a subscription with a deadline, without renewal.
const LONGEST_LIFE: Duration = Duration::from_secs(24 * 3600);
/// Time before expiry at which the consumer is notified, or half of the subscription's life if that is less.
const NOTICE: Duration = Duration::from_secs(30);

/// Target of a subscription's notifications.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A server of the consumer.
    Callback(Callback),
    /// The WebSocket of the subscription.
    WebSocket,
}

impl Target {
    /// Returns the target of a subscription; the WebSocket if both are requested.
    ///
    /// # Errors
    /// [`RequestError::Invalid`] if neither is requested, [`RequestError::Callback`] for an invalid callback.
    pub fn of(notifying: &Notifying) -> Result<Self, RequestError> {
        let socket = notifying.websock_notif_config.as_ref();
        if socket.is_some_and(|socket| socket.request_websocket_uri == Some(true)) {
            return Ok(Self::WebSocket);
        }
        let callback = notifying.callback_reference.as_ref().ok_or_else(|| {
            let what = "one of callbackReference and websockNotifConfig.requestWebsocketUri is needed";
            InvalidRequest::Malformed(what.to_owned())
        })?;
        Ok(Self::Callback(Callback::read(callback)?))
    }
}

/// A subscription of a standard.
pub trait Subscribed: Clone + Debug + Serialize + Send + Sync + 'static {
    /// Name of the service, for messages to the operator.
    const SERVICE: &'static str;
    /// Paths of the lists of subscriptions, below the service's: `subscriptions`. A path can have parameters.
    const LISTS: &'static [&'static str];
    /// What decides when notifications are due.
    type Schedule: Debug + Send;

    /// Parses the JSON of a subscription that is to be in a list.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] with the place.
    fn read(list: &str, body: &[u8]) -> Result<Self, InvalidRequest>;

    /// Returns the name of its type.
    fn type_name(&self) -> &'static str;

    /// Returns the path of the list that it is in, below the service's.
    fn list(&self) -> Cow<'static, str>;

    /// Returns the target and end of its notifications.
    fn notifying(&self) -> &Notifying;

    /// Returns the same to change it.
    fn notifying_mut(&mut self) -> &mut Notifying;

    /// Checks constraints that the types do not express.
    ///
    /// # Errors
    /// [`InvalidRequest`].
    fn check(&self) -> Result<(), InvalidRequest>;

    /// Returns when a notification may be due even if nothing changes; by default, never.
    fn deadline(_schedule: &Self::Schedule) -> Option<Timestamp> {
        None
    }

    /// Returns the notification that tests whether notifications arrive.
    fn test(href: &str) -> Arc<str>;

    /// Returns the notification of a subscription that is about to expire; by default `None`, for standards without one.
    fn expiry(_href: &str, _at: TimeStamp) -> Option<Arc<str>> {
        None
    }
}

#[derive(Debug)]
struct Held<S: Subscribed> {
    subscription: S,
    target: Target,
    /// URI by which the consumer that made it sees it.
    href: String,
    version: u64,
    schedule: S::Schedule,
    outbox: Outbox,
    expiry: Option<Expiry>,
}

#[derive(Debug, Clone, Copy)]
struct Expiry {
    at: Timestamp,
    /// Time of the expiry notification; `None` once it was sent.
    notice: Option<Timestamp>,
}

/// A checked subscription with the schedule of its notifications.
pub(crate) struct Scheduled<S: Subscribed> {
    pub(crate) subscription: S,
    pub(crate) schedule: S::Schedule,
}

/// The subscriptions to a service.
#[derive(Debug)]
pub struct Subscriptions<S: Subscribed> {
    epoch: Epoch,
    held: BTreeMap<u64, Held<S>>,
    /// The last number assigned to a resource, a version or an attempt.
    numbers: u64,
    limiter: Limiter,
    complaints: Vec<String>,
}

impl<S: Subscribed> Subscriptions<S> {
    /// Makes an empty set.
    pub fn new(epoch: Epoch) -> Self {
        let (held, limiter, complaints) = (BTreeMap::new(), Limiter::default(), Vec::new());
        Self { epoch, held, numbers: 0, limiter, complaints }
    }

    /// Assigns a number to a resource or a version of the service.
    pub fn number(&mut self) -> u64 {
        self.numbers += 1;
        self.numbers
    }

    /// Admits a change of the service's resources.
    ///
    /// # Errors
    /// [`RequestError::TooOften`].
    pub fn admit(&mut self, now: Timestamp) -> Result<(), RequestError> {
        Ok(self.limiter.admit(now)?)
    }

    /// Creates a subscription. `base` is the URI under which the consumer sees the service.
    ///
    /// # Errors
    /// [`RequestError`]; then there is none.
    pub(crate) fn add(
        &mut self,
        now: Timestamp,
        base: &str,
        Scheduled { subscription, schedule }: Scheduled<S>,
    ) -> Result<Resource<S>, RequestError> {
        self.admit(now)?;
        let (target, expiry) = self.target(now, &subscription)?;
        if self.held.len() >= MOST {
            return Err(RequestError::Full);
        }
        let (id, version) = (self.number(), self.number());
        let outbox = Outbox::new(target != Target::WebSocket);
        let list = subscription.list();
        let href = uri(base, &list, id);
        self.hold(id, Held { schedule, href, subscription, target, version, outbox, expiry });
        self.get(base, &list, &id.to_string())
    }

    /// Replaces a subscription by another of its type. Waiting notifications are kept if the target stays the same.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    pub(crate) fn replace(
        &mut self,
        now: Timestamp,
        base: &str,
        id: &str,
        if_match: Option<&str>,
        Scheduled { subscription, schedule }: Scheduled<S>,
    ) -> Result<Resource<S>, RequestError> {
        self.admit(now)?;
        let list = subscription.list();
        let (number, held) = self.find(&list, id)?;
        let (type_name, version) = (held.subscription.type_name(), held.version);
        let (target, expiry) = self.target(now, &subscription)?;
        if type_name != subscription.type_name() {
            let what = format!("the subscription is a {type_name}, which cannot change");
            return Err(InvalidRequest::Malformed(what).into());
        }
        let href = uri(base, &list, number);
        if let Some(links) = &subscription.notifying().links
            && !links.itself.href.ends_with(&format!("/{list}/{number}"))
        {
            return Err(InvalidRequest::Malformed(format!("_links.self must be {href}")).into());
        }
        check_unchanged(if_match, number, version)?;
        let old = self.held.remove(&number);
        let kept = old.filter(|old| old.target == target).map(|old| old.outbox);
        let outbox = kept.unwrap_or_else(|| Outbox::new(target != Target::WebSocket));
        let version = self.number();
        self.hold(number, Held { schedule, href, subscription, target, version, outbox, expiry });
        self.get(base, &list, id)
    }

    fn hold(&mut self, id: u64, mut held: Held<S>) {
        let complaint = match held.subscription.notifying().request_test_notification {
            Some(true) => held.outbox.push(S::test(&held.href)),
            _ => None,
        };
        self.complaints.extend(complaint);
        self.held.insert(id, held);
    }

    /// Returns the target of a subscription, and its expiry.
    fn target(&self, now: Timestamp, subscription: &S) -> Result<(Target, Option<Expiry>), RequestError> {
        let target = Target::of(subscription.notifying())?;
        let Some(deadline) = subscription.notifying().expiry_deadline else { return Ok((target, None)) };
        let at = self.epoch.run_time(deadline).min(now + LONGEST_LIFE);
        if at <= now {
            return Err(InvalidRequest::Malformed("expiryDeadline is in the past".to_owned()).into());
        }
        let notice = NOTICE.min(at.since(now) / 2);
        Ok((target, Some(Expiry { at, notice: Some(at - notice) })))
    }

    fn find(&self, list: &str, id: &str) -> Result<(u64, &Held<S>), RequestError> {
        let number = id.parse().ok();
        let found = number.and_then(|number| Some((number, self.held.get(&number)?)));
        found
            .filter(|(_, held)| held.subscription.list() == list)
            .ok_or_else(|| RequestError::NotFound { what: "subscription", id: id.to_owned() })
    }

    /// Returns a subscription in a list.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn get(&self, base: &str, list: &str, id: &str) -> Result<Resource<S>, RequestError> {
        let (number, held) = self.find(list, id)?;
        let mut value = held.subscription.clone();
        let href = uri(base, list, number);
        let notifying = value.notifying_mut();
        notifying.links = Some(SelfLink::to(href.clone()));
        notifying.expiry_deadline = held.expiry.map(|expiry| self.epoch.at(expiry.at));
        match held.target {
            Target::Callback(_) => notifying.websock_notif_config = None,
            Target::WebSocket => {
                notifying.callback_reference = None;
                let (_, rest) = href.split_once("://").unwrap_or(("", &href));
                notifying.websock_notif_config = Some(WebsockNotifConfig {
                    websocket_uri: Some(format!("ws://{rest}/websocket")),
                    request_websocket_uri: Some(true),
                });
            }
        }
        Ok(Resource { value, href, etag: etag(number, held.version) })
    }

    /// Returns the subscriptions with their URIs.
    pub fn all<'a>(&'a self, base: &'a str) -> impl Iterator<Item = (&'a S, String)> {
        self.held.iter().map(move |(id, held)| {
            let subscription = &held.subscription;
            (subscription, uri(base, &subscription.list(), *id))
        })
    }

    /// Ends a subscription. Waiting notifications are not sent.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn remove(
        &mut self,
        now: Timestamp,
        list: &str,
        id: &str,
        if_match: Option<&str>,
    ) -> Result<(), RequestError> {
        self.admit(now)?;
        let (number, held) = self.find(list, id)?;
        check_unchanged(if_match, number, held.version)?;
        self.held.remove(&number);
        Ok(())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Ends expired subscriptions, queues the notifications that `compose` returns for each of the others, and returns
    /// those to send now. `compose` also has the URI of the subscription. The sender reports each outcome by
    /// [`Subscriptions::done`].
    pub fn poll<I: IntoIterator<Item = Arc<str>>>(
        &mut self,
        now: Timestamp,
        mut compose: impl FnMut(&S, &mut S::Schedule, &str) -> I,
    ) -> Vec<Dispatch<Target>> {
        self.held.retain(|_, held| held.expiry.is_none_or(|expiry| now < expiry.at));
        let mut dispatches = Vec::new();
        for (id, held) in &mut self.held {
            let mut notifications = Vec::new();
            if let Some(expiry) = &mut held.expiry
                && expiry.notice.take_if(|notice| *notice <= now).is_some()
            {
                notifications.extend(S::expiry(&held.href, self.epoch.at(expiry.at)));
            }
            notifications.extend(compose(&held.subscription, &mut held.schedule, &held.href));
            for notification in notifications {
                let complaint = held.outbox.push(notification);
                self.complaints.extend(complaint.map(|what| about::<S>(&held.href, &what)));
            }
            if let Some(body) = held.outbox.poll(now, self.numbers + 1) {
                self.numbers += 1;
                let (attempt, target) = (self.numbers, held.target.clone());
                dispatches.push(Dispatch { subscription: *id, attempt, target, body });
            }
        }
        dispatches
    }

    /// Returns when [`Subscriptions::poll`] has something to do, even if nothing is observed until then.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let of = |held: &Held<S>| {
            let expiry = held.expiry.map(|expiry| expiry.notice.unwrap_or(expiry.at));
            [expiry, S::deadline(&held.schedule), held.outbox.deadline()].into_iter().flatten().min()
        };
        self.held.values().filter_map(of).min()
    }

    /// Records the outcome of an attempt to send a notification.
    pub fn done(&mut self, now: Timestamp, subscription: u64, attempt: u64, outcome: Outcome) {
        let Some(held) = self.held.get_mut(&subscription) else { return };
        let complaint = held.outbox.done(now, attempt, outcome);
        self.complaints.extend(complaint.map(|what| about::<S>(&held.href, &what)));
    }

    /// Whether the subscription exists and is notified over a WebSocket.
    pub fn has_websocket(&self, subscription: u64) -> bool {
        self.held.get(&subscription).is_some_and(|held| held.target == Target::WebSocket)
    }

    /// Records that a subscription's WebSocket was opened or closed. Does nothing if it has none.
    pub fn set_websocket_open(&mut self, subscription: u64, open: bool) {
        let held = self.held.get_mut(&subscription);
        if let Some(held) = held.filter(|held| held.target == Target::WebSocket) {
            held.outbox.set_open(open);
        }
    }

    /// Returns the complaints to the operator since the last call: dropped notifications and their reasons.
    pub fn take_complaints(&mut self) -> Vec<String> {
        std::mem::take(&mut self.complaints)
    }
}

fn about<S: Subscribed>(href: &str, what: &str) -> String {
    format!("{}, {href}: {what}", S::SERVICE)
}

fn uri(base: &str, list: &str, id: u64) -> String {
    format!("{base}/{list}/{id}")
}

/// Checks that `If-Match` permits a change of a resource's version.
///
/// # Errors
/// [`RequestError::Changed`].
pub fn check_unchanged(if_match: Option<&str>, id: u64, version: u64) -> Result<(), RequestError> {
    let etag = etag(id, version);
    if may_change(if_match, &etag) { Ok(()) } else { Err(RequestError::Changed(etag)) }
}

/// Returns the entity tag of a resource's version.
pub fn etag(id: u64, version: u64) -> String {
    format!("\"{id}-{version}\"")
}
