//! Tests of the radio as the fabric uses it: frames in, frames and events out, in virtual time.

mod airtime;
mod contention;
mod exchange;
mod foreign;
mod supplicant;

use cotorra_graph::{
    Access, BitRate, Conditions, Edca, FixedRate, FqCodel, FtKey, Handover, HandoverTimes, HostAddress, Link,
    Loss, Node, NodeKind, PassiveVisits, PathLoss, PowerSave, Probability, QueueDiscipline, QueueLimit,
    RadioUnit, Rate, RateControl, Roaming, Robot, ScanVisits, Shadowing, WifiStandard,
};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use super::*;
use crate::fabric::Fabric;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn mbps(rate: f64) -> BitRate {
    BitRate::from_mbps(rate).unwrap()
}

/// A network without randomness: no shadowing, no variation, 1 ms and 8 Mbit/s.
fn network() -> WirelessNetwork {
    WirelessNetwork { rate: Some(mbps(8.0)), ..base::wireless() }
}

fn node(name: &str, x: f64, kind: NodeKind) -> Node {
    Node { position: Some(Position::new(x, 0.0)), ..base::node(name, kind) }
}

fn unit(name: &str, x: f64, channel: u8) -> Node {
    let unit = RadioUnit { channel, ..base::radio_unit("lab") };
    node(name, x, NodeKind::RadioUnit(unit))
}

fn robot(name: &str, x: f64, roaming: Roaming) -> Node {
    let robot = Robot { roaming, ..base::robot("lab") };
    node(name, x, NodeKind::Robot(robot))
}

/// A radio and its output.
struct World {
    radio: Radio,
    ports: BTreeMap<NodeId, PortId>,
    arrived: Vec<(Timestamp, PortId, Frame)>,
    pushed: u64,
}

impl World {
    fn new(network: WirelessNetwork, nodes: Vec<Node>) -> Self {
        Self::seeded(network, nodes, 1)
    }

    fn seeded(network: WirelessNetwork, nodes: Vec<Node>, seed: u64) -> Self {
        let mut other = WirelessNetwork { gap: GapPolicy::Hold, ..network.clone() };
        if let Some(contention) = other.access.contention_mut() {
            contention.interference.clear();
        }
        let wireless = [("lab".to_owned(), network), ("other".to_owned(), other)].into();
        let graph = HardwareGraph { wireless, ..base::graph(nodes, Vec::new()) };
        let ports = graph.hosts().enumerate().map(|(i, n)| (n.id.clone(), PortId(i))).collect();
        Self { radio: Radio::new(&graph, seed).unwrap(), ports, arrived: Vec::new(), pushed: 0 }
    }

    fn port(&self, name: &str) -> PortId {
        self.ports[name]
    }

    /// Returns a numbered frame of a size.
    fn frame(&mut self, bytes: usize) -> Frame {
        let mut frame = vec![0; bytes];
        frame[14..22].copy_from_slice(&self.pushed.to_be_bytes());
        self.pushed += 1;
        Frame::new(frame)
    }

    fn up(&mut self, now: Timestamp, robot: &str, bytes: usize) {
        let frame = self.frame(bytes);
        self.radio.push_up(now, self.ports[robot], frame);
    }

    fn down(&mut self, now: Timestamp, unit: &str, robot: &str, bytes: usize) {
        let frame = self.frame(bytes);
        self.radio.push_down(now, self.ports[unit], self.ports[robot], frame);
    }

    /// Polls at every deadline up to a time.
    fn run(&mut self, until: Timestamp) {
        let mut arrivals = Vec::new();
        let mut now = Some(Timestamp::ZERO);
        while let Some(at) = now.filter(|now| *now <= until) {
            now = self.radio.poll(at, &mut Pool::default(), &mut arrivals);
            assert!(now.is_none_or(|next| next > at), "everything due at {at} is done");
        }
        self.radio.poll(until, &mut Pool::default(), &mut arrivals);
        self.arrived.extend(arrivals.into_iter().map(|a| (a.due, a.at, a.frame)));
    }

    fn events(&mut self) -> Vec<Stamped> {
        std::iter::from_fn(|| self.radio.next_event()).collect()
    }

    fn attached(&self, robot: &str) -> Option<PortId> {
        self.radio.attached_to(self.port(robot))
    }

    /// Returns the arrival times, µs.
    fn arrivals_us(&self) -> Vec<f64> {
        self.arrived.iter().map(|(due, _, _)| due.as_nanos() as f64 / 1e3).collect()
    }

    fn numbers(&self) -> Vec<u64> {
        self.arrived
            .iter()
            .map(|(_, _, f)| u64::from_be_bytes(f.bytes()[14..22].try_into().unwrap()))
            .collect()
    }

    fn counters(&self, now: Timestamp) -> cotorra_graph::LinkCounters {
        let mut sum = cotorra_graph::LinkCounters::default();
        for counters in self.radio.link_contexts(now, |_, _| None).iter().map(|c| c.counters) {
            sum.packets += counters.packets;
            sum.lost += counters.lost;
            sum.overflowed += counters.overflowed;
            sum.duplicated += counters.duplicated;
        }
        sum
    }
}

/// One robot between two radio units, closer to the first.
fn corridor(network: WirelessNetwork, roaming: Roaming) -> World {
    World::new(network, vec![robot("r", 5.0, roaming), unit("R1", 0.0, 1), unit("R2", 30.0, 6)])
}

#[test]
fn small_frames_on_an_idle_channel_take_exactly_the_delay() {
    let mut world = corridor(network(), Roaming::Instructed);
    world.up(at(10), "r", 430);
    world.down(at(20), "R1", "r", 430);
    world.up(at(30), "r", 60);
    world.run(at(100));
    assert_eq!(world.arrivals_us(), [11_000.0, 21_000.0, 31_000.0]);
    assert_eq!(world.arrived[0].1, world.port("R1"));
    assert_eq!(world.arrived[1].1, world.port("r"));
}

#[test]
fn frames_arrive_no_earlier_than_their_last_bit() {
    let mut world = corridor(network(), Roaming::Instructed);
    world.up(at(10), "r", 1500);
    world.run(at(100));
    // 12,000 bits at 8 Mbit/s.
    assert_eq!(world.arrivals_us(), [11_500.0]);
}

#[test]
fn consecutive_frames_wait_for_the_air() {
    let mut world = corridor(network(), Roaming::Instructed);
    (0..3).for_each(|_| world.up(at(10), "r", 500));
    world.run(at(100));
    assert_eq!(world.arrivals_us(), [11_000.0, 11_500.0, 12_000.0]);
}

#[test]
fn contexts_have_the_longest_queue_of_the_last_second() {
    let mut world = corridor(network(), Roaming::Instructed);
    let link = LinkId::wireless(&id("r"), &id("R1"));
    let queued = |world: &World, now| -> Vec<_> {
        let contexts = world.radio.link_contexts(at(now), |_, _| None).into_iter();
        contexts.filter(|context| context.link == link).map(|context| context.queued_packets).collect()
    };
    world.up(at(10), "r", 500);
    assert_eq!(queued(&world, 10), [Some(0), Some(0)], "it is on the air");
    (0..2).for_each(|_| world.up(at(10), "r", 500));
    assert_eq!(queued(&world, 10), [Some(2), Some(0)]);
    world.run(at(100));
    assert_eq!(world.arrived.len(), 3);
    assert_eq!(queued(&world, 900), [Some(2), Some(0)]);
    assert_eq!(queued(&world, 1200), [Some(0), Some(0)]);
    // Frames wait while the station scans.
    world.radio.scan(at(1200), &id("r")).unwrap();
    (0..4).for_each(|_| world.down(at(1200), "R1", "r", 500));
    assert_eq!(queued(&world, 1210), [Some(0), Some(4)]);
}

#[test]
fn the_standard_limits_the_rate_without_a_cap() {
    let mut world = corridor(WirelessNetwork { rate: None, ..network() }, Roaming::Instructed);
    (0..900).for_each(|_| world.up(at(10), "r", 1514));
    world.run(at(2000));
    let took = world.arrived.last().unwrap().0.since(at(10)).as_secs_f64();
    let rate = 900.0 * 1514.0 * 8.0 / took / 1e6;
    // 1514 bytes in DIFS, backoff (7.5 slots in the mean), 234 µs on the air, SIFS and acknowledgement: 373 µs.
    assert!((rate - 32.4).abs() < 0.4, "{rate}");
}

#[test]
fn a_station_begins_with_the_strongest_radio_unit() {
    let world = corridor(network(), Roaming::Instructed);
    assert_eq!(world.attached("r"), Some(world.port("R1")));
    let attachments = world.radio.attachments(at(0), &id("r"));
    assert_eq!(attachments.iter().map(|a| a.attached).collect::<Vec<_>>(), [true, false]);
    assert!(attachments[0].signal.is_some());
}

#[test]
fn before_its_first_scan_a_robot_has_heard_its_own_radio_unit_only() {
    for roaming in [Roaming::Instructed, Roaming::Signal, Roaming::Supplicant(Default::default())] {
        let mut world = corridor(network(), roaming);
        let known = |world: &World, now| {
            let attachments = world.radio.attachments(now, &id("r"));
            attachments.iter().map(|a| (a.signal.is_some(), a.age)).collect::<Vec<_>>()
        };
        assert_eq!(known(&world, at(0)), [(true, Some(Duration::ZERO)), (false, None)], "{roaming:?}");
        world.radio.scan(at(50), &id("r")).unwrap();
        let left = Some(Duration::from_millis(10));
        assert_eq!(known(&world, at(60)), [(true, left), (false, None)], "off its channel, {roaming:?}");
        world.run(at(150));
        let heard = Some(Duration::from_millis(30));
        assert_eq!(known(&world, at(180)), [(true, Some(Duration::ZERO)), (true, heard)], "{roaming:?}");
    }
}

#[test]
fn an_instructed_handover_takes_its_phases_and_reports_its_end() {
    for (fast_transition, gap) in [(true, 30), (false, 70)] {
        let mut world = corridor(WirelessNetwork { fast_transition, ..network() }, Roaming::Instructed);
        world.radio.attach(at(100), &id("r"), &id("R2")).unwrap();
        world.run(at(100 + gap - 1));
        assert_eq!(world.attached("r"), Some(world.port("R1")));
        world.run(at(500));
        assert_eq!(world.attached("r"), Some(world.port("R2")));
        let handover = Handover {
            robot: id("r"),
            from: Some(id("R1")),
            to: id("R2"),
            fast: fast_transition,
            gap: ms(gap),
        };
        assert_eq!(world.events(), [Stamped { at: at(100 + gap), event: Event::Handover(handover) }]);
    }
}

#[test]
fn impossible_calls_are_rejected_with_a_reason() {
    let mut other = unit("X", 1.0, 1);
    let NodeKind::RadioUnit(spec) = &mut other.kind else { unreachable!() };
    spec.network = "other".into();
    let nodes = vec![
        robot("r", 5.0, Roaming::Instructed),
        unit("R1", 0.0, 1),
        unit("R2", 30.0, 6),
        unit("far", 9000.0, 6),
        other,
    ];
    let mut world = World::new(network(), nodes);
    let mut attach = |now, robot: &str, unit: &str| world.radio.attach(now, &id(robot), &id(unit));
    let (r, radio_unit) = (id("r"), id("far"));
    assert_eq!(attach(at(1), "nobody", "R1"), Err(FabricError::UnknownRobot(id("nobody"))));
    assert_eq!(attach(at(1), "r", "R9"), Err(FabricError::UnknownRadioUnit(id("R9"))));
    assert_eq!(attach(at(1), "r", "far"), Err(FabricError::OutOfReach { robot: r.clone(), radio_unit }));
    let radio_unit = id("X");
    assert_eq!(attach(at(1), "r", "X"), Err(FabricError::OtherNetwork { robot: r.clone(), radio_unit }));
    assert_eq!(attach(at(1), "r", "R1"), Ok(()), "it is there already");
    assert_eq!(attach(at(1), "r", "R2"), Ok(()));
    assert_eq!(attach(at(2), "r", "R1"), Err(FabricError::Busy(r.clone())));
    assert_eq!(world.radio.scan(at(2), &r), Err(FabricError::Busy(r.clone())));
    world.run(at(100));
    assert_eq!(world.radio.scan(at(100), &r), Ok(()));
    assert_eq!(world.radio.scan(at(101), &r), Err(FabricError::Busy(r)));
    let trace = "1".parse::<u64>().map(|ms| vec![ms]).unwrap().try_into().unwrap();
    let change = ConditionChange {
        rate: Some(Rate::Trace { trace: std::sync::Arc::new(trace) }),
        ..ConditionChange::default()
    };
    let link = LinkId::wireless(&id("r"), &id("R1"));
    let error = world.radio.change(at(200), &link, None, &change).unwrap_err();
    assert!(matches!(error, FabricError::NotOnWireless(_)));
    let codel = QueueDiscipline::Codel(Default::default());
    for (discipline, expected) in
        [(codel, Err(FabricError::NotOnWireless("queue discipline"))), (QueueDiscipline::DropTail, Ok(()))]
    {
        let change = ConditionChange { queue_discipline: Some(discipline), ..ConditionChange::default() };
        assert_eq!(world.radio.change(at(200), &link, None, &change), expected);
    }
    let unknown = LinkId::new("r-R1").unwrap();
    let error = world.radio.change(at(200), &unknown, None, &change).unwrap_err();
    assert_eq!(error, FabricError::UnknownLink(unknown));
}

#[test]
fn a_scan_delays_frames_and_updates_signals() {
    let mut world = corridor(network(), Roaming::Instructed);
    world.radio.move_robot(at(40), &id("r"), Position::new(12.0, 0.0)).unwrap();
    assert_eq!(world.radio.attachments(at(40), &id("r"))[1].signal, None);
    world.radio.scan(at(50), &id("r")).unwrap();
    world.up(at(60), "r", 100);
    world.run(at(500));
    // 100 ms off the channel, of which 90 were left, and 1 ms on the air.
    assert_eq!(world.arrivals_us(), [151_000.0]);
    assert_eq!(world.events(), [Stamped { at: at(150), event: Event::Scanned { robot: id("r") } }]);
    assert!(world.radio.attachments(at(500), &id("r"))[1].signal.is_some());
    assert_eq!(world.attached("r"), Some(world.port("R1")), "to look is not to roam");
}

#[test]
fn a_handover_requested_during_a_scan_follows_it() {
    let mut world = corridor(network(), Roaming::Instructed);
    world.radio.scan(at(0), &id("r")).unwrap();
    world.radio.attach(at(50), &id("r"), &id("R2")).unwrap();
    world.run(at(500));
    let events = world.events();
    assert_eq!(events[0], Stamped { at: at(100), event: Event::Scanned { robot: id("r") } });
    assert!(
        matches!(&events[1], Stamped { at: t, event: Event::Handover(h) } if *t == at(130) && h.gap == ms(130))
    );
}

#[test]
fn held_frames_follow_the_gap_in_order() {
    let mut world = corridor(network(), Roaming::Instructed);
    (0..3).for_each(|_| world.up(at(10), "r", 1000));
    // One frame is on the air and arrives. The others wait, and move with the station.
    world.radio.attach(at(10), &id("r"), &id("R2")).unwrap();
    for i in 0..5 {
        world.up(at(12 + i), "r", 1000);
        world.down(at(12 + i), "R1", "r", 1000);
    }
    world.run(at(1000));
    let up: Vec<_> = world.arrived.iter().filter(|(_, to, _)| *to != world.port("r")).collect();
    assert_eq!(up[0].1, world.port("R1"));
    assert!(up[1..].iter().all(|(due, to, _)| *to == world.port("R2") && *due > at(40)));
    let mut numbers = world.numbers();
    assert_eq!(numbers.len(), 13);
    let (up, down): (Vec<u64>, Vec<u64>) = numbers.iter().partition(|n| **n < 3 || **n % 2 == 1);
    assert!(up.is_sorted() && down.is_sorted(), "each direction keeps its order");
    numbers.sort_unstable();
    assert_eq!(numbers, (0..13).collect::<Vec<_>>());
    assert_eq!(world.counters(at(1000)).lost, 0);
}

#[test]
fn the_drop_policy_loses_queued_frames_and_those_of_the_gap() {
    let mut world = corridor(WirelessNetwork { gap: GapPolicy::Drop, ..network() }, Roaming::Instructed);
    (0..3).for_each(|_| world.up(at(10), "r", 1000));
    world.radio.attach(at(10), &id("r"), &id("R2")).unwrap();
    world.up(at(20), "r", 1000);
    world.down(at(20), "R1", "r", 1000);
    // The gap is over, but R1 is the former radio unit.
    world.down(at(60), "R1", "r", 1000);
    world.down(at(60), "R2", "r", 1000);
    world.run(at(1000));
    assert_eq!(world.numbers(), [0, 6]);
    let counters = world.counters(at(1000));
    assert_eq!((counters.packets, counters.lost), (2, 5));
}

#[test]
fn a_scan_with_visits_makes_many_short_gaps() {
    let visits = ScanVisits { dwell: ms(60), passive: None, away: ms(125), back: ms(200) };
    let longest_wait = |scan, visits| {
        let handover = HandoverTimes { scan: ms(scan), visits, ..network().handover };
        let mut world = corridor(WirelessNetwork { handover, ..network() }, Roaming::Instructed);
        world.radio.scan(at(0), &id("r")).unwrap();
        for i in 0..1000 {
            world.up(at(i * 10), "r", 60);
            world.down(at(i * 10), "R1", "r", 60);
            world.run(at(i * 10));
        }
        world.run(at(11_000));
        assert_eq!(world.arrived.len(), 2000);
        let scanned = world.events();
        assert_eq!(scanned.len(), 1, "{scanned:?}");
        let number = |frame: &Frame| u64::from_be_bytes(frame.bytes()[14..22].try_into().unwrap());
        let waits = world.arrived.iter().map(|(due, _, frame)| due.since(at(number(frame) / 2 * 10)));
        (scanned[0].at, waits.max().unwrap().as_millis())
    };
    assert_eq!(longest_wait(780, None), (at(780), 781));
    // 13 visits and 12 returns. Frames wait for one visit.
    let (scanned, wait) = longest_wait(780, Some(visits));
    assert_eq!(scanned, at(13 * 60 + 12 * 200));
    assert!((60..65).contains(&wait), "{wait} ms");
    // Both bands: 13 + 4 channels are probed, and 15 only listened on.
    let passive = Some(PassiveVisits { channels: 15, dwell: ms(111) });
    let (scanned, wait) = longest_wait(17 * 60 + 15 * 111, Some(ScanVisits { passive, ..visits }));
    assert_eq!(scanned, at(17 * 60 + 15 * 111 + 31 * 200));
    assert!((111..116).contains(&wait), "{wait} ms");
}

#[test]
fn an_instructed_change_can_begin_with_a_scan() {
    let handover = HandoverTimes { scan_first: true, ..network().handover };
    let mut world = corridor(WirelessNetwork { handover, ..network() }, Roaming::Instructed);
    world.radio.attach(at(100), &id("r"), &id("R2")).unwrap();
    world.run(at(1000));
    assert_eq!(world.attached("r"), Some(world.port("R2")));
    let events = world.events();
    let [scanned, changed] = &events[..] else { panic!("{events:?}") };
    assert_eq!((scanned.at, &scanned.event), (at(200), &Event::Scanned { robot: id("r") }));
    assert!(
        matches!(&changed.event, Event::Handover(handover) if handover.gap == ms(100 + 30)),
        "{changed:?}"
    );
}

#[test]
fn a_station_scans_by_itself_so_long_after_its_last_scan() {
    let handover = HandoverTimes { scan_every: Some(ms(1000)), variation: 0.0, ..network().handover };
    for roaming in [Roaming::Instructed, Roaming::Signal] {
        let mut world = corridor(WirelessNetwork { handover, ..network() }, roaming);
        world.run(at(1500));
        // An instructed one counts, too.
        world.radio.scan(at(1500), &id("r")).unwrap();
        world.run(at(4000));
        let ends: Vec<_> = world.events().iter().map(|scanned| scanned.at).collect();
        assert_eq!(ends, [at(1100), at(1600), at(2600), at(3600)], "it stays where it is, and scans");
    }
}

#[test]
fn a_radio_unit_that_is_switched_off_between_visits_is_lost() {
    let visits = Some(ScanVisits { dwell: ms(60), passive: None, away: ms(60), back: ms(200) });
    let handover = HandoverTimes { scan: ms(780), visits, ..network().handover };
    let mut world = corridor(WirelessNetwork { handover, ..network() }, Roaming::Instructed);
    world.radio.scan(at(0), &id("r")).unwrap();
    world.run(at(100));
    world.radio.switch_off(at(100), &id("R1")).unwrap();
    world.run(at(1000));
    // The next scan is without returns.
    assert_eq!(world.attached("r"), Some(world.port("R2")));
    assert!(
        matches!(&world.events()[..], [Stamped { at: lost, event: Event::Detached { .. } }, ..] if *lost == at(100))
    );
}

#[test]
fn held_queues_are_bounded() {
    let mut world = corridor(network(), Roaming::Instructed);
    world.radio.scan(at(0), &id("r")).unwrap();
    (0..1500).for_each(|_| world.up(at(1), "r", 60));
    world.run(at(10_000));
    let counters = world.counters(at(10_000));
    assert_eq!((counters.packets, counters.overflowed), (1000, 500));
}

/// Walks at 1 m/s from one place to another. Returns the events.
fn walk(world: &mut World, from: f64, to: f64, start: Timestamp) -> Vec<Stamped> {
    let steps = ((to - from).abs() * 20.0) as u64;
    for i in 0..=steps {
        let now = start + ms(50 * i);
        let x = from + (to - from) * i as f64 / steps as f64;
        world.radio.move_robot(now, &id("r"), Position::new(x, 0.0)).unwrap();
        world.run(now);
    }
    world.run(start + ms(50 * steps + 2000));
    world.events()
}

fn handovers(events: &[Stamped]) -> Vec<(Timestamp, &str)> {
    let handover = |s: &Stamped| match &s.event {
        Event::Handover(h) => Some((s.at, h.to.as_str().to_owned())),
        _ => None,
    };
    let names = ["R1", "R2", "R3"];
    let named = |(at, to): (Timestamp, String)| (at, *names.iter().find(|n| **n == to).unwrap());
    events.iter().filter_map(handover).map(named).collect()
}

#[test]
fn a_station_roams_once_where_the_hysteresis_is_exceeded() {
    let mut world = corridor(network(), Roaming::Signal);
    let events = walk(&mut world, 5.0, 28.0, at(0));
    let found = handovers(&events);
    assert_eq!(found.len(), 1, "{events:?}");
    // 4 dB at 30 dB a decade is a factor of 1.36 between the distances: 17.3 m, 12.3 s on the way, and from the next
    // beacon on 500 ms to trigger, 100 ms of scanning and 30 ms to attach.
    let (when, to) = found[0];
    assert_eq!(to, "R2");
    assert!((12.9..13.2).contains(&when.as_secs_f64()), "{when}");
    // The way back: at 12.7 m.
    let events = walk(&mut world, 28.0, 5.0, at(30_000));
    let found = handovers(&events);
    assert_eq!(found.len(), 1);
    assert!((45.9..46.2).contains(&found[0].0.as_secs_f64()), "{}", found[0].0);
}

#[test]
fn a_station_between_two_radio_units_does_not_alternate() {
    let mut world = corridor(network(), Roaming::Signal);
    let mut count = 0;
    walk(&mut world, 5.0, 15.0, at(0));
    for i in 0..20 {
        let start = at(20_000 + i * 10_000);
        let (from, to) = if i % 2 == 0 { (15.0, 17.0) } else { (17.0, 13.5) };
        count += handovers(&walk(&mut world, from, to, start)).len();
    }
    assert_eq!(count, 0);
}

#[test]
fn shadowing_causes_few_handovers() {
    let shadowing = Shadowing { deviation_db: 4.0, correlation_m: 5.0 };
    for seed in 0..10 {
        let nodes = vec![robot("r", 5.0, Roaming::Signal), unit("R1", 0.0, 1), unit("R2", 30.0, 6)];
        let mut world = World::seeded(WirelessNetwork { shadowing, ..network() }, nodes, seed);
        let count = handovers(&walk(&mut world, 1.0, 29.0, at(0))).len();
        assert!((1..=5).contains(&count), "{count} handovers in 28 m");
    }
}

#[test]
fn a_lost_radio_unit_is_reported_and_joined_again() {
    for roaming in [Roaming::Instructed, Roaming::Signal] {
        let mut world = World::new(network(), vec![robot("r", 5.0, roaming), unit("R1", 0.0, 1)]);
        world.radio.move_robot(at(1000), &id("r"), Position::new(9000.0, 0.0)).unwrap();
        world.run(at(5000));
        let events = world.events();
        let lost = Event::Detached { robot: id("r"), from: id("R1") };
        // Seven beacons after the last one received.
        assert_eq!(events[0], Stamped { at: Timestamp::from_nanos(16 * 102_400_000), event: lost });
        assert!(events[1..].iter().all(|s| matches!(s.event, Event::Scanned { .. })));
        assert_eq!(world.attached("r"), None);
        assert_eq!(world.radio.deadline(), None, "where nothing is heard and nothing moves, nothing happens");
        world.up(at(6000), "r", 100);
        world.radio.move_robot(at(7000), &id("r"), Position::new(3.0, 0.0)).unwrap();
        world.run(at(10_000));
        assert_eq!(world.attached("r"), Some(world.port("R1")));
        let events = world.events();
        assert!(
            matches!(&events[1].event, Event::Handover(h) if h.from.is_none() && !h.fast && h.gap == ms(170)),
            "{events:?}"
        );
        assert_eq!(world.arrived.len(), 1, "its frames were held in the meantime");
    }
}

#[test]
fn only_stations_on_one_channel_share_its_airtime() {
    for (channel, share) in [(1, 4.0), (6, 8.0)] {
        let nodes = vec![
            robot("a", 1.0, Roaming::Instructed),
            robot("b", 29.0, Roaming::Instructed),
            unit("R1", 0.0, 1),
            unit("R2", 30.0, channel),
        ];
        let mut world = World::new(network(), nodes);
        assert_ne!(world.attached("a"), world.attached("b"));
        for i in 0..5000 {
            world.up(at(i), "a", 1500);
            world.up(at(i), "b", 1500);
            world.run(at(i));
        }
        let contexts = world.radio.link_contexts(at(5000), |_, _| None);
        for context in contexts.iter().filter(|c| c.direction == Direction::Forward) {
            let rate = context.throughput_bps / 1e6;
            assert!((rate - share).abs() < 0.05 * share, "{}: {rate} Mbit/s, not {share}", context.link);
        }
        for context in world.radio.contexts(at(5000)) {
            assert!(context.load.unwrap() > 0.98, "{context:?}");
        }
    }
}

#[test]
fn a_group_frame_reaches_all_but_its_source_in_one_transmission() {
    let robots = ["a", "b", "c"].map(|name| robot(name, 5.0, Roaming::Instructed));
    let mut world = World::new(network(), [&robots[..], &[unit("R1", 0.0, 1)]].concat());
    world.radio.scan(at(0), &id("c")).unwrap();
    let frame = world.frame(200);
    world.radio.push_group(at(10), world.port("R1"), world.port("a"), frame);
    world.run(at(500));
    // "c" was off the channel.
    assert_eq!(
        world.arrived.iter().map(|(due, to, _)| (*due, *to)).collect::<Vec<_>>(),
        [(at(11), world.port("b"))]
    );
    assert_eq!(world.counters(at(500)).lost, 1);
    // 200 bytes at 6.5 Mbit/s and more.
    let busy = world.radio.contexts(at(500))[0].load.unwrap() * 0.5;
    assert!((250e-6..600e-6).contains(&busy), "{busy}");
}

#[test]
fn conditions_and_scales_apply_to_a_wireless_link() {
    let mut world = corridor(network(), Roaming::Instructed);
    let link = LinkId::wireless(&id("r"), &id("R1"));
    let change =
        ConditionChange { delay_scale: Some(3.0), drop_scale: Some(2.0), ..ConditionChange::default() };
    world.radio.change(at(0), &link, Some(Direction::Forward), &change).unwrap();
    world.up(at(10), "r", 100);
    world.down(at(20), "R1", "r", 100);
    (0..2).for_each(|_| world.up(at(30), "r", 1000));
    world.run(at(40));
    // 3 ms up, still 1 ms down; 8000 bits take 2 ms at 4 Mbit/s.
    assert_eq!(world.arrivals_us(), [13_000.0, 21_000.0, 33_000.0, 35_000.0]);
    let change = ConditionChange {
        delay_ms: Some(5.0),
        delay_scale: Some(1.0),
        loss: Some(Loss::Independent { rate: Probability::ONE }),
        ..ConditionChange::default()
    };
    world.radio.change(at(50), &link, None, &change).unwrap();
    world.down(at(60), "R1", "r", 100);
    world.run(at(100));
    assert_eq!(world.arrived.len(), 4);
    let contexts = world.radio.link_contexts(at(100), |_, _| None);
    let up = contexts.iter().find(|c| c.direction == Direction::Forward).unwrap();
    assert_eq!((up.effective.delay, up.scale.drop_scale), (ms(5), 2.0));
    assert_eq!(up.effective.rate, Rate::Fixed { bits_per_second: mbps(4.0) });
    assert_eq!(up.delay, Some(Duration::from_nanos(3_666_666)));
    let above = ConditionChange { drop_scale: Some(0.1), ..ConditionChange::default() };
    let error = world.radio.change(at(100), &link, None, &above).unwrap_err();
    assert_eq!(error, FabricError::AboveMedium { asked_mbps: 80.0, medium: mbps(65.0) });
}

#[test]
fn a_network_loses_its_share_of_what_the_air_delivers() {
    let loss = Loss::Independent { rate: Probability::new(0.3).unwrap() };
    let mut world = corridor(WirelessNetwork { loss, ..network() }, Roaming::Instructed);
    for i in 0..2000 {
        world.up(at(20 * i), "r", 100);
        world.down(at(20 * i + 10), "R1", "r", 100);
    }
    world.run(at(41_000));
    for (port, direction) in [("R1", Direction::Forward), ("r", Direction::Backward)] {
        let arrived = world.arrived.iter().filter(|(_, at, _)| *at == world.port(port)).count();
        // Three standard deviations are 61 frames.
        assert!((1339..=1461).contains(&arrived), "{arrived}");
        let contexts = world.radio.link_contexts(at(41_000), |_, _| None);
        let context = contexts.iter().find(|context| context.direction == direction).unwrap();
        assert_eq!((context.effective.loss, context.counters.lost), (loss, 2000 - arrived as u64));
    }
}

#[test]
fn a_shorter_delay_brings_frames_in_flight_forward_in_order() {
    let mut world = corridor(network(), Roaming::Instructed);
    let link = LinkId::wireless(&id("r"), &id("R1"));
    let delay = |ms| ConditionChange { delay_ms: Some(ms), ..ConditionChange::default() };
    world.radio.change(at(0), &link, None, &delay(1000.0)).unwrap();
    (0..3).for_each(|i| world.up(at(10 * i), "r", 100));
    world.radio.change(at(25), &link, None, &delay(10.0)).unwrap();
    world.up(at(26), "r", 100);
    world.run(at(2000));
    assert_eq!(world.arrivals_us(), [25_000.0, 25_000.0, 30_000.0, 36_000.0]);
    assert_eq!(world.numbers(), [0, 1, 2, 3]);
}

#[test]
fn weak_signals_cause_retries_and_weaker_ones_losses() {
    let network = WirelessNetwork { rate: None, ..network() };
    let mut world = World::new(network, vec![robot("r", 228.0, Roaming::Instructed), unit("R1", 0.0, 1)]);
    let send = |world: &mut World, start: u64, count: u64| {
        for i in 0..count {
            world.up(at(start + i * 40), "r", 1514);
            world.run(at(start + i * 40));
        }
    };
    // 4.2 dB above the noise: one full frame in fifteen fails at the slowest rate, 2 ms, and is sent again.
    send(&mut world, 40, 1000);
    world.run(at(41_000));
    let late = world.arrived.iter().filter(|(due, _, _)| due.as_nanos() % 40_000_000 > 3_000_000).count();
    assert_eq!(world.arrived.len(), 1000);
    assert!((30..120).contains(&late), "{late}");
    // Far beyond, every frame is lost until the station notices.
    world.radio.move_robot(at(50_000), &id("r"), Position::new(500.0, 0.0)).unwrap();
    send(&mut world, 50_000, 10);
    world.run(at(60_000));
    assert_eq!((world.arrived.len(), world.counters(at(60_000)).lost), (1000, 10));
}

#[test]
fn runs_depend_only_on_the_seed() {
    let run = |seed| {
        let shadowing = Shadowing { deviation_db: 6.0, correlation_m: 4.0 };
        let handover = HandoverTimes { variation: 0.3, ..network().handover };
        let network = WirelessNetwork { rate: None, shadowing, handover, ..network() };
        let nodes = vec![robot("r", 5.0, Roaming::Signal), unit("R1", 0.0, 1), unit("R2", 30.0, 1)];
        let mut world = World::seeded(network, nodes, seed);
        for i in 0..2000 {
            world.radio.move_robot(at(i * 10), &id("r"), Position::new(0.015 * i as f64, 0.0)).unwrap();
            world.up(at(i * 10), "r", 800);
            world.down(at(i * 10), "R1", "r", 800);
            world.run(at(i * 10));
        }
        world.run(at(30_000));
        (world.events(), world.arrived)
    };
    let (first, second, other) = (run(1), run(1), run(2));
    assert!(first == second);
    assert!(first != other);
}

#[test]
fn frames_follow_the_robot_through_the_fabric() {
    let wire = |unit: &str, delay: Duration| {
        let conditions = Conditions { delay, ..Conditions::default() };
        Link { medium: mbps(10_000.0), ..base::link(unit, "s", conditions) }
    };
    let nodes = vec![
        robot("r", 5.0, Roaming::Instructed),
        unit("R1", 0.0, 1),
        unit("R2", 30.0, 6),
        node("s", 0.0, NodeKind::Server(base::server())),
    ];
    let links = vec![wire("R1", ms(2)), wire("R2", ms(5))];
    let wireless = [("lab".to_owned(), network())].into();
    let graph = HardwareGraph { wireless, ..base::graph(nodes, links) };
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    let (r, s) = (PortId(0), PortId(3));
    let frame = |from: PortId, to: PortId| {
        let [to, from] = [to, from].map(|port| HostAddress::of(port.0).mac);
        Frame::new([&to[..], &from[..], &[0x88, 0xb5], &[0; 100]].concat())
    };
    // Pushes a frame. Returns when and where it came out.
    let cross = |fabric: &mut Fabric, now, from, to| {
        let mut delivered = None;
        let mut next = Some(now);
        fabric.push(now, from, frame(from, to));
        while let Some(now) = next.filter(|_| delivered.is_none()) {
            next = fabric.poll(now, &mut |port, _| delivered = Some((now, port)));
        }
        delivered.unwrap()
    };
    assert_eq!(cross(&mut fabric, at(10), r, s), (at(13), s));
    assert_eq!(cross(&mut fabric, at(20), s, r), (at(23), r));
    // In the gap of 30 ms, frames are held at the robot and at its former radio unit; then the other way round.
    fabric.attach(at(100), &id("r"), &id("R2")).unwrap();
    assert_eq!(cross(&mut fabric, at(110), r, s), (at(136), s));
    assert_eq!(cross(&mut fabric, at(210), s, r), (at(216), r));
    fabric.attach(at(300), &id("r"), &id("R1")).unwrap();
    assert_eq!(cross(&mut fabric, at(310), s, r), (at(331), r));
    assert_eq!(cross(&mut fabric, at(410), r, s), (at(413), s));
}

/// A call to a radio.
#[derive(Debug, Clone)]
enum Operation {
    Up(usize, usize),
    Down(usize, usize, usize),
    Group(usize, usize),
    Move(usize, f64),
    Scan(usize),
    Attach(usize, usize),
    Change(usize, usize, f64, f64, f64),
}

fn operation(groups: u32) -> impl Strategy<Value = Operation> {
    prop_oneof![
        6 => (0..3usize, 22..1600usize).prop_map(|(r, b)| Operation::Up(r, b)),
        6 => (0..3usize, 0..3usize, 22..1600usize).prop_map(|(u, r, b)| Operation::Down(u, r, b)),
        groups => (0..3usize, 22..1600usize).prop_map(|(u, b)| Operation::Group(u, b)),
        3 => (0..3usize, -300.0..300.0f64).prop_map(|(r, x)| Operation::Move(r, x)),
        1 => (0..3usize).prop_map(Operation::Scan),
        1 => (0..3usize, 0..3usize).prop_map(|(r, u)| Operation::Attach(r, u)),
        1 => (0..3usize, 0..3usize, 0.0..50.0f64, 1.0..4.0f64, 0.0..0.5f64)
            .prop_map(|(r, u, d, s, p)| Operation::Change(r, u, d, s, p)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn no_frame_is_invented_or_forgotten(
        seed: u64,
        gap in prop_oneof![Just(GapPolicy::Hold), Just(GapPolicy::Drop)],
        deviation_db in 0.0..8.0f64,
        access in prop::option::of(any::<[bool; 5]>().prop_map(|[aggregation, learns, knows, sleeps, is_fair]| {
            let rate_control = match (learns, knows) {
                (true, _) => RateControl::Minstrel,
                (false, true) => RateControl::Ideal,
                (false, false) => RateControl::Fixed(FixedRate::Mcs(3)),
            };
            let power_save = sleeps.then_some(PowerSave { idle: ms(20), dtim_period: 3 });
            let (queue, queue_discipline) = match is_fair {
                false => Default::default(),
                true => (QueueLimit::Packets(20), QueueDiscipline::FqCodel(FqCodel::MAC80211)),
            };
            Edca { aggregation, rate_control, power_save, queue, queue_discipline }
        })),
        visited: bool,
        listens: bool,
        operations in (0..2u32).prop_flat_map(|groups| {
            prop::collection::vec((0..40u64, operation(groups)), 0..250)
        }),
    ) {
        let shadowing = Shadowing { deviation_db, correlation_m: 5.0 };
        let passive = listens.then_some(PassiveVisits { channels: 2, dwell: ms(30) });
        let visits = visited.then_some(ScanVisits { dwell: ms(20), passive, away: ms(40), back: ms(50) });
        let scan_every = listens.then_some(ms(300));
        let handover =
            HandoverTimes { variation: 0.5, visits, scan_first: listens, scan_every, ..network().handover };
        let robots = ["a", "b", "c"];
        let units = ["R1", "R2", "R3"];
        let roaming = [Roaming::Signal, supplicant::every(1), Roaming::Instructed];
        let nodes = (0..3).map(|i| robot(robots[i], 10.0 * i as f64, roaming[i]))
            .chain((0..3).map(|i| unit(units[i], 30.0 * i as f64, if i == 2 { 11 } else { 1 })))
            .collect();
        let access = access.map_or(Access::Turns, Access::from);
        let mut world = World::seeded(WirelessNetwork { gap, shadowing, handover, access, ..network() }, nodes, seed);
        let groups = operations.iter().any(|(_, o)| matches!(o, Operation::Group(..)));
        let mut now = Timestamp::ZERO;
        for (wait, operation) in operations {
            now = now + ms(wait);
            match operation {
                Operation::Up(r, bytes) => world.up(now, robots[r], bytes),
                Operation::Down(u, r, bytes) => world.down(now, units[u], robots[r], bytes),
                Operation::Group(u, bytes) => {
                    let frame = world.frame(bytes);
                    world.radio.push_group(now, world.port(units[u]), world.port(robots[0]), frame);
                }
                Operation::Move(r, x) => {
                    world.radio.move_robot(now, &id(robots[r]), Position::new(x, 1.0)).unwrap();
                }
                // Both may be rejected.
                Operation::Scan(r) => drop(world.radio.scan(now, &id(robots[r]))),
                Operation::Attach(r, u) => drop(world.radio.attach(now, &id(robots[r]), &id(units[u]))),
                Operation::Change(r, u, delay, drop_scale, rate) => {
                    let change = ConditionChange {
                        delay_ms: Some(delay),
                        drop_scale: Some(drop_scale),
                        loss: Some(Loss::Independent { rate: Probability::new(rate).unwrap() }),
                        duplication: Probability::new(0.1),
                        reordering: Probability::new(0.1),
                        corruption: Probability::new(0.1),
                        ..ConditionChange::default()
                    };
                    let link = LinkId::wireless(&id(robots[r]), &id(units[u]));
                    world.radio.change(now, &link, None, &change).unwrap();
                }
            }
            world.run(now);
        }
        world.run(now + ms(20_000));
        let counters = world.counters(now);
        prop_assert_eq!(counters.packets, world.arrived.len() as u64);
        prop_assert_eq!(world.radio.in_flight.len(), 0);
        // The number of copies of a group frame depends on the stations when it is sent.
        if !groups {
            let ended = counters.packets + counters.lost + counters.overflowed + world.radio.balance().under_way;
            prop_assert_eq!(world.pushed + counters.duplicated, ended);
            let mut packets = world.radio.balance();
            (packets.sent, packets.delivered) = (world.pushed, world.arrived.len() as u64);
            prop_assert!(packets.is_even(), "{packets:?}");
        }
    }
}

/// One robot near A. A and B are of different domains, and B is off.
fn domains(roaming: Roaming) -> World {
    let mut b = unit("B", 20.0, 6);
    b.domain = DomainId::new("other").unwrap();
    let NodeKind::RadioUnit(kind) = &mut b.kind else { panic!("a radio unit") };
    kind.serving = false;
    World::new(network(), vec![robot("r", 12.0, roaming), unit("A", 0.0, 1), b])
}

fn access_point(mobility_domain: u16, key: Option<u8>) -> AccessPoint {
    AccessPoint { ssid: "lab".into(), mobility_domain, key: key.map(|byte| FtKey([byte; 32])), core: None }
}

#[test]
fn radio_units_that_are_off_are_not_heard_or_joined() {
    // By signal, it would roam to B, which is closer.
    let mut world = domains(Roaming::Signal);
    world.radio.scan(at(0), &id("r")).unwrap();
    world.run(at(2_000));
    assert_eq!(world.attached("r"), Some(world.port("A")));
    let heard = world.radio.attachments(at(2_000), &id("r"));
    assert!(heard.iter().all(|a| a.radio_unit != id("B") || a.signal.is_none()), "{heard:?}");
    let attach = world.radio.attach(at(2_000), &id("r"), &id("B"));
    assert_eq!(attach, Err(FabricError::NotServing(id("B"))));
    assert_eq!(world.radio.switch_off(at(2_000), &id("B")), Err(FabricError::NotServing(id("B"))));
}

#[test]
fn frames_without_a_radio_unit_are_counted() {
    let mut off = unit("A", 0.0, 1);
    let NodeKind::RadioUnit(kind) = &mut off.kind else { panic!("a radio unit") };
    kind.serving = false;
    let mut world = World::new(network(), vec![robot("r", 1.0, Roaming::Signal), off]);
    world.up(at(0), "r", 100);
    world.run(at(1_000));
    assert_eq!(world.radio.balance(), Balance { stranded: 1, ..Balance::default() });
}

#[test]
fn a_vap_is_deployed_once_and_for_its_radio_units_network() {
    let mut world = domains(Roaming::Instructed);
    let other = AccessPoint { ssid: "other".into(), ..access_point(1, None) };
    let rejected = world.radio.switch_on(at(0), &id("B"), other).unwrap_err();
    assert!(matches!(&rejected, FabricError::OtherSsid { asked, .. } if asked == "other"), "{rejected}");
    world.radio.switch_on(at(0), &id("B"), access_point(1, None)).unwrap();
    let again = world.radio.switch_on(at(0), &id("B"), access_point(1, None));
    assert_eq!(again, Err(FabricError::Serving(id("B"))));
}

#[test]
fn a_robot_of_another_domain_needs_the_right_key() {
    let mut world = domains(Roaming::Instructed);
    world.radio.switch_on(at(0), &id("B"), access_point(1, Some(7))).unwrap();
    let other_ssid = AccessPoint { ssid: "labs".into(), ..access_point(1, Some(7)) };
    for wrong in [
        None,
        Some(access_point(1, Some(8))),
        Some(access_point(2, Some(7))),
        Some(access_point(1, None)),
        Some(other_ssid),
    ] {
        if let Some(wrong) = wrong {
            world.radio.provision(&id("r"), &id("B"), wrong).unwrap();
        }
        let rejected = FabricError::NotAdmitted { robot: id("r"), radio_unit: id("B") };
        assert_eq!(world.radio.attach(at(0), &id("r"), &id("B")), Err(rejected));
    }
    assert_eq!(world.attached("r"), Some(world.port("A")), "it stays where it was");
    world.radio.provision(&id("r"), &id("B"), access_point(1, Some(7))).unwrap();
    world.radio.attach(at(0), &id("r"), &id("B")).unwrap();
    world.run(at(100));
    let events = world.events();
    assert!(
        matches!(&events[0].event, Event::Handover(h) if h.to == id("B") && h.fast && h.gap == ms(30)),
        "{events:?}"
    );
}

#[test]
fn a_robot_without_a_key_joins_no_other_domain() {
    let mut world = domains(Roaming::Instructed);
    world.radio.switch_on(at(0), &id("B"), access_point(1, None)).unwrap();
    world.radio.switch_off(at(0), &id("A")).unwrap();
    world.radio.move_robot(at(0), &id("r"), Position::new(20.0, 0.0)).unwrap();
    world.run(at(5_000));
    assert_eq!(world.attached("r"), None);
}

#[test]
fn there_is_no_fast_transition_between_mobility_domains() {
    let mut world = domains(Roaming::Instructed);
    world.radio.switch_on(at(0), &id("B"), access_point(2, Some(7))).unwrap();
    world.radio.provision(&id("r"), &id("B"), access_point(2, Some(7))).unwrap();
    world.radio.attach(at(0), &id("r"), &id("B")).unwrap();
    world.run(at(100));
    assert!(matches!(&world.events()[0].event, Event::Handover(h) if !h.fast && h.gap == ms(70)));
}

#[test]
fn a_removed_vap_is_lost_also_during_a_handover_to_it() {
    for off_at in [10, 200] {
        let mut world = domains(Roaming::Instructed);
        world.radio.switch_on(at(0), &id("B"), access_point(1, Some(7))).unwrap();
        world.radio.provision(&id("r"), &id("B"), access_point(1, Some(7))).unwrap();
        world.radio.attach(at(0), &id("r"), &id("B")).unwrap();
        world.run(at(off_at));
        world.radio.switch_off(at(off_at), &id("B")).unwrap();
        world.run(at(5_000));
        let detached = world
            .events()
            .into_iter()
            .filter(|e| matches!(&e.event, Event::Detached { from, .. } if *from == id("B")));
        assert_eq!(detached.count(), 1, "taken down after {off_at} ms");
        assert_eq!(world.attached("r"), Some(world.port("A")), "it is back in its own domain");
    }
}
