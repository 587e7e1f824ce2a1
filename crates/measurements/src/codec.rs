//! How an event becomes a row, and a row an event: once, for every engine. The order of the columns is that of
//! [`TABLES`]; encoding and decoding stand side by side so that they cannot drift apart unseen.

use std::{borrow::Cow, sync::Arc, time::Duration};

use cotorra_graph::{
    Attachment, BitRate, ConditionChange, Conditions, Dbm, Decision, Direction, Event, Handover, Instruction,
    Jitter, JitterDistribution, Lateness, LinkContext, LinkCounters, LinkId, Loss, NodeId, Placement,
    PluginId, Pose, PoseSource, Probability, QueueLimit, RadioContext, Rate, RobotContext, Scale, SensorData,
    ServiceId, ServiceTime, Stamped, StationContext, Timestamp, Trace, Velocity, VirtualLinkMapping,
    VnfEvent, VnfId, VnfState,
};

use crate::store::Kind;

/// A table of events, beside the key (run, t_ns, seq) that all of them have.
pub(crate) struct Table {
    /// Columns, in order.
    pub columns: &'static [&'static str],
    /// Columns that name the series, for kinds that have them.
    pub series: &'static [&'static str],
    /// Rows that belong to a row: their table and columns; their key has `place`, from 0, behind it.
    pub children: Option<(&'static str, &'static [&'static str])>,
}

const fn plain(columns: &'static [&'static str]) -> Table {
    Table { columns, series: &[], children: None }
}

/// The table of a kind.
#[rustfmt::skip]
pub(crate) const fn table(kind: Kind) -> Table {
    match kind {
        Kind::Robot => Table {
            columns: &[
                "robot", "waypoint",
                "x_m", "y_m", "heading_rad",
                "cov_xx", "cov_xy", "cov_xh", "cov_yx", "cov_yy", "cov_yh", "cov_hx", "cov_hy", "cov_hh",
                "source",
                "odom_x_m", "odom_y_m", "odom_heading_rad",
                "odom_cov_xx", "odom_cov_xy", "odom_cov_xh", "odom_cov_yx", "odom_cov_yy", "odom_cov_yh",
                "odom_cov_hx", "odom_cov_hy", "odom_cov_hh",
                "odom_source",
                "linear_mps", "angular_radps", "bumper", "nearest_obstacle_m",
            ],
            series: &["robot"],
            children: Some(("attachment", &["radio_unit", "attached", "signal_dbm"])),
        },
        Kind::Radio => Table {
            columns: &["radio_unit", "channel", "load"],
            series: &["radio_unit"],
            children: Some(("station", &["robot", "signal_dbm", "downlink_mbps", "uplink_mbps"])),
        },
        Kind::Link => Table {
            columns: &[
                "link", "direction", "delay_ns", "throughput_bps", "delay_scale", "drop_scale",
                "asked", "effective",
                "packets", "bytes", "lost", "overflowed", "duplicated", "corrupted",
            ],
            series: &["link", "direction"],
            children: None,
        },
        Kind::Placement => Table { columns: &["vnf", "node"], series: &["vnf"], children: None },
        Kind::VirtualLink => Table {
            columns: &["from_vnf", "to_vnf"],
            series: &["from_vnf", "to_vnf"],
            children: Some(("hop", &["link"])),
        },
        Kind::ServiceTime => {
            plain(&["service", "robot", "sequence", "emitted_ns", "took_ns", "attachment", "server"])
        }
        Kind::Handover => plain(&["robot", "from_radio_unit", "to_radio_unit", "fast", "gap_ns"]),
        Kind::Detached => plain(&["robot", "from_radio_unit"]),
        Kind::Scanned | Kind::WalkFinished => plain(&["robot"]),
        Kind::Vnf => plain(&["vnf", "node", "state", "detail"]),
        Kind::Decision => plain(&[
            "plugin", "instruction", "subject", "object", "linear_mps", "angular_radps", "waypoint",
            "direction", "change", "reason", "refused",
        ]),
        Kind::PluginFault => plain(&["plugin", "reason"]),
        Kind::Lateness => plain(&["frames", "p50_us", "p99_us", "max_us"]),
        Kind::Notice => plain(&["message"]),
    }
}

/// Columns of `conditions`, behind its id.
#[rustfmt::skip]
pub(crate) const CONDITIONS: &[&str] = &[
    "delay_ns", "jitter_ns", "jitter_distribution", "loss", "loss_rate", "loss_mean_burst",
    "duplication", "corruption", "reordering", "rate_bps", "trace_ms", "queue_packets", "queue_bytes",
];

/// A figure on its way into a column.
#[derive(Debug, Clone)]
pub(crate) enum Value<'a> {
    Null,
    Integer(i64),
    /// NaN becomes NULL.
    Real(f64),
    Text(Cow<'a, str>),
    /// Becomes the id of the name's row.
    Name(&'a str),
    /// Becomes the id of the conditions' row.
    Conditions {
        link: &'a LinkId,
        direction: Direction,
        role: Role,
        conditions: &'a Conditions,
    },
}

/// Which conditions of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Role {
    Asked,
    Effective,
}

/// The columns of one row, or of several child rows one after the other.
#[derive(Debug, Default)]
pub(crate) struct Fields<'a>(pub Vec<Value<'a>>);

impl<'a> Fields<'a> {
    fn integer(&mut self, n: i64) -> &mut Self {
        self.0.push(Value::Integer(n));
        self
    }

    fn unsigned(&mut self, n: u64) -> &mut Self {
        self.integer(n.cast_signed())
    }

    fn real(&mut self, x: f64) -> &mut Self {
        self.0.push(Value::Real(x));
        self
    }

    fn name(&mut self, name: &'a str) -> &mut Self {
        self.0.push(Value::Name(name));
        self
    }

    fn text(&mut self, text: impl Into<Cow<'a, str>>) -> &mut Self {
        self.0.push(Value::Text(text.into()));
        self
    }

    fn duration(&mut self, duration: Duration) -> &mut Self {
        self.integer(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }

    fn direction(&mut self, direction: Direction) -> &mut Self {
        self.integer(direction_code(direction))
    }

    fn optional<T>(&mut self, value: Option<T>, some: impl FnOnce(&mut Self, T) -> &mut Self) -> &mut Self {
        match value {
            Some(value) => some(self, value),
            None => {
                self.0.push(Value::Null);
                self
            }
        }
    }

    fn pose(&mut self, pose: &Pose) -> &mut Self {
        self.real(pose.x).real(pose.y).real(pose.heading);
        for c in pose.covariance {
            self.real(c);
        }
        self.integer(match pose.source {
            PoseSource::Simulator => 0,
            PoseSource::Odometry => 1,
            PoseSource::Localization => 2,
        })
    }
}

/// A direction in a column.
pub(crate) const fn direction_code(direction: Direction) -> i64 {
    match direction {
        Direction::Forward => 0,
        Direction::Backward => 1,
    }
}

fn direction_of(code: i64) -> Option<Direction> {
    match code {
        0 => Some(Direction::Forward),
        1 => Some(Direction::Backward),
        _ => None,
    }
}

/// Whether a history can hold the event and give it back as it was.
pub(crate) fn storable(stamped: &Stamped) -> bool {
    let finite = |change: &ConditionChange| {
        let burst = match change.loss {
            Some(Loss::Bursty { mean_burst, .. }) => Some(mean_burst),
            _ => None,
        };
        [change.delay_ms, change.delay_scale, change.drop_scale, burst]
            .into_iter()
            .flatten()
            .all(f64::is_finite)
    };
    i64::try_from(stamped.at.as_nanos()).is_ok()
        && match &stamped.event {
            Event::Decision(Decision { instruction: Instruction::Condition { change, .. }, .. }) => {
                finite(change)
            }
            _ => true,
        }
}

/// Writes an event's columns into `row`, and those of its child rows into `children`.
pub(crate) fn encode<'a>(event: &'a Event, row: &mut Fields<'a>, children: &mut Fields<'a>) {
    match event {
        Event::Robot(context) => {
            let sensors = &context.sensors;
            row.name(context.robot.as_str())
                .integer(context.waypoint.into())
                .pose(&sensors.pose)
                .pose(&sensors.odometry)
                .real(sensors.velocity.linear)
                .real(sensors.velocity.angular)
                .integer(sensors.bumper.into())
                .optional(sensors.nearest_obstacle_m, Fields::real);
            for attachment in &context.attachments {
                children
                    .name(attachment.radio_unit.as_str())
                    .integer(attachment.attached.into())
                    .optional(attachment.signal, |f, signal| f.real(signal.0));
            }
        }
        Event::Radio(context) => {
            row.name(context.radio_unit.as_str()).integer(context.channel.into()).real(context.load);
            for station in &context.stations {
                children
                    .name(station.robot.as_str())
                    .real(station.signal.0)
                    .real(station.downlink_mbps)
                    .real(station.uplink_mbps);
            }
        }
        Event::Link(context) => {
            let conditions = |role, conditions| Value::Conditions {
                link: &context.link,
                direction: context.direction,
                role,
                conditions,
            };
            row.name(context.link.as_str())
                .direction(context.direction)
                .optional(context.delay, Fields::duration)
                .real(context.throughput_bps)
                .real(context.scale.delay_scale)
                .real(context.scale.drop_scale);
            row.0.push(conditions(Role::Asked, &context.asked));
            row.0.push(conditions(Role::Effective, &context.effective));
            let counters = &context.counters;
            row.unsigned(counters.packets)
                .unsigned(counters.bytes)
                .unsigned(counters.lost)
                .unsigned(counters.overflowed)
                .unsigned(counters.duplicated)
                .unsigned(counters.corrupted);
        }
        Event::Placement(placement) => {
            row.name(placement.vnf.as_str()).name(placement.node.as_str());
        }
        Event::VirtualLink(mapping) => {
            row.name(mapping.from.as_str()).name(mapping.to.as_str());
            for link in &mapping.links {
                children.name(link.as_str());
            }
        }
        Event::ServiceTime(time) => {
            row.name(time.service.as_str())
                .name(time.robot.as_str())
                .integer(time.sequence.into())
                .unsigned(time.emitted.as_nanos())
                .optional(time.took, Fields::duration)
                .optional(time.attachment.as_ref(), |f, unit| f.name(unit.as_str()))
                .name(time.server.as_str());
        }
        Event::Handover(handover) => {
            row.name(handover.robot.as_str())
                .optional(handover.from.as_ref(), |f, unit| f.name(unit.as_str()))
                .name(handover.to.as_str())
                .integer(handover.fast.into())
                .duration(handover.gap);
        }
        Event::Detached { robot, from } => {
            row.name(robot.as_str()).name(from.as_str());
        }
        Event::Scanned { robot } | Event::WalkFinished { robot } => {
            row.name(robot.as_str());
        }
        Event::Vnf(vnf) => {
            row.name(vnf.vnf.as_str())
                .name(vnf.node.as_str())
                .text(match vnf.state {
                    VnfState::Started => "started",
                    VnfState::Died => "died",
                    VnfState::Stopped => "stopped",
                    VnfState::Failed => "failed",
                })
                .optional(vnf.detail.as_deref(), Fields::text);
        }
        Event::Decision(decision) => {
            row.name(decision.plugin.as_str());
            encode_instruction(&decision.instruction, row);
            row.optional(decision.reason.as_deref(), Fields::text)
                .optional(decision.refused.as_deref(), Fields::text);
        }
        Event::PluginFault { plugin, reason } => {
            row.name(plugin.as_str()).text(reason.as_str());
        }
        Event::Lateness(lateness) => {
            row.unsigned(lateness.frames).real(lateness.p50_us).real(lateness.p99_us).real(lateness.max_us);
        }
        Event::Notice { message } => {
            row.text(message.as_str());
        }
    }
}

fn encode_instruction<'a>(instruction: &'a Instruction, row: &mut Fields<'a>) {
    let mut put = |instruction: &'static str, subject: &'a str, object: Option<&'a str>| {
        row.text(instruction).name(subject).optional(object, Fields::name);
    };
    // Then: linear, angular, waypoint, direction, change.
    match instruction {
        Instruction::Move { robot, velocity, waypoint } => {
            put("move", robot.as_str(), None);
            row.real(velocity.linear).real(velocity.angular).integer((*waypoint).into());
            row.0.extend([Value::Null, Value::Null]);
        }
        Instruction::Scan { robot } => {
            put("scan", robot.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Attach { robot, radio_unit } => {
            put("attach", robot.as_str(), Some(radio_unit.as_str()));
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Place { vnf, node } => {
            put("place", vnf.as_str(), Some(node.as_str()));
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Condition { link, direction, change } => {
            put("condition", link.as_str(), None);
            row.0.extend([const { Value::Null }; 3]);
            let change = serde_json::to_string(change).expect("a change has no map keys that are not text");
            row.optional(*direction, Fields::direction).text(change);
        }
    }
}

/// Writes the columns of conditions.
pub(crate) fn encode_conditions<'a>(conditions: &'a Conditions, row: &mut Fields<'a>) {
    row.duration(conditions.delay)
        .optional(conditions.jitter, |f, jitter| f.duration(jitter.deviation))
        .optional(conditions.jitter, |f, jitter| {
            f.text(match jitter.distribution {
                JitterDistribution::Uniform => "uniform",
                JitterDistribution::Normal => "normal",
                JitterDistribution::Pareto => "pareto",
            })
        });
    match conditions.loss {
        Loss::None => {
            row.text("none");
            row.0.extend([Value::Null, Value::Null]);
        }
        Loss::Independent { rate } => {
            row.text("independent").real(rate.get());
            row.0.push(Value::Null);
        }
        Loss::Bursty { rate, mean_burst } => {
            row.text("bursty").real(rate.get()).real(mean_burst);
        }
    }
    row.real(conditions.duplication.get())
        .real(conditions.corruption.get())
        .real(conditions.reordering.get());
    match &conditions.rate {
        Rate::Unlimited => row.0.extend([Value::Null, Value::Null]),
        Rate::Fixed { bits_per_second } => {
            row.unsigned(bits_per_second.bits_per_second());
            row.0.push(Value::Null);
        }
        Rate::Trace { trace } => {
            row.0.push(Value::Null);
            let opportunities = trace.opportunities_ms();
            row.text(serde_json::to_string(opportunities).expect("whole numbers are JSON"));
        }
    }
    match conditions.queue {
        QueueLimit::Packets(packets) => {
            row.integer(packets.into());
            row.0.push(Value::Null);
        }
        QueueLimit::Bytes(bytes) => {
            row.0.push(Value::Null);
            row.unsigned(bytes);
        }
    }
}

/// The columns of a row that is read, from the first to the last.
pub(crate) trait Source {
    fn integer(&mut self) -> Result<Option<i64>>;
    fn real(&mut self) -> Result<Option<f64>>;
    fn text(&mut self) -> Result<Option<String>>;
    fn name(&mut self) -> Result<Option<Arc<str>>>;
    fn conditions(&mut self) -> Result<Conditions>;
    /// Calls `read` with each of the row's child rows, in their order.
    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source) -> Result<()>) -> Result<()>;
}

/// Why a row cannot be read.
#[derive(Debug)]
pub(crate) enum ReadError {
    /// A column says what it never does.
    Unreadable(String),
    /// The engine cannot.
    Engine(crate::Error),
}

type Result<T> = std::result::Result<T, ReadError>;

fn unreadable(what: impl std::fmt::Display) -> ReadError {
    ReadError::Unreadable(what.to_string())
}

fn required<T>(value: Option<T>) -> Result<T> {
    value.ok_or_else(|| unreadable("a column is NULL that never is"))
}

fn json<T: serde::de::DeserializeOwned>(text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(unreadable)
}

fn children<T>(source: &mut dyn Source, mut read: impl FnMut(Columns<'_>) -> Result<T>) -> Result<Vec<T>> {
    let mut all = Vec::new();
    source.children(&mut |child| {
        all.push(read(Columns(child))?);
        Ok(())
    })?;
    Ok(all)
}

/// Typed columns on top of a [`Source`].
struct Columns<'a>(&'a mut dyn Source);

impl Columns<'_> {
    fn integer(&mut self) -> Result<i64> {
        required(self.0.integer()?)
    }

    fn unsigned(&mut self) -> Result<u64> {
        Ok(self.integer()?.cast_unsigned())
    }

    fn small<T: TryFrom<i64>>(&mut self) -> Result<T> {
        let n = self.integer()?;
        n.try_into().map_err(|_| unreadable(format_args!("{n} is out of its column's range")))
    }

    fn real(&mut self) -> Result<f64> {
        Ok(self.0.real()?.unwrap_or(f64::NAN))
    }

    fn share(&mut self) -> Result<Probability> {
        let share = self.real()?;
        Probability::new(share).ok_or_else(|| unreadable(format_args!("{share} is not a share")))
    }

    fn boolean(&mut self) -> Result<bool> {
        Ok(self.integer()? != 0)
    }

    fn duration(&mut self) -> Result<Option<Duration>> {
        let Some(n) = self.0.integer()? else { return Ok(None) };
        let nanos = u64::try_from(n).map_err(|_| unreadable(format_args!("{n} ns is not a duration")))?;
        Ok(Some(Duration::from_nanos(nanos)))
    }

    fn text(&mut self) -> Result<String> {
        required(self.0.text()?)
    }

    fn optional_name<T: std::str::FromStr<Err: std::fmt::Display>>(&mut self) -> Result<Option<T>> {
        let Some(name) = self.0.name()? else { return Ok(None) };
        name.parse().map(Some).map_err(unreadable)
    }

    fn name<T: std::str::FromStr<Err: std::fmt::Display>>(&mut self) -> Result<T> {
        required(self.optional_name()?)
    }

    fn optional_direction(&mut self) -> Result<Option<Direction>> {
        let Some(code) = self.0.integer()? else { return Ok(None) };
        Ok(Some(direction_of(code).ok_or_else(|| unreadable(format_args!("{code} is not a direction")))?))
    }

    fn pose(&mut self) -> Result<Pose> {
        let (x, y, heading) = (self.real()?, self.real()?, self.real()?);
        let mut covariance = [0.0; 9];
        for c in &mut covariance {
            *c = self.real()?;
        }
        let source = match self.integer()? {
            0 => PoseSource::Simulator,
            1 => PoseSource::Odometry,
            2 => PoseSource::Localization,
            code => return Err(unreadable(format_args!("{code} is not a source of a pose"))),
        };
        Ok(Pose { x, y, heading, covariance, source })
    }
}

/// Reads an event of a kind.
pub(crate) fn decode(kind: Kind, source: &mut dyn Source) -> Result<Event> {
    let mut row = Columns(source);
    Ok(match kind {
        Kind::Robot => {
            let robot: NodeId = row.name()?;
            let waypoint = row.small()?;
            let sensors = SensorData {
                pose: row.pose()?,
                odometry: row.pose()?,
                velocity: Velocity { linear: row.real()?, angular: row.real()? },
                bumper: row.boolean()?,
                nearest_obstacle_m: row.0.real()?,
            };
            let attachments = children(source, |mut row| {
                Ok(Attachment {
                    radio_unit: row.name()?,
                    attached: row.boolean()?,
                    signal: row.0.real()?.map(Dbm),
                })
            })?;
            Event::Robot(RobotContext { robot, attachments, sensors, waypoint })
        }
        Kind::Radio => {
            let (radio_unit, channel, load) = (row.name()?, row.small()?, row.real()?);
            let stations = children(source, |mut row| {
                Ok(StationContext {
                    robot: row.name()?,
                    signal: Dbm(row.real()?),
                    downlink_mbps: row.real()?,
                    uplink_mbps: row.real()?,
                })
            })?;
            Event::Radio(RadioContext { radio_unit, channel, load, stations })
        }
        Kind::Link => Event::Link(LinkContext {
            link: row.name()?,
            direction: required(row.optional_direction()?)?,
            delay: row.duration()?,
            throughput_bps: row.real()?,
            scale: Scale { delay_scale: row.real()?, drop_scale: row.real()? },
            asked: row.0.conditions()?,
            effective: row.0.conditions()?,
            counters: LinkCounters {
                packets: row.unsigned()?,
                bytes: row.unsigned()?,
                lost: row.unsigned()?,
                overflowed: row.unsigned()?,
                duplicated: row.unsigned()?,
                corrupted: row.unsigned()?,
            },
        }),
        Kind::Placement => Event::Placement(Placement { vnf: row.name()?, node: row.name()? }),
        Kind::VirtualLink => {
            let (from, to): (VnfId, VnfId) = (row.name()?, row.name()?);
            let links = children(source, |mut row| row.name::<LinkId>())?;
            Event::VirtualLink(VirtualLinkMapping { from, to, links })
        }
        Kind::ServiceTime => Event::ServiceTime(ServiceTime {
            service: row.name::<ServiceId>()?,
            robot: row.name()?,
            sequence: row.small()?,
            emitted: Timestamp::from_nanos(row.unsigned()?),
            took: row.duration()?,
            attachment: row.optional_name()?,
            server: row.name()?,
        }),
        Kind::Handover => Event::Handover(Handover {
            robot: row.name()?,
            from: row.optional_name()?,
            to: row.name()?,
            fast: row.boolean()?,
            gap: required(row.duration()?)?,
        }),
        Kind::Detached => Event::Detached { robot: row.name()?, from: row.name()? },
        Kind::Scanned => Event::Scanned { robot: row.name()? },
        Kind::WalkFinished => Event::WalkFinished { robot: row.name()? },
        Kind::Vnf => Event::Vnf(VnfEvent {
            vnf: row.name()?,
            node: row.name()?,
            state: match row.text()?.as_str() {
                "started" => VnfState::Started,
                "died" => VnfState::Died,
                "stopped" => VnfState::Stopped,
                "failed" => VnfState::Failed,
                other => return Err(unreadable(format_args!("`{other}` is not a state of a VNF"))),
            },
            detail: row.0.text()?,
        }),
        Kind::Decision => Event::Decision(Decision {
            plugin: row.name::<PluginId>()?,
            instruction: decode_instruction(&mut row)?,
            reason: row.0.text()?,
            refused: row.0.text()?,
        }),
        Kind::PluginFault => Event::PluginFault { plugin: row.name()?, reason: row.text()? },
        Kind::Lateness => Event::Lateness(Lateness {
            frames: row.unsigned()?,
            p50_us: row.real()?,
            p99_us: row.real()?,
            max_us: row.real()?,
        }),
        Kind::Notice => Event::Notice { message: row.text()? },
    })
}

fn decode_instruction(row: &mut Columns<'_>) -> Result<Instruction> {
    let instruction = row.text()?;
    let subject: Arc<str> = required(row.0.name()?)?;
    let object: Option<NodeId> = row.optional_name()?;
    let velocity = Velocity { linear: row.real()?, angular: row.real()? };
    let waypoint = row.0.integer()?.and_then(|n| u32::try_from(n).ok());
    let direction = row.optional_direction()?;
    let change = row.0.text()?;

    let robot = || subject.parse::<NodeId>().map_err(unreadable);
    Ok(match instruction.as_str() {
        "move" => Instruction::Move { robot: robot()?, velocity, waypoint: required(waypoint)? },
        "scan" => Instruction::Scan { robot: robot()? },
        "attach" => Instruction::Attach { robot: robot()?, radio_unit: required(object)? },
        "place" => Instruction::Place { vnf: subject.parse().map_err(unreadable)?, node: required(object)? },
        "condition" => Instruction::Condition {
            link: subject.parse().map_err(unreadable)?,
            direction,
            change: json(&required(change)?)?,
        },
        other => return Err(unreadable(format_args!("`{other}` is not an instruction"))),
    })
}

/// Reads conditions.
pub(crate) fn decode_conditions(source: &mut dyn Source) -> Result<Conditions> {
    let mut row = Columns(source);
    let delay = required(row.duration()?)?;
    let deviation = row.duration()?;
    let distribution = match row.0.text()?.as_deref() {
        None => None,
        Some("uniform") => Some(JitterDistribution::Uniform),
        Some("normal") => Some(JitterDistribution::Normal),
        Some("pareto") => Some(JitterDistribution::Pareto),
        Some(other) => return Err(unreadable(format_args!("`{other}` is not a distribution"))),
    };
    let jitter =
        deviation.zip(distribution).map(|(deviation, distribution)| Jitter { deviation, distribution });
    let loss = match row.text()?.as_str() {
        "none" => {
            row.0.real()?;
            row.0.real()?;
            Loss::None
        }
        "independent" => {
            let rate = row.share()?;
            row.0.real()?;
            Loss::Independent { rate }
        }
        "bursty" => Loss::Bursty { rate: row.share()?, mean_burst: row.real()? },
        other => return Err(unreadable(format_args!("`{other}` is not a kind of loss"))),
    };
    let (duplication, corruption, reordering) = (row.share()?, row.share()?, row.share()?);
    let rate = match (row.0.integer()?, row.0.text()?) {
        (_, Some(trace)) => Rate::Trace { trace: Arc::new(json::<Trace>(&trace)?) },
        (Some(rate), None) => Rate::Fixed {
            bits_per_second: BitRate::from_bits_per_second(rate.cast_unsigned())
                .ok_or_else(|| unreadable("a rate is zero"))?,
        },
        (None, None) => Rate::Unlimited,
    };
    let queue = match (row.0.integer()?, row.0.integer()?) {
        (Some(packets), _) => QueueLimit::Packets(
            u32::try_from(packets)
                .map_err(|_| unreadable(format_args!("{packets} packets are out of range")))?,
        ),
        (None, Some(bytes)) => QueueLimit::Bytes(bytes.cast_unsigned()),
        (None, None) => return Err(unreadable("a queue has no limit")),
    };
    Ok(Conditions { delay, jitter, loss, duplication, corruption, reordering, rate, queue })
}
