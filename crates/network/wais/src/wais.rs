//! The service as a state machine, without a clock or a socket: surveys and requests go in with the time, answers and
//! notifications come out.

mod configured;

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::Timestamp;
use cotorra_mec::{Dispatch, Machine, Query, RequestError, Subscribed as _, Subscriptions, Target};

use self::configured::Configured;
use crate::{
    notification::Schedule,
    requests::{InvalidRequest, Subscription, SubscriptionLink, SubscriptionLinkList},
    subscribed::SUBSCRIPTIONS,
    survey::{Site, Survey},
    types::{Epoch, SelfLink},
    view::{self, Answer, Kind, Listings},
};

/// The WLAN Access Information Service of one scope.
#[derive(Debug)]
pub struct Wais {
    site: Arc<Site>,
    epoch: Epoch,
    survey: Survey,
    listings: Listings,
    subscriptions: Subscriptions<Subscription>,
    configured: BTreeMap<u64, Configured>,
}

impl Wais {
    /// Makes the service of a site, of which nothing is known yet.
    pub fn new(site: Arc<Site>, epoch: Epoch) -> Self {
        Self {
            survey: Survey::empty(&site),
            site,
            epoch,
            listings: Listings::default(),
            subscriptions: Subscriptions::new(epoch),
            configured: BTreeMap::new(),
        }
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

    /// Returns links to all subscriptions, or to those of one type.
    pub fn subscription_links(&self, base: &str, type_name: Option<&str>) -> SubscriptionLinkList {
        let all = self.subscriptions.all(base).map(|(subscription, href)| SubscriptionLink {
            href,
            subscription_type: subscription.type_name(),
        });
        let wanted = |link: &SubscriptionLink| type_name.is_none_or(|name| link.subscription_type == name);
        SubscriptionLinkList {
            links: SelfLink::to(format!("{base}/{SUBSCRIPTIONS}")),
            subscription: all.filter(wanted).collect(),
        }
    }
}

impl Machine for Wais {
    type Site = Site;
    type Survey = Survey;
    type Subscription = Subscription;

    fn site(&self) -> &Arc<Site> {
        &self.site
    }

    fn observe(&mut self, survey: Survey) {
        self.survey = survey;
        self.listings.forget();
    }

    fn check(&self, subscription: &Subscription) -> Result<(), RequestError> {
        if let Subscription::AssocStaSubscription(s) = subscription
            && !self.site.serves(s.ap_id.bssid)
        {
            return Err(InvalidRequest::Unsupported("there is no access point with this bssid here").into());
        }
        Ok(())
    }

    fn schedule(&self, now: Timestamp, subscription: &Subscription) -> Schedule {
        Schedule::new(now, subscription)
    }

    fn subscriptions(&mut self) -> &mut Subscriptions<Subscription> {
        &mut self.subscriptions
    }

    fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Target>> {
        let (survey, epoch) = (&self.survey, self.epoch);
        self.subscriptions.poll(now, |subscription, schedule, _| {
            schedule.poll(now, subscription, survey, epoch).map(|notification| notification.to_json())
        })
    }
}

#[cfg(test)]
mod tests;
