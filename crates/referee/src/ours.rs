//! Our side: a run in virtual time, and the scenario that has ns-3 send the same at the same times.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use cotorra_fabric::sensitivity;
use cotorra_graph::{
    Codel, Conditions, Direction, Event, FixedRate, Link, NodeId, NodeKind, Pie, QueueDiscipline, QueueLimit,
    Rate, RateControl, Red, RedThresholds, SensorKind, Service, ServiceTime, Stamped, Testbed, Timestamp,
    TrafficSource, WifiStandard, WirelessNetwork,
};
use cotorra_testbed::{Altered, RunError, Unrecorded, simulate_unrecorded};

use crate::{
    Carried, Measured, Run,
    plain::{load, serves, stations},
    scenario::{BEFORE, Network, Queue, RadioUnit, Robot, Scenario, Sender, Traffic, Wire},
};

/// Requests of the first second do not count: ns-3 looks for addresses, and rates begin at the slowest.
const SETTLING: Duration = Duration::from_secs(1);
/// Requests so near to a handover or a scan do not count.
const NEAR: Duration = Duration::from_millis(250);
/// Bytes of a position packet without the robot's name, of its answer, of a scan of 360 beams without the name, and of its
/// answer. A test compares them with what is sent.
const POSITION: u32 = 92;
const NAVIGATION: u32 = 84;
const SCAN: u32 = 870;
const POSE: u32 = 104;
/// Bytes of an image in each datagram, and bytes before them without the names.
const FRAGMENT: u32 = 1280;
const BEFORE_FRAGMENT: u32 = 33;
/// Packets that a radio queues.
const RADIO_QUEUE: u32 = 1000;
/// Ages at which answers count no more: of commands, and of poses.
const COMMANDS: f64 = 0.6;
const POSES: f64 = 3.0;
/// Rate of a wire without a limit, bit/s.
const UNLIMITED: u64 = 100_000_000_000;
/// Thermal noise over 20 MHz at 290 K, dBm.
const THERMAL_NOISE: f64 = -100.965;

/// Our run, and the scenario for the other side.
#[derive(Debug, Clone, PartialEq)]
pub struct Ours {
    /// What was measured.
    pub run: Run,
    /// The same for ns-3.
    pub scenario: Scenario,
    /// What is compared together.
    pub(crate) groups: Vec<Group>,
    /// Numbers of requests that do not count, by sender.
    pub(crate) uncounted: BTreeMap<String, BTreeSet<u32>>,
}

/// Services and robots whose figures are compared together: those whose robots send images, and the others. What one of
/// many robots meets depends too much on chance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Group {
    pub(crate) name: String,
    pub(crate) services: Vec<String>,
    pub(crate) robots: Vec<String>,
    /// Sources of traffic.
    pub(crate) sources: Vec<String>,
}

/// Runs a testbed in virtual time up to `until`. Returns `None` if `go_on` said to stop.
///
/// # Errors
/// [`RunError`] of the run.
pub fn ours(
    testbed: &Arc<Testbed>,
    text: &str,
    seed: u64,
    until: Duration,
    go_on: impl FnMut() -> bool,
) -> Result<Option<Ours>, RunError> {
    let mut seen = Seen::new(testbed);
    let folder = std::env::temp_dir().join(format!("cotorra-referee-{}-{seed}", std::process::id()));
    let altered = Altered::default();
    let run = Unrecorded { seed, until: Some(until), altered: &altered, folder: &folder, text };
    let ended = simulate_unrecorded(Arc::clone(testbed), &run, |event| seen.absorb(event), go_on)?;
    Ok(ended.map(|ended| seen.conclude(testbed, until, &ended.summary.traffic)))
}

/// What a run showed of what its robots sent.
struct Seen {
    samples: BTreeMap<String, Vec<ServiceTime>>,
    /// Times of images by robot and sensor.
    images: BTreeMap<(NodeId, String), Vec<Timestamp>>,
    places: BTreeMap<NodeId, Vec<[f64; 4]>>,
    attachments: BTreeMap<NodeId, Vec<(Timestamp, NodeId)>>,
    /// Beginnings and ends of what takes robots off their channels.
    away: BTreeMap<NodeId, Vec<[Timestamp; 2]>>,
    bytes: BTreeMap<String, u64>,
    scans: BTreeMap<NodeId, Duration>,
}

impl Seen {
    fn new(testbed: &Testbed) -> Self {
        let mut places = BTreeMap::new();
        let mut scans = BTreeMap::new();
        for (node, robot) in testbed.graph.robots() {
            let place = testbed.walk(&node.id).map(|walk| walk.waypoints[0]).or(node.position);
            let place = place.unwrap_or_default();
            places.insert(node.id.clone(), vec![[0.0, place.x, place.y, place.z]]);
            if let Some(network) = testbed.graph.wireless.get(&robot.network) {
                let handover = &network.handover;
                let back = handover.visits.map_or(Duration::ZERO, |visits| {
                    visits.back * (handover.scan.as_nanos() / visits.dwell.as_nanos().max(1)) as u32
                });
                scans.insert(node.id.clone(), (handover.scan + back).mul_f64(1.0 + handover.variation));
            }
        }
        Self {
            samples: BTreeMap::new(),
            images: BTreeMap::new(),
            places,
            attachments: BTreeMap::new(),
            away: BTreeMap::new(),
            bytes: BTreeMap::new(),
            scans,
        }
    }

    fn absorb(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::ServiceTime(sample) => {
                self.samples.entry(sample.service.to_string()).or_default().push(sample.clone());
            }
            Event::Sensor(reading) if reading.data.is_some() => {
                let key = (reading.robot.clone(), reading.sensor.to_string());
                self.images.entry(key).or_default().push(*at);
            }
            Event::Robot(context) => {
                let pose = &context.sensors.pose;
                let places = self.places.entry(context.robot.clone()).or_default();
                if places.last().is_none_or(|last| last[0] < at.as_secs_f64()) {
                    places.push([at.as_secs_f64(), pose.x, pose.y, pose.z]);
                }
                let attached = context.attachments.iter().find(|attachment| attachment.attached);
                let attachments = self.attachments.entry(context.robot.clone()).or_default();
                if let (true, Some(attached)) = (attachments.is_empty(), attached) {
                    attachments.push((Timestamp::ZERO, attached.radio_unit.clone()));
                }
            }
            Event::Handover(handover) => {
                let attachments = self.attachments.entry(handover.robot.clone()).or_default();
                attachments.push((*at, handover.to.clone()));
                self.is_away(&handover.robot, *at, handover.gap);
            }
            Event::Scanned { robot } => {
                let scan = self.scans.get(robot).copied().unwrap_or_default();
                self.is_away(robot, *at, scan);
            }
            Event::Link(context) if context.direction == Direction::Forward => {
                self.bytes.insert(context.link.to_string(), context.counters.bytes);
            }
            _ => {}
        }
    }

    fn is_away(&mut self, robot: &NodeId, at: Timestamp, time: Duration) {
        let from = Timestamp::ZERO + at.since(Timestamp::ZERO).saturating_sub(time + NEAR);
        self.away.entry(robot.clone()).or_default().push([from, at + NEAR]);
    }

    fn conclude(self, testbed: &Testbed, until: Duration, carried: &[cotorra_traffic::Measured]) -> Ours {
        let mut run = Run::default();
        let mut senders = Vec::new();
        let mut uncounted = BTreeMap::new();
        for service in &testbed.services {
            let name = service.id.to_string();
            let Some(samples) = self.samples.get(&name).filter(|_| service.kpis.flow.is_none()) else {
                continue;
            };
            let away = self.away.get(&service.robot).map_or(&[][..], Vec::as_slice);
            let counts = |sample: &ServiceTime| {
                sample.emitted >= Timestamp::ZERO + SETTLING
                    && !away.iter().any(|[from, to]| (*from..=*to).contains(&sample.emitted))
            };
            // Answers come in any order.
            let mut samples: Vec<_> = samples.iter().collect();
            samples.sort_by_key(|sample| sample.emitted);
            let numbered = || samples.iter().zip(0..);
            let skipped: BTreeSet<u32> =
                numbered().filter(|(sample, _)| !counts(sample)).map(|(_, number)| number).collect();
            let took_ms = numbered()
                .filter_map(|(sample, number)| Some((number, sample.took?.as_secs_f64() * 1e3)))
                .collect();
            let sent = samples.len() as u32;
            senders.push(request_sender(service, &samples));
            run.senders.insert(name.clone(), Measured { took_ms, sent });
            uncounted.insert(name, skipped);
        }
        for (node, robot) in testbed.graph.robots() {
            for sensor in &robot.sensors {
                let SensorKind::Camera(camera) = &sensor.kind else { continue };
                let Some(to) = &camera.to else { continue };
                let Some(vnf) = testbed.vnfs().find(|vnf| vnf.id == *to) else { continue };
                let Some(times) = self.images.get(&(node.id.clone(), sensor.id.to_string())) else {
                    continue;
                };
                let pixel = if camera.format == cotorra_graph::DataFormat::Rgb8 { 3 } else { 1 };
                let bytes = u32::from(camera.width) * u32::from(camera.height) * pixel;
                let names = (node.id.as_str().len() + sensor.id.as_str().len()) as u32;
                let datagram = |bytes: u32| BEFORE_FRAGMENT + names + bytes;
                let mut datagrams = vec![datagram(FRAGMENT); (bytes / FRAGMENT) as usize];
                datagrams.extend((bytes % FRAGMENT != 0).then(|| datagram(bytes % FRAGMENT)));
                senders.push(Sender {
                    name: format!("{}/{}", node.id, sensor.id),
                    robot: node.id.to_string(),
                    servers: vec![(0.0, vnf.node.all()[0].to_string())],
                    times_s: times.iter().map(|time| BEFORE + time.as_secs_f64()).collect(),
                    datagrams,
                    answer_bytes: None,
                    processing_s: 0.0,
                    timeout_s: 0.0,
                });
            }
            let links = format!("{}~", node.id);
            let bytes: u64 =
                self.bytes.iter().filter(|(link, _)| link.starts_with(&links)).map(|(_, bytes)| bytes).sum();
            run.mbps.insert(node.id.to_string(), bytes as f64 * 8e-6 / until.as_secs_f64());
        }
        run.traffic = carried.iter().map(|carried| (carried.source.to_string(), arrived(carried))).collect();
        let groups = groups(testbed, &senders);
        let scenario = self.scenario(testbed, until, senders);
        Ours { run, scenario, groups, uncounted }
    }

    fn scenario(&self, testbed: &Testbed, until: Duration, senders: Vec<Sender>) -> Scenario {
        let graph = &testbed.graph;
        let used: BTreeSet<&str> =
            self.attachments.values().flatten().map(|(_, unit)| unit.as_str()).collect();
        let units =
            || graph.radio_units().filter(|(node, _)| serves(&node.kind) && used.contains(node.id.as_str()));
        let mut servers: BTreeSet<String> =
            senders.iter().flat_map(|sender| &sender.servers).map(|(_, server)| server.clone()).collect();
        let traffic: Vec<_> = testbed.traffic.iter().filter_map(|source| traffic(source, until)).collect();
        let is_server =
            |name: &NodeId| matches!(graph.node(name).map(|node| &node.kind), Some(NodeKind::Server(_)));
        let ends = || testbed.traffic.iter().flat_map(|source| [&source.from, &source.to]);
        servers.extend(ends().filter(|end| is_server(end)).map(NodeId::to_string));
        let senders_on_wires =
            testbed.traffic.iter().map(|source| &source.from).filter(|from| is_server(from));
        let mut paths = Vec::new();
        for from in units().map(|(unit, _)| &unit.id).chain(senders_on_wires.collect::<BTreeSet<_>>()) {
            paths.extend(servers.iter().filter_map(|server| path(testbed, from, server)));
        }
        let robots = graph.robots().map(|(node, robot)| Robot {
            name: node.id.to_string(),
            tx_power_dbm: robot.tx_power.0,
            places: self.places[&node.id].iter().map(|[t, x, y, z]| [t + BEFORE, *x, *y, *z]).collect(),
            attachments: self.attachments.get(&node.id).map_or_else(Vec::new, |all| {
                let starts = |time: Timestamp| {
                    if time == Timestamp::ZERO { 0.0 } else { BEFORE + time.as_secs_f64() }
                };
                all.iter().map(|(time, unit)| (starts(*time), unit.to_string())).collect()
            }),
        });
        let units: Vec<_> = units()
            .map(|(node, unit)| {
                let place = node.position.unwrap_or_default();
                let (channel, primary) = wide_channel(&graph.wireless[&unit.network], unit.channel);
                RadioUnit {
                    name: node.id.to_string(),
                    network: unit.network.clone(),
                    channel,
                    primary,
                    position: [place.x, place.y, place.z],
                    tx_power_dbm: unit.tx_power.0,
                }
            })
            .collect();
        let networks = graph.wireless.iter().map(|(name, network)| {
            let mut units = graph.radio_units().filter(|(_, unit)| unit.network == *name);
            let channel = units.next().map_or(1, |(_, unit)| unit.channel);
            air(name, network, channel)
        });
        Scenario {
            until_s: BEFORE + until.as_secs_f64(),
            radio_queue: RADIO_QUEUE,
            networks: networks.collect(),
            wires: graph.links.iter().map(wire).collect(),
            paths,
            servers: servers.into_iter().collect(),
            robots: robots.collect(),
            radio_units: units,
            senders,
            traffic,
        }
    }
}

/// Returns the groups: by whether robots send images, and by the kind of service.
fn groups(testbed: &Testbed, senders: &[Sender]) -> Vec<Group> {
    let sends_images =
        |robot: &str| senders.iter().any(|sender| sender.robot == robot && sender.answer_bytes.is_none());
    let mut groups = Vec::new();
    for (images, of) in [(true, "with images"), (false, "without images")] {
        for localizes in [false, true] {
            let services = testbed.services.iter().filter(|service| {
                service.localizes() == localizes
                    && sends_images(service.robot.as_str()) == images
                    && senders.iter().any(|sender| sender.name == service.id.as_str())
            });
            let services: Vec<_> = services.collect();
            let name = match &services[..] {
                [] => continue,
                [one] => one.id.to_string(),
                many if localizes => format!("{} robots {of}, localization", many.len()),
                many => format!("{} robots {of}", many.len()),
            };
            let robots =
                if localizes { Vec::new() } else { services.iter().map(|s| s.robot.to_string()).collect() };
            let services = services.iter().map(|s| s.id.to_string()).collect();
            groups.push(Group { name, services, robots, sources: Vec::new() });
        }
    }
    groups.extend(groups_of_sources(testbed));
    groups
}

/// Returns the groups of sources of traffic: those with the same load between the same servers or wireless networks.
fn groups_of_sources(testbed: &Testbed) -> Vec<Group> {
    let place = |end| match testbed.graph.node(end).map(|node| &node.kind) {
        Some(NodeKind::Robot(robot)) => robot.network.as_str(),
        _ => NodeId::as_str(end),
    };
    let mut alike: Vec<(_, Vec<&TrafficSource>)> = Vec::new();
    for source in &testbed.traffic {
        let kind = (&source.load, place(&source.from), place(&source.to));
        match alike.iter_mut().find(|(other, _)| *other == kind) {
            Some((_, sources)) => sources.push(source),
            None => alike.push((kind, vec![source])),
        }
    }
    let groups = alike.into_iter().map(|(_, sources)| Group {
        name: match &sources[..] {
            [one] => one.id.to_string(),
            many => format!("{} to {}", many[0].id, many[many.len() - 1].id),
        },
        sources: sources.iter().map(|source| source.id.to_string()).collect(),
        ..Group::default()
    });
    groups.collect()
}

/// Returns a source of traffic for ns-3; `None` if ns-3 has none like it.
fn traffic(source: &TrafficSource, until: Duration) -> Option<Traffic> {
    Some(Traffic {
        name: source.id.to_string(),
        from: source.from.to_string(),
        to: source.to.to_string(),
        start_s: BEFORE + source.start.as_secs_f64(),
        stop_s: BEFORE + source.stop.map_or(until, |stop| stop.min(until)).as_secs_f64(),
        load: load(source)?,
    })
}

/// Returns what we compare of a source of traffic.
fn arrived(carried: &cotorra_traffic::Measured) -> Carried {
    Carried {
        mbps: carried.goodput_bps * 1e-6,
        lost: carried
            .udp
            .as_ref()
            .map(|udp| 100.0 * udp.lost as f64 / (carried.sent_packets as f64).max(1.0)),
        delay_ms: carried.udp.as_ref().and_then(|udp| udp.delay_ms),
    }
}

fn request_sender(service: &Service, samples: &[&ServiceTime]) -> Sender {
    let name = service.robot.as_str().len() as u32;
    let (request, answer, timeout_s) =
        if service.localizes() { (SCAN, POSE, POSES) } else { (POSITION, NAVIGATION, COMMANDS) };
    let mut servers: Vec<(f64, String)> = Vec::new();
    for sample in samples {
        if servers.last().is_none_or(|(_, server)| *server != sample.server.as_str()) {
            servers.push((BEFORE + sample.emitted.as_secs_f64(), sample.server.to_string()));
        }
    }
    let serving = service.vnfs.iter().find(|vnf| vnf.program.serves_robots());
    let processing = serving.and_then(|vnf| Some(vnf.image.as_deref()?.processing)).unwrap_or_default();
    Sender {
        name: service.id.to_string(),
        robot: service.robot.to_string(),
        servers,
        times_s: samples.iter().map(|sample| BEFORE + sample.emitted.as_secs_f64()).collect(),
        datagrams: vec![request + name],
        answer_bytes: Some(answer),
        processing_s: processing.as_secs_f64(),
        timeout_s,
    }
}

/// Returns the number of a channel of the network's width, and the place of its primary channel of 20 MHz, from below.
fn wide_channel(network: &WirelessNetwork, primary: u8) -> (u8, u8) {
    let [low, high] = network.standard.span_mhz(primary, network.width);
    let centre = network.standard.frequency_mhz(primary);
    // Channel numbers count steps of 5 MHz.
    let above = ((low + high) / 2).saturating_sub(centre) / 5;
    let below = centre.saturating_sub((low + high) / 2) / 5;
    (primary + above as u8 - below as u8, ((centre - low) / 20) as u8)
}

fn air(name: &str, network: &WirelessNetwork, channel: u8) -> Network {
    let frequency_mhz = network.standard.frequency_mhz(channel);
    let loss = |metres| network.path_loss.loss_db(metres, frequency_mhz);
    let (rate_control, aggregation) = stations(network);
    let (rate_control, mode) = match rate_control {
        RateControl::Ideal => (Some("ideal"), None),
        RateControl::Minstrel => (Some("minstrel"), None),
        RateControl::Fixed(rate) => (None, Some(mode(network.standard, rate))),
    };
    Network {
        name: name.to_owned(),
        standard: match network.standard {
            WifiStandard::G => "g",
            WifiStandard::A => "a",
            WifiStandard::N => "n",
            WifiStandard::Ac => "ac",
            WifiStandard::Ax => "ax",
        },
        is_5ghz: frequency_mhz > 5000,
        width_mhz: network.width.mhz(),
        streams: network.streams,
        guard_interval_ns: network.guard_interval.ns(),
        exponent: (loss(10.0) - loss(1.0)) / 10.0,
        reference_db: loss(1.0),
        noise_figure_db: network.noise_floor.0 - THERMAL_NOISE,
        sensitivity_dbm: sensitivity(network).0,
        rate_control,
        mode,
        aggregation,
    }
}

/// Returns ns-3's name of the mode of a fixed rate.
fn mode(standard: WifiStandard, rate: FixedRate) -> String {
    match (standard, rate) {
        (WifiStandard::N, FixedRate::Mcs(mcs)) => format!("HtMcs{mcs}"),
        (WifiStandard::Ac, FixedRate::Mcs(mcs)) => format!("VhtMcs{mcs}"),
        (_, FixedRate::Mcs(mcs)) => format!("HeMcs{mcs}"),
        (WifiStandard::G, FixedRate::BitsPerSecond(rate)) => format!("ErpOfdmRate{}Mbps", rate.mbps()),
        (_, FixedRate::BitsPerSecond(rate)) => format!("OfdmRate{}Mbps", rate.mbps()),
    }
}

fn wire(link: &Link) -> Wire {
    let Conditions { delay, rate, queue, queue_discipline, .. } = &link.forward;
    let (limit, in_bytes) = match queue {
        QueueLimit::Packets(packets) => (u64::from(*packets), false),
        QueueLimit::Bytes(bytes) => (*bytes, true),
    };
    Wire {
        ends: link.ends.each_ref().map(NodeId::to_string),
        rate_bps: match rate {
            Rate::Fixed { bits_per_second } => bits_per_second.bits_per_second(),
            _ => UNLIMITED,
        },
        delay_s: delay.as_secs_f64(),
        queue: Queue {
            discipline: match queue_discipline {
                QueueDiscipline::DropTail => "drop_tail",
                QueueDiscipline::Codel(_) => "codel",
                QueueDiscipline::FqCodel(_) => "fq_codel",
                QueueDiscipline::Pie(_) => "pie",
                QueueDiscipline::Red(_) => "red",
            },
            limit,
            in_bytes,
            attributes: attributes(*queue_discipline),
        },
    }
}

/// Returns the parameters of a queue discipline, as ns-3 names and writes them.
fn attributes(discipline: QueueDiscipline) -> BTreeMap<&'static str, String> {
    let ns = |time: Duration| format!("{}ns", time.as_nanos());
    let codel = |Codel { target, interval, ecn }| {
        [("Target", ns(target)), ("Interval", ns(interval)), ("UseEcn", ecn.to_string())]
    };
    match discipline {
        QueueDiscipline::DropTail => BTreeMap::new(),
        QueueDiscipline::Codel(parameters) => codel(parameters).into(),
        QueueDiscipline::FqCodel(parameters) => {
            codel(parameters.codel()).into_iter().chain([("Flows", parameters.flows.to_string())]).collect()
        }
        QueueDiscipline::Pie(Pie { target, update, burst, ecn }) => [
            ("QueueDelayReference", ns(target)),
            ("Tupdate", ns(update)),
            ("MaxBurstAllowance", ns(burst)),
            ("UseEcn", ecn.to_string()),
            ("UseDerandomization", true.to_string()),
            ("UseCapDropAdjustment", true.to_string()),
        ]
        .into(),
        QueueDiscipline::Red(Red { thresholds, probability, weight, ecn }) => {
            let (min, max) = match thresholds {
                RedThresholds::Packets { min, max } => (u64::from(min), u64::from(max)),
                RedThresholds::Bytes { min, max } => (min, max),
            };
            [
                ("MinTh", min.to_string()),
                ("MaxTh", max.to_string()),
                // ns-3 has the inverse of max_p.
                ("LInterm", (1.0 / probability.get()).to_string()),
                ("QW", weight.get().to_string()),
                ("UseEcn", ecn.to_string()),
            ]
            .into()
        }
    }
}

/// Returns the nodes from a radio unit to a server, on the path of least delay.
fn path(testbed: &Testbed, unit: &NodeId, server: &str) -> Option<Vec<String>> {
    let to = testbed.graph.nodes.iter().find(|node| node.id == *server)?;
    let route = testbed.graph.route(unit, &to.id, |_| None)?;
    let mut nodes = vec![unit.clone()];
    for link in &route.links {
        let link = testbed.graph.link(link)?;
        let here = nodes.last()?;
        let next = link.ends.iter().find(|end| *end != here)?.clone();
        nodes.push(next);
    }
    (nodes.len() > 1 && matches!(to.kind, NodeKind::Server(_)))
        .then(|| nodes.iter().map(NodeId::to_string).collect())
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{BitRate, Pose, PoseSource, Velocity};
    use cotorra_plugin::{
        convert::{to_pose, to_twist},
        wire::{self, HEADER_LEN, NavigationPacket, PosePacket, PositionPacket, ScanPacket},
    };

    use super::*;

    /// Returns the bytes that a packet has.
    fn bytes(encode: impl FnOnce(&mut Vec<u8>)) -> u32 {
        let mut buffer = Vec::new();
        encode(&mut buffer);
        buffer.len() as u32
    }

    #[test]
    fn datagrams_are_as_long_as_those_that_robots_send() {
        let robot: NodeId = "robot".parse().unwrap();
        let pose = Pose::planar(1.0, 2.0, 0.5, [0.0; 9], PoseSource::Odometry);
        let position = PositionPacket {
            sequence: 1,
            emitted: Timestamp::ZERO,
            nonce: 1,
            waypoint: 0,
            goal: None,
            robot: robot.clone(),
            pose: to_pose(&pose),
        };
        let name = robot.as_str().len() as u32;
        assert_eq!(bytes(|buffer| position.encode(buffer)), POSITION + name);
        let answer = NavigationPacket::answering(&position, 0, to_twist(Velocity::planar(0.0, 0.0)));
        assert_eq!(bytes(|buffer| answer.encode(buffer)), NAVIGATION);
        let scan = ScanPacket {
            sequence: 1,
            emitted: Timestamp::ZERO,
            nonce: 1,
            robot,
            odometry: [0.0; 3],
            sweep: [0.0; 3],
            believed: pose,
            since: None,
            first_angle: 0.0,
            angle_step: 0.0,
            ranges: vec![0; 360],
        };
        assert_eq!(bytes(|buffer| scan.encode(buffer)), SCAN + name);
        let answer = PosePacket { sequence: 1, emitted: Timestamp::ZERO, nonce: 1, pose };
        assert_eq!(bytes(|buffer| answer.encode(buffer)), POSE);
        assert_eq!((FRAGMENT, BEFORE_FRAGMENT), (wire::FRAGMENT as u32, HEADER_LEN as u32 + 1));
    }

    #[test]
    fn ns3_gets_its_own_names_of_fixed_rates() {
        use WifiStandard::{A, Ac, Ax, G, N};
        let mbps = |mbps| FixedRate::BitsPerSecond(BitRate::from_mbps(mbps).unwrap());
        let names = [
            mode(A, mbps(24.0)),
            mode(G, mbps(9.0)),
            mode(N, FixedRate::Mcs(15)),
            mode(Ac, FixedRate::Mcs(9)),
            mode(Ax, FixedRate::Mcs(11)),
        ];
        assert_eq!(names, ["OfdmRate24Mbps", "ErpOfdmRate9Mbps", "HtMcs15", "VhtMcs9", "HeMcs11"]);
    }

    #[test]
    fn ns3_gets_the_parameters_of_queues() {
        let codel = Codel { target: Duration::from_millis(20), ..Default::default() };
        let given = attributes(QueueDiscipline::Codel(codel));
        assert_eq!((&*given["Target"], &*given["Interval"]), ("20000000ns", "100000000ns"));
        let red = attributes(QueueDiscipline::Red(Red::default()));
        assert_eq!((&*red["LInterm"], &*red["MaxTh"]), ("50", "15"));
        assert!(attributes(QueueDiscipline::DropTail).is_empty());
    }
}
