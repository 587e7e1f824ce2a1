//! Converts rows to events.

mod machine;

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    AnswersRejected, Attachment, BitRate, ComponentId, Conditions, Correlation, DataFormat, Dbm, Decision,
    Direction, Event, GoalEvent, GoalState, Handover, Instruction, Jitter, JitterDistribution, LargeData,
    Lateness, LinkContext, LinkCounters, LinkId, LinkTime, Loss, NodeId, Nodes, PathKind, Placement,
    PluginId, Pose, PoseSource, Position, Probability, Probed, QueueLimit, RadioContext, Rate, RobotContext,
    RobotFault, Scale, SensorData, SensorReading, ServiceId, ServiceTime, StationContext, StationCounts,
    Tested, TimeParts, Timestamp, Trace, Velocity, VirtualLinkMapping, VnfEvent, VnfId, VnfState, millis,
};

use super::{
    direction_of,
    heard::Heard,
    read_error::{ReadError, unreadable},
    time_parts,
};
use crate::kind::Kind;

/// A row that is read column by column, from the first to the last.
pub(crate) trait Source {
    fn integer(&mut self) -> Result<Option<i64>>;
    fn real(&mut self) -> Result<Option<f64>>;
    fn text(&mut self) -> Result<Option<String>>;
    fn name(&mut self) -> Result<Option<Arc<str>>>;
    fn conditions(&mut self) -> Result<Conditions>;
    fn heard(&mut self) -> Result<Option<Heard>>;
    /// Calls `read` with each of the row's child rows, in their order.
    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source) -> Result<()>) -> Result<()>;
}

type Result<T> = std::result::Result<T, ReadError>;

fn required<T>(value: Option<T>) -> Result<T> {
    value.ok_or_else(|| unreadable("a required column is NULL"))
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

fn milliseconds(ms: f64) -> Result<Duration> {
    millis::duration(ms).map_err(unreadable)
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
        required(self.optional_small()?)
    }

    fn real(&mut self) -> Result<f64> {
        Ok(self.0.real()?.unwrap_or(f64::NAN))
    }

    fn share(&mut self) -> Result<Probability> {
        let share = self.real()?;
        Probability::new(share).ok_or_else(|| unreadable(format_args!("{share} is not a share")))
    }

    fn optional_small<T: TryFrom<i64>>(&mut self) -> Result<Option<T>> {
        let Some(n) = self.0.integer()? else { return Ok(None) };
        n.try_into().map(Some).map_err(|_| unreadable(format_args!("{n} is out of its column's range")))
    }

    fn boolean(&mut self) -> Result<bool> {
        Ok(self.integer()? != 0)
    }

    fn duration(&mut self) -> Result<Option<Duration>> {
        self.0.real()?.map(milliseconds).transpose()
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

    fn faults(&mut self) -> Result<Vec<RobotFault>> {
        let text = self.0.text()?.unwrap_or_default();
        let fault = |word| RobotFault::ALL.into_iter().find(|fault| fault.as_str() == word);
        text.split_whitespace()
            .map(|word| {
                fault(word).ok_or_else(|| unreadable(format_args!("`{word}` is not a fault of a robot")))
            })
            .collect()
    }

    /// Reads probed values. Every probe with a result has the age of the loss.
    fn probed(&mut self) -> Result<Option<Probed>> {
        let [delay, jitter, delay_age] = [self.duration()?, self.duration()?, self.duration()?];
        let (loss, loss_age) = (self.0.real()?, self.duration()?);
        Ok(loss_age.map(|loss_age| Probed { delay, jitter, delay_age, loss, loss_age }))
    }

    /// Reads large data, which has every column, while other readings have none.
    fn large_data(&mut self) -> Result<Option<LargeData>> {
        let Some(sequence) = self.0.integer()? else {
            self.0.text()?;
            self.0.integer()?;
            self.0.integer()?;
            self.0.integer()?;
            return Ok(None);
        };
        let format = self.text()?;
        let known = DataFormat::ALL.into_iter().find(|known| known.as_str() == format);
        Ok(Some(LargeData {
            sequence: sequence.cast_unsigned(),
            format: known.ok_or_else(|| unreadable(format_args!("`{format}` is not a format of data")))?,
            width: self.small()?,
            height: self.small()?,
            bytes: self.unsigned()?,
        }))
    }

    fn tested(&mut self) -> Result<Option<Tested>> {
        let (throughput_bps, offered_bps) = (self.real()?, self.real()?);
        Ok(self.duration()?.map(|age| Tested { throughput_bps, offered_bps, age }))
    }

    /// Reads the part of a pose outside the plane.
    fn height(&mut self, pose: &mut Pose) -> Result<()> {
        (pose.z, pose.roll, pose.pitch) = (self.real()?, self.real()?, self.real()?);
        Ok(())
    }

    /// Reads the part of a pose in the plane.
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
        Ok(Pose::planar(x, y, heading, covariance, source))
    }
}

/// Reads an event of a kind that happened at a time.
pub(crate) fn decode(kind: Kind, at: Timestamp, source: &mut dyn Source) -> Result<Event> {
    let mut row = Columns(source);
    Ok(match kind {
        Kind::Robot => {
            let robot: NodeId = row.name()?;
            let waypoint = row.small()?;
            let mut sensors = SensorData {
                pose: row.pose()?,
                odometry: row.pose()?,
                velocity: Velocity::planar(row.real()?, row.real()?),
                bumper: row.boolean()?,
                nearest_obstacle_m: row.0.real()?,
            };
            let health = row.faults()?;
            row.height(&mut sensors.pose)?;
            row.height(&mut sensors.odometry)?;
            sensors.velocity.vertical = row.real()?;
            let (speed_limit_mps, localization_error_m) = (row.0.real()?, row.0.real()?);
            let heard = row.0.heard()?;
            let attachments = children(source, |mut row| {
                Ok(Attachment {
                    radio_unit: row.name()?,
                    attached: row.boolean()?,
                    signal: row.0.real()?.map(Dbm),
                    age: row.duration()?,
                })
            })?;
            let attachments = match heard {
                Some(heard) => heard.complete(at, attachments),
                None => attachments,
            };
            Event::Robot(RobotContext {
                robot,
                attachments,
                sensors,
                waypoint,
                health,
                speed_limit_mps,
                localization_error_m,
            })
        }
        Kind::Radio => {
            let (radio_unit, channel, load) = (row.name()?, row.small()?, row.0.real()?);
            let stations = children(source, |mut row| {
                Ok(StationContext {
                    robot: row.name()?,
                    signal: Dbm(row.real()?),
                    downlink_bps: row.real()?,
                    uplink_bps: row.real()?,
                    counted: StationCounts {
                        retransmissions: row.optional_small()?,
                        transmissions_failed: row.optional_small()?,
                        transmit_airtime: row.duration()?,
                        receive_airtime: row.duration()?,
                    },
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
            probed: row.probed()?,
            tested: row.tested()?,
            queued_packets: row.0.integer()?.map(i64::cast_unsigned),
        }),
        Kind::Placement => {
            let (vnf, first) = (row.name()?, row.name()?);
            let mut nodes = vec![first];
            nodes.extend(children(source, |mut row| row.name::<NodeId>())?);
            Event::Placement(Placement { vnf, node: Nodes::new(nodes).map_err(unreadable)? })
        }
        Kind::VirtualLink => {
            let (from, to): (VnfId, VnfId) = (row.name()?, row.name()?);
            let path = match row.0.text()? {
                None => PathKind::default(),
                Some(path) => PathKind::ALL
                    .into_iter()
                    .find(|kind| kind.as_str() == path)
                    .ok_or_else(|| unreadable(format_args!("`{path}` is not a kind of path")))?,
            };
            let others = row.0.text()?.as_deref().map(json).transpose()?.unwrap_or_default();
            let links = children(source, |mut row| row.name::<LinkId>())?;
            Event::VirtualLink(VirtualLinkMapping { from, to, links, path, others })
        }
        Kind::ServiceTime => {
            let mut sample = ServiceTime {
                service: row.name::<ServiceId>()?,
                robot: row.name()?,
                sequence: row.small()?,
                emitted: Timestamp::from_nanos(row.unsigned()?),
                took: row.duration()?,
                attachment: row.optional_name()?,
                server: row.name()?,
                parts: None,
                lost_at: row.0.text()?.as_deref().map(json).transpose()?,
            };
            sample.parts = time_parts_of(source)?;
            Event::ServiceTime(sample)
        }
        Kind::Handover => Event::Handover(Handover {
            robot: row.name()?,
            from: row.optional_name()?,
            to: row.name()?,
            fast: row.boolean()?,
            gap: required(row.duration()?)?,
        }),
        Kind::Detached => Event::Detached { robot: row.name()?, from: row.name()? },
        Kind::Scanned => Event::Scanned { robot: row.name()? },
        Kind::SuggestionAnswered => {
            Event::SuggestionAnswered { robot: row.name()?, radio_unit: row.name()?, status: row.small()? }
        }
        Kind::AnswersRejected => Event::AnswersRejected(AnswersRejected {
            robot: row.name()?,
            late: row.unsigned()?,
            forged: row.unsigned()?,
            repeated: row.unsigned()?,
            unknown: row.unsigned()?,
            invalid: row.unsigned()?,
            redundant: row.unsigned()?,
        }),
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
        Kind::Decision => {
            let (plugin, mut instruction) = (row.name::<PluginId>()?, decode_instruction(&mut row)?);
            let (reason, refused, vertical) = (row.0.text()?, row.0.text()?, row.0.real()?);
            if let Instruction::Move { velocity, .. } = &mut instruction {
                velocity.vertical = vertical.unwrap_or(f64::NAN);
            }
            Event::Decision(Decision { plugin, instruction, reason, refused })
        }
        Kind::Goal => {
            let (robot, goal) = (row.name()?, Position { x: row.real()?, y: row.real()?, z: row.real()? });
            let state = row.text()?;
            let known = GoalState::ALL.into_iter().find(|known| known.as_str() == state);
            let state =
                known.ok_or_else(|| unreadable(format_args!("`{state}` is not a state of a goal")))?;
            Event::Goal(GoalEvent { robot, goal, state, remaining_m: row.0.real()?, reason: row.0.text()? })
        }
        Kind::Sensor => {
            let (robot, sensor) = (row.name()?, row.name()?);
            let measured = Timestamp::from_nanos(row.unsigned()?);
            let data = row.large_data()?;
            let values = children(source, |mut row| Ok((row.name::<ComponentId>()?, row.real()?)))?;
            let values = values.into_iter().collect();
            Event::Sensor(SensorReading { robot, sensor, measured, values, data })
        }
        Kind::Machine => Event::Machine(machine::read(source)?),
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

/// Reads the parts of a service time; `None` without any.
fn time_parts_of(source: &mut dyn Source) -> Result<Option<Box<TimeParts>>> {
    let mut parts: Option<Box<TimeParts>> = None;
    let mut back = false;
    source.children(&mut |child| {
        let mut row = Columns(child);
        let parts = parts.get_or_insert_default();
        let part: Arc<str> = required(row.0.name()?)?;
        let direction = row.optional_direction()?;
        let total = required(row.duration()?)?;
        let [queueing, retries] = [row.duration()?, row.duration()?].map(Option::unwrap_or_default);
        let Some(direction) = direction else {
            back |= time_parts::is_turn(&part);
            let is_known = time_parts::set_host(parts, &part, total);
            let error = || unreadable(format_args!("`{part}` is not a part of a service time"));
            return is_known.then_some(()).ok_or_else(error);
        };
        let crossing = total.checked_sub(queueing).and_then(|left| left.checked_sub(retries));
        let crossing = crossing.ok_or_else(|| unreadable("the parts of a link's time exceed it"))?;
        let link = part.parse::<LinkId>().map_err(unreadable)?;
        parts.links.push(LinkTime { link, direction, back, queueing, retries, crossing });
        Ok(())
    })?;
    Ok(parts)
}

fn decode_instruction(row: &mut Columns<'_>) -> Result<Instruction> {
    let instruction = row.text()?;
    let subject: Arc<str> = required(row.0.name()?)?;
    let object: Option<Arc<str>> = row.0.name()?;
    let linear = row.0.real()?;
    let velocity = Velocity::planar(linear.unwrap_or(f64::NAN), row.real()?);
    let waypoint = row.0.integer()?.and_then(|n| u32::try_from(n).ok());
    let direction = row.optional_direction()?;
    let change = row.0.text()?;

    let robot = || subject.parse::<NodeId>().map_err(unreadable);
    let node = || required(object.as_deref())?.parse::<NodeId>().map_err(unreadable);
    Ok(match instruction.as_str() {
        "move" => Instruction::Move { robot: robot()?, velocity, waypoint: required(waypoint)? },
        "limit_speed" => Instruction::LimitSpeed { robot: robot()?, speed_limit_mps: linear },
        "navigate_to" => {
            Instruction::NavigateTo { robot: robot()?, goal: change.as_deref().map(json).transpose()? }
        }
        "report" => Instruction::Report {
            robot: robot()?,
            sensor: required(object.as_deref())?.parse().map_err(unreadable)?,
            values: json(&required(change)?)?,
        },
        "scan" => Instruction::Scan { robot: robot()? },
        "attach" => Instruction::Attach { robot: robot()?, radio_unit: node()? },
        "suggest" => Instruction::Suggest { robot: robot()?, radio_unit: node()? },
        "place" => {
            let several = change.as_deref().map(json).transpose()?;
            let node = several.map_or_else(|| node().map(Into::into), Ok)?;
            Instruction::Place { vnf: subject.parse().map_err(unreadable)?, node }
        }
        "add_vnf" => Instruction::AddVnf { vnf: json(&required(change)?)? },
        "remove_vnf" => Instruction::RemoveVnf { vnf: subject.parse().map_err(unreadable)? },
        "map" => Instruction::Map { from: robot()?, to: node()?, links: json(&required(change)?)? },
        "test_throughput" => Instruction::TestThroughput {
            link: subject.parse().map_err(unreadable)?,
            direction: required(direction)?,
            test: json(&required(change)?)?,
        },
        "condition" => Instruction::Condition {
            link: subject.parse().map_err(unreadable)?,
            direction,
            change: json(&required(change)?)?,
        },
        "deploy" => Instruction::Deploy { radio_unit: robot()?, access_point: json(&required(change)?)? },
        "remove" => Instruction::Remove { radio_unit: robot()? },
        "provision" => Instruction::Provision {
            robot: robot()?,
            radio_unit: node()?,
            access_point: json(&required(change)?)?,
        },
        "halt" => Instruction::Halt { robot: robot()? },
        "go" => Instruction::Go { robot: robot()? },
        "note" => Instruction::Note {
            process: subject.to_string(),
            step: required(object)?.to_string(),
            ago: change.as_deref().map(json).transpose()?.map(milliseconds).transpose()?,
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
        (_, Some(name)) if name.starts_with('{') => Rate::NamedTrace(json(&name)?),
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
    let queue_discipline = row.0.text()?.as_deref().map(json).transpose()?.unwrap_or_default();
    let correlation = match row.0.real()? {
        None => Correlation::NONE,
        Some(correlation) => Correlation::new(correlation)
            .ok_or_else(|| unreadable(format_args!("{correlation} is not a correlation")))?,
    };
    let rate = match (rate, row.0.text()?) {
        (Rate::Trace { trace }, Some(file)) => {
            Rate::Trace { trace: Arc::new(Arc::unwrap_or_clone(trace).in_file(file)) }
        }
        (rate, _) => rate,
    };
    let jitter = deviation.zip(distribution);
    let jitter = jitter.map(|(deviation, distribution)| Jitter { deviation, distribution, correlation });
    Ok(Conditions { delay, jitter, loss, duplication, corruption, reordering, rate, queue, queue_discipline })
}
