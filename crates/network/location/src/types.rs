//! The data types of ETSI GS MEC 013 v3.1.1 that this service provides, with the standard's names. Attributes unknown to
//! the testbed are omitted.

use cotorra_mec::{LinkType, TimeStamp};
use serde::{Deserialize, Serialize};

/// Whether an access point serves (6.4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
pub enum OperationStatus {
    /// It has reported.
    Serviceable,
    /// It is out of order. The testbed has no such state.
    Unserviceable,
    /// It has not reported yet.
    Unknown,
}

/// Kind of an access point (6.4.2). All of the testbed are Wi-Fi.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub enum ConnectionType {
    Wifi,
}

/// A zone: a domain of the testbed file (6.2.7).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ZoneInfo {
    pub zone_id: String,
    pub number_of_access_points: usize,
    pub number_of_unserviceable_access_points: usize,
    pub number_of_users: usize,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
}

/// Zones (6.2.8).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ZoneList {
    pub zone: Vec<ZoneInfo>,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
}

/// An access point: a radio unit (6.2.1).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct AccessPointInfo {
    pub access_point_id: String,
    pub connection_type: ConnectionType,
    pub operation_status: OperationStatus,
    pub number_of_users: usize,
    /// Its place, if the testbed file locates its map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub location_info: Option<LocationInfo>,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
}

/// Access points of a zone (6.2.2).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct AccessPointList {
    pub zone_id: String,
    pub access_point: Vec<AccessPointInfo>,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
}

/// A user: a robot that is attached to an access point (6.2.5).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct UserInfo {
    /// `acr:` and the robot's name.
    pub address: String,
    pub access_point_id: String,
    pub zone_id: String,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
    pub timestamp: TimeStamp,
    #[serde(flatten)]
    pub whereabouts: Whereabouts,
}

/// Users (6.2.6).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct UserList {
    pub user: Vec<UserInfo>,
    #[serde(rename = "resourceURL")]
    pub resource_url: String,
}

/// A location on Earth and on the map, as far as known.
#[derive(Debug, Clone, PartialEq, Default, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct Whereabouts {
    /// If the testbed file locates its map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub location_info: Option<LocationInfo>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative_location_info: Option<RelativeLocationInfo>,
}

/// A place on Earth, WGS 84 (6.5.3).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct LocationInfo {
    /// Degrees north.
    pub latitude: [f64; 1],
    /// Degrees east.
    pub longitude: [f64; 1],
    /// Metres above the ellipsoid, if the testbed file has the altitude of its map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude: Option<f64>,
    /// Radius of the circle that has the user with a probability of 95 %, metres, rounded up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<u32>,
    /// 2: point; 3: point with altitude; 5: point with the uncertainty of a circle.
    pub shape: u8,
}

/// A place on the testbed's map (6.5.11).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct RelativeLocationInfo {
    #[serde(rename = "mapInfo")]
    pub map_info: MapInfo,
    /// Metres to the east.
    #[serde(rename = "X")]
    pub x: f64,
    /// Metres to the north.
    #[serde(rename = "Y")]
    pub y: f64,
    /// Metres above the floor.
    #[serde(rename = "Z")]
    pub z: f64,
}

/// The testbed's map (6.5.12).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct MapInfo {
    /// Name of the testbed.
    pub map_id: String,
    /// Origin of the map, if the testbed file locates it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
}

/// Origin of a map (6.5.13).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Origin {
    pub latitude: f64,
    pub longitude: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude: Option<f64>,
}

/// Distance of a user from another, or from a place (6.2.3).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct TerminalDistance {
    /// Metres, rounded.
    pub distance: u32,
    /// Metres: the radii of both circles of 95 % together; omitted if one has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<u32>,
    pub timestamp: TimeStamp,
}

/// Links to subscriptions (6.3.3).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct NotificationSubscriptionList {
    #[serde(rename = "resourceURL")]
    pub resource_url: LinkType,
    pub subscription: Vec<SubscriptionLink>,
}

/// A link to a subscription.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SubscriptionLink {
    pub href: String,
    pub subscription_type: &'static str,
}
