//! The service as a state machine, without a clock or a socket: surveys and requests go in with the time, answers and
//! notifications come out.

use std::{borrow::Cow, sync::Arc};

use cotorra_graph::Timestamp;
use cotorra_mec::{
    Dispatch, Epoch, InvalidRequest, LinkType, Machine, Notifying, RequestError, Subscribed, Subscriptions,
    Target,
};
use serde_json::json;

use crate::{
    notification::{Area, Schedule, links},
    requests::{List, Subscription},
    survey::{Site, Survey},
    types::{
        AccessPointInfo, AccessPointList, NotificationSubscriptionList, SubscriptionLink, TerminalDistance,
        UserList, ZoneInfo, ZoneList,
    },
    view::{DistanceQuery, UserQuery, View},
};

/// The Location API of one scope.
#[derive(Debug)]
pub struct Location {
    site: Arc<Site>,
    epoch: Epoch,
    survey: Survey,
    subscriptions: Subscriptions<Subscription>,
}

impl Location {
    /// Makes the service of a site, of which nothing is known yet.
    pub fn new(site: Arc<Site>, epoch: Epoch) -> Self {
        Self { site, epoch, survey: Survey::empty(), subscriptions: Subscriptions::new(epoch) }
    }

    fn view<'a>(&'a self, base: &'a str) -> View<'a> {
        View { site: &self.site, survey: &self.survey, epoch: self.epoch, base }
    }

    /// Returns the zones with these IDs; all without any. `base` is the URI under which the consumer sees the service.
    pub fn zones(&self, base: &str, ids: &[String]) -> ZoneList {
        self.view(base).zones(ids)
    }

    /// Returns a zone.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn zone(&self, base: &str, zone: &str) -> Result<ZoneInfo, RequestError> {
        self.view(base).zone(zone)
    }

    /// Returns the access points of a zone with these IDs; all without any.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn access_points(
        &self,
        base: &str,
        zone: &str,
        ids: &[String],
    ) -> Result<AccessPointList, RequestError> {
        self.view(base).access_points(zone, ids)
    }

    /// Returns an access point.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn access_point(&self, base: &str, zone: &str, id: &str) -> Result<AccessPointInfo, RequestError> {
        self.view(base).access_point(zone, id)
    }

    /// Returns users.
    pub fn users(&self, base: &str, query: &UserQuery) -> UserList {
        self.view(base).users(query)
    }

    /// Returns the distance of a user from another, or from a place.
    ///
    /// # Errors
    /// [`RequestError`] if there is no such user, or a place is unknown.
    pub fn distance(&self, query: &DistanceQuery) -> Result<TerminalDistance, RequestError> {
        self.view("").distance(query)
    }

    /// Returns links to the subscriptions of a list that are wanted.
    pub fn links(
        &self,
        base: &str,
        list: List,
        wanted: impl Fn(&Subscription) -> bool,
    ) -> NotificationSubscriptionList {
        let all = self.subscriptions.all(base);
        let all = all.filter(|(subscription, _)| subscription.list() == list && wanted(subscription));
        let link = |(subscription, href): (&Subscription, String)| SubscriptionLink {
            href,
            subscription_type: subscription.type_name(),
        };
        NotificationSubscriptionList {
            resource_url: LinkType::to(format!("{base}/{}", list.path())),
            subscription: all.map(link).collect(),
        }
    }
}

impl Machine for Location {
    type Site = Site;
    type Survey = Survey;
    type Subscription = Subscription;

    fn site(&self) -> &Arc<Site> {
        &self.site
    }

    fn observe(&mut self, survey: Survey) {
        self.survey = survey;
    }

    fn check(&self, subscription: &Subscription) -> Result<(), RequestError> {
        let zone = |zone: &str| match self.site.has_zone(zone) {
            true => Ok(()),
            false => Err(InvalidRequest::Unsupported("there is no zone with this zoneId here")),
        };
        let user = |address: &String| match self.site.has_user(address) {
            true => Ok(()),
            false => Err(InvalidRequest::Unsupported(
                "there is no user with this address; an address is `acr:` and the name of a robot",
            )),
        };
        let exists = match subscription {
            Subscription::UserLocationEventSubscription(s) => {
                user(&s.address)?;
                let named = s.user_event_para.as_ref().and_then(|para| para.zone_id.as_deref());
                named.map_or(Ok(()), zone)
            }
            Subscription::UserLocationPeriodicSubscription(s) => user(&s.address),
            Subscription::ZoneLocationEventSubscription(s) => {
                zone(&s.zone_id)?;
                s.address_list.iter().try_for_each(user)
            }
            Subscription::ZoneStatusSubscription(s) => zone(&s.zone_id),
            Subscription::UserAreaSubscription(s) => {
                s.address_list.iter().try_for_each(user)?;
                Area::new(&s.area_define, &self.view("")).map(|_| ())
            }
            Subscription::UserDistanceSubscription(s) => {
                s.monitored_address.iter().chain(&s.reference_address).try_for_each(user)
            }
        };
        Ok(exists?)
    }

    fn schedule(&self, now: Timestamp, subscription: &Subscription) -> Schedule {
        Schedule::new(now, subscription)
    }

    fn subscriptions(&mut self) -> &mut Subscriptions<Subscription> {
        &mut self.subscriptions
    }

    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        let (site, survey, epoch) = (&self.site, &self.survey, self.epoch);
        self.subscriptions.poll(now, |subscription, schedule, href| {
            // Links in notifications begin as the subscription's.
            let base = href.split_once("/subscriptions/").map_or(href, |(base, _)| base);
            let view = View { site, survey, epoch, base };
            let due = schedule.poll(now, subscription, &view, href);
            due.into_iter().map(|notification| Arc::from(notification.to_string())).collect::<Vec<_>>()
        })
    }
}

impl Subscribed for Subscription {
    const SERVICE: &'static str = "Location API";
    const LISTS: &'static [&'static str] =
        &[List::Users.path(), List::Zones.path(), List::Area.path(), List::Distance.path()];
    type Schedule = Schedule;

    fn read(list: &str, body: &[u8]) -> Result<Self, InvalidRequest> {
        Self::read(list, body)
    }

    fn type_name(&self) -> &'static str {
        Subscription::type_name(self)
    }

    fn list(&self) -> Cow<'static, str> {
        Subscription::list(self).path().into()
    }

    fn notifying(&self) -> &Notifying {
        &self.common().notifying
    }

    fn notifying_mut(&mut self) -> &mut Notifying {
        &mut self.common_mut().notifying
    }

    fn check(&self) -> Result<(), InvalidRequest> {
        self.check_constraints()
    }

    fn deadline(schedule: &Schedule) -> Option<Timestamp> {
        schedule.deadline()
    }

    fn test(href: &str) -> Arc<str> {
        json!({ "notificationType": "TestNotification", "_links": links(href) }).to_string().into()
    }
}

#[cfg(test)]
mod tests;
