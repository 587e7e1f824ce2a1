//! The state of a survey as the standard's data types.

use cotorra_graph::NodeId;
use cotorra_mec::{Epoch, InvalidRequest, RequestError, to_map};

use crate::{
    requests::Point,
    survey::{Place, Site, Survey, Unit, User, address, metres},
    types::{
        AccessPointInfo, AccessPointList, ConnectionType, OperationStatus, TerminalDistance, UserInfo,
        UserList, ZoneInfo, ZoneList,
    },
};

/// What is known, and the URI under which the consumer sees the service.
pub(crate) struct View<'a> {
    pub(crate) site: &'a Site,
    pub(crate) survey: &'a Survey,
    pub(crate) epoch: Epoch,
    pub(crate) base: &'a str,
}

/// Users to list: those that match all of the lists that are not empty.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct UserQuery {
    pub zones: Vec<String>,
    pub access_points: Vec<String>,
    pub addresses: Vec<String>,
}

/// Ends of a distance.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceQuery {
    /// A user.
    pub from: String,
    /// Another user, or a place.
    pub to: End,
}

/// The other end of a distance.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// The user with this address.
    User(String),
    Place(Point),
}

fn admits(list: &[String], value: &str) -> bool {
    list.is_empty() || list.iter().any(|listed| listed == value)
}

impl View<'_> {
    /// Returns the zones, or those listed.
    pub(crate) fn zones(&self, listed: &[String]) -> ZoneList {
        let zones = self.site.zones().filter(|zone| admits(listed, zone));
        ZoneList {
            zone: zones.map(|zone| self.zone_info(zone)).collect(),
            resource_url: format!("{}/queries/zones", self.base),
        }
    }

    /// Returns a zone.
    pub(crate) fn zone(&self, zone: &str) -> Result<ZoneInfo, RequestError> {
        self.check_zone(zone).map(|()| self.zone_info(zone))
    }

    fn check_zone(&self, zone: &str) -> Result<(), RequestError> {
        match self.site.has_zone(zone) {
            true => Ok(()),
            false => Err(RequestError::NotFound { what: "zone", id: zone.to_owned() }),
        }
    }

    fn zone_info(&self, zone: &str) -> ZoneInfo {
        ZoneInfo {
            zone_id: zone.to_owned(),
            number_of_access_points: self.site.units(zone).count(),
            number_of_unserviceable_access_points: 0,
            number_of_users: self.survey.users_in(zone),
            resource_url: format!("{}/queries/zones/{zone}", self.base),
        }
    }

    /// Returns the access points of a zone, or those listed.
    pub(crate) fn access_points(
        &self,
        zone: &str,
        listed: &[String],
    ) -> Result<AccessPointList, RequestError> {
        self.check_zone(zone)?;
        let units = self.site.units(zone).filter(|(id, _)| admits(listed, id.as_str()));
        Ok(AccessPointList {
            zone_id: zone.to_owned(),
            access_point: units.map(|(id, unit)| self.access_point_info(id, unit)).collect(),
            resource_url: format!("{}/queries/zones/{zone}/accessPoints", self.base),
        })
    }

    /// Returns an access point.
    pub(crate) fn access_point(&self, zone: &str, id: &str) -> Result<AccessPointInfo, RequestError> {
        self.check_zone(zone)?;
        let unit = self.site.units(zone).find(|(unit, _)| unit.as_str() == id);
        let (unit, of) =
            unit.ok_or_else(|| RequestError::NotFound { what: "access point", id: id.to_owned() })?;
        Ok(self.access_point_info(unit, of))
    }

    fn access_point_info(&self, id: &NodeId, unit: &Unit) -> AccessPointInfo {
        AccessPointInfo {
            access_point_id: id.to_string(),
            connection_type: ConnectionType::Wifi,
            operation_status: status(self.survey, id),
            number_of_users: self.survey.users_at(id),
            location_info: self.site.location_of(unit),
            resource_url: format!("{}/queries/zones/{}/accessPoints/{id}", self.base, unit.zone),
        }
    }

    /// Returns users.
    pub(crate) fn users(&self, query: &UserQuery) -> UserList {
        let wanted = |(id, user): &(&NodeId, &User)| {
            admits(&query.zones, &user.zone)
                && admits(&query.access_points, user.access_point.as_str())
                && admits(&query.addresses, &address(id))
        };
        self.list(self.survey.users.iter().filter(wanted))
    }

    /// Returns a list of users.
    pub(crate) fn list<'u>(&self, users: impl Iterator<Item = (&'u NodeId, &'u User)>) -> UserList {
        UserList {
            user: users.map(|(id, user)| self.user_info(id, user)).collect(),
            resource_url: format!("{}/queries/users", self.base),
        }
    }

    fn user_info(&self, id: &NodeId, user: &User) -> UserInfo {
        let address = address(id);
        UserInfo {
            access_point_id: user.access_point.to_string(),
            zone_id: user.zone.clone(),
            resource_url: format!("{}/queries/users?address={address}", self.base),
            address,
            timestamp: self.epoch.at(self.survey.at),
            whereabouts: user.place.as_ref().map(|place| self.site.whereabouts(place)).unwrap_or_default(),
        }
    }

    /// Returns a distance.
    pub(crate) fn distance(&self, query: &DistanceQuery) -> Result<TerminalDistance, RequestError> {
        let from = self.place(&query.from)?;
        let to = match &query.to {
            End::User(address) => self.place(address)?,
            End::Place(point) => {
                let position = position(self.site, *point)?;
                // A place on Earth is given without a height.
                Place {
                    position: cotorra_graph::Position { z: from.position.z, ..position },
                    radius: Some(0.0),
                }
            }
        };
        let accuracy = from.radius.zip(to.radius).map(|(a, b)| metres(a + b));
        let distance = apart(&from, &to).round() as u32;
        Ok(TerminalDistance { distance, accuracy, timestamp: self.epoch.at(self.survey.at) })
    }

    fn place(&self, address: &str) -> Result<Place, RequestError> {
        let not_found =
            || RequestError::NotFound { what: "user at an access point here,", id: address.to_owned() };
        let user = self.survey.user(address).ok_or_else(not_found)?;
        let unknown = InvalidRequest::Unsupported(
            "the user's location is unknown: it has no pose, and its access point has no position",
        );
        Ok(user.place.ok_or(unknown)?)
    }
}

/// Returns the distance of two places in metres.
pub(crate) fn apart(a: &Place, b: &Place) -> f64 {
    let (a, b) = (a.position, b.position);
    (a.x - b.x).hypot(a.y - b.y).hypot(a.z - b.z)
}

/// Returns the state of an access point.
pub(crate) fn status(survey: &Survey, id: &NodeId) -> OperationStatus {
    if survey.reporting.contains(id) { OperationStatus::Serviceable } else { OperationStatus::Unknown }
}

/// Converts a place on Earth to one on the map.
pub(crate) fn position(site: &Site, point: Point) -> Result<cotorra_graph::Position, InvalidRequest> {
    let unlocated = InvalidRequest::Unsupported(
        "the map has no place on Earth: the testbed file needs `wais.origin` with its latitude and longitude",
    );
    let origin = site.origin().ok_or(unlocated)?;
    Ok(to_map(origin, point.latitude, point.longitude))
}
