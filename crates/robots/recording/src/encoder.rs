//! Encodes the events of a testbed as ROS 2 messages on topics, once for the file and for live viewers. It has no clock,
//! no file and no socket.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{
    Direction, Event, Handover, LinkContext, NodeId, Position, Program, RadioContext, RobotContext, Service,
    ServiceTime, Stamped, Testbed, Timestamp, VnfId, millis,
};
use cotorra_plugin::convert::to_header;
use cotorra_robot_middleware::{SensedScan, ros};
use cotorra_ros_messages::Message;

use crate::{
    channel::{Channels, Encoded, Names, Qos},
    frames::Frames,
    log, markers, messages,
};

/// Reserved first parts of topics.
const RESERVED: &[&str] = &["radio_units", "network", "emulation"];

/// Receiver of encoded messages.
pub(crate) type Out<'a> = &'a mut dyn FnMut(Encoded<'_>);

/// Encodes the events and scans of one run.
pub(crate) struct Encoder {
    testbed: Arc<Testbed>,
    channels: Channels,
    nodes: Names,
    links: Names,
    robots: BTreeMap<NodeId, Robot>,
    radio_units: BTreeMap<NodeId, Position>,
    placements: BTreeMap<VnfId, NodeId>,
}

/// State of a robot.
struct Robot {
    number: usize,
    /// First part of its topics.
    topic: String,
    frames: Frames,
    navigation: Option<VnfId>,
    last: Option<ServiceTime>,
}

impl Encoder {
    pub fn new(testbed: Arc<Testbed>) -> Self {
        let mut nodes = Names::without(RESERVED);
        let robots = testbed.graph.robots().enumerate().map(|(number, (node, _))| {
            let topic = nodes.token(&node.id).to_owned();
            let services = testbed.services.iter().filter(|service| service.robot == node.id);
            let navigation =
                services.flat_map(|service| &service.vnfs).find(|v| v.program == Program::Navigation);
            let navigation = navigation.map(|vnf| vnf.id.clone());
            let frames = Frames::of(&topic);
            (node.id.clone(), Robot { number, topic, frames, navigation, last: None })
        });
        let robots = robots.collect();
        let radio_units = testbed.graph.radio_units();
        let radio_units =
            radio_units.filter_map(|(node, _)| Some((node.id.clone(), node.position?))).collect();
        let (channels, links, placements) = (Channels::default(), Names::without(&[]), BTreeMap::new());
        Self { testbed, channels, nodes, links, robots, radio_units, placements }
    }

    /// Encodes the map and the fixed parts of the testbed.
    pub fn begin(&mut self, out: Out<'_>) {
        let at = Timestamp::ZERO;
        let testbed = Arc::clone(&self.testbed);
        if let Some(grid) = &testbed.map {
            out(self.channels.encode("/map", Qos::Latched, at, &markers::map(grid)));
        }
        out(self.channels.encode("/testbed", Qos::Latched, at, &markers::standing(&testbed)));
    }

    /// Encodes an event.
    pub fn event(&mut self, Stamped { at, event }: &Stamped, out: Out<'_>) {
        let at = *at;
        match event {
            Event::Robot(context) => self.robot(at, context, out),
            Event::Radio(context) => self.radio(at, context, out),
            Event::Link(context) => self.link(at, context, out),
            Event::ServiceTime(sample) => self.service_time(at, sample, out),
            Event::Handover(handover) => self.handover(at, handover, out),
            Event::Placement(placement) => {
                self.placements.insert(placement.vnf.clone(), placement.node.first().clone());
                let mut nodes = placement.node.all().iter().map(ToString::to_string);
                let (vnf, node) = (placement.vnf.to_string(), nodes.next().unwrap_or_default());
                let others = nodes.collect();
                let message = messages::Placement { header: to_header(at, ""), vnf, node, others };
                self.tell("/placement", at, &message, out);
            }
            Event::VirtualLink(mapping) => {
                let message = messages::VirtualLink {
                    header: to_header(at, ""),
                    from_vnf: mapping.from.to_string(),
                    to_vnf: mapping.to.to_string(),
                    links: mapping.links.iter().map(ToString::to_string).collect(),
                    path: mapping.path.as_str().to_owned(),
                };
                self.tell("/virtual_links", at, &message, out);
            }
            Event::Decision(decision) => {
                let instruction = serde_json::to_string(&decision.instruction);
                let message = messages::Decision {
                    header: to_header(at, ""),
                    plugin: decision.plugin.to_string(),
                    instruction: instruction.expect("an instruction holds only what JSON can"),
                    reason: decision.reason.clone().unwrap_or_default(),
                    refused: decision.refused.clone().unwrap_or_default(),
                };
                self.tell("/decisions", at, &message, out);
            }
            Event::Lateness(lateness) => {
                let message = messages::Lateness {
                    header: to_header(at, ""),
                    frames: lateness.frames,
                    p50_us: lateness.p50_us,
                    p99_us: lateness.p99_us,
                    max_us: lateness.max_us,
                };
                self.tell("/emulation/lateness", at, &message, out);
            }
            _ => {}
        }
        if let Some(line) = log::line(at, event) {
            self.tell("/rosout", at, &line, out);
        }
        if let Some(diagnostics) = log::diagnostics(at, event) {
            self.tell("/diagnostics", at, &diagnostics, out);
        }
    }

    /// Encodes a turn of a robot's lidar.
    pub fn scan(&mut self, sensed: &SensedScan, out: Out<'_>) {
        let Some(robot) = self.robots.get(&sensed.robot) else { return };
        let mut scan = ros::laser_scan(&sensed.scan);
        robot.frames.own(&mut scan.header.frame_id);
        let topic = format!("/{}/scan", robot.topic);
        out(self.channels.encode(&topic, Qos::Sensor, sensed.at, &scan));
    }

    fn robot(&mut self, at: Timestamp, context: &RobotContext, out: Out<'_>) {
        let Some(robot) = self.robots.get(&context.robot) else { return };
        let Robot { topic, frames, .. } = robot;
        let sensors = &context.sensors;
        out(self.channels.encode("/tf", Qos::Default, at, &frames.transforms(at, sensors)));
        let mut odometry = ros::odometry(at, sensors);
        frames.own(&mut odometry.header.frame_id);
        frames.own(&mut odometry.child_frame_id);
        out(self.channels.encode(&format!("/{topic}/odom"), Qos::Default, at, &odometry));
        let pose = ros::localized(at, sensors);
        out(self.channels.encode(&format!("/{topic}/amcl_pose"), Qos::Default, at, &pose));
        let attachment = |a: &cotorra_graph::Attachment| messages::Attachment {
            radio_unit: a.radio_unit.to_string(),
            attached: a.attached,
            signal_dbm: a.signal.map_or(f64::NAN, |signal| signal.0),
        };
        let message = messages::RobotContext {
            header: to_header(at, &frames.base()),
            robot: context.robot.to_string(),
            attached_to: text(context.attached_to()),
            attachments: context.attachments.iter().map(attachment).collect(),
            waypoint: context.waypoint,
            bumper: sensors.bumper,
            nearest_obstacle_m: sensors.nearest_obstacle_m.unwrap_or(f64::NAN),
            health: context.health.iter().map(ToString::to_string).collect(),
            speed_limit_mps: context.speed_limit_mps.unwrap_or(f64::NAN),
            localization_error_m: context.localization_error_m.unwrap_or(f64::NAN),
        };
        out(self.channels.encode(&format!("/{topic}/context"), Qos::Default, at, &message));
        let label = self.label(robot, context);
        let markers = markers::robot(robot.number, context, &self.radio_units, &label);
        out(self.channels.encode("/markers", Qos::Default, at, &markers));
    }

    /// Returns the label of a robot: its name, radio unit, server, and last service time.
    fn label(&self, robot: &Robot, context: &RobotContext) -> String {
        let attached = context.attached_to().map_or("no radio unit", |unit| unit.as_str());
        let mut words = format!("{}: {attached}", context.robot);
        let server = robot.navigation.as_ref().and_then(|vnf| self.placements.get(vnf));
        words.extend(server.map(|server| format!(", {server}")));
        if let Some(sample) = &robot.last {
            let took = sample.took.map(|took| format!(", {:.1} ms", millis::of(took)));
            words += &took.unwrap_or_else(|| ", no answer".to_owned());
        }
        words
    }

    fn service_time(&mut self, at: Timestamp, sample: &ServiceTime, out: Out<'_>) {
        let Some(robot) = self.robots.get_mut(&sample.robot) else { return };
        let is_other = |service: &Service| service.id == sample.service && !service.navigates();
        if !self.testbed.services.iter().any(is_other) {
            robot.last = Some(sample.clone());
        }
        let message = messages::ServiceTime {
            header: to_header(sample.emitted, &robot.frames.base()),
            service: sample.service.to_string(),
            robot: sample.robot.to_string(),
            sequence: sample.sequence,
            service_time_ms: sample.took.map_or(f64::NAN, millis::of),
            attached_to: text(sample.attachment.as_ref()),
            server: sample.server.to_string(),
        };
        out(self.channels.encode(&format!("/{}/service_time", robot.topic), Qos::Default, at, &message));
    }

    fn handover(&mut self, at: Timestamp, handover: &Handover, out: Out<'_>) {
        let Some(robot) = self.robots.get(&handover.robot) else { return };
        let message = messages::Handover {
            header: to_header(at, &robot.frames.base()),
            robot: handover.robot.to_string(),
            from_radio_unit: text(handover.from.as_ref()),
            to_radio_unit: handover.to.to_string(),
            fast: handover.fast,
            gap_ms: millis::of(handover.gap),
        };
        out(self.channels.encode(&format!("/{}/handover", robot.topic), Qos::Default, at, &message));
    }

    fn radio(&mut self, at: Timestamp, context: &RadioContext, out: Out<'_>) {
        let station = |station: &cotorra_graph::StationContext| messages::Station {
            robot: station.robot.to_string(),
            signal_dbm: station.signal.0,
            downlink_bps: station.downlink_bps,
            uplink_bps: station.uplink_bps,
        };
        let message = messages::RadioContext {
            header: to_header(at, ""),
            radio_unit: context.radio_unit.to_string(),
            channel: context.channel,
            load: context.load.unwrap_or(f64::NAN),
            stations: context.stations.iter().map(station).collect(),
        };
        let topic = format!("/radio_units/{}", self.nodes.token(&context.radio_unit));
        self.tell(&topic, at, &message, out);
    }

    fn link(&mut self, at: Timestamp, context: &LinkContext, out: Out<'_>) {
        let direction = match context.direction {
            Direction::Forward => "forward",
            Direction::Backward => "backward",
        };
        let counters = &context.counters;
        let (probed, tested) = (&context.probed, &context.tested);
        let message = messages::LinkContext {
            header: to_header(at, ""),
            link: context.link.to_string(),
            direction: direction.to_owned(),
            delay_ms: context.delay.map_or(f64::NAN, millis::of),
            throughput_bps: context.throughput_bps,
            queued_packets: context.queued_packets.map_or(f64::NAN, |packets| packets as f64),
            probed_delay_ms: probed.and_then(|probed| probed.delay).map_or(f64::NAN, millis::of),
            probed_jitter_ms: probed.and_then(|probed| probed.jitter).map_or(f64::NAN, millis::of),
            probed_delay_age_ms: probed.and_then(|probed| probed.delay_age).map_or(f64::NAN, millis::of),
            probed_loss: probed.and_then(|probed| probed.loss).unwrap_or(f64::NAN),
            probed_loss_age_ms: probed.map_or(f64::NAN, |probed| millis::of(probed.loss_age)),
            tested_throughput_bps: tested.map_or(f64::NAN, |tested| tested.throughput_bps),
            tested_offered_bps: tested.map_or(f64::NAN, |tested| tested.offered_bps),
            tested_age_ms: tested.map_or(f64::NAN, |tested| millis::of(tested.age)),
            delay_scale: context.scale.delay_scale,
            drop_scale: context.scale.drop_scale,
            asked_delay_ms: millis::of(context.asked.delay),
            effective_delay_ms: millis::of(context.effective.delay),
            packets: counters.packets,
            bytes: counters.bytes,
            lost: counters.lost,
            overflowed: counters.overflowed,
            duplicated: counters.duplicated,
            corrupted: counters.corrupted,
        };
        let topic = format!("/network/{}/{direction}", self.links.token(&context.link));
        self.tell(&topic, at, &message, out);
    }

    fn tell<M: Message>(&mut self, topic: &str, at: Timestamp, message: &M, out: Out<'_>) {
        out(self.channels.encode(topic, Qos::Default, at, message));
    }
}

/// Returns a name, or empty text.
fn text(name: Option<&NodeId>) -> String {
    name.map(ToString::to_string).unwrap_or_default()
}
