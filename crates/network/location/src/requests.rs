//! Subscriptions of consumers (ETSI GS MEC 013 v3.1.1, clause 6.3), in their JSON form, with the checks of each by itself.

use cotorra_mec::{InvalidRequest, Notifying};
use serde::{Deserialize, Serialize};

use crate::types::OperationStatus;

/// Most addresses, access points or states that a subscription lists.
const LONGEST_LIST: usize = 256;
/// Longest duration of periodic reports (6.5.10), seconds.
const LONGEST_REPORTING: u64 = 8_639_999;

/// A subscription. Requests and answers have it as an object with one attribute, its type in lower camel case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub enum Subscription {
    /// A user enters or leaves zones or access points.
    UserLocationEventSubscription(UserLocationEventSubscription),
    /// A user's location, periodically.
    UserLocationPeriodicSubscription(UserLocationPeriodicSubscription),
    /// Users enter or leave a zone.
    ZoneLocationEventSubscription(ZoneLocationEventSubscription),
    /// Numbers of users in a zone, and states of its access points.
    ZoneStatusSubscription(ZoneStatusSubscription),
    /// Users enter or leave an area.
    UserAreaSubscription(UserAreaSubscription),
    /// Distances between users.
    UserDistanceSubscription(UserDistanceSubscription),
}

/// The part that all subscriptions have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct Common {
    /// Name of the type.
    pub subscription_type: String,
    /// The consumer's own name for it; shown again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub client_correlator: Option<String>,
    /// Target and end.
    #[serde(flatten)]
    pub notifying: Notifying,
}

/// Whether a user enters or leaves (6.4.5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum LocationEventType {
    EnteringAreaEvent,
    LeavingAreaEvent,
}

/// Bounds on notifications (6.5.6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ReportingCtrl {
    /// Seconds between notifications, at least.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minimum_interval: Option<u32>,
    /// The same, in the standard's other words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maximum_frequency: Option<u32>,
    /// Notifications, at most; 0 for no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maximum_count: Option<u32>,
}

/// How often events are notified (6.4.7).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum OccurrenceInfo {
    OneTimeEvent,
    MultipleTimeEvent,
}

/// What a user enters or leaves (6.5.8).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserEventPara {
    /// Access points; without any, zones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub access_point_list: Vec<String>,
    /// A zone; without one, all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zone_id: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub occurrence_info: Option<OccurrenceInfo>,
    /// Whether notifications have the location.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_location_req: Option<bool>,
}

/// A user enters or leaves zones or access points (6.3.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserLocationEventSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub address: String,
    /// Without any, both.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub location_event_criteria: Vec<LocationEventType>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub user_event_para: Option<UserEventPara>,
}

/// When periodic reports come (6.5.10).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct PeriodicEventInfo {
    /// Number of reports.
    pub reporting_amount: u32,
    /// Seconds between them.
    pub reporting_interval: u32,
}

/// A user's location, periodically (6.3.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserLocationPeriodicSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub address: String,
    pub periodic_event_info: PeriodicEventInfo,
}

/// Users enter or leave a zone (6.3.6).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ZoneLocationEventSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub zone_id: String,
    /// Without any, all users.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub address_list: Vec<String>,
    /// Without any, both.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub location_event_criteria: Vec<LocationEventType>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_ctrl: Option<ReportingCtrl>,
}

/// Numbers of users in a zone, and states of its access points (6.3.7).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ZoneStatusSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub zone_id: String,
    /// Notified when the zone has more users.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper_number_of_users_zone_threshold: Option<u32>,
    /// Notified when the zone has fewer users.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower_number_of_users_zone_threshold: Option<u32>,
    /// Notified when an access point has more users.
    #[serde(default, rename = "upperNumberOfUsersAPThreshold", skip_serializing_if = "Option::is_none")]
    pub upper_number_of_users_ap_threshold: Option<u32>,
    /// Notified when an access point has fewer users.
    #[serde(default, rename = "lowerNumberOfUsersAPThreshold", skip_serializing_if = "Option::is_none")]
    pub lower_number_of_users_ap_threshold: Option<u32>,
    /// States of access points to notify.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operation_status: Vec<OperationStatus>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_ctrl: Option<ReportingCtrl>,
}

/// A place on Earth, degrees (6.5.15).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Point {
    pub latitude: f64,
    pub longitude: f64,
}

/// An area (6.5.14).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AreaInfo {
    /// 1: circle; 2: polygon.
    pub shape: u8,
    /// One point of a circle; 3 to 15 of a polygon.
    pub points: Vec<Point>,
    /// Metres, of a circle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<u32>,
}

/// Users enter or leave an area (6.3.8).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserAreaSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub address_list: Vec<String>,
    pub area_define: AreaInfo,
    /// Acceptable error, metres. Accepted without effect: locations are as exact as they are.
    pub tracking_accuracy: f64,
    /// Without any, both.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub location_event_criteria: Vec<LocationEventType>,
    /// Whether notifications have the location.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_location_req: Option<bool>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_ctrl: Option<ReportingCtrl>,
}

/// Which distances are notified (6.4.6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub enum DistanceCriteria {
    AllWithinDistance,
    AnyWithinDistance,
    AllBeyondDistance,
    AnyBeyondDistance,
}

/// Distances between users (6.3.9).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserDistanceSubscription {
    #[serde(flatten)]
    pub common: Common,
    pub monitored_address: Vec<String>,
    /// Without any, distances between the monitored users count.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reference_address: Vec<String>,
    /// Metres.
    pub distance: f64,
    pub criteria: DistanceCriteria,
    /// Whether the criterion is notified if it is met at once.
    pub check_immediate: bool,
    /// Acceptable error, metres. Accepted without effect.
    pub tracking_accuracy: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reporting_ctrl: Option<ReportingCtrl>,
}

/// A list of subscriptions, by which their URIs begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum List {
    Users,
    Zones,
    Area,
    Distance,
}

impl List {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Users, Self::Zones, Self::Area, Self::Distance];

    /// Returns its path below the service's.
    pub const fn path(self) -> &'static str {
        match self {
            Self::Users => "subscriptions/users",
            Self::Zones => "subscriptions/zones",
            Self::Area => "subscriptions/area",
            Self::Distance => "subscriptions/distance",
        }
    }
}

impl Subscription {
    /// Parses the JSON of a subscription.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`] with the place.
    pub(crate) fn read(list: &str, body: &[u8]) -> Result<Self, InvalidRequest> {
        let subscription: Self = cotorra_mec::read(body)?;
        if subscription.list().path() != list {
            return InvalidRequest::malformed(format!(
                "a {} belongs to {}",
                subscription.type_name(),
                subscription.list().path()
            ));
        }
        Ok(subscription)
    }

    /// Returns the name of its type.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::UserLocationEventSubscription(_) => "UserLocationEventSubscription",
            Self::UserLocationPeriodicSubscription(_) => "UserLocationPeriodicSubscription",
            Self::ZoneLocationEventSubscription(_) => "ZoneLocationEventSubscription",
            Self::ZoneStatusSubscription(_) => "ZoneStatusSubscription",
            Self::UserAreaSubscription(_) => "UserAreaSubscription",
            Self::UserDistanceSubscription(_) => "UserDistanceSubscription",
        }
    }

    /// Returns the list that it is in.
    pub fn list(&self) -> List {
        match self {
            Self::UserLocationEventSubscription(_) | Self::UserLocationPeriodicSubscription(_) => List::Users,
            Self::ZoneLocationEventSubscription(_) | Self::ZoneStatusSubscription(_) => List::Zones,
            Self::UserAreaSubscription(_) => List::Area,
            Self::UserDistanceSubscription(_) => List::Distance,
        }
    }

    /// Returns the part that all subscriptions have.
    pub fn common(&self) -> &Common {
        match self {
            Self::UserLocationEventSubscription(s) => &s.common,
            Self::UserLocationPeriodicSubscription(s) => &s.common,
            Self::ZoneLocationEventSubscription(s) => &s.common,
            Self::ZoneStatusSubscription(s) => &s.common,
            Self::UserAreaSubscription(s) => &s.common,
            Self::UserDistanceSubscription(s) => &s.common,
        }
    }

    pub(crate) fn common_mut(&mut self) -> &mut Common {
        match self {
            Self::UserLocationEventSubscription(s) => &mut s.common,
            Self::UserLocationPeriodicSubscription(s) => &mut s.common,
            Self::ZoneLocationEventSubscription(s) => &mut s.common,
            Self::ZoneStatusSubscription(s) => &mut s.common,
            Self::UserAreaSubscription(s) => &mut s.common,
            Self::UserDistanceSubscription(s) => &mut s.common,
        }
    }

    /// Returns the bounds on its notifications.
    pub(crate) fn reporting(&self) -> ReportingCtrl {
        let given = match self {
            Self::ZoneLocationEventSubscription(s) => s.reporting_ctrl,
            Self::ZoneStatusSubscription(s) => s.reporting_ctrl,
            Self::UserAreaSubscription(s) => s.reporting_ctrl,
            Self::UserDistanceSubscription(s) => s.reporting_ctrl,
            Self::UserLocationEventSubscription(s) => {
                let occurrence = s.user_event_para.as_ref().and_then(|para| para.occurrence_info);
                (occurrence == Some(OccurrenceInfo::OneTimeEvent))
                    .then(|| ReportingCtrl { maximum_count: Some(1), ..ReportingCtrl::default() })
            }
            Self::UserLocationPeriodicSubscription(_) => None,
        };
        given.unwrap_or_default()
    }

    /// Checks constraints that the types do not express.
    pub(crate) fn check_constraints(&self) -> Result<(), InvalidRequest> {
        let (type_name, common) = (self.type_name(), self.common());
        if common.subscription_type != type_name {
            return InvalidRequest::malformed(format!("subscriptionType must be {type_name}"));
        }
        match self {
            Self::UserLocationEventSubscription(s) => match &s.user_event_para {
                Some(para) => bounded("accessPointList", &para.access_point_list),
                None => Ok(()),
            },
            Self::UserLocationPeriodicSubscription(s) => s.periodic_event_info.check(),
            Self::ZoneLocationEventSubscription(s) => bounded("addressList", &s.address_list),
            Self::ZoneStatusSubscription(s) => s.check(),
            Self::UserAreaSubscription(s) => {
                filled("addressList", &s.address_list)?;
                s.area_define.check()
            }
            Self::UserDistanceSubscription(s) => s.check(),
        }
    }
}

fn bounded(what: &str, list: &[String]) -> Result<(), InvalidRequest> {
    if list.len() <= LONGEST_LIST {
        return Ok(());
    }
    InvalidRequest::malformed(format!("{what} has at most {LONGEST_LIST} entries"))
}

fn filled(what: &str, list: &[String]) -> Result<(), InvalidRequest> {
    if list.is_empty() {
        return InvalidRequest::malformed(format!("{what} must name at least one user"));
    }
    bounded(what, list)
}

impl PeriodicEventInfo {
    fn check(self) -> Result<(), InvalidRequest> {
        if self.reporting_amount == 0 || self.reporting_interval == 0 {
            return InvalidRequest::malformed("reportingAmount and reportingInterval must be at least 1");
        }
        if u64::from(self.reporting_amount) * u64::from(self.reporting_interval) > LONGEST_REPORTING {
            return InvalidRequest::malformed(format!(
                "reportingAmount times reportingInterval must be at most {LONGEST_REPORTING} seconds"
            ));
        }
        Ok(())
    }
}

impl ZoneStatusSubscription {
    fn check(&self) -> Result<(), InvalidRequest> {
        let thresholds = [
            self.upper_number_of_users_zone_threshold,
            self.lower_number_of_users_zone_threshold,
            self.upper_number_of_users_ap_threshold,
            self.lower_number_of_users_ap_threshold,
        ];
        if thresholds.iter().all(Option::is_none) && self.operation_status.is_empty() {
            return InvalidRequest::malformed("a threshold or operationStatus is needed");
        }
        if self.operation_status.len() > 3 {
            return InvalidRequest::malformed("operationStatus has at most 3 entries");
        }
        Ok(())
    }
}

impl AreaInfo {
    fn check(&self) -> Result<(), InvalidRequest> {
        let is_on_earth = |point: &Point| {
            (-90.0..=90.0).contains(&point.latitude) && (-180.0..=180.0).contains(&point.longitude)
        };
        if !self.points.iter().all(is_on_earth) {
            return InvalidRequest::malformed(
                "latitudes are from -90 to 90 degrees, longitudes from -180 to 180",
            );
        }
        match (self.shape, self.points.len(), self.radius) {
            (1, 1, Some(1..)) | (2, 3..=15, None) => Ok(()),
            (1, ..) => {
                InvalidRequest::malformed("a circle (shape 1) has one point and a radius of at least 1 m")
            }
            (2, ..) => InvalidRequest::malformed("a polygon (shape 2) has 3 to 15 points and no radius"),
            _ => InvalidRequest::malformed("shape must be 1 (circle) or 2 (polygon)"),
        }
    }
}

impl UserDistanceSubscription {
    fn check(&self) -> Result<(), InvalidRequest> {
        filled("monitoredAddress", &self.monitored_address)?;
        bounded("referenceAddress", &self.reference_address)?;
        if self.reference_address.is_empty() && self.monitored_address.len() < 2 {
            return InvalidRequest::malformed(
                "without referenceAddress, monitoredAddress must name two users",
            );
        }
        // Each look compares every pair.
        if self.monitored_address.len() * self.reference_address.len().max(self.monitored_address.len())
            > 4096
        {
            return InvalidRequest::malformed("a subscription compares at most 4096 pairs of users");
        }
        if self.distance.is_finite() && self.distance >= 0.0 {
            return Ok(());
        }
        InvalidRequest::malformed("distance must be at least 0 m")
    }
}
