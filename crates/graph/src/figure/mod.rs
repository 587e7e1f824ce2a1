//! Figures: the numbers of a run, which can be drawn over time, compared and bounded.

mod bound;
mod declared;
mod statistic;
mod unit;

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use self::declared::OtherQuantity;
pub use self::{
    bound::{Bound, InvalidBound, Measure},
    declared::{
        Better, Declared, FIGURES, FigureKind, LatenessQuantity, LinkQuantity, MachineQuantity,
        RobotQuantity, Total,
    },
    statistic::Statistic,
    unit::Unit,
};
use crate::{
    hardware::Direction,
    id::{ComponentId, LinkId, NodeId, SensorId, ServiceId},
    sensor::SensorKind,
};

/// A figure over time. As text, its name and its subject, with colons between, as [`FIGURES`] declare them. The direction of a
/// link is forward if it is left out. `service_time`, `time_part` and `handover_gap` are of all services and robots that are
/// not named.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Figure {
    /// A quantity of one direction of a link.
    Link(LinkId, Direction, LinkQuantity),
    /// A quantity of a robot.
    Robot(NodeId, RobotQuantity),
    /// The signal at which a robot hears a radio unit, dBm.
    Signal {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// The load of a radio unit's channel, a share of time.
    Load(NodeId),
    /// Service times that were answered, ms, at the time when they were recorded.
    ServiceTime {
        /// `None` for all services.
        service: Option<ServiceId>,
        /// `None` for all robots.
        robot: Option<NodeId>,
    },
    /// Time of answered samples on a link, or in one of the parts `sender`, `vnf`, `receiver` and `unknown`, ms.
    TimePart {
        /// Name of the link or part.
        part: String,
        /// `None` for all services.
        service: Option<ServiceId>,
        /// `None` for all robots.
        robot: Option<NodeId>,
    },
    /// Time that handovers cut robots off, ms.
    HandoverGap {
        /// `None` for all robots.
        robot: Option<NodeId>,
    },
    /// One of the numbers that a sensor of a robot reads.
    Sensor {
        /// The robot.
        robot: NodeId,
        /// The sensor.
        sensor: SensorId,
        /// The component of the reading.
        component: ComponentId,
    },
    /// A quantity of a node's machine.
    Machine(NodeId, MachineQuantity),
    /// The emulator's lateness.
    Lateness(LatenessQuantity),
}

impl Figure {
    /// Returns the figure's declaration.
    pub const fn declared(&self) -> &'static Declared {
        match self {
            Self::Link(_, _, quantity) => quantity.declared(),
            Self::Robot(_, quantity) => quantity.declared(),
            Self::Machine(_, quantity) => quantity.declared(),
            Self::Lateness(quantity) => quantity.declared(),
            Self::Signal { .. } => OtherQuantity::Signal.declared(),
            Self::Load(_) => OtherQuantity::Load.declared(),
            Self::ServiceTime { .. } => OtherQuantity::ServiceTime.declared(),
            Self::TimePart { .. } => OtherQuantity::TimePart.declared(),
            Self::HandoverGap { .. } => OtherQuantity::HandoverGap.declared(),
            Self::Sensor { .. } => OtherQuantity::Sensor.declared(),
        }
    }

    /// Returns the figure's unit; empty for a bare number.
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Sensor { component, .. } => SensorKind::unit(component),
            other => other.declared().unit.symbol(),
        }
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.declared().name)?;
        match self {
            Self::Link(link, direction, _) => {
                let direction = match direction {
                    Direction::Forward => "forward",
                    Direction::Backward => "backward",
                };
                write!(f, ":{link}:{direction}")
            }
            Self::Signal { robot, radio_unit } => write!(f, ":{robot}:{radio_unit}"),
            Self::ServiceTime { service, robot } => write_samples(f, service.as_ref(), robot.as_ref()),
            Self::TimePart { part, service, robot } => {
                write!(f, ":{part}")?;
                write_samples(f, service.as_ref(), robot.as_ref())
            }
            Self::Sensor { robot, sensor, component } => write!(f, ":{robot}:{sensor}:{component}"),
            Self::HandoverGap { robot: None } | Self::Lateness(_) => Ok(()),
            Self::Robot(node, _)
            | Self::Load(node)
            | Self::HandoverGap { robot: Some(node) }
            | Self::Machine(node, _) => write!(f, ":{node}"),
        }
    }
}

fn write_samples(
    f: &mut fmt::Formatter<'_>,
    service: Option<&ServiceId>,
    robot: Option<&NodeId>,
) -> fmt::Result {
    match (service, robot) {
        (None, None) => Ok(()),
        (Some(service), None) => write!(f, ":{service}"),
        (service, Some(robot)) => write!(f, ":{}:{robot}", service.map_or("", ServiceId::as_str)),
    }
}

/// A text that is not a figure.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a figure: give {known}; DIRECTION, SERVICE, and ROBOT behind it, can be left out", known = known())]
pub struct InvalidFigure(String);

/// Lists the figures over time with their subjects.
fn known() -> String {
    let over_time = FIGURES.iter().filter(|figure| figure.kind == FigureKind::Samples);
    let named = |figure: &&Declared| match figure.of {
        "" => figure.name.to_owned(),
        of => format!("{}:{of}", figure.name),
    };
    over_time.map(named).collect::<Vec<_>>().join(", ")
}

impl FromStr for Figure {
    type Err = InvalidFigure;
    fn from_str(text: &str) -> Result<Self, InvalidFigure> {
        parse(text).ok_or_else(|| InvalidFigure(text.chars().take(80).collect()))
    }
}

fn parse(text: &str) -> Option<Figure> {
    let mut parts = text.split(':');
    let name = parts.next()?;
    let of: Vec<&str> = parts.collect();
    let node = |text: &str| NodeId::new(text).ok();
    if let Some(quantity) = LinkQuantity::named(name) {
        let direction = match of.get(1) {
            None | Some(&"forward") => Direction::Forward,
            Some(&"backward") => Direction::Backward,
            Some(_) => return None,
        };
        let link = of.first().filter(|_| of.len() <= 2)?;
        return Some(Figure::Link(LinkId::new(link).ok()?, direction, quantity));
    }
    if let (Some(quantity), [robot]) = (RobotQuantity::named(name), &of[..]) {
        return Some(Figure::Robot(node(robot)?, quantity));
    }
    if let (Some(quantity), [machine]) = (MachineQuantity::named(name), &of[..]) {
        return Some(Figure::Machine(node(machine)?, quantity));
    }
    if let (Some(quantity), []) = (LatenessQuantity::named(name), &of[..]) {
        return Some(Figure::Lateness(quantity));
    }
    let service = |text: &str| match text {
        "" => Some(None),
        text => ServiceId::new(text).ok().map(Some),
    };
    // Parts that are no links have names of the same kind.
    let name_of = |part: &str| LinkId::new(part).ok().map(|part| part.to_string());
    Some(match (OtherQuantity::named(name)?, &of[..]) {
        (OtherQuantity::Signal, [robot, unit]) => {
            Figure::Signal { robot: node(robot)?, radio_unit: node(unit)? }
        }
        (OtherQuantity::Load, [unit]) => Figure::Load(node(unit)?),
        (OtherQuantity::ServiceTime, []) => Figure::ServiceTime { service: None, robot: None },
        (OtherQuantity::ServiceTime, [of]) => Figure::ServiceTime { service: service(of)?, robot: None },
        (OtherQuantity::ServiceTime, [of, robot]) => {
            Figure::ServiceTime { service: service(of)?, robot: Some(node(robot)?) }
        }
        (OtherQuantity::HandoverGap, []) => Figure::HandoverGap { robot: None },
        (OtherQuantity::Sensor, [robot, sensor, component]) => Figure::Sensor {
            robot: node(robot)?,
            sensor: SensorId::new(sensor).ok()?,
            component: ComponentId::new(component).ok()?,
        },
        (OtherQuantity::TimePart, [part]) => {
            Figure::TimePart { part: name_of(part)?, service: None, robot: None }
        }
        (OtherQuantity::TimePart, [part, of]) => {
            Figure::TimePart { part: name_of(part)?, service: service(of)?, robot: None }
        }
        (OtherQuantity::TimePart, [part, of, robot]) => {
            Figure::TimePart { part: name_of(part)?, service: service(of)?, robot: Some(node(robot)?) }
        }
        (OtherQuantity::HandoverGap, [robot]) => Figure::HandoverGap { robot: Some(node(robot)?) },
        _ => return None,
    })
}

impl TryFrom<String> for Figure {
    type Error = InvalidFigure;
    fn try_from(text: String) -> Result<Self, InvalidFigure> {
        text.parse()
    }
}

impl From<Figure> for String {
    fn from(figure: Figure) -> Self {
        figure.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_forms_are_read_and_others_rejected() {
        let link = LinkId::new("r1~ap1").unwrap();
        assert_eq!("delay:r1~ap1".parse(), Ok(Figure::Link(link, Direction::Forward, LinkQuantity::Delay)));
        let link = LinkId::new("a-b").unwrap();
        let queue = Figure::Link(link, Direction::Backward, LinkQuantity::Queue);
        assert_eq!(queue.unit(), "packets");
        assert_eq!("queue:a-b:backward".parse(), Ok(queue));
        let robot = NodeId::new("r1").unwrap();
        let error = Figure::Robot(robot, RobotQuantity::LocalizationError);
        assert_eq!("localization_error:r1".parse(), Ok(error));
        assert_eq!("service_time".parse(), Ok(Figure::ServiceTime { service: None, robot: None }));
        for text in [
            "",
            "weather:r1",
            "delay",
            "delay:a:up",
            "delay:a:forward:b",
            "x:r1:r2",
            "lateness_p99:r1",
            "load:a b",
        ] {
            let error = text.parse::<Figure>().unwrap_err();
            assert!(error.to_string().starts_with(&format!("`{text}` is not a figure")), "{error}");
        }
    }
}
