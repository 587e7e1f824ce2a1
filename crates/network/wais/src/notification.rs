//! Notifications (ETSI GS MEC 028 v2.3.1, clause 6.4): their contents, and when they are due.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;
use serde::Serialize;

use crate::{
    measurement::{Measured, Reports},
    requests::{
        AssocStaSubscription, MeasurementReportSubscription, StaDataRateSubscription, Subscription,
        ToSubscription,
    },
    survey::Survey,
    types::{
        ApIdentity, BeaconReport, ChannelLoad, Epoch, LinkType, Mac, NeighborReport, StaDataRate,
        StaIdentity, TimeStamp,
    },
    view::data_rate,
};

/// Interval of radio units' reports: no measurement is newer.
const MEASUREMENT: Duration = Duration::from_secs(1);
/// Time unit of IEEE 802.11.
const TIME_UNIT: Duration = Duration::from_micros(1024);

/// A notification to a consumer.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(tag = "notificationType")]
pub enum Notification {
    /// Stations associated with an access point (6.4.2).
    #[serde(rename_all = "camelCase")]
    AssocStaNotification {
        /// Time of the survey.
        time_stamp: TimeStamp,
        ap_id: ApIdentity,
        /// Its stations.
        sta_id: Vec<StaIdentity>,
    },
    /// Rates of stations (6.4.3).
    #[serde(rename_all = "camelCase")]
    StaDataRateNotification {
        /// Time of the survey.
        time_stamp: TimeStamp,
        /// Rates of associated stations that meet the threshold, if there is one.
        sta_data_rate: Vec<StaDataRate>,
    },
    /// A subscription is about to expire (6.4.4).
    #[serde(rename_all = "camelCase")]
    ExpiryNotification {
        /// The subscription.
        #[serde(rename = "_links")]
        links: ToSubscription,
        /// Time of expiry.
        expiry_deadline: TimeStamp,
    },
    /// Reports of one kind of measurement (6.4.5).
    #[serde(rename_all = "camelCase")]
    MeasurementReportNotification {
        /// Time of the survey.
        time_stamp: TimeStamp,
        /// Beacons that stations hear.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        #[schema(required = false)]
        beacon_report: Vec<BeaconReport>,
        /// Access points that they could roam to.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        #[schema(required = false)]
        neighbor_report: Vec<NeighborReport>,
        /// Loads of channels.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        #[schema(required = false)]
        channel_load: Vec<ChannelLoad>,
    },
    /// Tests that notifications arrive (6.4.6).
    TestNotification {
        #[serde(rename = "_links")]
        links: ToSubscription,
    },
}

impl Notification {
    pub(crate) fn test(href: &str) -> Self {
        Self::TestNotification { links: to(href) }
    }

    pub(crate) fn expiry(href: &str, expiry_deadline: TimeStamp) -> Self {
        Self::ExpiryNotification { links: to(href), expiry_deadline }
    }

    /// Encodes the notification as it is sent.
    pub(crate) fn to_json(&self) -> Arc<str> {
        serde_json::to_string(self).expect("a notification holds only what JSON can").into()
    }
}

fn to(href: &str) -> ToSubscription {
    ToSubscription { subscription: LinkType { href: href.to_owned() } }
}

/// Schedule of a subscription's notifications.
#[derive(Debug, Default)]
pub struct Schedule {
    /// Interval between notifications. Without one, they are sent when a threshold is reached.
    period: Option<Duration>,
    next: Timestamp,
    /// Stations that met the threshold at the last poll. `None` stands for a threshold on the number of stations.
    met: BTreeSet<Option<Mac>>,
}

impl Schedule {
    pub(crate) fn new(now: Timestamp, subscription: &Subscription) -> Self {
        let seconds = |period: Option<u8>| period.map(|seconds| Duration::from_secs(seconds.into()));
        let period = match subscription {
            Subscription::AssocStaSubscription(s) => seconds(s.notification_period),
            Subscription::StaDataRateSubscription(s) => seconds(s.notification_period),
            Subscription::MeasurementReportSubscription(s) => {
                let units = s.measurement_info.measurement_duration.unwrap_or_default();
                Some(MEASUREMENT.max(TIME_UNIT * units.into()))
            }
        };
        Self { period, next: period.map_or(now, |period| now + period), met: BTreeSet::new() }
    }

    /// Returns when a notification may be due even if nothing changes.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        self.period.map(|_| self.next)
    }

    /// Returns the notification that is due now, if any.
    pub(crate) fn poll(
        &mut self,
        now: Timestamp,
        of: &Subscription,
        survey: &Survey,
        epoch: Epoch,
    ) -> Option<Notification> {
        if let Some(period) = self.period {
            if now < self.next {
                return None;
            }
            // Missed periods are skipped.
            while self.next <= now {
                self.next = self.next + period;
            }
        }
        let time_stamp = epoch.at(survey.at);
        match of {
            Subscription::AssocStaSubscription(s) => self.associated(s, survey, time_stamp),
            Subscription::StaDataRateSubscription(s) => self.rates(s, survey, time_stamp),
            Subscription::MeasurementReportSubscription(s) => reports(s, survey, time_stamp),
        }
    }

    /// Returns which of those meeting a threshold to report: all of them periodically, otherwise those that did not
    /// meet it before.
    fn news(&mut self, met: BTreeSet<Option<Mac>>) -> BTreeSet<Option<Mac>> {
        let news = if self.period.is_some() { met.clone() } else { &met - &self.met };
        self.met = met;
        news
    }

    fn associated(
        &mut self,
        of: &AssocStaSubscription,
        survey: &Survey,
        time_stamp: TimeStamp,
    ) -> Option<Notification> {
        let ap = survey.access_point(of.ap_id.bssid)?;
        if let Some(event) = of.notification_event {
            let (count, threshold) = (ap.associated.len(), usize::from(event.threshold));
            let is_met = if event.trigger == 1 { count >= threshold } else { count <= threshold };
            if self.news(is_met.then_some(None).into_iter().collect()).is_empty() {
                return None;
            }
        }
        let stations = ap.associated.iter().map(|place| survey.stations[*place].identity.clone());
        let (ap_id, sta_id) = (survey.unit(ap).identity.clone(), stations.collect());
        Some(Notification::AssocStaNotification { time_stamp, ap_id, sta_id })
    }

    fn rates(
        &mut self,
        of: &StaDataRateSubscription,
        survey: &Survey,
        time_stamp: TimeStamp,
    ) -> Option<Notification> {
        let stations = of.sta_id.iter().filter_map(|wanted| survey.station(wanted.mac_id));
        let mut rates: Vec<_> =
            stations.filter_map(|station| data_rate(station, Some(station.identity.clone()))).collect();
        if let Some(event) = of.notification_event {
            let mac = |rate: &StaDataRate| rate.sta_id.as_ref().map(|station| station.mac_id);
            rates.retain(|r| event.is_met(r.sta_last_data_downlink_rate, r.sta_last_data_uplink_rate));
            let news = self.news(rates.iter().map(mac).collect());
            rates.retain(|rate| news.contains(&mac(rate)));
            if rates.is_empty() {
                return None;
            }
        }
        Some(Notification::StaDataRateNotification { time_stamp, sta_data_rate: rates })
    }
}

fn reports(
    of: &MeasurementReportSubscription,
    survey: &Survey,
    time_stamp: TimeStamp,
) -> Option<Notification> {
    let mut reports = Reports::default();
    for station in of.sta_id.iter().filter_map(|wanted| survey.station(wanted.mac_id)) {
        let measured = Measured { survey, station, id: &of.measurement_id, named: true };
        measured.report(&of.measurement_info, &mut reports);
    }
    let Reports { beacon_report, neighbor_report, channel_load } = reports;
    let nothing = beacon_report.is_empty() && neighbor_report.is_empty() && channel_load.is_empty();
    (!nothing).then_some(Notification::MeasurementReportNotification {
        time_stamp,
        beacon_report,
        neighbor_report,
        channel_load,
    })
}
