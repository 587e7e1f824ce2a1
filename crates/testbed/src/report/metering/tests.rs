use std::path::Path;

use cotorra_graph::{CpuContext, MachineContext, Probability, Velocity};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use super::*;
use crate::computed::UsedComputer;

const LAB: &str = "name: lab
domains: [factory, operator, nobody]
wireless: { w: {} }
nodes:
  r:
    kind: robot
    cpus: 2
    power:
      { idle: 15 W, driving: 40 W, computing: 20 W, radio: { idle: 0.8 W, sending: 2 W, receiving: 1 W }, battery: 55 Wh }
  unit: { kind: radio_unit, position: [0, 2], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB, power: { idle: 100 W, full: 250 W } }
  cloud: { kind: server, tier: cloud, domain: operator, cpus: 4, memory: 8 GB, power: { idle: 10 W, full: 10 W } }
links: [{ ends: [unit, [edge, cloud]], delay: 1 ms }]
walks: { r: { waypoints: [[0, 0], [5, 0]] } }
";

fn metering() -> Metering {
    Metering::new(&cotorra_testbed_file::parse("lab.yaml", LAB, Path::new("")).unwrap()).unwrap()
}

fn at(seconds: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_secs(seconds)
}

fn drive(metering: &mut Metering, seconds: u64, speed: f64) {
    let velocity = Velocity::planar(speed, 0.0);
    let mut context = base::robot_context("r", base::pose(0.0, 0.0, 0.0));
    context.sensors.velocity = velocity;
    metering.absorb(&Stamped { at: at(seconds), event: Event::Robot(context) });
}

/// Tells the share of the edge's CPUs that was busy since the last time.
fn tell(metering: &mut Metering, seconds: u64, busy: f64) {
    let cpu = CpuContext { cpus: 4, busy: Probability::new(busy) };
    let context = MachineContext { cpu: Some(cpu), ..base::machine_context("edge") };
    metering.absorb(&Stamped { at: at(seconds), event: Event::Machine(context) });
}

/// Returns the energy where nothing computed and no frame was sent.
fn silent(metering: &Metering, end: u64) -> EnergySummary {
    let (computed, airtimes) = Default::default();
    metering.summary(at(end), &Known { computed: &computed, is_all: true, airtimes: &airtimes })
}

#[test]
fn an_idle_testbed_takes_its_idle_power() {
    let energy = silent(&metering(), 3600);
    let servers: Vec<_> = energy.nodes().collect();
    let [edge, cloud, robot] = &servers[..] else { panic!("{servers:?}") };
    assert_eq!([edge.1, cloud.1, robot.1], [100.0, 10.0, 15.0]);
    let domains: Vec<_> = energy.domains.iter().map(|its| its.energy_wh).collect();
    let written = serde_json::to_string(&energy).unwrap();
    assert!(!written.contains("-0"), "{written}");
    assert_eq!((domains, energy.total_energy_wh), (vec![115.0, 10.0, 0.0], 125.0));
    assert_eq!(energy.sentence(), "125.00 Wh: edge 100.00, cloud 10.00, r 15.00");
}

#[test]
fn load_is_known_by_cpu_time_or_by_contexts_or_not_at_all() {
    let mut metering = metering();
    let computed = ComputedSoFar {
        nodes: vec![UsedComputer {
            node: "edge".parse().unwrap(),
            cpus: 4.0,
            speed: 1.0,
            cpu_time: Duration::from_secs(7200),
        }],
        vnfs: Vec::new(),
    };
    let (nothing, airtimes) = Default::default();
    let real = Known { computed: &nothing, is_all: false, airtimes: &airtimes };
    let unknown = metering.summary(at(3600), &real);
    assert_eq!((unknown.servers[0].load_energy_wh, unknown.servers[0].energy_wh), (None, 100.0));
    assert_eq!(unknown.servers[1].load_energy_wh, Some(0.0), "its load takes nothing");
    assert_eq!((unknown.total(), unknown.of_robot(&"r".parse().unwrap())), (None, None));
    assert!(unknown.sentence().starts_with("at least 125.00 Wh"), "{}", unknown.sentence());
    // A quarter of an hour at all CPUs, and three at one of them.
    tell(&mut metering, 900, 1.0);
    tell(&mut metering, 3600, 0.25);
    let told = metering.summary(at(3600), &real).servers[0].load_energy_wh.unwrap();
    assert!((told - 150.0 * (0.25 + 0.75 * 0.25)).abs() < 1e-9, "{told}");
    // Two hours of CPU time within an hour are half of four CPUs. They are exact, and contexts are not.
    let exact = metering.summary(at(3600), &Known { computed: &computed, is_all: true, airtimes: &airtimes });
    assert_eq!((exact.servers[0].load_energy_wh, exact.total()), (Some(75.0), Some(200.0)));
}

#[test]
fn a_robot_takes_the_energy_of_driving_computing_and_its_radio() {
    let mut metering = metering();
    drive(&mut metering, 600, 0.3);
    drive(&mut metering, 700, 0.2);
    drive(&mut metering, 1320, 0.0);
    let computed = ComputedSoFar {
        nodes: vec![UsedComputer {
            node: "r".parse().unwrap(),
            cpus: 2.0,
            speed: 1.0,
            cpu_time: Duration::from_secs(3600),
        }],
        vnfs: Vec::new(),
    };
    let airtime = Airtime { sending: Duration::from_secs(360), receiving: Duration::from_secs(720) };
    let airtimes = BTreeMap::from([("r".parse().unwrap(), airtime)]);
    let energy =
        metering.summary(at(3600), &Known { computed: &computed, is_all: true, airtimes: &airtimes });
    let [robot] = &energy.robots[..] else { panic!("{energy:?}") };
    // 720 s of driving: a fifth of an hour.
    assert_eq!((robot.driving_ms, robot.base_energy_wh), (720_000.0, 20.0));
    assert_eq!(robot.computing_energy_wh, Some(10.0));
    let radio = robot.radio.unwrap();
    // A tenth of an hour at 2 W, a fifth at 1 W, and the rest at 0.8 W.
    assert!((radio.energy_wh - (0.2 + 0.2 + 0.7 * 0.8)).abs() < 1e-9, "{radio:?}");
    let battery = robot.battery.unwrap();
    assert!((battery.battery_left - (1.0 - robot.energy_wh / 55.0)).abs() < 1e-12, "{battery:?}");
    assert_eq!(battery.empty, None);
    assert_eq!(energy.battery_left(&"r".parse().unwrap()), Some(battery.battery_left));
}

#[test]
fn a_battery_is_empty_once_its_energy_is_taken() {
    let mut metering = metering();
    // 15 Wh in the first hour; the other 40 Wh last one more at 40 W.
    drive(&mut metering, 3600, 0.3);
    let energy = silent(&metering, 3 * 3600);
    let battery = energy.robots[0].battery.unwrap();
    assert_eq!((battery.battery_left, battery.empty), (0.0, Some(at(7200))));
    let empty: Vec<_> = energy.empty_batteries().collect();
    assert_eq!(empty, ["the battery of r was empty after 7200.0 s, and the robot went on"]);
    assert_eq!(silent(&metering, 7000).empty_batteries().count(), 0);
}

#[test]
fn a_testbed_without_powers_is_not_metered() {
    let mut testbed = cotorra_testbed_file::parse("lab.yaml", LAB, Path::new("")).unwrap();
    for node in &mut testbed.graph.nodes {
        match &mut node.kind {
            cotorra_graph::NodeKind::Server(server) => server.power = None,
            cotorra_graph::NodeKind::Robot(robot) => robot.power = None,
            _ => {}
        }
    }
    assert!(Metering::new(&testbed).is_none());
}

proptest! {
    #[test]
    fn energy_never_falls_and_a_battery_is_empty_when_the_energy_says_so(
        changes in prop::collection::vec((1_u64..4000, any::<bool>()), 0..20), end in 1_u64..40_000,
    ) {
        let (mut metering, mut now, mut last) = (metering(), 0, 0.0);
        for (after, moves) in changes {
            now += after;
            if now > end {
                break;
            }
            drive(&mut metering, now, if moves { 0.3 } else { 0.0 });
            let energy = silent(&metering, now).robots[0].energy_wh;
            prop_assert!(energy >= last && energy >= 15.0 * now as f64 / 3600.0 - 1e-9);
            last = energy;
        }
        let energy = silent(&metering, end);
        let battery = energy.robots[0].battery.unwrap();
        prop_assert_eq!(battery.empty.is_some(), energy.robots[0].energy_wh >= 55.0);
        if let Some(empty) = battery.empty {
            // The closed form at that time is the whole battery.
            let drove = metering.robots[0].1.stretches(empty).filter(|(.., moves)| *moves);
            let drove: Duration = drove.map(|(from, to, _)| empty.min(to).since(from)).sum();
            let taken = metering.robots[0].0.power.base_wh(empty.since(Timestamp::ZERO), drove);
            prop_assert!((taken - 55.0).abs() < 1e-6, "{} Wh at {}", taken, empty);
        }
    }
}
