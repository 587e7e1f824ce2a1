use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use cotorra_graph::{DataFormat, Event, SensorReading};
use cotorra_measurements::{WantedData, read_large_data};

use crate::virtual_time::*;
use crate::{options::Options, report::Place};

const SENSORS: &str = "sensors: { front: { kind: lidar }, fast: { kind: lidar, rate: 50 Hz },
    slow: { kind: lidar, rate: 2 Hz, keep: 20 kB } }";
const NONE: &str = "sensors: { wheels: { kind: odometry } }";

fn testbeds() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds")
}

/// The corridor with these sensors on its robot.
fn text(sensors: &str) -> String {
    let text = fs::read_to_string(testbeds().join("corridor.yaml")).unwrap();
    let with_sensors = text.replace("robot: { kind: robot,", &format!("robot: {{ kind: robot, {sensors},"));
    assert_ne!(text, with_sensors);
    with_sensors
}

fn parse(text: &str) -> Testbed {
    cotorra_testbed_file::parse("corridor.yaml", text, &testbeds()).unwrap()
}

#[test]
fn large_data_precedes_its_event_and_matches_it() {
    let mut simulation = Simulation::new(Arc::new(parse(&text(SENSORS))), 1).unwrap();
    let (mut told, mut readings) = (VecDeque::new(), BTreeMap::<_, Vec<SensorReading>>::new());
    while simulation.now().as_secs_f64() < 10.0 {
        simulation.step();
        while let Some(happened) = simulation.poll() {
            match happened {
                Output::Data(data) => told.push_back(data),
                Output::Event(event) => {
                    let Event::Sensor(reading) = &event.event else { continue };
                    let data = told.pop_front().unwrap();
                    assert_eq!(Some(data.data), reading.data);
                    assert_eq!((data.at, data.measured), (event.at, reading.measured));
                    assert_eq!((&data.robot, &data.sensor), (&reading.robot, &reading.sensor));
                    assert_eq!(data.content.bytes().len() as u64, data.data.bytes);
                    readings.entry(reading.sensor.to_string()).or_default().push(reading.clone());
                }
                Output::Scan(_) => panic!("nobody taps scans"),
            }
        }
    }
    assert!(told.is_empty());
    // The lidar turns ten times a second, however often it is read.
    for (sensor, expected) in [("front", 95..=101), ("fast", 95..=101), ("slow", 18..=21)] {
        let readings = &readings[sensor];
        assert!(expected.contains(&readings.len()), "{sensor}: {}", readings.len());
        for (number, reading) in readings.iter().enumerate() {
            let data = reading.data.unwrap();
            assert_eq!((data.sequence, data.format), (number as u64, DataFormat::Scan));
            assert_eq!((data.width, data.height, data.bytes), (360, 1, 1500));
        }
        assert!(readings.windows(2).all(|two| two[0].measured < two[1].measured), "{sensor}");
    }
}

/// Returns all files in a folder and below, with their content.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|(below, bytes)| (format!("{name}/{below}"), bytes)));
        } else {
            found.insert(name, fs::read(path).unwrap());
        }
    }
    found
}

#[test]
fn a_run_keeps_the_last_large_data_with_the_same_bytes_for_the_same_seed() {
    let run = |sensors: &str, seed| {
        let out = tempfile::tempdir().unwrap();
        let options = Options {
            seed: Some(seed),
            until: Some(Duration::from_secs(15)),
            folder: Place::In(out.path().to_owned()),
            ..Options::default()
        };
        let text = text(sensors);
        let finished = simulate(parse(&text), &text, &options, |_| true).unwrap();
        assert_eq!(finished.unrecorded, [""; 0]);
        (finished.folder, out)
    };
    let (first, _out) = run(SENSORS, 1);
    let (second, _out) = run(SENSORS, 1);
    let (other, _out) = run(SENSORS, 2);
    let (without, _out) = run(NONE, 1);
    let kept = files(&first.join("sensors"));
    assert!(kept == files(&second.join("sensors")), "the same seed gives other bytes");
    assert!(kept != files(&other.join("sensors")), "another seed gives the same bytes");
    assert!(!without.join("sensors").exists());

    let (robot, slow) = ("robot".parse().unwrap(), "slow".parse().unwrap());
    let read = |wanted| read_large_data(&first, &robot, &slow, wanted).unwrap();
    let size: usize =
        kept.iter().filter(|(name, _)| name.starts_with("robot/slow/")).map(|(_, bytes)| bytes.len()).sum();
    assert!((17_500..=20_000).contains(&size), "{size}");
    let last = read(WantedData::UpTo(u64::MAX)).unwrap();
    assert!((27..=30).contains(&last.data.sequence), "{last:?}");
    assert_eq!(read(WantedData::Number(0)), None);
    let scan = cotorra_ros_messages::Message::decode_cdr(&last.bytes);
    let scan: cotorra_ros_messages::LaserScan = scan.unwrap();
    assert_eq!(
        (scan.ranges.len(), scan.header.stamp.sec),
        (360, (last.measured.as_nanos() / 1_000_000_000) as i32)
    );
}
