//! Converts events to rows.

use std::{borrow::Cow, time::Duration};

use cotorra_graph::{
    AccessPoint, AnswersRejected, Conditions, Direction, Event, GoalEvent, Instruction, InterfaceContext,
    InterfaceTraffic, JitterDistribution, Loss, MachineContext, Pose, PoseSource, QueueLimit, Rate,
    RobotFault, SensorReading, Stamped, VnfState, millis,
};

use super::{
    Role, Value, direction_code,
    heard::{Heard, is_written},
    time_parts::{self, Row},
};

/// Columns of one row, or of several child rows one after the other.
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
        self.real(millis::of(duration))
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

    /// Adds the part of a pose outside the plane.
    fn height(&mut self, pose: &Pose) -> &mut Self {
        self.real(pose.z).real(pose.roll).real(pose.pitch)
    }

    /// Adds the part of a pose in the plane.
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

/// Writes an event's columns into `row`, and those of its child rows into `children`.
pub(crate) fn encode<'a>(stamped: &'a Stamped, row: &mut Fields<'a>, children: &mut Fields<'a>) {
    match &stamped.event {
        Event::Robot(context) => {
            let sensors = &context.sensors;
            row.name(context.robot.as_str())
                .integer(context.waypoint.into())
                .pose(&sensors.pose)
                .pose(&sensors.odometry)
                .real(sensors.velocity.linear)
                .real(sensors.velocity.angular)
                .integer(sensors.bumper.into())
                .optional(sensors.nearest_obstacle_m, Fields::real)
                .optional(faults(&context.health), Fields::text)
                .height(&sensors.pose)
                .height(&sensors.odometry)
                .real(sensors.velocity.vertical)
                .optional(context.speed_limit_mps, Fields::real)
                .optional(context.localization_error_m, Fields::real)
                .optional(Heard::of(stamped.at, &context.attachments), |row, heard| {
                    row.0.push(Value::Heard(heard));
                    row
                });
            for attachment in context.attachments.iter().filter(|attachment| is_written(attachment)) {
                children
                    .name(attachment.radio_unit.as_str())
                    .integer(attachment.attached.into())
                    .optional(attachment.signal, |f, signal| f.real(signal.0))
                    .optional(attachment.age, Fields::duration);
            }
        }
        Event::Radio(context) => {
            row.name(context.radio_unit.as_str())
                .integer(context.channel.into())
                .optional(context.load, Fields::real);
            for station in &context.stations {
                children
                    .name(station.robot.as_str())
                    .real(station.signal.0)
                    .real(station.downlink_bps)
                    .real(station.uplink_bps)
                    .optional(station.counted.retransmissions, |f, count| f.integer(count.into()))
                    .optional(station.counted.transmissions_failed, |f, count| f.integer(count.into()))
                    .optional(station.counted.transmit_airtime, Fields::duration)
                    .optional(station.counted.receive_airtime, Fields::duration);
            }
        }
        Event::Link(context) => {
            row.name(context.link.as_str())
                .direction(context.direction)
                .optional(context.delay, Fields::duration)
                .real(context.throughput_bps)
                .real(context.scale.delay_scale)
                .real(context.scale.drop_scale);
            row.0.push(Value::Conditions(Role::Asked, &context.asked));
            row.0.push(Value::Conditions(Role::Effective, &context.effective));
            let counters = &context.counters;
            row.unsigned(counters.packets)
                .unsigned(counters.bytes)
                .unsigned(counters.lost)
                .unsigned(counters.overflowed)
                .unsigned(counters.duplicated)
                .unsigned(counters.corrupted);
            let (probed, tested) = (&context.probed, &context.tested);
            row.optional(probed.and_then(|probed| probed.delay), Fields::duration)
                .optional(probed.and_then(|probed| probed.jitter), Fields::duration)
                .optional(probed.and_then(|probed| probed.delay_age), Fields::duration)
                .optional(probed.and_then(|probed| probed.loss), Fields::real)
                .optional(probed.map(|probed| probed.loss_age), Fields::duration)
                .optional(tested.map(|tested| tested.throughput_bps), Fields::real)
                .optional(tested.map(|tested| tested.offered_bps), Fields::real)
                .optional(tested.map(|tested| tested.age), Fields::duration)
                .optional(context.queued_packets, Fields::unsigned);
        }
        Event::Placement(placement) => {
            row.name(placement.vnf.as_str()).name(placement.node.first().as_str());
            for node in &placement.node.all()[1..] {
                children.name(node.as_str());
            }
        }
        Event::VirtualLink(mapping) => {
            row.name(mapping.from.as_str()).name(mapping.to.as_str()).text(mapping.path.as_str());
            let others = Some(&mapping.others).filter(|others| !others.is_empty());
            row.optional(others, |row, others| {
                row.text(serde_json::to_string(others).expect("names are JSON"))
            });
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
                .name(time.server.as_str())
                .optional(time.lost_at.as_deref(), |row, lost_at| {
                    row.text(serde_json::to_string(lost_at).expect("names are JSON"))
                });
            for part in time.parts.iter().flat_map(|parts| time_parts::rows(parts)) {
                match part {
                    Row::Host(name, took) => {
                        children.name(name);
                        children.0.push(Value::Null);
                        children.duration(took);
                        children.0.extend([Value::Null, Value::Null]);
                    }
                    Row::Link(on) => {
                        let some = |took: Duration| (!took.is_zero()).then_some(took);
                        children
                            .name(on.link.as_str())
                            .direction(on.direction)
                            .duration(on.total())
                            .optional(some(on.queueing), Fields::duration)
                            .optional(some(on.retries), Fields::duration);
                    }
                }
            }
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
        Event::SuggestionAnswered { robot, radio_unit, status } => {
            row.name(robot.as_str()).name(radio_unit.as_str()).integer((*status).into());
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
            let moved = match &decision.instruction {
                Instruction::Move { velocity, .. } => Some(velocity.vertical),
                _ => None,
            };
            row.optional(moved, Fields::real);
        }
        Event::Goal(GoalEvent { robot, goal, state, remaining_m, reason }) => {
            row.name(robot.as_str())
                .real(goal.x)
                .real(goal.y)
                .real(goal.z)
                .text(state.as_str())
                .optional(*remaining_m, Fields::real)
                .optional(reason.as_deref(), Fields::text);
        }
        Event::Sensor(SensorReading { robot, sensor, measured, values, data }) => {
            row.name(robot.as_str()).name(sensor.as_str()).unsigned(measured.as_nanos());
            row.optional(data.as_ref(), |row, data| row.unsigned(data.sequence))
                .optional(data.as_ref(), |row, data| row.text(data.format.as_str()))
                .optional(data.as_ref(), |row, data| row.integer(data.width.into()))
                .optional(data.as_ref(), |row, data| row.integer(data.height.into()))
                .optional(data.as_ref(), |row, data| row.unsigned(data.bytes));
            for (component, value) in values {
                children.name(component.as_str()).real(*value);
            }
        }
        Event::Machine(context) => encode_machine(context, row, children),
        Event::PluginFault { plugin, reason } => {
            row.name(plugin.as_str()).text(reason.as_str());
        }
        Event::Lateness(lateness) => {
            row.unsigned(lateness.frames).real(lateness.p50_us).real(lateness.p99_us).real(lateness.max_us);
        }
        Event::Notice { message } => {
            row.text(message.as_str());
        }
        Event::AnswersRejected(counts) => {
            let AnswersRejected { robot, late, forged, repeated, redundant, unknown, invalid } = counts;
            row.name(robot.as_str());
            for count in [late, forged, repeated, unknown, invalid, redundant] {
                row.unsigned(*count);
            }
        }
    }
}

fn encode_machine<'a>(context: &'a MachineContext, row: &mut Fields<'a>, children: &mut Fields<'a>) {
    let MachineContext {
        node,
        reading,
        cpu,
        load_average,
        memory,
        interfaces,
        interfaces_left_out,
        wifi,
        wifi_left_out,
    } = context;
    row.name(node.as_str())
        .optional(*cpu, |row, cpu| row.integer(cpu.cpus.into()))
        .optional(cpu.and_then(|cpu| cpu.busy), |row, busy| row.real(busy.get()))
        .optional(*load_average, |row, load| row.real(load.one_minute))
        .optional(*load_average, |row, load| row.real(load.five_minutes))
        .optional(*load_average, |row, load| row.real(load.fifteen_minutes))
        .optional(*memory, |row, memory| row.unsigned(memory.memory_bytes))
        .optional(*memory, |row, memory| row.unsigned(memory.available_bytes))
        .integer((*interfaces_left_out).into())
        .integer((*wifi_left_out).into())
        .optional(Some(wifi).filter(|wifi| !wifi.is_empty()), |row, wifi| {
            row.text(serde_json::to_string(wifi).expect("texts and numbers are JSON"))
        })
        .optional(*reading, |row, reading| row.unsigned(reading.measured.as_nanos()))
        .optional(*reading, |row, reading| row.duration(reading.error));
    for InterfaceContext { name, up, carrier, speed, mtu_bytes, received, sent } in interfaces {
        children
            .name(name)
            .integer((*up).into())
            .integer((*carrier).into())
            .optional(*speed, |row, speed| row.unsigned(speed.bits_per_second()))
            .integer((*mtu_bytes).into());
        for InterfaceTraffic { packets, bytes, errors, dropped, throughput_bps } in [received, sent] {
            children
                .unsigned(*packets)
                .unsigned(*bytes)
                .unsigned(*errors)
                .unsigned(*dropped)
                .optional(*throughput_bps, Fields::real);
        }
    }
}

/// Returns faults as words with spaces between; `None` without any.
fn faults(health: &[RobotFault]) -> Option<String> {
    let words: Vec<_> = health.iter().map(|fault| fault.as_str()).collect();
    (!words.is_empty()).then(|| words.join(" "))
}

fn encode_instruction<'a>(instruction: &'a Instruction, row: &mut Fields<'a>) {
    let mut put = |instruction: &'static str, subject: &'a str, object: Option<&'a str>| {
        row.text(instruction).name(subject).optional(object, Fields::name);
    };
    // The columns that follow: linear, angular, waypoint, direction, change.
    match instruction {
        Instruction::Move { robot, velocity, waypoint } => {
            put("move", robot.as_str(), None);
            row.real(velocity.linear).real(velocity.angular).integer((*waypoint).into());
            row.0.extend([Value::Null, Value::Null]);
        }
        Instruction::LimitSpeed { robot, speed_limit_mps } => {
            put("limit_speed", robot.as_str(), None);
            row.optional(*speed_limit_mps, Fields::real);
            row.0.extend([const { Value::Null }; 4]);
        }
        Instruction::NavigateTo { robot, goal } => {
            put("navigate_to", robot.as_str(), None);
            row.0.extend([const { Value::Null }; 4]);
            row.optional(goal.as_ref(), |row, goal| {
                row.text(serde_json::to_string(goal).expect("finite numbers are JSON"))
            });
        }
        Instruction::Report { robot, sensor, values } => {
            put("report", robot.as_str(), Some(sensor.as_str()));
            row.0.extend([const { Value::Null }; 4]);
            row.text(serde_json::to_string(values).expect("finite numbers are JSON"));
        }
        Instruction::Scan { robot } => {
            put("scan", robot.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Attach { robot, radio_unit } => {
            put("attach", robot.as_str(), Some(radio_unit.as_str()));
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Suggest { robot, radio_unit } => {
            put("suggest", robot.as_str(), Some(radio_unit.as_str()));
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Place { vnf, node } => {
            put("place", vnf.as_str(), Some(node.first().as_str()));
            row.0.extend([const { Value::Null }; 4]);
            let several = Some(node).filter(|node| node.only().is_none());
            row.optional(several, |row, nodes| {
                row.text(serde_json::to_string(nodes).expect("names are JSON"))
            });
        }
        Instruction::AddVnf { vnf } => {
            put("add_vnf", vnf.id.as_str(), Some(vnf.node.first().as_str()));
            row.0.extend([const { Value::Null }; 4]);
            row.text(serde_json::to_string(vnf).expect("a VNF has no map keys that are not text"));
        }
        Instruction::RemoveVnf { vnf } => {
            put("remove_vnf", vnf.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Map { from, to, links } => {
            put("map", from.as_str(), Some(to.as_str()));
            row.0.extend([const { Value::Null }; 4]);
            row.text(serde_json::to_string(links).expect("names are JSON"));
        }
        Instruction::TestThroughput { link, direction, test } => {
            put("test_throughput", link.as_str(), None);
            row.0.extend([const { Value::Null }; 3]);
            let test = serde_json::to_string(test).expect("a test has no map keys that are not text");
            row.direction(*direction).text(test);
        }
        Instruction::Condition { link, direction, change } => {
            put("condition", link.as_str(), None);
            row.0.extend([const { Value::Null }; 3]);
            let change = serde_json::to_string(change).expect("a change has no map keys that are not text");
            row.optional(*direction, Fields::direction).text(change);
        }
        Instruction::Deploy { radio_unit, access_point } => {
            put("deploy", radio_unit.as_str(), None);
            row.0.extend([const { Value::Null }; 4]);
            row.text(access_point_json(access_point));
        }
        Instruction::Remove { radio_unit } => {
            put("remove", radio_unit.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Provision { robot, radio_unit, access_point } => {
            put("provision", robot.as_str(), Some(radio_unit.as_str()));
            row.0.extend([const { Value::Null }; 4]);
            row.text(access_point_json(access_point));
        }
        Instruction::Halt { robot } => {
            put("halt", robot.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Go { robot } => {
            put("go", robot.as_str(), None);
            row.0.extend([const { Value::Null }; 5]);
        }
        Instruction::Note { process, step, ago } => {
            put("note", process, Some(step));
            row.0.extend([const { Value::Null }; 4]);
            row.optional(*ago, |row, ago| row.text(millis::of(ago).to_string()));
        }
    }
}

/// Returns an access point as JSON, without its key, which must not reach a history.
fn access_point_json(access_point: &AccessPoint) -> String {
    serde_json::to_string(&access_point.public()).expect("an access point holds only what JSON can")
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
        Rate::NamedTrace(name) => {
            row.0.push(Value::Null);
            row.text(serde_json::to_string(name).expect("a name is JSON"));
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
    let discipline = Some(&conditions.queue_discipline).filter(|discipline| !discipline.is_drop_tail());
    row.optional(discipline, |row, discipline| {
        row.text(serde_json::to_string(discipline).expect("figures and words are JSON"))
    });
    let correlation = conditions.jitter.map(|jitter| jitter.correlation);
    row.optional(correlation.filter(|correlation| !correlation.is_none()), |row, correlation| {
        row.real(correlation.get())
    });
    let file = conditions.rate.trace_name().and_then(|name| name.file.as_deref());
    row.optional(file, |row, file| row.text(file.to_owned()));
}
