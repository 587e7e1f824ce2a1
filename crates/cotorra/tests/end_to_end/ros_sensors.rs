//! Sensors of robots in ROS: programs of ROS 1 and Cyclone DDS publish, and a run reads.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{path::Path, process::Command};

use cotorra_testing::{process::Process, python, ros1::Ros, ros2::Meeting};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    harness::{Run, wait_until},
    one_robot::testbed,
};

/// Runs a testbed with a robot behind a driver.
fn driven(folder: &Path, driver: &str) -> Run {
    let sensors = "
      imu: { kind: imu }
      pack: { kind: battery, topic: power, rate: 10 Hz }
      front: { kind: lidar }
      camera: { kind: camera, rate: 5 Hz }
      depth: { kind: camera, topic: depth/image_raw }
      small: { kind: camera, topic: /tb2/pi/image/compressed }
      fingers: { kind: vector, size: 2, topic: fingers }
      toes: { kind: vector, size: 2, topic: toes }
      nobody: { kind: imu, topic: nobody }";
    let robot = format!("\n    kind: robot\n    driver: {driver}\n    sensors:{sensors}");
    let walk = "walks: { tb: { waypoints: [[2, 3], [5, 3]] } }\n";
    Run::start_beside(&testbed(folder, "sensing", &robot, walk), &[])
}

/// Returns the last reading of a sensor, or null if there is none.
fn last(run: &Run, sensor: &str) -> Value {
    let all = run.get("/api/v1/robots/tb/sensors");
    all.as_array().unwrap().iter().find(|one| one["declared"]["sensor"] == sensor).unwrap()["last"].clone()
}

/// Asserts the readings of a robot that runs `ros1_sensors.py` or `ros2_sensors.py`.
fn assert_readings(run: &Run) {
    for sensor in ["imu", "pack", "front", "camera", "small", "fingers"] {
        wait_until(|| last(run, sensor).is_object());
    }
    let read = |sensor: &str| last(run, sensor);
    let turns = json!({ "angular_x": 0.0, "angular_y": 0.0, "angular_z": 0.25 });
    let mut moves = json!({ "acceleration_x": 0.0, "acceleration_y": 0.0, "acceleration_z": 9.75 });
    moves.as_object_mut().unwrap().extend(turns.as_object().unwrap().clone());
    assert_eq!(read("imu")["values"], moves);
    assert_eq!(read("pack")["values"], json!({ "voltage_v": 16.5 }), "its charge is not known");
    assert_eq!(read("fingers")["values"], json!({ "0": 0.5, "1": -2.0 }));
    let large = |sensor: &str| {
        let data = &read(sensor)["data"];
        ["format", "width", "height", "bytes"].map(|key| data[key].clone())
    };
    let data =
        |format: &str, width, height, bytes| [json!(format), json!(width), json!(height), json!(bytes)];
    assert_eq!(large("camera"), data("rgb8", 640, 480, 640 * 480 * 3));
    assert_eq!(large("small"), data("png", 640, 480, 29));
    assert_eq!(large("front")[..3], data("scan", 3, 1, 0)[..3]);
    let (bytes, header) = run.bytes("/api/v1/robots/tb/sensors/camera/latest");
    let pixels = (0..480u32).flat_map(|y| (0..640u32).flat_map(move |x| [y as u8, 7, x as u8]));
    assert!(bytes.iter().copied().eq(pixels), "blue and red change places, and rows lose their padding");
    assert_eq!(
        (header("X-Cotorra-Format"), header("X-Cotorra-Width")),
        ("rgb8".to_owned(), "640".to_owned())
    );
    let (bytes, header) = run.bytes("/api/v1/robots/tb/sensors/small/latest");
    assert_eq!(bytes, b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02\0\0\0");
    assert_eq!(header("Content-Type"), "image/png");
    // Readings continue at the sensor's rate, with their times.
    let sequence = |sensor: &str| read(sensor)["data"]["sequence"].as_u64().unwrap();
    let before = sequence("camera");
    wait_until(|| sequence("camera") > before + 3);
    let camera = read("camera");
    assert!(camera["measured_ns"].as_u64().unwrap() > 0, "{camera}");
    let at = |reading: &Value| reading["measured_ns"].as_u64().unwrap() / 200_000_000;
    let events = run.get("/api/v1/measurements/events?kinds=sensor&limit=10000");
    let images: Vec<_> =
        events["items"].as_array().unwrap().iter().filter(|event| event["sensor"] == "camera").collect();
    assert!(images.len() > 3, "{images:?}");
    let seconds = at(images[images.len() - 1]) - at(images[0]);
    assert!(images.len() as u64 <= seconds + 2, "five a second at most: {images:?}");
    // A sensor that cannot be read is reported once, and the others continue.
    assert_eq!([read("depth"), read("toes"), read("nobody")], [Value::Null, Value::Null, Value::Null]);
    let notices = || run.get("/api/v1/measurements/events?kinds=notice")["items"].to_string();
    let expected = [
        "robot tb, sensor depth: its pixels are `16UC1`, where `mono8`, `rgb8` and `bgr8` are read",
        "robot tb, sensor toes: it has 2 numbers, and its topic 5",
    ];
    wait_until(|| expected.iter().all(|notice| notices().contains(notice)));
    let notices = notices();
    for notice in expected {
        assert_eq!(notices.matches(notice).count(), 1, "{notices}");
    }
}

#[test]
fn sensors_of_a_robot_in_ros_1_are_read() {
    let Some(ros) = Ros::start() else { return };
    let folder = TempDir::new().unwrap();
    let master = format!("http://127.0.0.1:{}", ros.port());
    let run = driven(folder.path(), &format!("{{ kind: ros1, master: '{master}', namespace: /tb2 }}"));
    let _robot = ros.python("sensors.py", include_str!("ros1_sensors.py"));
    assert_readings(&run);
}

#[test]
fn sensors_of_a_robot_in_ros_2_are_read() {
    let Some(python) = python("cyclonedds", "Cyclone DDS") else { return };
    let (meeting, folder) = (Meeting::new(), TempDir::new().unwrap());
    let driver =
        format!("{{ kind: ros2, domain: {}, interface: 127.0.0.1, namespace: /tb2 }}", meeting.domain());
    let run = driven(folder.path(), &driver);
    let only_loopback = "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>\
        </General><Discovery><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>";
    let mut robot = Command::new(python);
    robot.args(["-u", "-c", include_str!("ros2_sensors.py"), &meeting.domain().to_string(), "/tb2"]);
    let robot = Process::spawn(robot.env("CYCLONEDDS_URI", only_loopback)).unwrap();
    robot.prints("ready");
    assert_readings(&run);
}
