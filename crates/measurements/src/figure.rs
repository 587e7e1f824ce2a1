//! Figures: the numbers of an embedding, which can be drawn over time and compared.

use std::{fmt, str::FromStr};

use cotorra_graph::{ComponentId, Direction, Event, LinkId, NodeId, SensorId, SensorKind, ServiceId, millis};
use serde::{Deserialize, Serialize};

use crate::kind::{Kind, Series};

macro_rules! quantities {
    ($(#[$doc:meta])* $of:ident { $($(#[$its:meta])* $quantity:ident = $name:literal, $unit:literal, $column:literal;)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $of { $($(#[$its])* $quantity,)* }

        impl $of {
            pub const ALL: &[Self] = &[$(Self::$quantity),*];

            /// Returns its name in a figure's text.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$quantity => $name),* }
            }

            const fn unit(self) -> &'static str {
                match self { $(Self::$quantity => $unit),* }
            }

            const fn column(self) -> &'static str {
                match self { $(Self::$quantity => $column),* }
            }

            fn named(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|quantity| quantity.as_str() == name)
            }
        }
    };
}

quantities! {
    /// Figures of one direction of a link.
    LinkQuantity {
        /// d, ms.
        Delay = "delay", "ms", "delay_ms";
        /// λ, bit/s.
        Throughput = "throughput", "bit/s", "throughput_bps";
        /// The most packets that waited at a time over the last second.
        Queue = "queue", "packets", "queued_packets";
        /// ψ.
        DelayScale = "delay_scale", "", "delay_scale";
        /// δ.
        DropScale = "drop_scale", "", "drop_scale";
        /// Delay by probes, ms.
        ProbedDelay = "probed_delay", "ms", "probed_delay_ms";
        /// Jitter by probes, ms.
        ProbedJitter = "probed_jitter", "ms", "probed_jitter_ms";
        /// Loss by probes, a share.
        ProbedLoss = "probed_loss", "", "probed_loss";
    }
}

quantities! {
    /// Figures of a robot.
    RobotQuantity {
        /// Its position, m.
        X = "x", "m", "x";
        /// Its position, m.
        Y = "y", "m", "y";
        /// Its height above the floor, m.
        Z = "z", "m", "z";
        /// Its heading, rad.
        Heading = "heading", "rad", "heading";
        /// Its speed ahead, m/s.
        Linear = "linear", "m/s", "linear";
        /// Its speed upwards, m/s.
        Vertical = "vertical", "m/s", "vertical";
        /// Its turning rate, rad/s.
        Angular = "angular", "rad/s", "angular";
        /// Distance of the nearest obstacle, m.
        NearestObstacle = "nearest_obstacle", "m", "nearest_obstacle_m";
        /// Distance between the pose of localization and the true one, m.
        LocalizationError = "localization_error", "m", "localization_error_m";
    }
}

quantities! {
    /// Figures of a machine.
    MachineQuantity {
        /// Share of time in which its CPUs were busy.
        Cpu = "cpu", "", "cpu_busy";
        /// Mean number of tasks that ran or waited, over one minute.
        LoadAverage = "load_average", "", "one_minute";
        /// Memory that new programs could use, bytes.
        AvailableMemory = "available_memory", "bytes", "available_bytes";
    }
}

quantities! {
    /// Figures of the emulator's lateness since the run began.
    LatenessQuantity {
        /// Its median, µs.
        P50 = "lateness_p50", "µs", "p50_us";
        /// Its 99th percentile, µs.
        P99 = "lateness_p99", "µs", "p99_us";
        /// Its maximum, µs.
        Max = "lateness_max", "µs", "max_us";
    }
}

/// A figure. As text, its name and its subject, with colons between: `delay:LINK:DIRECTION`, `throughput:…`, `queue:…`,
/// `delay_scale:…`, `drop_scale:…`, `probed_delay:…`, `probed_jitter:…`, `probed_loss:…` (forward if the direction is left out); `x:ROBOT`, `y:…`, `z:…`, `heading:…`, `linear:…`,
/// `vertical:…`, `angular:…`, `nearest_obstacle:…`, `localization_error:…`; `signal:ROBOT:RADIO_UNIT`; `load:RADIO_UNIT`; `service_time:SERVICE:ROBOT` (all robots or
/// services if they are left out); `time_part:LINK:SERVICE:ROBOT` (likewise;
/// also of `sender`, `vnf`, `receiver`, `unknown`); `handover_gap:ROBOT` (likewise);
/// `sensor:ROBOT:SENSOR:COMPONENT`; `cpu:NODE`, `load_average:…`, `available_memory:…`; `lateness_p50`, `lateness_p99`, `lateness_max`.
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

/// Table and columns of a figure.
pub(crate) struct Kept<'a> {
    pub kind: Kind,
    /// The series, for kinds that make any.
    pub series: Option<Series>,
    /// Columns of a row, and the names that they must have.
    pub named: Vec<(&'static str, &'a str)>,
    /// For figures in child rows: the column, and the name that it must have.
    pub child: Option<(&'static str, &'a str)>,
    pub column: &'static str,
}

impl Figure {
    /// Returns the figure's unit; empty for a bare number.
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Sensor { component, .. } => SensorKind::unit(component),
            Self::Link(_, _, quantity) => quantity.unit(),
            Self::Robot(_, quantity) => quantity.unit(),
            Self::Signal { .. } => "dBm",
            Self::Load(_) => "",
            Self::ServiceTime { .. } | Self::TimePart { .. } | Self::HandoverGap { .. } => "ms",
            Self::Machine(_, quantity) => quantity.unit(),
            Self::Lateness(quantity) => quantity.unit(),
        }
    }

    pub(crate) fn kept(&self) -> Kept<'_> {
        let plain = |kind, column| Kept { kind, series: None, named: Vec::new(), child: None, column };
        match self {
            Self::Link(link, direction, quantity) => {
                let series = Some(Series::new(Kind::Link, link, *direction));
                Kept { series, ..plain(Kind::Link, quantity.column()) }
            }
            Self::Robot(robot, quantity) => Kept {
                series: Some(Series::new(Kind::Robot, robot, ())),
                ..plain(Kind::Robot, quantity.column())
            },
            Self::Signal { robot, radio_unit } => Kept {
                series: Some(Series::new(Kind::Robot, robot, ())),
                child: Some(("radio_unit", radio_unit.as_str())),
                ..plain(Kind::Robot, "signal_dbm")
            },
            Self::Load(unit) => {
                Kept { series: Some(Series::new(Kind::Radio, unit, ())), ..plain(Kind::Radio, "load") }
            }
            Self::ServiceTime { service, robot } => {
                Kept { named: samples(service, robot), ..plain(Kind::ServiceTime, "service_time_ms") }
            }
            Self::TimePart { part, service, robot } => Kept {
                named: samples(service, robot),
                child: Some(("part", part)),
                ..plain(Kind::ServiceTime, "total_ms")
            },
            Self::HandoverGap { robot } => {
                let named = robot.iter().map(|robot| ("robot", robot.as_str())).collect();
                Kept { named, ..plain(Kind::Handover, "gap_ms") }
            }
            Self::Sensor { robot, sensor, component } => Kept {
                series: Some(Series::new(Kind::Sensor, robot, sensor)),
                child: Some(("component", component.as_str())),
                ..plain(Kind::Sensor, "value")
            },
            Self::Machine(node, quantity) => Kept {
                series: Some(Series::new(Kind::Machine, node, ())),
                ..plain(Kind::Machine, quantity.column())
            },
            Self::Lateness(quantity) => plain(Kind::Lateness, quantity.column()),
        }
    }

    /// Calls `each` with the figure's values in an event, NaN included.
    pub(crate) fn of(&self, event: &Event, mut each: impl FnMut(f64)) {
        match (self, event) {
            (Self::Link(link, direction, quantity), Event::Link(context))
                if context.link == *link && context.direction == *direction =>
            {
                let probed = context.probed;
                match quantity {
                    LinkQuantity::Delay => context.delay.map(millis::of).into_iter().for_each(each),
                    LinkQuantity::Throughput => each(context.throughput_bps),
                    LinkQuantity::Queue => {
                        context.queued_packets.into_iter().for_each(|packets| each(packets as f64));
                    }
                    LinkQuantity::DelayScale => each(context.scale.delay_scale),
                    LinkQuantity::DropScale => each(context.scale.drop_scale),
                    LinkQuantity::ProbedDelay => {
                        probed.and_then(|p| p.delay).map(millis::of).into_iter().for_each(each)
                    }
                    LinkQuantity::ProbedJitter => {
                        probed.and_then(|p| p.jitter).map(millis::of).into_iter().for_each(each)
                    }
                    LinkQuantity::ProbedLoss => probed.and_then(|p| p.loss).into_iter().for_each(each),
                }
            }
            (Self::Robot(robot, quantity), Event::Robot(context)) if context.robot == *robot => {
                let sensors = &context.sensors;
                match quantity {
                    RobotQuantity::X => each(sensors.pose.x),
                    RobotQuantity::Y => each(sensors.pose.y),
                    RobotQuantity::Z => each(sensors.pose.z),
                    RobotQuantity::Heading => each(sensors.pose.heading),
                    RobotQuantity::Linear => each(sensors.velocity.linear),
                    RobotQuantity::Vertical => each(sensors.velocity.vertical),
                    RobotQuantity::Angular => each(sensors.velocity.angular),
                    RobotQuantity::NearestObstacle => sensors.nearest_obstacle_m.into_iter().for_each(each),
                    RobotQuantity::LocalizationError => {
                        context.localization_error_m.into_iter().for_each(each);
                    }
                }
            }
            (Self::Signal { robot, radio_unit }, Event::Robot(context)) if context.robot == *robot => {
                let heard = context.attachments.iter();
                // A signal counts once, where it was heard.
                let heard = heard.filter(|heard| heard.radio_unit == *radio_unit && heard.is_news());
                heard.filter_map(|heard| heard.signal).for_each(|signal| each(signal.0));
            }
            (Self::Load(unit), Event::Radio(context)) if context.radio_unit == *unit => {
                context.load.into_iter().for_each(each);
            }
            (Self::ServiceTime { service, robot }, Event::ServiceTime(time))
                if service.as_ref().is_none_or(|service| time.service == *service)
                    && robot.as_ref().is_none_or(|robot| time.robot == *robot) =>
            {
                time.took.map(millis::of).into_iter().for_each(each);
            }
            (Self::TimePart { part, service, robot }, Event::ServiceTime(time))
                if service.as_ref().is_none_or(|service| time.service == *service)
                    && robot.as_ref().is_none_or(|robot| time.robot == *robot) =>
            {
                let rows = time.parts.iter().flat_map(|parts| parts.rows());
                rows.filter(|row| row.name() == part).for_each(|row| each(millis::of(row.total())));
            }
            (Self::HandoverGap { robot }, Event::Handover(handover))
                if robot.as_ref().is_none_or(|robot| handover.robot == *robot) =>
            {
                each(millis::of(handover.gap));
            }
            (Self::Sensor { robot, sensor, component }, Event::Sensor(reading))
                if reading.robot == *robot && reading.sensor == *sensor =>
            {
                reading.values.get(component).copied().into_iter().for_each(each);
            }
            (Self::Machine(node, quantity), Event::Machine(context)) if context.node == *node => {
                let busy = || context.cpu?.busy;
                match quantity {
                    MachineQuantity::Cpu => busy().into_iter().for_each(|busy| each(busy.get())),
                    MachineQuantity::LoadAverage => {
                        context.load_average.into_iter().for_each(|load| each(load.one_minute));
                    }
                    MachineQuantity::AvailableMemory => {
                        context.memory.into_iter().for_each(|memory| each(memory.available_bytes as f64));
                    }
                }
            }
            (Self::Lateness(quantity), Event::Lateness(lateness)) => each(match quantity {
                LatenessQuantity::P50 => lateness.p50_us,
                LatenessQuantity::P99 => lateness.p99_us,
                LatenessQuantity::Max => lateness.max_us,
            }),
            _ => {}
        }
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Link(link, direction, quantity) => {
                let direction = match direction {
                    Direction::Forward => "forward",
                    Direction::Backward => "backward",
                };
                write!(f, "{}:{link}:{direction}", quantity.as_str())
            }
            Self::Robot(robot, quantity) => write!(f, "{}:{robot}", quantity.as_str()),
            Self::Signal { robot, radio_unit } => write!(f, "signal:{robot}:{radio_unit}"),
            Self::Load(unit) => write!(f, "load:{unit}"),
            Self::ServiceTime { service, robot } => {
                f.write_str("service_time")?;
                write_samples(f, service.as_ref(), robot.as_ref())
            }
            Self::TimePart { part, service, robot } => {
                write!(f, "time_part:{part}")?;
                write_samples(f, service.as_ref(), robot.as_ref())
            }
            Self::HandoverGap { robot: None } => f.write_str("handover_gap"),
            Self::HandoverGap { robot: Some(robot) } => write!(f, "handover_gap:{robot}"),
            Self::Sensor { robot, sensor, component } => write!(f, "sensor:{robot}:{sensor}:{component}"),
            Self::Machine(node, quantity) => write!(f, "{}:{node}", quantity.as_str()),
            Self::Lateness(quantity) => f.write_str(quantity.as_str()),
        }
    }
}

/// Returns the columns of samples, and the names that they must have.
fn samples<'a>(service: &'a Option<ServiceId>, robot: &'a Option<NodeId>) -> Vec<(&'static str, &'a str)> {
    let service = service.iter().map(|service| ("service", service.as_str()));
    service.chain(robot.iter().map(|robot| ("robot", robot.as_str()))).collect()
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
#[error(
    "`{0}` is not a figure: give delay, throughput, queue, delay_scale, drop_scale, probed_delay, probed_jitter or probed_loss \
     with :LINK or :LINK:DIRECTION; x, y, z, heading, linear, vertical, angular, nearest_obstacle or localization_error with :ROBOT; signal:ROBOT:RADIO_UNIT; load:RADIO_UNIT; service_time, with :SERVICE \
     or :SERVICE:ROBOT if you like; time_part with :LINK, :sender, :vnf, \
     :receiver or :unknown, and more as of service_time; handover_gap, with :ROBOT if you like; sensor:ROBOT:SENSOR:COMPONENT; \
     cpu, load_average or available_memory with :NODE; lateness_p50, lateness_p99 or lateness_max"
)]
pub struct InvalidFigure(String);

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
    Some(match (name, &of[..]) {
        ("signal", [robot, unit]) => Figure::Signal { robot: node(robot)?, radio_unit: node(unit)? },
        ("load", [unit]) => Figure::Load(node(unit)?),
        ("service_time", []) => Figure::ServiceTime { service: None, robot: None },
        ("service_time", [of]) => Figure::ServiceTime { service: service(of)?, robot: None },
        ("service_time", [of, robot]) => {
            Figure::ServiceTime { service: service(of)?, robot: Some(node(robot)?) }
        }
        ("handover_gap", []) => Figure::HandoverGap { robot: None },
        ("sensor", [robot, sensor, component]) => Figure::Sensor {
            robot: node(robot)?,
            sensor: SensorId::new(sensor).ok()?,
            component: ComponentId::new(component).ok()?,
        },
        ("time_part", [part]) => Figure::TimePart { part: name_of(part)?, service: None, robot: None },
        ("time_part", [part, of]) => {
            Figure::TimePart { part: name_of(part)?, service: service(of)?, robot: None }
        }
        ("time_part", [part, of, robot]) => {
            Figure::TimePart { part: name_of(part)?, service: service(of)?, robot: Some(node(robot)?) }
        }
        ("handover_gap", [robot]) => Figure::HandoverGap { robot: Some(node(robot)?) },
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
    use proptest::prelude::*;

    use super::*;
    use crate::testing::figure;

    proptest! {
        #[test]
        fn written_figures_are_read_back(figure in figure()) {
            prop_assert_eq!(figure.to_string().parse(), Ok(figure));
        }
    }

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
