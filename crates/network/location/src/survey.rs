//! Where users are at a time: their access points (φ, ι), and their places (σ_p).

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use cotorra_graph::{
    GeoOrigin, HardwareGraph, NodeId, NodeKind, Pose, PoseSource, Position, RadioContext, RobotContext,
    Timestamp,
};
use cotorra_mec::{Scope, to_earth, to_north};

use crate::types::{LocationInfo, MapInfo, Origin, RelativeLocationInfo, Whereabouts};

/// Radius of the circle that has 95 % of a normal distribution in two dimensions, in standard deviations.
const RADIUS_OF_95_PERCENT: f64 = 2.447_746_830_680_816;

/// The fixed part: zones, access points and users, and the map.
#[derive(Debug)]
pub struct Site {
    map: String,
    origin: Option<GeoOrigin>,
    /// Domains in scope that have radio units.
    zones: BTreeSet<String>,
    units: BTreeMap<NodeId, Unit>,
    users: BTreeSet<NodeId>,
}

/// A radio unit in scope.
#[derive(Debug)]
pub(crate) struct Unit {
    pub(crate) zone: String,
    position: Option<Position>,
}

/// The state at a time.
#[derive(Debug, Clone)]
pub struct Survey {
    /// Time of the survey.
    pub at: Timestamp,
    pub(crate) users: BTreeMap<NodeId, User>,
    /// Access points that have reported.
    pub(crate) reporting: BTreeSet<NodeId>,
}

/// A user that is attached to an access point in scope.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct User {
    pub(crate) access_point: NodeId,
    pub(crate) zone: String,
    /// `None` if nothing is known: no pose, and an access point without a position.
    pub(crate) place: Option<Place>,
}

/// A place on the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) position: Position,
    /// Radius of the circle that has the user with a probability of 95 %, metres; `None` if unknown.
    pub(crate) radius: Option<f64>,
}

impl Place {
    /// Returns the place that a pose gives. The simulator's exact pose is not one that a network could know.
    fn of(pose: &Pose) -> Option<Self> {
        if pose.source == PoseSource::Simulator || !pose.is_finite() {
            return None;
        }
        let [xx, xy, _, _, yy, ..] = pose.covariance;
        // The larger eigenvalue of the covariance of x and y.
        let variance = f64::midpoint(xx, yy) + (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
        let radius = (variance > 0.0 && variance.is_finite()).then(|| variance.sqrt() * RADIUS_OF_95_PERCENT);
        Some(Self { position: pose.position(), radius })
    }
}

impl Site {
    /// Collects the zones, radio units and robots of a graph. `map` names the map.
    pub fn new(graph: &HardwareGraph, map: &str, origin: Option<GeoOrigin>, scope: &Scope) -> Self {
        let (mut units, mut users) = (BTreeMap::new(), BTreeSet::new());
        for node in &graph.nodes {
            match node.kind {
                NodeKind::RadioUnit(_) if scope.covers(&node.domain) => {
                    let unit = Unit { zone: node.domain.to_string(), position: node.position };
                    units.insert(node.id.clone(), unit);
                }
                NodeKind::Robot(_) => drop(users.insert(node.id.clone())),
                _ => {}
            }
        }
        let zones = units.values().map(|unit| unit.zone.clone()).collect();
        Self { map: map.to_owned(), origin, zones, units, users }
    }

    pub(crate) fn origin(&self) -> Option<&GeoOrigin> {
        self.origin.as_ref()
    }

    pub(crate) fn zones(&self) -> impl Iterator<Item = &str> {
        self.zones.iter().map(String::as_str)
    }

    pub(crate) fn has_zone(&self, zone: &str) -> bool {
        self.zones.contains(zone)
    }

    /// Returns the access points of a zone.
    pub(crate) fn units<'a>(&'a self, zone: &'a str) -> impl Iterator<Item = (&'a NodeId, &'a Unit)> {
        self.units.iter().filter(move |(_, unit)| unit.zone == zone)
    }

    /// Whether a robot has this address.
    pub(crate) fn has_user(&self, address: &str) -> bool {
        name(address).is_some_and(|name| self.users.iter().any(|user| *user == *name))
    }

    /// Returns a place as the standard's types, as far as the map is located.
    pub(crate) fn whereabouts(&self, place: &Place) -> Whereabouts {
        let position = place.position;
        let (x, y) = match &self.origin {
            Some(origin) => to_north(origin, position),
            None => (position.x, position.y),
        };
        let origin = self.origin.map(|origin| Origin {
            latitude: origin.latitude,
            longitude: origin.longitude,
            altitude: origin.altitude,
        });
        let map_info = MapInfo { map_id: self.map.clone(), origin };
        Whereabouts {
            location_info: self.location(place),
            relative_location_info: Some(RelativeLocationInfo { map_info, x, y, z: position.z }),
        }
    }

    fn location(&self, place: &Place) -> Option<LocationInfo> {
        let origin = self.origin.as_ref()?;
        let (latitude, longitude) = to_earth(origin, place.position);
        let altitude = origin.altitude.map(|altitude| altitude + place.position.z);
        let accuracy = place.radius.map(metres);
        let shape = match (accuracy, altitude) {
            (Some(_), _) => 5,
            (None, Some(_)) => 3,
            (None, None) => 2,
        };
        // The circle has no altitude in the standard.
        let altitude = altitude.filter(|_| shape == 3);
        Some(LocationInfo { latitude: [latitude], longitude: [longitude], altitude, accuracy, shape })
    }

    /// Returns the location of a radio unit.
    pub(crate) fn location_of(&self, unit: &Unit) -> Option<LocationInfo> {
        self.location(&Place { position: unit.position?, radius: None })
    }

    /// Surveys the state. A user is at the access point that it reports (φ), or that reports it (ι) before the user's
    /// first report. Its place is the pose that it believes (σ_p), by localization or odometry. Without one, it is that of
    /// its access point.
    pub fn survey(
        self: &Arc<Self>,
        at: Timestamp,
        radio: &BTreeMap<NodeId, RadioContext>,
        robots: &BTreeMap<NodeId, RobotContext>,
    ) -> Survey {
        let mut reported = BTreeMap::new();
        for context in radio.values() {
            reported.extend(context.stations.iter().map(|station| (&station.robot, &context.radio_unit)));
        }
        let user = |robot: &NodeId| {
            let context = robots.get(robot);
            let access_point = match context {
                Some(context) => context.attached_to()?,
                None => *reported.get(robot)?,
            };
            let unit = self.units.get(access_point)?;
            let place = context.and_then(|context| Place::of(&context.sensors.pose));
            let cell = || unit.position.map(|position| Place { position, radius: None });
            let (access_point, zone) = (access_point.clone(), unit.zone.clone());
            Some((robot.clone(), User { access_point, zone, place: place.or_else(cell) }))
        };
        let users = self.users.iter().filter_map(user).collect();
        let known = |context: &RadioContext| self.units.contains_key(&context.radio_unit);
        let reporting = radio.values().filter(|context| known(context));
        Survey { at, users, reporting: reporting.map(|context| context.radio_unit.clone()).collect() }
    }
}

impl Survey {
    /// Returns the survey in which nothing is known yet.
    pub(crate) fn empty() -> Self {
        Self { at: Timestamp::ZERO, users: BTreeMap::new(), reporting: BTreeSet::new() }
    }

    /// Returns the user with this address, if it is attached in scope.
    pub(crate) fn user(&self, address: &str) -> Option<&User> {
        let name = name(address)?;
        self.users.iter().find(|(id, _)| **id == *name).map(|(_, user)| user)
    }

    pub(crate) fn users_at(&self, access_point: &NodeId) -> usize {
        self.users.values().filter(|user| user.access_point == *access_point).count()
    }

    pub(crate) fn users_in(&self, zone: &str) -> usize {
        self.users.values().filter(|user| user.zone == zone).count()
    }
}

/// Returns the address of a robot: `acr:` (anonymous customer reference) and its name.
pub(crate) fn address(robot: &NodeId) -> String {
    format!("acr:{robot}")
}

fn name(address: &str) -> Option<&str> {
    address.strip_prefix("acr:")
}

/// Rounds metres up to what the standard's integers hold.
pub(crate) fn metres(metres: f64) -> u32 {
    metres.ceil().clamp(0.0, f64::from(u32::MAX)) as u32
}
