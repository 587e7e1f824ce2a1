//! Requests of service consumers: subscriptions (ETSI GS MEC 028 v2.3.1, clause 6.3) and measurement configurations
//! (6.2.4), in their JSON form, with the checks of each by itself.

use std::sync::Arc;

use cotorra_mec::read;
pub use cotorra_mec::{InvalidRequest, Notifying, WebsockNotifConfig};
use serde::{Deserialize, Serialize};

use crate::types::{ApIdentity, LinkType, Mac, SelfLink, StaIdentity};

#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(tag = "subscriptionType")]
pub enum Subscription {
    /// Stations associated with an access point.
    AssocStaSubscription(AssocStaSubscription),
    /// Rates of stations.
    StaDataRateSubscription(StaDataRateSubscription),
    /// Reports of a measurement.
    MeasurementReportSubscription(MeasurementReportSubscription),
}

/// Subscription to the stations associated with an access point (6.3.2): periodically, at a threshold, or
/// periodically beyond it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct AssocStaSubscription {
    /// Target and end.
    #[serde(flatten)]
    pub notifying: Notifying,
    pub ap_id: ApIdentity,
    /// Seconds between notifications. Either this or `notificationEvent` is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 255, nullable = false)]
    pub notification_period: Option<u8>,
    /// Threshold.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub notification_event: Option<AssocStaEvent>,
}

/// A threshold on the number of stations (6.3.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AssocStaEvent {
    /// 1: at the threshold or more; 2: at the threshold or fewer.
    #[schema(minimum = 1, maximum = 2)]
    pub trigger: u8,
    /// Number of stations.
    #[schema(maximum = 255)]
    pub threshold: u8,
}

/// Subscription to rates of stations (6.3.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaDataRateSubscription {
    /// Target and end.
    #[serde(flatten)]
    pub notifying: Notifying,
    #[schema(min_items = 1)]
    pub sta_id: Vec<StaIdentity>,
    /// Seconds between notifications. Either this or `notificationEvent` is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 255, nullable = false)]
    pub notification_period: Option<u8>,
    /// Threshold.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub notification_event: Option<StaDataRateEvent>,
}

/// Thresholds on rates (6.3.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaDataRateEvent {
    /// 1 and 2: downlink at its threshold or more, or less; 3 and 4: uplink; 5 and 6: both; 7 and 8: either.
    #[schema(minimum = 1, maximum = 8)]
    pub trigger: u8,
    /// Downlink threshold, kbit/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub downlink_rate_threshold: Option<u32>,
    /// Uplink threshold, kbit/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub uplink_rate_threshold: Option<u32>,
}

impl StaDataRateEvent {
    /// Whether rates meet the trigger.
    pub(crate) fn is_met(&self, downlink: u32, uplink: u32) -> bool {
        let (down, up) = (self.downlink_rate_threshold, self.uplink_rate_threshold);
        let compare = |rate: u32, threshold: Option<u32>| {
            let more = self.trigger % 2 == 1;
            threshold.is_some_and(|threshold| if more { rate >= threshold } else { rate <= threshold })
        };
        match self.trigger {
            1 | 2 => compare(downlink, down),
            3 | 4 => compare(uplink, up),
            5 | 6 => compare(downlink, down) && compare(uplink, up),
            _ => compare(downlink, down) || compare(uplink, up),
        }
    }
}

/// Subscription to reports of a measurement (6.3.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeasurementReportSubscription {
    /// Target and end.
    #[serde(flatten)]
    pub notifying: Notifying,
    #[schema(min_items = 1)]
    pub sta_id: Vec<StaIdentity>,
    /// Consumer's name for the measurement.
    #[schema(value_type = String)]
    pub measurement_id: Arc<str>,
    /// The measurement.
    pub measurement_info: MeasurementInfo,
}

/// A measurement whose reports are included in station information (6.2.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeasurementConfig {
    /// Set by the service.
    #[serde(rename = "_links", default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub links: Option<SelfLink>,
    /// Consumer's name for the measurement, unique among configurations.
    #[schema(value_type = String)]
    pub measurement_id: Arc<str>,
    #[schema(min_items = 1)]
    pub sta_id: Vec<StaIdentity>,
    /// The measurement.
    pub measurement_info: MeasurementInfo,
}

/// A measurement (6.5.41): exactly one of the four.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeasurementInfo {
    /// Units of 1024 µs between a subscription's reports, if that is more than a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 65535, nullable = false)]
    pub measurement_duration: Option<u16>,
    /// Accepted without effect: measurements put nothing on the air that would have to be spread.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 65535, nullable = false)]
    pub random_interval: Option<u16>,
    /// Load of a channel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub channel_load_conf: Option<ChannelLoadConfig>,
    /// Beacons that stations hear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub beacon_request_conf: Option<BeaconRequestConfig>,
    /// Counters of a station. This service has none and rejects it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub sta_statistics_conf: Option<StaStatisticsConfig>,
    /// Access points that stations could roam to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub neighbor_report_conf: Option<NeighborReportConfig>,
}

/// Load of a channel (6.5.24).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ChannelLoadConfig {
    /// Global operating class (IEEE 802.11-2016, Table E-4).
    #[schema(maximum = 255)]
    pub operating_class: u8,
    #[schema(maximum = 255)]
    pub channel: u8,
    /// 0 or absent: always; 1: at the threshold or more; 2: at the threshold or less.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 2, nullable = false)]
    pub reporting_condition: Option<u8>,
    /// Load; 255 is busy all the time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 255, nullable = false)]
    pub threshold: Option<u8>,
}

/// Beacons that stations hear (6.5.25).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BeaconRequestConfig {
    /// Global operating class (IEEE 802.11-2016, Table E-4).
    #[schema(maximum = 255)]
    pub operating_class: u8,
    /// A channel of that class; 0 or 255: all of them.
    #[schema(maximum = 255)]
    pub channel_id: u8,
    /// 0: passive, 1: active, 2: beacon table. In each mode the report has what the station heard last: this service
    /// takes no radio off its channel.
    #[schema(maximum = 2)]
    pub measurement_mode: u8,
    /// Restrict to this access point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub bssid: Option<Mac>,
    /// Restrict to this network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub ssid: Option<String>,
    /// Condition for reporting a beacon.
    pub beacon_reporting_conf: BeaconReportingConfig,
}

/// Condition for reporting a beacon (6.5.28).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BeaconReportingConfig {
    /// 0: all; 1 and 2: RCPI above or below the threshold; 3 and 4: RSNI; 5 to 8: the same relative to the serving
    /// access point's with an offset; 9 and 10: RCPI or RSNI between the serving access point's and that with the
    /// offset.
    #[schema(maximum = 10)]
    pub reporting_condition: u8,
    /// The threshold, or the offset: an 8-bit two's complement number in units of 0.5 dB.
    #[schema(maximum = 255)]
    pub threshold: u8,
}

/// Counters of a station (6.5.26), which this service does not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaStatisticsConfig {
    /// Group of counters.
    #[schema(maximum = 255)]
    pub group_identity: u8,
    /// Whether reports are triggered.
    pub triggered_report: bool,
}

/// Access points that stations could roam to (6.5.32).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NeighborReportConfig {
    /// Network; by default the station's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub ssid: Option<String>,
    /// Restrict to this access point; ignored without `ssid`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub bssid: Option<Mac>,
}

/// Links to subscriptions (6.3.4).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct SubscriptionLinkList {
    /// Link to this list.
    #[serde(rename = "_links")]
    pub links: SelfLink,
    /// Links to the subscriptions.
    pub subscription: Vec<SubscriptionLink>,
}

/// A link to a subscription (6.3.4).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SubscriptionLink {
    #[schema(format = "uri")]
    pub href: String,
    pub subscription_type: &'static str,
}

/// Links to measurement configurations (6.2.5).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeasurementConfigLinkList {
    /// Link to this list.
    #[serde(rename = "_links")]
    pub links: SelfLink,
    /// Links to the configurations.
    pub measurement_config: Vec<MeasurementConfigLink>,
}

/// A link to a measurement configuration (6.2.5).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeasurementConfigLink {
    #[schema(format = "uri")]
    pub href: String,
    /// Consumer's name for the measurement.
    #[schema(value_type = String)]
    pub measurement_id: Arc<str>,
}

/// Link from an expiry or test notification to its subscription (6.4.4, 6.4.6).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ToSubscription {
    pub subscription: LinkType,
}

fn malformed<T>(what: impl Into<String>) -> Result<T, InvalidRequest> {
    InvalidRequest::malformed(what)
}

impl Subscription {
    /// Parses the JSON of a subscription, as the standard defines it: the plain object.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] with the place.
    pub fn read(body: &[u8]) -> Result<Self, InvalidRequest> {
        #[derive(Deserialize)]
        #[serde(rename_all = "camelCase")]
        struct Typed {
            subscription_type: String,
        }
        let Typed { subscription_type } = read(body)?;
        match subscription_type.as_str() {
            "AssocStaSubscription" => read(body).map(Self::AssocStaSubscription),
            "StaDataRateSubscription" => read(body).map(Self::StaDataRateSubscription),
            "MeasurementReportSubscription" => read(body).map(Self::MeasurementReportSubscription),
            other => malformed(format!(
                "there is no subscriptionType `{other}`; there are AssocStaSubscription, StaDataRateSubscription, \
                 MeasurementReportSubscription"
            )),
        }
    }

    /// Checks constraints that the types do not express.
    pub(crate) fn check_constraints(&self) -> Result<(), InvalidRequest> {
        let when = |period: Option<u8>, event: bool| match (period, event) {
            (Some(0), _) => malformed("notificationPeriod must be at least 1 second"),
            (None, false) => malformed("one of notificationPeriod and notificationEvent is needed"),
            _ => Ok(()),
        };
        match self {
            Self::AssocStaSubscription(s) => {
                when(s.notification_period, s.notification_event.is_some())?;
                match s.notification_event {
                    Some(AssocStaEvent { trigger: 1 | 2, .. }) | None => Ok(()),
                    Some(_) => malformed("notificationEvent.trigger must be 1 or 2"),
                }
            }
            Self::StaDataRateSubscription(s) => {
                when(s.notification_period, s.notification_event.is_some())?;
                check_stations(&s.sta_id)?;
                s.notification_event.map_or(Ok(()), |event| event.check())
            }
            Self::MeasurementReportSubscription(s) => {
                check_stations(&s.sta_id)?;
                s.measurement_info.check()
            }
        }
    }
}

impl StaDataRateEvent {
    fn check(&self) -> Result<(), InvalidRequest> {
        let (down, up) = (self.downlink_rate_threshold.is_some(), self.uplink_rate_threshold.is_some());
        match (self.trigger, down, up) {
            (1 | 2, true, _) | (3 | 4, _, true) | (5..=8, true, true) => Ok(()),
            (1 | 2, false, _) => malformed("triggers 1 and 2 need downlinkRateThreshold"),
            (3 | 4, _, false) => malformed("triggers 3 and 4 need uplinkRateThreshold"),
            (5..=8, ..) => malformed("triggers 5 to 8 need downlinkRateThreshold and uplinkRateThreshold"),
            _ => malformed("notificationEvent.trigger must be from 1 to 8"),
        }
    }
}

impl MeasurementConfig {
    /// Parses the JSON of a configuration.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] with the place.
    pub fn read(body: &[u8]) -> Result<Self, InvalidRequest> {
        read(body)
    }

    /// Checks constraints that the types do not express.
    ///
    /// # Errors
    /// [`InvalidRequest`].
    pub fn check(&self) -> Result<(), InvalidRequest> {
        check_stations(&self.sta_id)?;
        self.measurement_info.check()
    }
}

impl MeasurementInfo {
    fn check(&self) -> Result<(), InvalidRequest> {
        let given = [
            self.channel_load_conf.is_some(),
            self.beacon_request_conf.is_some(),
            self.sta_statistics_conf.is_some(),
            self.neighbor_report_conf.is_some(),
        ];
        if given.iter().filter(|given| **given).count() != 1 {
            return malformed(
                "measurementInfo needs exactly one of channelLoadConf, beaconRequestConf, staStatisticsConf and \
                 neighborReportConf",
            );
        }
        if self.sta_statistics_conf.is_some() {
            return Err(InvalidRequest::Unsupported(
                "the testbed does not have the IEEE 802.11 counters of staStatistics reports",
            ));
        }
        match self.channel_load_conf {
            Some(ChannelLoadConfig { reporting_condition: Some(1 | 2), threshold: None, .. }) => {
                malformed("reportingCondition 1 and 2 need a threshold")
            }
            Some(ChannelLoadConfig { reporting_condition: Some(3..), .. }) => {
                malformed("channelLoadConf.reportingCondition must be from 0 to 2")
            }
            _ => match &self.beacon_request_conf {
                Some(request) if request.measurement_mode > 2 => {
                    malformed("measurementMode must be from 0 to 2")
                }
                Some(request) if request.beacon_reporting_conf.reporting_condition > 10 => {
                    malformed("beaconReportingConf.reportingCondition must be from 0 to 10")
                }
                _ => Ok(()),
            },
        }
    }
}

fn check_stations(stations: &[StaIdentity]) -> Result<(), InvalidRequest> {
    if stations.is_empty() { malformed("staId must name at least one station") } else { Ok(()) }
}

#[cfg(test)]
mod tests;
