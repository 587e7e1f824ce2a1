use cotorra_graph::{ComponentId, Event, Instruction, SensorReading};

use crate::virtual_time::*;

/// A robot that walks 18 m and back.
const ROOM: &str = "
name: room
wireless: { lab: { path_loss: { model: log_distance, exponent: 3.0 } } }
nodes:
  robot: { kind: robot, roaming: signal }
  west: { kind: radio_unit, position: [0, 3], channel: 1 }
  east: { kind: radio_unit, position: [20, 3], channel: 6 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [west, east]] }
  - { ends: [lan, edge], delay: 2 ms }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge, cpus: 2 }
walks:
  robot: { waypoints: [[1, 0], [19, 0]], and_back: true }
";
const SENSORS: &str = "roaming: signal, clock: { phase: aligned, drift: 0 ppm }, sensors: {
      battery: { kind: battery, rate: 2 Hz, charge: 80 % }, imu: { kind: imu },
      wheels: { kind: odometry, rate: 20 Hz }, gripper: { kind: vector, size: 2, unit: N, rate: 4 Hz } } }";

fn room(with_sensors: bool) -> Arc<Testbed> {
    let text = if with_sensors { ROOM.replace("roaming: signal }", SENSORS) } else { ROOM.to_owned() };
    Arc::new(cotorra_testbed_file::parse("room.yaml", &text, std::path::Path::new("")).unwrap())
}

/// Returns the events of 30 s. The gripper reports 3 and 4 N at 10.1 s, and nothing afterwards.
fn events(testbed: Arc<Testbed>) -> Vec<Stamped> {
    let has_sensors = testbed.graph.robots().any(|(_, robot)| !robot.sensors.is_empty());
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let (mut events, mut reported) = (Vec::new(), !has_sensors);
    while simulation.now().as_secs_f64() < 30.0 {
        simulation.set_alarm(Some(Timestamp::from_secs_f64(if reported { 30.0 } else { 10.1 })));
        let now = simulation.step();
        if !reported && now.as_secs_f64() >= 10.1 {
            reported = true;
            let report = |sensor: &str, values: &[f64]| Instruction::Report {
                robot: "robot".parse().unwrap(),
                sensor: sensor.parse().unwrap(),
                values: values.to_vec(),
            };
            let plugin = || "test".parse().unwrap();
            for (sensor, values, refused) in [
                ("gripper", &[3.0][..], "has 2 numbers, and here are 1"),
                ("gripper", &[3.0, f64::INFINITY], "not all values"),
                ("battery", &[1.0, 1.0], "is no vector"),
                ("nose", &[1.0], "has no sensor `nose`"),
            ] {
                let told = simulation.instruct(Given::new(plugin(), report(sensor, values))).unwrap_err();
                assert!(told.to_string().contains(refused), "{told}");
            }
            for values in [[1.0, 1.0], [3.0, 4.0]] {
                simulation.instruct(Given::new(plugin(), report("gripper", &values))).unwrap();
            }
        }
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events
}

/// Returns the times, s, and readings of a sensor.
fn readings<'a>(events: &'a [Stamped], sensor: &str) -> Vec<(f64, &'a SensorReading)> {
    let of = events.iter().filter_map(|stamped| match &stamped.event {
        Event::Sensor(reading) if reading.sensor == *sensor => Some((stamped.at.as_secs_f64(), reading)),
        _ => None,
    });
    of.collect()
}

fn values(readings: &[(f64, &SensorReading)], component: &str) -> Vec<f64> {
    let component = ComponentId::new(component).unwrap();
    readings.iter().map(|(_, reading)| reading.values[&component]).collect()
}

#[test]
fn sensors_are_read_at_their_rates_and_show_what_the_robot_does() {
    let events = events(room(true));
    for (sensor, rate) in [("battery", 2.0), ("imu", 50.0), ("wheels", 20.0)] {
        let found = readings(&events, sensor);
        assert!(
            (29.0 * rate..=30.0 * rate + 1.0).contains(&(found.len() as f64)),
            "{sensor}: {}",
            found.len()
        );
        assert!(found.windows(2).all(|two| (two[1].0 - two[0].0 - 1.0 / rate).abs() < 1e-6), "{sensor}");
        assert!(found.iter().all(|(at, reading)| reading.measured.as_secs_f64() == *at));
    }
    let battery = readings(&events, "battery");
    let charge = values(&battery, "charge");
    assert!(charge[0] <= 0.8 && charge.windows(2).all(|two| two[1] < two[0]), "{charge:?}");
    // Between 5.8 W and 10.9 W of 32.6 Wh for half a minute.
    let used = (charge[0] - charge[charge.len() - 1]) * 32.56 * 3600.0 / 29.5;
    assert!((5.8..10.9).contains(&used), "{used} W");
    assert!(values(&battery, "voltage_v").iter().all(|volts| (volts - 15.8).abs() < 0.11));

    let imu = readings(&events, "imu");
    let mean = |component: &str| {
        let all = values(&imu, component);
        all.iter().sum::<f64>() / all.len() as f64
    };
    assert!((mean("acceleration_z") - 9.81).abs() < 0.7 && mean("acceleration_z") != 9.81);
    assert!(mean("angular_z").abs() < 0.1, "it goes straight on");

    let wheels = readings(&events, "wheels");
    let (x, linear) = (values(&wheels, "x"), values(&wheels, "linear"));
    let (way, driven) = (x[x.len() - 1] - x[0], linear.iter().sum::<f64>() / 20.0);
    assert!(way > 5.0 && (way / driven - 1.0).abs() < 0.05, "{way} m by {driven} m");
}

#[test]
fn a_vector_has_the_last_report_once_with_its_time() {
    let events = events(room(true));
    let gripper = readings(&events, "gripper");
    let [(at, reading)] = gripper[..] else { panic!("{gripper:?}") };
    assert_eq!((at, reading.measured), (10.25, Timestamp::from_secs_f64(10.1)));
    assert_eq!([values(&gripper, "0"), values(&gripper, "1")], [[3.0], [4.0]]);
}

#[test]
fn readings_depend_on_the_seed_and_exist_only_with_sensors() {
    let with = events(room(true));
    assert_eq!(with, events(room(true)));
    let without = events(room(false));
    assert!(!without.iter().any(|stamped| matches!(stamped.event, Event::Sensor(_))));
    let walked = |events: &[Stamped]| {
        let mut contexts = events.iter().filter_map(|stamped| match &stamped.event {
            Event::Robot(context) => Some(context.sensors.pose.x),
            _ => None,
        });
        contexts.next_back().unwrap()
    };
    let (with, without) = (walked(&with), walked(&without));
    assert!((with - without).abs() < 0.1, "reading does not move the robot: {with} m, {without} m");
}
