//! Links that keep the reservations of mappings.

use cotorra_bandwidth::{Bandwidth, Change, Consumer, Seen, Survey, types::BwInfo};

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
    let [from, to] = ["robot", "cloud"].map(|node| node.parse().unwrap());
    let map = Instruction::Map { from, to, links, reservation: None };
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

/// Returns the goodput of the other host over 10 s, Mbit/s, from a second on: what waited before a change leaves as it was.
fn goodput(simulation: &mut Simulation) -> f64 {
    let mut step_to = |seconds: f64| {
        let until = simulation.now().as_secs_f64() + seconds;
        while simulation.step().as_secs_f64() < until {}
        simulation.traffic()[0].bytes
    };
    let [start, end] = [1.0, 10.0].map(&mut step_to);
    (end - start) as f64 * 8e-6 / 10.0
}

#[test]
fn an_allocation_of_bandwidth_shapes_the_traffic_of_its_session() {
    let testbed = cotorra_testbed_file::parse("test.yaml", FILLED, Path::new("")).unwrap();
    let testbed = Arc::new(testbed);
    let mut simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap();
    let mut service = Bandwidth::new(Arc::clone(&testbed));
    let nodes = ["fog", "cloud"].map(|node| node.parse::<NodeId>().unwrap());
    let [source, target] = nodes.each_ref().map(|node| testbed.graph.address(node).unwrap().ipv4);
    let survey = Survey {
        nodes: [("navigation".parse().unwrap(), vec![nodes[1].clone()])].into(),
        ..Survey::default()
    };
    let seen = Seen { consumer: &Consumer::Operator, part: &testbed, survey: &survey };
    let info = |rate: &str| -> BwInfo {
        serde_json::from_value(serde_json::json!({
            "appInsId": "navigation", "requestType": 1, "fixedAllocation": rate, "allocationDirection": "01",
            "sessionFilter": [{ "sourceIp": source, "dstAddress": target }],
        }))
        .unwrap()
    };
    let give = |simulation: &mut Simulation, change: &Change| {
        for instruction in change.instructions() {
            simulation.instruct(Given::new("test".parse().unwrap(), instruction)).unwrap();
        }
    };
    let mut rates = vec![goodput(&mut simulation)];
    let change = service.create(seen, info("3000000")).unwrap();
    give(&mut simulation, &change);
    let resource = service.commit("", change).unwrap();
    rates.push(goodput(&mut simulation));
    let change = service.replace(seen, "1", Some(&resource.etag), info("5000000")).unwrap();
    give(&mut simulation, &change);
    service.commit("", change);
    rates.push(goodput(&mut simulation));
    let change = service.remove(seen, "1", None).unwrap();
    give(&mut simulation, &change);
    rates.push(goodput(&mut simulation));
    println!("goodput without, with 3 and 5 Mbit/s, and without: {rates:.2?} Mbit/s");
    // Headers of packets count for the link, not for the goodput.
    for (rate, expected) in rates.iter().zip([9.72, 2.92, 4.86, 9.72]) {
        assert!((rate / expected - 1.0).abs() < 0.03, "{rates:?}");
    }
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
