//! Strategies for events. They draw from a small set of names, so that several events belong to the same series.

mod drawn;
mod machine;

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    AccessPoint, Attachment, BitRate, Codel, ComponentId, ConditionChange, Conditions, ContextKind,
    Correlation, CorrelationTime, DataFormat, Dbm, Decision, Direction, Event, FqCodel, GoalEvent, GoalState,
    Image, InstancePath, Instruction, Jitter, JitterDistribution, LargeData, LinkContext, LinkCounters,
    LinkId, LinkTime, ListenPort, Loss, LostAt, LostCause, MapReservation, NodeId, Nodes, PathKind, Pie,
    Placement, PluginId, Pose, PoseSource, Position, Probability, Probed, Program, QueueDiscipline,
    QueueLimit, RadioContext, Rate, Red, RedThresholds, Reservations, Rights, RobotContext, RobotFault,
    Scale, SensorData, SensorId, SensorReading, ServiceId, ServiceTime, Staleness, Stamped, StationContext,
    StationCounts, Tested, ThroughputTest, TimeParts, Timestamp, Trace, Transport, Velocity,
    VirtualLinkMapping, Vnf, VnfEvent, VnfId, VnfState,
};
use proptest::{
    collection::{btree_map, vec},
    num::f64::{INFINITE, NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO},
    option::of,
    prelude::*,
    sample::{select, subsequence},
};

use crate::RunInfo;

pub fn run_info(name: &str) -> RunInfo {
    RunInfo {
        name: name.to_owned(),
        seed: u64::MAX,
        started_at_unix_ns: 1_800_000_000_000_000_000,
        testbed: "name: corridor\n".to_owned(),
    }
}

pub fn notice(at: u64, message: &str) -> Stamped {
    Stamped { at: Timestamp::from_nanos(at), event: Event::Notice { message: message.to_owned() } }
}

pub fn placement(at: u64, vnf: &str, node: &str) -> Stamped {
    let (vnf, node) = (VnfId::new(vnf).unwrap(), NodeId::new(node).unwrap());
    Stamped {
        at: Timestamp::from_nanos(at),
        event: Event::Placement(Placement { vnf, node: NodeId::into(node) }),
    }
}

/// Draws any number but NaN, which equals nothing.
fn real() -> impl Strategy<Value = f64> {
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO | INFINITE
}

fn finite() -> impl Strategy<Value = f64> {
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

fn share() -> impl Strategy<Value = Probability> {
    (0.0..=1.0).prop_map(|p| Probability::new(p).unwrap())
}

fn duration() -> impl Strategy<Value = Duration> {
    (0..=1_u64 << 51).prop_map(Duration::from_nanos)
}

/// Draws durations that survive the milliseconds of a [`ConditionChange`]'s JSON.
fn hours() -> impl Strategy<Value = Duration> {
    (0..1_000_000_000_000_u64).prop_map(Duration::from_nanos)
}

macro_rules! names {
    ($name:ident: $id:ident) => {
        fn $name() -> impl Strategy<Value = $id> {
            select(vec!["a", "b", "c~d", "9.x_y"]).prop_map(|name| $id::new(name).unwrap())
        }
    };
}
names!(node: NodeId);
names!(link: LinkId);
names!(vnf: VnfId);
names!(service: ServiceId);
names!(plugin: PluginId);
names!(sensor: SensorId);
names!(component: ComponentId);

fn direction() -> impl Strategy<Value = Direction> {
    select(vec![Direction::Forward, Direction::Backward])
}

prop_compose! {
    fn pose()(
        (x, y, z, roll, pitch, heading) in (real(), real(), real(), real(), real(), real()),
        covariance in proptest::array::uniform9(real()),
        source in select(vec![PoseSource::Simulator, PoseSource::Odometry, PoseSource::Localization]),
    ) -> Pose {
        Pose { x, y, z, roll, pitch, heading, covariance, source }
    }
}

fn velocity() -> impl Strategy<Value = Velocity> {
    (real(), real(), real()).prop_map(|(linear, vertical, angular)| Velocity { linear, vertical, angular })
}

prop_compose! {
    fn map_reservation()(
        kept in select(vec![Reservations::Counted, Reservations::Guaranteed, Reservations::Limited]),
        rate in of(1_u64..),
    ) -> MapReservation {
        MapReservation { kept, rate: rate.and_then(BitRate::from_bits_per_second) }
    }
}

prop_compose! {
    fn attachment()(
        radio_unit in node(),
        attached: bool,
        (signal, age) in (of(real().prop_map(Dbm)), of(0..1_000_000_000_000_u64)),
    ) -> Attachment {
        Attachment { radio_unit, attached, signal, age: signal.and(age).map(Duration::from_nanos) }
    }
}

/// Keeps one attachment to each radio unit.
fn each_once(mut attachments: Vec<Attachment>) -> Vec<Attachment> {
    attachments.sort_by(|a, b| a.radio_unit.cmp(&b.radio_unit));
    attachments.dedup_by(|a, b| a.radio_unit == b.radio_unit);
    attachments
}

prop_compose! {
    fn robot_context()(
        robot in node(),
        attachments in vec(attachment(), 0..4).prop_map(each_once),
        (pose, odometry, velocity) in (pose(), pose(), velocity()),
        bumper: bool,
        nearest_obstacle_m in of(real()),
        waypoint: u32,
        health in subsequence(RobotFault::ALL.to_vec(), 0..=RobotFault::ALL.len()),
        (speed_limit_mps, localization_error_m) in (of(finite()), of(finite())),
    ) -> RobotContext {
        let sensors = SensorData { pose, odometry, velocity, bumper, nearest_obstacle_m };
        RobotContext { robot, attachments, sensors, waypoint, health, speed_limit_mps, localization_error_m }
    }
}

prop_compose! {
    fn station()(
        robot in node(), signal in real().prop_map(Dbm), downlink_bps in real(), uplink_bps in real(),
        retransmissions in of(any::<u32>()), transmissions_failed in of(any::<u32>()),
        transmit_airtime in of(duration()), receive_airtime in of(duration()),
    ) -> StationContext {
        let counted =
            StationCounts { retransmissions, transmissions_failed, transmit_airtime, receive_airtime };
        StationContext { robot, signal, downlink_bps, uplink_bps, counted }
    }
}

prop_compose! {
    fn radio_context()(
        radio_unit in node(), channel: u8, load in of(real()), stations in vec(station(), 0..4),
    ) -> RadioContext {
        RadioContext { radio_unit, channel, load, stations }
    }
}

fn jitter(deviation: impl Strategy<Value = Duration>) -> impl Strategy<Value = Jitter> {
    let shapes = vec![JitterDistribution::Uniform, JitterDistribution::Normal, JitterDistribution::Pareto];
    (deviation, select(shapes), correlation(), of(1u64..60_000)).prop_map(
        |(deviation, distribution, correlation, over_ms)| Jitter {
            deviation,
            distribution,
            correlation,
            over: over_ms.map(Duration::from_millis).and_then(CorrelationTime::new),
        },
    )
}

fn correlation() -> impl Strategy<Value = Correlation> {
    let some = (-0.999..0.999).prop_map(|correlation| Correlation::new(correlation).unwrap());
    prop_oneof![Just(Correlation::NONE), some]
}

fn loss(mean_burst: impl Strategy<Value = f64>) -> impl Strategy<Value = Loss> {
    prop_oneof![
        Just(Loss::None),
        share().prop_map(|rate| Loss::Independent { rate }),
        (share(), mean_burst).prop_map(|(rate, mean_burst)| Loss::Bursty { rate, mean_burst }),
    ]
}

fn rate() -> impl Strategy<Value = Rate> {
    rate_by(of(prop_oneof![Just("air.trace".to_owned()), Just("ärea 51".to_owned())]))
}

/// Draws a rate, which may be a trace in such a file.
fn rate_by(file: impl Strategy<Value = Option<String>>) -> impl Strategy<Value = Rate> {
    let trace = (vec(1..1000_u64, 1..5), file).prop_map(|(mut times, file)| {
        times.sort_unstable();
        let trace = Trace::try_from(times).unwrap();
        Rate::Trace {
            trace: Arc::new(match file {
                Some(file) => trace.in_file(file),
                None => trace,
            }),
        }
    });
    let fixed = (1..=u64::MAX)
        .prop_map(|rate| Rate::Fixed { bits_per_second: BitRate::from_bits_per_second(rate).unwrap() });
    prop_oneof![Just(Rate::Unlimited), fixed, trace]
}

fn queue() -> impl Strategy<Value = QueueLimit> {
    prop_oneof![any::<u32>().prop_map(QueueLimit::Packets), any::<u64>().prop_map(QueueLimit::Bytes)]
}

fn codel() -> impl Strategy<Value = Codel> {
    (duration(), duration(), any::<bool>()).prop_map(|(target, interval, ecn)| Codel {
        target,
        interval,
        ecn,
    })
}

fn discipline() -> impl Strategy<Value = QueueDiscipline> {
    let fq = (codel(), any::<u32>(), any::<u32>()).prop_map(|(codel, flows, quantum)| {
        let Codel { target, interval, ecn } = codel;
        QueueDiscipline::FqCodel(FqCodel { target, interval, flows, quantum, ecn })
    });
    let pie = (duration(), duration(), duration(), any::<bool>())
        .prop_map(|(target, update, burst, ecn)| QueueDiscipline::Pie(Pie { target, update, burst, ecn }));
    let thresholds = prop_oneof![
        any::<(u32, u32)>().prop_map(|(min, max)| RedThresholds::Packets { min, max }),
        any::<(u64, u64)>().prop_map(|(min, max)| RedThresholds::Bytes { min, max }),
    ];
    let red =
        (thresholds, share(), share(), any::<bool>()).prop_map(|(thresholds, probability, weight, ecn)| {
            QueueDiscipline::Red(Red { thresholds, probability, weight, ecn })
        });
    prop_oneof![Just(QueueDiscipline::DropTail), codel().prop_map(QueueDiscipline::Codel), fq, pie, red]
}

prop_compose! {
    fn conditions()(
        delay in duration(),
        jitter in of(jitter(duration())),
        loss in loss(real()),
        (duplication, corruption, reordering) in (share(), share(), share()),
        rate in rate(),
        (queue, queue_discipline) in (queue(), discipline()),
    ) -> Conditions {
        Conditions { delay, jitter, loss, duplication, corruption, reordering, rate, queue, queue_discipline }
    }
}

/// Draws similar conditions, so that a link sometimes keeps them from one sample to the next, or changes a part.
fn similar_conditions() -> impl Strategy<Value = Conditions> {
    prop_oneof![
        2 => Just(Conditions::default()),
        1 => queue().prop_map(|queue| Conditions { queue, ..Conditions::default() }),
        1 => rate().prop_map(|rate| Conditions { rate, ..Conditions::default() }),
        1 => share().prop_map(|duplication| Conditions { duplication, ..Conditions::default() }),
        1 => conditions(),
    ]
}

prop_compose! {
    fn counters()(figures: [u64; 6]) -> LinkCounters {
        let [packets, bytes, lost, overflowed, duplicated, corrupted] = figures;
        LinkCounters { packets, bytes, lost, overflowed, duplicated, corrupted }
    }
}

prop_compose! {
    fn link_context()(
        (link, direction) in (link(), direction()),
        delay in of(duration()),
        throughput_bps in real(),
        // No figure of a longer queue is exact.
        queued_packets in of(0..1_u64 << 53),
        (asked, effective) in (similar_conditions(), similar_conditions()),
        (delay_scale, drop_scale) in (real(), real()),
        counters in counters(),
        probed in of(probed()),
        tested in of(tested()),
    ) -> LinkContext {
        let scale = Scale { delay_scale, drop_scale };
        LinkContext {
            link, direction, delay, throughput_bps, queued_packets, probed, tested, asked, scale, effective, counters,
        }
    }
}

prop_compose! {
    fn probed()(
        (delay, jitter, delay_age) in (of(duration()), of(duration()), of(duration())),
        loss in of(real()),
        loss_age in duration(),
    ) -> Probed {
        Probed { delay, jitter, delay_age, loss, loss_age }
    }
}

prop_compose! {
    fn tested()(throughput_bps in real(), offered_bps in real(), age in duration()) -> Tested {
        Tested { throughput_bps, offered_bps, age }
    }
}

prop_compose! {
    fn lost_at()(
        link in of(link()),
        back: bool,
        cause in select(vec![LostCause::Loss, LostCause::FullQueue, LostCause::NoAnswer, LostCause::Rejected]),
    ) -> LostAt {
        LostAt { link, back, cause }
    }
}

prop_compose! {
    fn service_time()(
        (service, robot, server) in (service(), node(), node()),
        sequence: u32,
        emitted in any::<u64>().prop_map(Timestamp::from_nanos),
        took in of(duration()),
        attachment in of(node()),
        parts in of(time_parts().prop_map(Box::new)),
        lost_at in of(lost_at().prop_map(Box::new)),
    ) -> ServiceTime {
        ServiceTime { service, robot, sequence, emitted, took, attachment, server, parts, lost_at }
    }
}

prop_compose! {
    fn link_time()(
        link in link(),
        direction in direction(),
        [queueing, retries, crossing] in [short(), short(), short()],
    ) -> LinkTime {
        LinkTime { link, direction, back: false, queueing, retries, crossing }
    }
}

prop_compose! {
    fn time_parts()(
        [sender, vnf, receiver, unknown] in [short(), short(), short(), short()],
        out in vec(link_time(), 0..3),
        back in vec(link_time(), 0..3),
    ) -> TimeParts {
        let back = back.into_iter().map(|on| LinkTime { back: true, ..on });
        TimeParts { sender, vnf, receiver, unknown, links: out.into_iter().chain(back).collect() }
    }
}

/// Draws a part of a service time.
fn part() -> impl Strategy<Value = String> {
    let hosts = select(vec!["sender", "vnf", "receiver", "unknown"]).prop_map(str::to_owned);
    prop_oneof![hosts, link().prop_map(|link| link.to_string())]
}

/// A duration that is exact in milliseconds even if three are added up.
fn short() -> impl Strategy<Value = Duration> {
    (0..1_u64 << 50).prop_map(|ns| Duration::from_nanos(if ns % 3 == 0 { 0 } else { ns }))
}

prop_compose! {
    fn change()(
        (delay_ms, delay_scale, drop_scale) in (of(finite()), of(finite()), of(finite())),
        jitter in of(jitter(hours())),
        loss in of(loss(finite())),
        (duplication, corruption, reordering) in (of(share()), of(share()), of(share())),
        (rate, queue, queue_discipline) in (of(rate_by(Just(None))), of(queue()), of(discipline())),
    ) -> ConditionChange {
        ConditionChange {
            delay_ms, jitter, loss, duplication, corruption, reordering, rate, queue, queue_discipline, delay_scale,
            drop_scale,
        }
    }
}

fn instruction() -> impl Strategy<Value = Instruction> {
    prop_oneof![
        (node(), velocity(), any::<u32>()).prop_map(|(robot, velocity, waypoint)| Instruction::Move {
            robot,
            velocity,
            waypoint
        }),
        (node(), of(finite()))
            .prop_map(|(robot, speed_limit_mps)| Instruction::LimitSpeed { robot, speed_limit_mps }),
        (node(), of(position(finite))).prop_map(|(robot, goal)| Instruction::NavigateTo { robot, goal }),
        (node(), sensor(), vec(finite(), 0..4)).prop_map(|(robot, sensor, values)| Instruction::Report {
            robot,
            sensor,
            values
        }),
        node().prop_map(|robot| Instruction::Scan { robot }),
        (node(), node()).prop_map(|(robot, radio_unit)| Instruction::Attach { robot, radio_unit }),
        (node(), node()).prop_map(|(robot, radio_unit)| Instruction::Suggest { robot, radio_unit }),
        (vnf(), nodes()).prop_map(|(vnf, node)| Instruction::Place { vnf, node }),
        added_vnf().prop_map(|vnf| Instruction::AddVnf { vnf: Box::new(vnf) }),
        vnf().prop_map(|vnf| Instruction::RemoveVnf { vnf }),
        (node(), node(), vec(link(), 0..4), of(map_reservation()))
            .prop_map(|(from, to, links, reservation)| Instruction::Map { from, to, links, reservation }),
        (link(), of(direction()), change()).prop_map(|(link, direction, change)| Instruction::Condition {
            link,
            direction,
            change
        }),
        (node(), access_point())
            .prop_map(|(radio_unit, access_point)| Instruction::Deploy { radio_unit, access_point }),
        node().prop_map(|radio_unit| Instruction::Remove { radio_unit }),
        (node(), node(), access_point()).prop_map(|(robot, radio_unit, access_point)| {
            Instruction::Provision { robot, radio_unit, access_point }
        }),
        node().prop_map(|robot| Instruction::Halt { robot }),
        node().prop_map(|robot| Instruction::Go { robot }),
        ("[a-z]{1,9}", "[a-z ]{1,9}", of(hours())).prop_map(|(process, step, ago)| Instruction::Note {
            process,
            step,
            ago
        }),
        (link(), direction(), hours(), of(any::<u64>())).prop_map(|(link, direction, duration, rate)| {
            let test = ThroughputTest { duration, rate_limit: rate.and_then(BitRate::from_bits_per_second) };
            Instruction::TestThroughput { link, direction, test }
        }),
    ]
}

/// Draws a VNF that a run can add.
fn added_vnf() -> impl Strategy<Value = Vnf> {
    let image = (0..100_u64, vec(1..u16::MAX, 0..3)).prop_map(|(seconds, ports)| {
        let port = |port| ListenPort { port, transport: Transport::Tcp };
        let ports = ports.into_iter().map(port).collect();
        Box::new(Image {
            reference: "a:1".to_owned(),
            ports,
            start: Duration::from_secs(seconds),
            ..Image::default()
        })
    });
    (vnf(), nodes(), 1..64_u32, of(image), vec("[A-Z]{1,4}=[ -~]{0,9}", 0..3)).prop_map(
        |(id, node, cpus, image, env)| Vnf {
            id,
            program: Program::Command(vec!["serve".to_owned()]),
            cpus: f64::from(cpus) / 4.0,
            memory_bytes: 1 << 20,
            pinned_to: node.only().cloned(),
            node,
            env,
            rights: Rights::default(),
            keep: false,
            image,
            cpu_limit: None,
            start: Duration::ZERO,
            computing: None,
            state: None,
        },
    )
}

/// Draws one node or several.
fn nodes() -> impl Strategy<Value = Nodes> {
    proptest::collection::btree_set(node(), 1..4)
        .prop_map(|nodes| Nodes::new(nodes.into_iter().rev().collect()).unwrap())
}

fn instance_path() -> impl Strategy<Value = InstancePath> {
    (node(), node(), vec(link(), 0..4), select(PathKind::ALL.to_vec()))
        .prop_map(|(from, to, links, path)| InstancePath { from, to, links, path })
}

fn access_point() -> impl Strategy<Value = AccessPoint> {
    (".{0,8}", any::<u16>()).prop_map(|(ssid, mobility_domain)| AccessPoint {
        ssid,
        mobility_domain,
        key: None,
        core: None,
    })
}

prop_compose! {
    fn decision()(
        plugin in plugin(), instruction in instruction(), reason in of(".*"), refused in of(".*"),
    ) -> Decision {
        Decision { plugin, instruction, reason, refused }
    }
}

fn vnf_event() -> impl Strategy<Value = VnfEvent> {
    let states = vec![VnfState::Started, VnfState::Died, VnfState::Stopped, VnfState::Failed];
    (vnf(), node(), select(states), of(".*")).prop_map(|(vnf, node, state, detail)| VnfEvent {
        vnf,
        node,
        state,
        detail,
    })
}

prop_compose! {
    fn staleness()(
        plugin in plugin(), kind in select(ContextKind::ALL.to_vec()), contexts: u32,
        (youngest, oldest) in (duration(), duration()),
    ) -> Staleness {
        Staleness { plugin, kind, contexts, youngest, oldest }
    }
}

fn position<S: Strategy<Value = f64>>(metres: impl Fn() -> S) -> impl Strategy<Value = Position> {
    (metres(), metres(), metres()).prop_map(|(x, y, z)| Position { x, y, z })
}

prop_compose! {
    fn goal_event()(
        robot in node(), goal in position(real), state in select(GoalState::ALL.to_vec()),
        remaining_m in of(real()), reason in of(".*"),
    ) -> GoalEvent {
        GoalEvent { robot, goal, state, remaining_m, reason }
    }
}

prop_compose! {
    fn large_data()(
        sequence in any::<u64>(), format in select(DataFormat::ALL.to_vec()),
        width in any::<u32>(), height in any::<u32>(), bytes in any::<u64>(),
    ) -> LargeData {
        LargeData { sequence, format, width, height, bytes }
    }
}

prop_compose! {
    fn reading()(
        robot in node(), sensor in sensor(), measured in any::<u64>(),
        values in btree_map(component(), real(), 0..4), data in of(large_data()),
    ) -> SensorReading {
        SensorReading { robot, sensor, measured: Timestamp::from_nanos(measured), values, data }
    }
}

/// Draws any event that a history can hold.
pub fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        1 => robot_context().prop_map(Event::Robot),
        1 => radio_context().prop_map(Event::Radio),
        1 => link_context().prop_map(Event::Link),
        1 => (vnf(), nodes()).prop_map(|(vnf, node)| Event::Placement(Placement { vnf, node })),
        1 => (vnf(), vnf(), instance_path(), vec(instance_path(), 0..3)).prop_map(|(from, to, first, others)| {
            let InstancePath { links, path, .. } = first;
            Event::VirtualLink(VirtualLinkMapping { from, to, links, path, others })
        }),
        1 => service_time().prop_map(Event::ServiceTime),
        10 => drawn::event(),
        1 => vnf_event().prop_map(Event::Vnf),
        1 => decision().prop_map(Event::Decision),
        1 => goal_event().prop_map(Event::Goal),
        1 => reading().prop_map(Event::Sensor),
        1 => machine::context().prop_map(Event::Machine),
        1 => staleness().prop_map(Event::Staleness),
    ]
}

/// Draws times that coincide, that lie in few or in distant stretches of 5 s, and up to the end of a history's time.
pub fn time() -> impl Strategy<Value = Timestamp> {
    let last = i64::MAX.cast_unsigned();
    prop_oneof![
        0..5_u64,
        (0..200_u64).prop_map(|n| n * 250_000_000),
        4_999_999_998..5_000_000_002_u64,
        0..=last,
        last - 2..=last,
    ]
    .prop_map(Timestamp::from_nanos)
}

/// Draws any event that a history can hold, at any time.
pub fn stamped() -> impl Strategy<Value = Stamped> {
    (time(), event()).prop_map(|(at, event)| Stamped { at, event })
}

/// Draws any figure of these names.
pub fn figure() -> impl Strategy<Value = crate::Figure> {
    use crate::{Figure, LatenessQuantity, LinkQuantity, MachineQuantity, RobotQuantity};
    prop_oneof![
        4 => (link(), direction(), select(LinkQuantity::ALL.to_vec())).prop_map(|(l, d, q)| Figure::Link(l, d, q)),
        4 => (node(), select(RobotQuantity::ALL.to_vec())).prop_map(|(r, q)| Figure::Robot(r, q)),
        2 => (node(), node()).prop_map(|(robot, radio_unit)| Figure::Signal { robot, radio_unit }),
        1 => node().prop_map(Figure::Load),
        2 => (of(service()), of(node())).prop_map(|(service, robot)| Figure::ServiceTime { service, robot }),
        2 => (part(), of(service()), of(node()))
            .prop_map(|(part, service, robot)| Figure::TimePart { part, service, robot }),
        1 => of(node()).prop_map(|robot| Figure::HandoverGap { robot }),
        2 => (node(), sensor(), component())
            .prop_map(|(robot, sensor, component)| Figure::Sensor { robot, sensor, component }),
        2 => (node(), select(MachineQuantity::ALL.to_vec())).prop_map(|(n, q)| Figure::Machine(n, q)),
        1 => select(LatenessQuantity::ALL.to_vec()).prop_map(Figure::Lateness),
    ]
}
