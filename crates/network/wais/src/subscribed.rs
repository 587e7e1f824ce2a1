//! Subscriptions of this service, as the common parts of ETSI MEC hold them.

use std::{borrow::Cow, sync::Arc};

use cotorra_graph::Timestamp;
use cotorra_mec::Subscribed;

use crate::{
    notification::{Notification, Schedule},
    requests::{InvalidRequest, Notifying, Subscription},
    types::TimeStamp,
};

/// Path of the list of subscriptions.
pub(crate) const SUBSCRIPTIONS: &str = "subscriptions";

impl Subscribed for Subscription {
    const SERVICE: &'static str = "WAIS";
    const LISTS: &'static [&'static str] = &[SUBSCRIPTIONS];
    type Schedule = Schedule;

    fn read(_: &str, body: &[u8]) -> Result<Self, InvalidRequest> {
        Self::read(body)
    }

    fn type_name(&self) -> &'static str {
        match self {
            Self::AssocStaSubscription(_) => "AssocStaSubscription",
            Self::StaDataRateSubscription(_) => "StaDataRateSubscription",
            Self::MeasurementReportSubscription(_) => "MeasurementReportSubscription",
        }
    }

    fn list(&self) -> Cow<'static, str> {
        SUBSCRIPTIONS.into()
    }

    fn notifying(&self) -> &Notifying {
        match self {
            Self::AssocStaSubscription(s) => &s.notifying,
            Self::StaDataRateSubscription(s) => &s.notifying,
            Self::MeasurementReportSubscription(s) => &s.notifying,
        }
    }

    fn notifying_mut(&mut self) -> &mut Notifying {
        match self {
            Self::AssocStaSubscription(s) => &mut s.notifying,
            Self::StaDataRateSubscription(s) => &mut s.notifying,
            Self::MeasurementReportSubscription(s) => &mut s.notifying,
        }
    }

    fn check(&self) -> Result<(), InvalidRequest> {
        self.check_constraints()
    }

    fn deadline(schedule: &Schedule) -> Option<Timestamp> {
        schedule.deadline()
    }

    fn test(href: &str) -> Arc<str> {
        Notification::test(href).to_json()
    }

    fn expiry(href: &str, at: TimeStamp) -> Option<Arc<str>> {
        Some(Notification::expiry(href, at).to_json())
    }
}
