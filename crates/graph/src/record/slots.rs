//! Columns of instructions. All share one table: each field of an instruction has a slot in it.

use std::{borrow::Cow, fmt::Display, str::FromStr, time::Duration};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Unreadable, json, parse_json, required};
use crate::{
    access::AccessPoint,
    context::Velocity,
    hardware::Direction,
    id::{LinkId, NodeId, SensorId, VnfId},
    nodes::Nodes,
    reservation::MapReservation,
    service::Vnf,
    units::millis,
};

/// The columns of an instruction.
#[derive(Debug, Default)]
pub(crate) struct Slots<'a> {
    /// Its subject, such as a robot, a VNF or a link.
    pub(crate) subject: &'a str,
    /// The radio unit or node that this shall get.
    pub(crate) object: Option<&'a str>,
    pub(crate) linear: Option<f64>,
    pub(crate) angular: Option<f64>,
    pub(crate) vertical: Option<f64>,
    pub(crate) waypoint: Option<u32>,
    pub(crate) direction: Option<Direction>,
    /// Anything else, mostly in JSON.
    pub(crate) change: Option<Cow<'a, str>>,
}

/// The way in which a field of an instruction is kept.
pub(crate) trait Slot<T> {
    fn put<'a>(value: &'a T, slots: &mut Slots<'a>);
    fn take(slots: &Slots<'_>) -> Result<T, Unreadable>;
}

/// A name.
pub(crate) trait Name: FromStr<Err: Display> {
    fn name(&self) -> &str;
}

macro_rules! names {
    ($($name:ident)*) => { $(
        impl Name for $name {
            fn name(&self) -> &str {
                self.as_str()
            }
        }
    )* };
}
names!(LinkId NodeId SensorId String VnfId);

/// The name of what the instruction is about.
pub(crate) struct Subject;

impl<T: Name> Slot<T> for Subject {
    fn put<'a>(value: &'a T, slots: &mut Slots<'a>) {
        slots.subject = value.name();
    }

    fn take(slots: &Slots<'_>) -> Result<T, Unreadable> {
        parse(slots.subject)
    }
}

/// A second name.
pub(crate) struct Object;

impl<T: Name> Slot<T> for Object {
    fn put<'a>(value: &'a T, slots: &mut Slots<'a>) {
        slots.object = Some(value.name());
    }

    fn take(slots: &Slots<'_>) -> Result<T, Unreadable> {
        parse(required::<_, Unreadable>(slots.object)?)
    }
}

/// A speed.
pub(crate) struct Linear;

impl Slot<Option<f64>> for Linear {
    fn put<'a>(value: &'a Option<f64>, slots: &mut Slots<'a>) {
        slots.linear = *value;
    }

    fn take(slots: &Slots<'_>) -> Result<Option<f64>, Unreadable> {
        Ok(slots.linear)
    }
}

/// A velocity, in a column for each component.
pub(crate) struct Motion;

impl Slot<Velocity> for Motion {
    fn put<'a>(value: &'a Velocity, slots: &mut Slots<'a>) {
        let Velocity { linear, vertical, angular } = *value;
        (slots.linear, slots.vertical, slots.angular) = (Some(linear), Some(vertical), Some(angular));
    }

    fn take(slots: &Slots<'_>) -> Result<Velocity, Unreadable> {
        let [linear, vertical, angular] =
            [slots.linear, slots.vertical, slots.angular].map(|value| value.unwrap_or(f64::NAN));
        Ok(Velocity { linear, vertical, angular })
    }
}

/// The number of a waypoint.
pub(crate) struct Waypoint;

impl Slot<u32> for Waypoint {
    fn put<'a>(value: &'a u32, slots: &mut Slots<'a>) {
        slots.waypoint = Some(*value);
    }

    fn take(slots: &Slots<'_>) -> Result<u32, Unreadable> {
        required(slots.waypoint)
    }
}

/// One direction of a link.
pub(crate) struct OneDirection;

impl Slot<Direction> for OneDirection {
    fn put<'a>(value: &'a Direction, slots: &mut Slots<'a>) {
        slots.direction = Some(*value);
    }

    fn take(slots: &Slots<'_>) -> Result<Direction, Unreadable> {
        required(slots.direction)
    }
}

/// One direction of a link, or both.
pub(crate) struct AnyDirection;

impl Slot<Option<Direction>> for AnyDirection {
    fn put<'a>(value: &'a Option<Direction>, slots: &mut Slots<'a>) {
        slots.direction = *value;
    }

    fn take(slots: &Slots<'_>) -> Result<Option<Direction>, Unreadable> {
        Ok(slots.direction)
    }
}

/// Anything in JSON.
pub(crate) struct Json;

impl<T: Serialize + DeserializeOwned> Slot<T> for Json {
    fn put<'a>(value: &'a T, slots: &mut Slots<'a>) {
        slots.change = Some(json(value).into());
    }

    fn take(slots: &Slots<'_>) -> Result<T, Unreadable> {
        parse_json(required::<_, Unreadable>(slots.change.as_deref())?)
    }
}

/// The links of a path, in JSON.
pub(crate) struct Path;

impl Slot<Vec<LinkId>> for Path {
    fn put<'a>(value: &'a Vec<LinkId>, slots: &mut Slots<'a>) {
        Json::put(value, slots);
    }

    fn take(slots: &Slots<'_>) -> Result<Vec<LinkId>, Unreadable> {
        Ok(match KeptPath::take(slots)? {
            KeptPath::Links(links) | KeptPath::Reserved { links, .. } => links,
        })
    }
}

/// A path's own reservation, which is kept with its links. Goes behind [`Path`].
pub(crate) struct PathReservation;

impl Slot<Option<MapReservation>> for PathReservation {
    fn put<'a>(value: &'a Option<MapReservation>, slots: &mut Slots<'a>) {
        if let Some(own) = value {
            let links = slots.change.take().unwrap_or_default();
            slots.change = Some(format!(r#"{{"links":{links},"reservation":{}}}"#, json(own)).into());
        }
    }

    fn take(slots: &Slots<'_>) -> Result<Option<MapReservation>, Unreadable> {
        Ok(match KeptPath::take(slots)? {
            KeptPath::Links(_) => None,
            KeptPath::Reserved { reservation, .. } => Some(reservation),
        })
    }
}

/// A path with its own reservation is an object. One without has the form of all histories before there were any.
#[derive(Deserialize)]
#[serde(untagged)]
enum KeptPath {
    Links(Vec<LinkId>),
    Reserved { links: Vec<LinkId>, reservation: MapReservation },
}

impl KeptPath {
    fn take(slots: &Slots<'_>) -> Result<Self, Unreadable> {
        parse_json(required::<_, Unreadable>(slots.change.as_deref())?)
    }
}

/// Anything in JSON, or nothing.
pub(crate) struct OptionalJson;

impl<T: Serialize + DeserializeOwned> Slot<Option<T>> for OptionalJson {
    fn put<'a>(value: &'a Option<T>, slots: &mut Slots<'a>) {
        slots.change = value.as_ref().map(|value| json(value).into());
    }

    fn take(slots: &Slots<'_>) -> Result<Option<T>, Unreadable> {
        slots.change.as_deref().map(parse_json).transpose()
    }
}

/// The nodes of instances. Only several are in JSON.
pub(crate) struct Instances;

impl Slot<Nodes> for Instances {
    fn put<'a>(value: &'a Nodes, slots: &mut Slots<'a>) {
        slots.object = Some(value.first().as_str());
        slots.change = value.only().is_none().then(|| json(value).into());
    }

    fn take(slots: &Slots<'_>) -> Result<Nodes, Unreadable> {
        match slots.change.as_deref() {
            Some(several) => parse_json(several),
            None => <Object as Slot<NodeId>>::take(slots).map(Nodes::from),
        }
    }
}

/// A VNF in JSON, with its name and first node in columns of their own.
pub(crate) struct Added;

impl Slot<Box<Vnf>> for Added {
    fn put<'a>(value: &'a Box<Vnf>, slots: &mut Slots<'a>) {
        (slots.subject, slots.object) = (value.id.as_str(), Some(value.node.first().as_str()));
        Json::put(value, slots);
    }

    fn take(slots: &Slots<'_>) -> Result<Box<Vnf>, Unreadable> {
        Json::take(slots)
    }
}

/// An access point in JSON, without its key, which must not reach a history.
pub(crate) struct PublicJson;

impl Slot<AccessPoint> for PublicJson {
    fn put<'a>(value: &'a AccessPoint, slots: &mut Slots<'a>) {
        slots.change = Some(json(&value.public()).into());
    }

    fn take(slots: &Slots<'_>) -> Result<AccessPoint, Unreadable> {
        Json::take(slots)
    }
}

/// Milliseconds, or nothing.
pub(crate) struct Milliseconds;

impl Slot<Option<Duration>> for Milliseconds {
    fn put<'a>(value: &'a Option<Duration>, slots: &mut Slots<'a>) {
        slots.change = value.map(|duration| millis::of(duration).to_string().into());
    }

    fn take(slots: &Slots<'_>) -> Result<Option<Duration>, Unreadable> {
        let ms: Option<f64> = slots.change.as_deref().map(parse_json::<_, Unreadable>).transpose()?;
        ms.map(millis::duration).transpose().map_err(Unreadable::new)
    }
}

fn parse<T: FromStr<Err: Display>>(name: &str) -> Result<T, Unreadable> {
    name.parse().map_err(Unreadable::new)
}
