//! Answers to queries: the last survey as the standard's data types, serialised once and searched often.

use std::{
    hash::{DefaultHasher, Hash, Hasher},
    sync::Arc,
};

use bytes::Bytes;
use cotorra_mec::{Attribute, Query};
use serde::Serialize;
use serde_json::Value;

use crate::{
    attributes::{AP_INFO, STA_INFO},
    coding::{rcpi, share},
    measurement::{Measured, Reports},
    requests::MeasurementConfig,
    survey::{Station, Survey},
    types::{ApInfo, BssLoad, Epoch, Rssi, StaDataRate, StaIdentity, StaInfo},
};

/// Kind of object to query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `ApInfo`.
    AccessPoints,
    /// `StaInfo`.
    Stations,
}

impl Kind {
    /// Returns the attributes of the object.
    pub fn attributes(self) -> &'static [Attribute] {
        match self {
            Self::AccessPoints => AP_INFO,
            Self::Stations => STA_INFO,
        }
    }
}

/// An answer: a JSON array and its entity tag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// The array.
    pub body: Bytes,
    /// Entity tag in quotes, which changes with the body.
    pub etag: String,
}

impl Answer {
    fn new(body: Vec<u8>) -> Self {
        let mut hasher = DefaultHasher::new();
        body.hash(&mut hasher);
        Self { body: body.into(), etag: format!("\"{:016x}\"", hasher.finish()) }
    }
}

/// All objects of one kind as JSON.
#[derive(Debug)]
pub(crate) struct Listing {
    items: Vec<(Value, String)>,
    whole: Answer,
}

impl Listing {
    fn new<T: Serialize>(things: impl Iterator<Item = T>) -> Self {
        let items: Vec<_> = things
            .map(|thing| {
                let value = serde_json::to_value(&thing).expect("these types hold only what JSON can");
                let text = serde_json::to_string(&thing).expect("these types hold only what JSON can");
                (value, text)
            })
            .collect();
        let whole = Answer::new(array(items.iter().map(|(_, text)| text.as_str())));
        Self { items, whole }
    }

    /// Returns the answer to a query.
    pub(crate) fn answer(&self, query: &Query) -> Answer {
        let wanted = self.items.iter().filter(|(value, _)| query.wants(value));
        match (query.wants_all(), query.selects_all()) {
            (true, true) => self.whole.clone(),
            (false, true) => Answer::new(array(wanted.map(|(_, text)| text.as_str()))),
            (_, false) => Answer::new(array(wanted.map(|(value, _)| query.select(value).to_string()))),
        }
    }
}

fn array<T: AsRef<str>>(items: impl Iterator<Item = T>) -> Vec<u8> {
    let mut text = b"[".to_vec();
    for (i, item) in items.enumerate() {
        text.extend_from_slice(if i == 0 { b"" } else { b"," });
        text.extend_from_slice(item.as_ref().as_bytes());
    }
    text.push(b']');
    text
}

/// Lists the access points.
pub(crate) fn access_points(survey: &Survey, epoch: Epoch) -> Listing {
    Listing::new(survey.access_points.iter().map(|ap| {
        let unit = survey.unit(ap);
        ApInfo {
            time_stamp: epoch.at(survey.at),
            ap_id: unit.identity.clone(),
            channel: unit.channel.into(),
            wan_metrics: ap.wan,
            bss_load: ap.load.map(|load| BssLoad {
                sta_count: u16::try_from(ap.associated.len()).unwrap_or(u16::MAX),
                channel_utilization: share(load),
                avail_adm_cap: 0,
            }),
            ap_location: unit.location,
        }
    }))
}

/// Lists the stations, with the reports of configured measurements.
pub(crate) fn stations<'a>(
    survey: &Survey,
    epoch: Epoch,
    configured: impl Iterator<Item = &'a MeasurementConfig> + Clone,
) -> Listing {
    Listing::new(survey.stations.iter().map(|station| {
        let unit = survey.unit_of(station);
        let mut reports = Reports::default();
        for config in configured.clone() {
            if config.sta_id.iter().any(|wanted| wanted.mac_id == station.identity.mac_id) {
                let measured = Measured { survey, station, id: &config.measurement_id, named: false };
                measured.report(&config.measurement_info, &mut reports);
            }
        }
        StaInfo {
            time_stamp: epoch.at(survey.at),
            sta_id: station.identity.clone(),
            channel: unit.channel.into(),
            ap_associated: unit.identity.clone(),
            rssi: station.reception.map(|reception| Rssi { rssi: rcpi(reception.signal) }),
            sta_data_rate: data_rate(station, None),
            beacon_report: reports.beacon_report,
            neighbor_report: reports.neighbor_report,
            channel_load: reports.channel_load,
        }
    }))
}

/// Returns the rates of a station as its access point knows them.
pub(crate) fn data_rate(station: &Station, named: Option<StaIdentity>) -> Option<StaDataRate> {
    station.reception.map(|reception| StaDataRate {
        sta_id: named,
        sta_last_data_downlink_rate: reception.downlink_kbps,
        sta_last_data_uplink_rate: reception.uplink_kbps,
    })
}

/// Listings made on demand and kept until something changes.
#[derive(Debug, Default)]
pub(crate) struct Listings {
    access_points: Option<Arc<Listing>>,
    stations: Option<Arc<Listing>>,
}

impl Listings {
    /// Drops all listings, after a new survey.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Drops the listing of stations, after a change of measurements.
    pub(crate) fn forget_stations(&mut self) {
        self.stations = None;
    }

    pub(crate) fn access_points(&mut self, make: impl FnOnce() -> Listing) -> Arc<Listing> {
        Arc::clone(self.access_points.get_or_insert_with(|| Arc::new(make())))
    }

    pub(crate) fn stations(&mut self, make: impl FnOnce() -> Listing) -> Arc<Listing> {
        Arc::clone(self.stations.get_or_insert_with(|| Arc::new(make())))
    }
}
