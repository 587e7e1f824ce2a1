//! Energy and used CPU time of runs in virtual time.

use std::path::Path;

use crate::{Summary, report::Losses, report::Report, virtual_time::*};

/// A robot drives along a hall at 0.3 m/s. Each answer takes 10 ms of a CPU of the edge, which has two.
const HALL: &str = "name: hall
currency: EUR
wireless: { lab: { access: turns, delay: 1 ms } }
nodes:
  r:
    kind: robot
    clock: { phase: aligned, drift: 0 ppm }
    power: { idle: 15 W, driving: 40 W, radio: { idle: 0.8 W, sending: 2 W, receiving: 1 W }, battery: 0.5 Wh, cost: 0.5 }
  unit: { kind: radio_unit, position: [10, 2], channel: 1 }
  edge:
    { kind: server, tier: edge, cpus: 2, memory: 8 GB, cost: 0, used_cost: 36, power: { idle: 100 W, full: 200 W, cost: 0.25 } }
links: [{ ends: [unit, edge], delay: 1 ms }]
walks: { r: { waypoints: [[0, 0], [40, 0]], position_interval: 50 ms } }
services:
  navigation:
    robot: r
    kpis:
      service_time: 50 ms
      require: [energy <= 0.11 Wh, robot_energy <= 1 Wh, battery_left >= 1 %, total_energy <= 3 Wh, total_bill <= 1]
    vnfs:
      driver: { program: robot_driver, pinned_to: r, cpus: 0 }
      brain: { program: navigation, node: edge, cpus: 0.5, demand: 10 ms }
";

fn run(text: &str, seconds: u64) -> (Summary, u64) {
    let testbed = Arc::new(cotorra_testbed_file::parse("hall.yaml", text, Path::new("")).unwrap());
    let mut report = Report::new(&testbed, 1).in_virtual_time(&testbed);
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let end = Timestamp::ZERO + Duration::from_secs(seconds);
    simulation.set_alarm(Some(end));
    while simulation.now() < end {
        simulation.step();
        std::iter::from_fn(|| simulation.poll_event()).for_each(|event| report.absorb(&event));
    }
    let computed = simulation.computed();
    let served = computed.vnfs.iter().map(|its| its.load.served).sum();
    report.computed(computed);
    report.sent(simulation.airtimes());
    (report.summary(end, "until", Losses::default()), served)
}

#[test]
fn energy_follows_the_load_and_the_way() {
    let (summary, served) = run(HALL, 60);
    let energy = summary.energy.as_ref().unwrap();
    let [edge] = &energy.servers[..] else { panic!("{energy:?}") };
    // 20 answers a second; one may be under way.
    assert!((1198..=1200).contains(&served), "{served}");
    let hours = 60.0 / 3600.0;
    assert!((edge.idle_energy_wh - 100.0 * hours).abs() < 1e-9, "{edge:?}");
    // 10 ms each on one of two CPUs: half of the difference.
    let load = edge.load_energy_wh.unwrap();
    let known = served as f64 * 0.01 * 50.0 / 3600.0;
    assert!((load - known).abs() <= 0.01 * 50.0 / 3600.0 + 1e-9, "{load} for {known}");
    assert_eq!(energy.services[0].energy_wh, Some(load), "all load is the one service's");
    let [robot] = &energy.robots[..] else { panic!("{energy:?}") };
    assert!(robot.driving_ms > 58_000.0, "it waits for the first answer: {robot:?}");
    assert!(robot.base_energy_wh > 39.0 * hours && robot.base_energy_wh < 40.0 * hours, "{robot:?}");
    assert_eq!(robot.computing_energy_wh, Some(0.0));
    let radio = robot.radio.unwrap();
    assert!(radio.transmit_airtime_ms > 100.0 && radio.receive_airtime_ms > 100.0, "{radio:?}");
    assert!(radio.energy_wh > 0.8 * hours && radio.energy_wh < 2.0 * hours, "{radio:?}");
    let all = edge.energy_wh + robot.energy_wh;
    assert!(
        (energy.total_energy_wh - all).abs() < 1e-12 && (energy.domains[0].energy_wh - all).abs() < 1e-12
    );
    let battery = robot.battery.unwrap();
    // 0.5 Wh last for 45 s at 40 W, and somewhat less with the radio.
    let empty = battery.empty.unwrap().as_secs_f64();
    assert!(battery.battery_left == 0.0 && (43.0..46.0).contains(&empty), "{battery:?}");
    assert_eq!(energy.empty_batteries().count(), 1);
    let verdicts: Vec<_> =
        summary.services[0].kpis.iter().map(|kpi| kpi.verdict.unwrap().to_string()).collect();
    assert_eq!(verdicts, ["FAIL", "PASS", "FAIL", "PASS", "PASS"]);
}

#[test]
fn energy_and_used_cpu_time_are_in_the_bill() {
    let (summary, _) = run(HALL, 60);
    let (bill, energy) = (summary.bill.unwrap(), summary.energy.unwrap());
    let computing = summary.computing.unwrap();
    let cpu_hours = computing.vnfs[0].cpu_time_ms / 3.6e6;
    let taken = bill.services[0].taken;
    assert!((taken.used_cpu_hours - cpu_hours).abs() < 1e-12 && taken.cpu_hours > cpu_hours, "{taken:?}");
    assert!((taken.used_cpu_price - 36.0 * cpu_hours).abs() < 1e-9 && taken.price == taken.used_cpu_price);
    let [robot, edge] = &bill.energy[..] else {
        panic!("{:?}", bill.energy);
    };
    let priced = |wh: f64, cost: f64| wh / 1000.0 * cost;
    let (edge, robot) = if edge.node.as_str() == "edge" { (edge, robot) } else { (robot, edge) };
    assert!((edge.price - priced(energy.servers[0].energy_wh, 0.25)).abs() < 1e-12, "{edge:?}");
    assert!((robot.price - priced(energy.robots[0].energy_wh, 0.5)).abs() < 1e-12, "{robot:?}");
    let all = taken.price + edge.price + robot.price;
    assert!((bill.total_price - all).abs() < 1e-12 && (bill.domains[0].price - all).abs() < 1e-12);
    assert!(
        bill.sentence().contains("CPU time ") && bill.sentence().contains("energy "),
        "{}",
        bill.sentence()
    );
}

#[test]
fn energy_is_additive_over_time() {
    let text = HALL.replace("battery: 0.5 Wh, ", "").replace("battery_left >= 1 %, ", "");
    let of = |seconds| run(&text, seconds).0.energy.unwrap();
    let (half, whole) = (of(30), of(60));
    // The second half of the run is like the first one: both drive, but for the start.
    assert!((whole.servers[0].idle_energy_wh - 2.0 * half.servers[0].idle_energy_wh).abs() < 1e-9);
    let loads = [&half, &whole].map(|its| its.servers[0].load_energy_wh.unwrap());
    assert!((loads[1] / loads[0] - 2.0).abs() < 0.01, "{loads:?}");
    assert!(whole.total_energy_wh > half.total_energy_wh);
}

#[test]
fn files_without_powers_have_no_energy() {
    let mut text = String::new();
    for line in HALL.lines().filter(|line| !line.contains("require:")) {
        let line = if line.starts_with("    power:") { "" } else { line };
        let line = line.replace(" used_cost: 36,", "");
        let line = line.replace(", power: { idle: 100 W, full: 200 W, cost: 0.25 }", "");
        text += &(line + "\n");
    }
    let (summary, _) = run(&text, 5);
    let json = serde_json::to_string(&summary).unwrap();
    assert!(!json.contains("energy") && !json.contains("used_cpu") && json.contains("\"bill\""), "{json}");
}
