//! The service as a state machine, without a clock or a socket: surveys and requests go in with the time, answers and
//! notifications come out.

mod configured;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;
use cotorra_mec::{Callback, CallbackError, Dispatch, Limiter, Outbox, Outcome, Query, TooOften};

use self::configured::Configured;
use crate::{
    conditional::may_change,
    notification::{Notification, Schedule},
    requests::{InvalidRequest, Subscription, SubscriptionLink, SubscriptionLinkList, WebsockNotifConfig},
    survey::{Site, Survey},
    types::{Epoch, SelfLink},
    view::{self, Answer, Kind, Listings},
};

/// Most subscriptions, and most measurement configurations.
const MOST: usize = 256;
/// Longest life of a subscription with a deadline, without renewal.
const LONGEST_LIFE: Duration = Duration::from_secs(24 * 3600);
/// Time before expiry at which the consumer is notified, or half of the subscription's life if that is less.
const NOTICE: Duration = Duration::from_secs(30);

/// A request that is not met.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The request is invalid.
    #[error(transparent)]
    Invalid(#[from] InvalidRequest),
    /// The callback cannot be used.
    #[error(transparent)]
    Callback(#[from] CallbackError),
    /// There is no such resource.
    #[error("there is no {what} `{id}`")]
    NotFound {
        /// Kind of the resource.
        what: &'static str,
        /// Its ID.
        id: String,
    },
    /// The resource was changed meanwhile.
    #[error("the resource has changed since the version in `If-Match`: it is {0} now")]
    Changed(String),
    /// The limit is reached.
    #[error("there are {MOST} already: delete some first")]
    Full,
    /// Changes are too frequent.
    #[error(transparent)]
    TooOften(#[from] TooOften),
}

/// A resource with its metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Resource<T> {
    pub value: T,
    pub href: String,
    /// Entity tag in quotes, which changes with the resource.
    pub etag: String,
}

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
    pub fn of(subscription: &Subscription) -> Result<Self, RequestError> {
        let notifying = subscription.notifying();
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

#[derive(Debug)]
struct Held {
    subscription: Subscription,
    target: Target,
    /// URI by which the consumer that made it sees it.
    href: String,
    version: u64,
    schedule: Schedule,
    outbox: Outbox,
    expiry: Option<Expiry>,
}

#[derive(Debug, Clone, Copy)]
struct Expiry {
    at: Timestamp,
    /// Time of the expiry notification; `None` once it was sent.
    notice: Option<Timestamp>,
}

/// The WLAN Access Information Service of one scope.
#[derive(Debug)]
pub struct Wais {
    site: Arc<Site>,
    epoch: Epoch,
    survey: Survey,
    listings: Listings,
    subscriptions: BTreeMap<u64, Held>,
    configured: BTreeMap<u64, Configured>,
    /// The last number assigned to a resource, a version or an attempt.
    numbers: u64,
    limiter: Limiter,
    complaints: Vec<String>,
}

impl Wais {
    /// Makes the service of a site, of which nothing is known yet.
    pub fn new(site: Arc<Site>, epoch: Epoch) -> Self {
        Self {
            survey: Survey::empty(&site),
            site,
            epoch,
            listings: Listings::default(),
            subscriptions: BTreeMap::new(),
            configured: BTreeMap::new(),
            numbers: 0,
            limiter: Limiter::default(),
            complaints: Vec::new(),
        }
    }

    pub fn site(&self) -> &Arc<Site> {
        &self.site
    }

    /// Replaces the survey.
    pub fn observe(&mut self, survey: Survey) {
        self.survey = survey;
        self.listings.forget();
    }

    /// Answers a query.
    pub fn query(&mut self, of: Kind, query: &Query) -> Answer {
        let (survey, epoch) = (&self.survey, self.epoch);
        let listing = match of {
            Kind::AccessPoints => self.listings.access_points(|| view::access_points(survey, epoch)),
            Kind::Stations => {
                let configured = self.configured.values().map(|configured| &configured.config);
                self.listings.stations(|| view::stations(survey, epoch, configured))
            }
        };
        listing.answer(query)
    }

    fn number(&mut self) -> u64 {
        self.numbers += 1;
        self.numbers
    }

    fn admit(&mut self, now: Timestamp) -> Result<(), RequestError> {
        Ok(self.limiter.admit(now)?)
    }

    /// Creates a subscription. `base` is the URI under which the consumer sees the service.
    ///
    /// # Errors
    /// [`RequestError`]; then there is none.
    pub fn subscribe(
        &mut self,
        now: Timestamp,
        base: &str,
        subscription: Subscription,
    ) -> Result<Resource<Subscription>, RequestError> {
        self.admit(now)?;
        let (target, expiry) = self.check(now, &subscription)?;
        if self.subscriptions.len() >= MOST {
            return Err(RequestError::Full);
        }
        let (id, version) = (self.number(), self.number());
        let outbox = Outbox::new(target != Target::WebSocket);
        self.hold(
            id,
            Held {
                schedule: Schedule::new(now, &subscription),
                href: subscription_uri(base, id),
                subscription,
                target,
                version,
                outbox,
                expiry,
            },
        );
        self.subscription(base, &id.to_string())
    }

    /// Replaces a subscription by another of its type. Waiting notifications are kept if the target stays the same.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    pub fn resubscribe(
        &mut self,
        now: Timestamp,
        base: &str,
        id: &str,
        if_match: Option<&str>,
        subscription: Subscription,
    ) -> Result<Resource<Subscription>, RequestError> {
        self.admit(now)?;
        let (number, held) = self.find(id)?;
        let type_name = held.subscription.type_name();
        let version = held.version;
        let (target, expiry) = self.check(now, &subscription)?;
        if type_name != subscription.type_name() {
            let what = format!("the subscription is a {type_name}, which cannot change");
            return Err(InvalidRequest::Malformed(what).into());
        }
        if let Some(links) = &subscription.notifying().links
            && !links.itself.href.ends_with(&format!("/subscriptions/{number}"))
        {
            let what = format!("_links.self must be {}", subscription_uri(base, number));
            return Err(InvalidRequest::Malformed(what).into());
        }
        check_unchanged(if_match, number, version)?;
        let old = self.subscriptions.remove(&number);
        let kept = old.filter(|old| old.target == target).map(|old| old.outbox);
        let outbox = kept.unwrap_or_else(|| Outbox::new(target != Target::WebSocket));
        let version = self.number();
        self.hold(
            number,
            Held {
                schedule: Schedule::new(now, &subscription),
                href: subscription_uri(base, number),
                subscription,
                target,
                version,
                outbox,
                expiry,
            },
        );
        self.subscription(base, id)
    }

    fn hold(&mut self, id: u64, mut held: Held) {
        let complaint = match held.subscription.notifying().request_test_notification {
            Some(true) => held.outbox.push(Notification::test(&held.href).to_json()),
            _ => None,
        };
        self.complaints.extend(complaint);
        self.subscriptions.insert(id, held);
    }

    /// Checks a subscription, and returns its target and its expiry.
    fn check(
        &self,
        now: Timestamp,
        subscription: &Subscription,
    ) -> Result<(Target, Option<Expiry>), RequestError> {
        subscription.check()?;
        let target = Target::of(subscription)?;
        if let Subscription::AssocStaSubscription(s) = subscription
            && !self.site.serves(s.ap_id.bssid)
        {
            return Err(InvalidRequest::Unsupported("there is no access point with this bssid here").into());
        }
        let Some(deadline) = subscription.notifying().expiry_deadline else { return Ok((target, None)) };
        let at = self.epoch.run_time(deadline).min(now + LONGEST_LIFE);
        if at <= now {
            return Err(InvalidRequest::Malformed("expiryDeadline is in the past".to_owned()).into());
        }
        let notice = NOTICE.min(at.since(now) / 2);
        Ok((target, Some(Expiry { at, notice: Some(at - notice) })))
    }

    fn find(&self, id: &str) -> Result<(u64, &Held), RequestError> {
        let number = id.parse().ok();
        let found = number.and_then(|number| Some((number, self.subscriptions.get(&number)?)));
        found.ok_or_else(|| RequestError::NotFound { what: "subscription", id: id.to_owned() })
    }

    /// Returns a subscription.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn subscription(&self, base: &str, id: &str) -> Result<Resource<Subscription>, RequestError> {
        let (number, held) = self.find(id)?;
        let mut value = held.subscription.clone();
        let href = subscription_uri(base, number);
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

    /// Returns links to all subscriptions, or to those of one type.
    pub fn subscriptions(&self, base: &str, type_name: Option<&str>) -> SubscriptionLinkList {
        let wanted = |held: &Held| type_name.is_none_or(|name| held.subscription.type_name() == name);
        let held = self.subscriptions.iter().filter(|(_, held)| wanted(held));
        let link = |(id, held): (&u64, &Held)| SubscriptionLink {
            href: subscription_uri(base, *id),
            subscription_type: held.subscription.type_name(),
        };
        SubscriptionLinkList {
            links: SelfLink::to(format!("{base}/subscriptions")),
            subscription: held.map(link).collect(),
        }
    }

    /// Ends a subscription. Waiting notifications are not sent.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn unsubscribe(
        &mut self,
        now: Timestamp,
        id: &str,
        if_match: Option<&str>,
    ) -> Result<(), RequestError> {
        self.admit(now)?;
        let (number, held) = self.find(id)?;
        check_unchanged(if_match, number, held.version)?;
        self.subscriptions.remove(&number);
        Ok(())
    }

    /// Whether there are any subscriptions.
    pub fn has_subscriptions(&self) -> bool {
        !self.subscriptions.is_empty()
    }

    /// Ends expired subscriptions, composes due notifications, and returns those to send now. The sender reports each
    /// outcome by [`Wais::done`].
    pub fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        self.subscriptions.retain(|_, held| held.expiry.is_none_or(|expiry| now < expiry.at));
        let mut dispatches = Vec::new();
        for (id, held) in &mut self.subscriptions {
            let mut notifications = Vec::new();
            if let Some(expiry) = &mut held.expiry
                && expiry.notice.take_if(|notice| *notice <= now).is_some()
            {
                notifications.push(Notification::expiry(&held.href, self.epoch.at(expiry.at)));
            }
            notifications.extend(held.schedule.poll(now, &held.subscription, &self.survey, self.epoch));
            for notification in notifications {
                let complaint = held.outbox.push(notification.to_json());
                self.complaints.extend(complaint.map(|what| about(&held.href, &what)));
            }
            if let Some(body) = held.outbox.poll(now, self.numbers + 1) {
                self.numbers += 1;
                let (attempt, target) = (self.numbers, held.target.clone());
                dispatches.push(Dispatch { subscription: *id, attempt, target, body });
            }
        }
        dispatches
    }

    /// Returns when [`Wais::poll`] has something to do, even if nothing is observed until then.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let of = |held: &Held| {
            let expiry = held.expiry.map(|expiry| expiry.notice.unwrap_or(expiry.at));
            [expiry, held.schedule.deadline(), held.outbox.deadline()].into_iter().flatten().min()
        };
        self.subscriptions.values().filter_map(of).min()
    }

    /// Records the outcome of an attempt to send a notification.
    pub fn done(&mut self, now: Timestamp, subscription: u64, attempt: u64, outcome: Outcome) {
        let Some(held) = self.subscriptions.get_mut(&subscription) else { return };
        let complaint = held.outbox.done(now, attempt, outcome);
        self.complaints.extend(complaint.map(|what| about(&held.href, &what)));
    }

    /// Whether the subscription exists and is notified over a WebSocket.
    pub fn has_websocket(&self, subscription: u64) -> bool {
        self.subscriptions.get(&subscription).is_some_and(|held| held.target == Target::WebSocket)
    }

    /// Records that a subscription's WebSocket was opened or closed. Does nothing if it has none.
    pub fn set_websocket_open(&mut self, subscription: u64, open: bool) {
        let held = self.subscriptions.get_mut(&subscription);
        if let Some(held) = held.filter(|held| held.target == Target::WebSocket) {
            held.outbox.set_open(open);
        }
    }

    /// Returns the complaints to the operator since the last call: dropped notifications and their reasons.
    pub fn take_complaints(&mut self) -> Vec<String> {
        std::mem::take(&mut self.complaints)
    }
}

fn about(href: &str, what: &str) -> String {
    format!("WAIS, {href}: {what}")
}

fn subscription_uri(base: &str, id: u64) -> String {
    format!("{base}/subscriptions/{id}")
}

/// Checks that `If-Match` permits a change of a resource's version.
fn check_unchanged(if_match: Option<&str>, id: u64, version: u64) -> Result<(), RequestError> {
    let etag = etag(id, version);
    if may_change(if_match, &etag) { Ok(()) } else { Err(RequestError::Changed(etag)) }
}

fn etag(id: u64, version: u64) -> String {
    format!("\"{id}-{version}\"")
}

#[cfg(test)]
mod tests;
