use crate::virtual_time::*;

/// A robot with a camera walks 9 m and back.
const ROOM: &str = "
name: room
wireless: { lab: { shadowing: { deviation: 0 dB } } }
nodes:
  robot: { kind: robot, sensors: { front: { kind: camera, CAMERA } } }
  unit: { kind: radio_unit, position: [5, 3], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [unit, edge], delay: 2 ms, rate: 100 Mbit/s }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge, cpus: 2 }
      detector: { command: [sleep, '1000'], node: edge }
walks:
  robot: { waypoints: [[1, 0], [10, 0]], and_back: true, position_interval: 50 ms }
";
const SECONDS: f64 = 10.0;

fn events(camera: &str) -> Vec<Stamped> {
    let testbed =
        cotorra_testbed_file::parse("room.yaml", &ROOM.replace("CAMERA", camera), std::path::Path::new(""))
            .unwrap();
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let mut events = Vec::new();
    while simulation.now().as_secs_f64() < SECONDS {
        simulation.step();
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events
}

/// Bytes that crossed a link in that time, without dropped packets.
fn bytes(events: &[Stamped], link: &str, direction: Direction) -> u64 {
    let mut of_link = events.iter().filter_map(|stamped| match &stamped.event {
        Event::Link(context) if context.link == *link && context.direction == direction => {
            Some(context.counters.bytes)
        }
        _ => None,
    });
    of_link.next_back().unwrap()
}

fn service_times_ms(events: &[Stamped]) -> Vec<f64> {
    let took = events.iter().filter_map(|stamped| match &stamped.event {
        Event::ServiceTime(sample) => Some(sample.took?.as_secs_f64() * 1e3),
        _ => None,
    });
    let mut took: Vec<_> = took.collect();
    took.sort_by(f64::total_cmp);
    took
}

fn images(events: &[Stamped]) -> Vec<(u64, u64)> {
    let of = events.iter().filter_map(|stamped| match &stamped.event {
        Event::Sensor(reading) => reading.data.map(|data| (data.sequence, data.bytes)),
        _ => None,
    });
    of.collect()
}

#[test]
fn images_load_the_links_and_raise_the_service_time() {
    let (alone, beside) = (events("rate: 15 Hz"), events("rate: 15 Hz, to: detector"));
    for events in [&alone, &beside] {
        let told = |stamped: &Stamped| matches!(&stamped.event, Event::Notice { message } if message.contains("VNF detector does not run"));
        assert_eq!(events.iter().filter(|stamped| told(stamped)).count(), 1);
        let images = images(events);
        assert!((148..=151).contains(&images.len()), "{}", images.len());
        assert!(images.iter().enumerate().all(|(i, image)| *image == (i as u64, 320 * 240)));
    }
    let sent = (320.0 * 240.0) * 15.0 * SECONDS;
    for link in ["robot~unit", "unit-edge"] {
        let [alone, beside] = [&alone, &beside].map(|events| bytes(events, link, Direction::Forward) as f64);
        // Headers are 86 of 1366 bytes. Packets in flight and those before the last link context are missing.
        assert!(alone < 0.02 * sent, "{link}: {alone} bytes");
        let share = (beside - alone) / sent;
        assert!((1.0..1.08).contains(&share), "{link}: {share} of what the camera sends");
    }
    let [alone, beside] = [&alone, &beside].map(|events| service_times_ms(events));
    assert!(
        alone.len().abs_diff(beside.len()) < 4,
        "navigation goes on: {} and {}",
        alone.len(),
        beside.len()
    );
    let at = |times: &[f64], share: f64| times[(times.len() as f64 * share) as usize];
    // An image of 60 packets takes ten milliseconds of airtime, in aggregates of which each lasts for some.
    assert!(at(&beside, 0.99) > at(&alone, 0.99) + 5.0, "{} and {}", at(&beside, 0.99), at(&alone, 0.99));
    assert!(at(&beside, 0.25) < at(&alone, 0.75) + 1.0, "between images there is room");
}

#[test]
fn images_without_a_receiver_stay_on_the_robot() {
    let [small, large] = ["width: 32, height: 24", "width: 640, height: 480"].map(events);
    let crossed = |events: &[Stamped]| bytes(events, "unit-edge", Direction::Forward);
    assert_eq!(crossed(&small), crossed(&large));
}

#[test]
fn the_same_seed_gives_the_same_events() {
    const SMALL: &str = "to: detector, format: rgb8, width: 96, height: 64";
    assert_eq!(events(SMALL), events(SMALL));
}
