//! Kinds of events, and the series that some of them make.

use std::str::FromStr;

use cotorra_graph::{Direction, Event, LinkId, NodeId, SensorId, VnfId};
use serde::{Deserialize, Serialize};

macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident = $name:literal,)*) => {
        /// Kinds of events, one for each variant of [`Event`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Kind { $($(#[$doc])* $kind,)* }

        impl Kind {
            pub const ALL: [Self; [$(Self::$kind),*].len()] = [$(Self::$kind),*];

            /// Returns the event's name in JSON, which is also its table in the schema.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$kind => $name),* }
            }
        }
    };
}

kinds! {
    /// κ(r).
    Robot = "robot",
    /// ι(R).
    Radio = "radio",
    /// d, λ, ψ, δ.
    Link = "link",
    /// a(n).
    Placement = "placement",
    /// a(n1,n2).
    VirtualLink = "virtual_link",
    /// Service times.
    ServiceTime = "service_time",
    /// Finished handovers.
    Handover = "handover",
    /// Robots without a radio unit.
    Detached = "detached",
    /// Finished scans.
    Scanned = "scanned",
    /// Life cycle of VNFs.
    Vnf = "vnf",
    /// Decisions of plug-ins.
    Decision = "decision",
    /// Plug-ins that were cut off.
    PluginFault = "plugin_fault",
    /// The emulator's lateness.
    Lateness = "lateness",
    /// Robots at the end of their walk.
    WalkFinished = "walk_finished",
    /// Notices.
    Notice = "notice",
    /// Answers that robots did not follow.
    AnswersRejected = "answers_rejected",
    /// Changes of robots' goals.
    Goal = "goal",
    /// Readings of sensors.
    Sensor = "sensor",
    /// Contexts of machines.
    Machine = "machine",
    /// Answers to suggestions of radio units.
    SuggestionAnswered = "suggestion_answered",
}

impl Kind {
    /// Kinds whose old samples are rolled up: embeddings that are sampled all the time. Events of other kinds are all
    /// kept.
    pub const SAMPLED: [Self; 5] = [Self::Robot, Self::Radio, Self::Link, Self::Sensor, Self::Machine];

    /// Returns the kind of an event.
    pub const fn of(event: &Event) -> Self {
        match event {
            Event::Robot(_) => Self::Robot,
            Event::Radio(_) => Self::Radio,
            Event::Link(_) => Self::Link,
            Event::Placement(_) => Self::Placement,
            Event::VirtualLink(_) => Self::VirtualLink,
            Event::ServiceTime(_) => Self::ServiceTime,
            Event::Handover(_) => Self::Handover,
            Event::Detached { .. } => Self::Detached,
            Event::Scanned { .. } => Self::Scanned,
            Event::Vnf(_) => Self::Vnf,
            Event::Decision(_) => Self::Decision,
            Event::PluginFault { .. } => Self::PluginFault,
            Event::Lateness(_) => Self::Lateness,
            Event::WalkFinished { .. } => Self::WalkFinished,
            Event::Notice { .. } => Self::Notice,
            Event::AnswersRejected(_) => Self::AnswersRejected,
            Event::Goal(_) => Self::Goal,
            Event::Sensor(_) => Self::Sensor,
            Event::Machine(_) => Self::Machine,
            Event::SuggestionAnswered { .. } => Self::SuggestionAnswered,
        }
    }
}

impl FromStr for Kind {
    type Err = InvalidKind;
    fn from_str(name: &str) -> std::result::Result<Self, InvalidKind> {
        let found = Self::ALL.into_iter().find(|k| k.as_str() == name);
        found.ok_or_else(|| InvalidKind(name.chars().take(60).collect()))
    }
}

/// A text that names no kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a kind of event; one of {list}", list = Kind::ALL.map(Kind::as_str).join(", "))]
pub struct InvalidKind(String);

/// A part of the graph's embedding. Each of its events is its state until the next one.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Series {
    Robot(NodeId),
    Radio(NodeId),
    Link(LinkId, Direction),
    Placement(VnfId),
    VirtualLink(VnfId, VnfId),
    Sensor(NodeId, SensorId),
    Machine(NodeId),
}

impl Series {
    /// Kinds whose events make series.
    pub const KINDS: [Kind; 7] = [
        Kind::Robot,
        Kind::Radio,
        Kind::Link,
        Kind::Placement,
        Kind::VirtualLink,
        Kind::Sensor,
        Kind::Machine,
    ];

    /// Returns the series that an event belongs to.
    pub fn of(event: &Event) -> Option<Self> {
        Some(match event {
            Event::Robot(context) => Self::Robot(context.robot.clone()),
            Event::Radio(context) => Self::Radio(context.radio_unit.clone()),
            Event::Link(context) => Self::Link(context.link.clone(), context.direction),
            Event::Placement(placement) => Self::Placement(placement.vnf.clone()),
            Event::VirtualLink(mapping) => Self::VirtualLink(mapping.from.clone(), mapping.to.clone()),
            Event::Sensor(reading) => Self::Sensor(reading.robot.clone(), reading.sensor.clone()),
            Event::Machine(context) => Self::Machine(context.node.clone()),
            _ => return None,
        })
    }

    /// Whether an event belongs to the series.
    pub fn holds(&self, event: &Event) -> bool {
        match (self, event) {
            (Self::Robot(node), Event::Robot(context)) => *node == context.robot,
            (Self::Radio(node), Event::Radio(context)) => *node == context.radio_unit,
            (Self::Link(link, direction), Event::Link(context)) => {
                *link == context.link && *direction == context.direction
            }
            (Self::Placement(vnf), Event::Placement(placement)) => *vnf == placement.vnf,
            (Self::VirtualLink(from, to), Event::VirtualLink(mapping)) => {
                *from == mapping.from && *to == mapping.to
            }
            (Self::Sensor(robot, sensor), Event::Sensor(reading)) => {
                *robot == reading.robot && *sensor == reading.sensor
            }
            (Self::Machine(node), Event::Machine(context)) => *node == context.node,
            _ => false,
        }
    }

    pub const fn kind(&self) -> Kind {
        match self {
            Self::Robot(_) => Kind::Robot,
            Self::Radio(_) => Kind::Radio,
            Self::Link(..) => Kind::Link,
            Self::Placement(_) => Kind::Placement,
            Self::VirtualLink(..) => Kind::VirtualLink,
            Self::Sensor(..) => Kind::Sensor,
            Self::Machine(_) => Kind::Machine,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::stamped;

    proptest! {
        #[test]
        fn a_kind_is_named_as_its_event_is_in_json(stamped in stamped()) {
            let kind = Kind::of(&stamped.event);
            let json = serde_json::to_value(&stamped).unwrap();
            prop_assert_eq!(&json["event"], kind.as_str());
            prop_assert_eq!(kind.as_str().parse(), Ok(kind));
            prop_assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
        }

        #[test]
        fn a_series_holds_its_own_events(a in stamped(), b in stamped()) {
            let [of_a, of_b] = [&a, &b].map(|stamped| Series::of(&stamped.event));
            let Some(series) = &of_a else { return Ok(()) };
            prop_assert!(series.holds(&a.event));
            prop_assert_eq!(series.holds(&b.event), of_a == of_b);
        }
    }

    #[test]
    fn unknown_kinds_are_rejected() {
        let error = "weather".parse::<Kind>().unwrap_err();
        assert!(error.to_string().starts_with("`weather` is not a kind of event; one of robot, radio, link"));
    }
}
