//! Links that keep the reservations of mappings.

use super::*;

/// A robot is navigated over a wire of 10 Mbit/s that another host fills.
const FILLED: &str = "
name: filled
wireless: { lab: { delay: 1 ms } }
nodes:
  robot: { kind: robot }
  unit: { kind: radio_unit, position: [5, 3], channel: 1 }
  fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [unit, fog]], delay: 0.5 ms, rate: 100 Mbit/s }
  - { ends: [lan, cloud], delay: 4 ms, rate: 10 Mbit/s, queue: 100 packets }
traffic:
  video: { from: fog, to: cloud, protocol: udp, rate: 11 Mbit/s }
services:
  navigation:
    robot: robot
    kpis: { service_time: 30 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: cloud, cpus: 2 }
    virtual_links: [{ from: robot-driver, to: navigation, rate: 1 Mbit/s }]
walks:
  robot: { waypoints: [[0, 0], [10, 0]], and_back: true, position_interval: 50 ms }
";

/// Returns the service times of 20 s, sorted, from 5 s on, and the goodput of the other host, Mbit/s. Those of unanswered
/// packets are the longest.
fn measured(reservations: &str) -> (Vec<Duration>, f64) {
    let text = format!("{FILLED}reservations: {reservations}\n");
    let testbed = cotorra_testbed_file::parse("test.yaml", &text, Path::new("")).unwrap();
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let links = ["robot~unit", "lan-unit", "lan-cloud"].map(|link| link.parse().unwrap()).to_vec();
    let map = Instruction::Map { from: "robot".parse().unwrap(), to: "cloud".parse().unwrap(), links };
    simulation.instruct(Given::new("test".parse().unwrap(), map)).unwrap();
    let mut took = Vec::new();
    while simulation.step().as_secs_f64() < 20.0 {
        while let Some(stamped) = simulation.poll_event() {
            if let Event::ServiceTime(sample) = stamped.event
                && sample.emitted.as_secs_f64() > 5.0
            {
                took.push(sample.took.unwrap_or(Duration::MAX));
            }
        }
    }
    took.sort_unstable();
    (took, simulation.traffic()[0].goodput_bps / 1e6)
}

#[test]
fn a_reservation_keeps_the_target_beside_traffic_that_fills_the_wire() {
    let [counted, guaranteed, limited] = ["counted", "guaranteed", "limited"].map(measured);
    let quantile = |(took, _): &(Vec<Duration>, f64), share: usize| took[took.len() * share / 100];
    for (name, of) in [("counted", &counted), ("guaranteed", &guaranteed), ("limited", &limited)] {
        println!("{name}: p50 {:?}, p95 {:?}, video {:.2} Mbit/s", quantile(of, 50), quantile(of, 95), of.1);
    }
    // 100 full frames wait for 121 ms.
    assert!(counted.0.len() > 100 && quantile(&counted, 50) > Duration::from_millis(100));
    for kept in [&guaranteed, &limited] {
        assert!(kept.0.len() > 100 && quantile(kept, 95) < Duration::from_millis(20));
        // The wire stays full: what navigation leaves over goes to the other host.
        assert!(kept.1 > 0.98 * counted.1, "{} and {}", kept.1, counted.1);
    }
}
