//! Reads testbed files: YAML with references to maps and traces.
//!
//! A file is read and checked as a whole. A testbed that passes can run; otherwise [`Diagnostics`] lists all mistakes, each with
//! its place and a correct alternative. [`schema`] returns the JSON Schema. Both come from the declarations in `records.rs`.
#![forbid(unsafe_code)]

mod bound;
mod build;
mod carry;
mod check;
pub mod compose;
mod dependencies;
mod file;
mod image;
pub mod map_server;
pub mod png;
mod python;
mod records;
mod setting;
mod vnf_keys;
mod walls;
mod yaml;

use std::{io, path::Path};

use cotorra_graph::{Retentions, Testbed};
use serde_json::{Value as Json, json};

use self::yaml::{Sink, decode::Decode};
pub use self::{
    build::{COMMAND_LINE, SCHEDULE},
    carry::{Carried, CarriedFile, Contents, LEDGER_PATHS, carry, carry_all},
    dependencies::{Dependencies, Dependency, dependencies},
    setting::{InvalidSetting, Setting},
    vnf_keys::{VnfKeysError, set_vnf_keys},
    yaml::{Diagnostic, Diagnostics},
};

/// Reads a testbed file, and the map and traces that it names.
///
/// # Errors
/// All mistakes, each with its place.
pub fn load(path: impl AsRef<Path>) -> Result<Testbed, Diagnostics> {
    load_with(path, &[])
}

/// Reads a testbed file with settings from outside.
///
/// # Errors
/// All mistakes, each with its place.
pub fn load_with(path: impl AsRef<Path>, settings: &[Setting]) -> Result<Testbed, Diagnostics> {
    let path = path.as_ref();
    let name = path.display().to_string();
    let text = read(path).map_err(|error| {
        Diagnostics::of_file(&name, format!("the testbed file cannot be read: {error}"), "check its path")
    })?;
    parse_with(&name, &text, path.parent().unwrap_or(Path::new("")), settings)
}

/// Reads the text of a testbed file, which may be a pipe.
///
/// # Errors
/// When it cannot be read, is not UTF-8, or has more than 32 MiB.
pub fn read(path: &Path) -> io::Result<String> {
    file::read_text_or_pipe(path)
}

/// Parses a testbed file's text. Relative paths in it start at `base_dir`.
///
/// # Errors
/// All mistakes, each with its place.
pub fn parse(source_name: &str, text: &str, base_dir: &Path) -> Result<Testbed, Diagnostics> {
    parse_with(source_name, text, base_dir, &[])
}

/// Parses a testbed file's text with settings from outside. The settings that its last lines note, as [`annotated`] writes
/// them, apply before.
///
/// # Errors
/// All mistakes, each with its place. A setting's place is its line in [`annotated`].
pub fn parse_with(
    source_name: &str,
    text: &str,
    base_dir: &Path,
    settings: &[Setting],
) -> Result<Testbed, Diagnostics> {
    parse_with_warnings(source_name, text, base_dir, settings).map(|(testbed, _)| testbed)
}

/// As [`parse_with`], and returns warnings, too: what is valid, but to be checked before results are trusted.
///
/// # Errors
/// All mistakes, each with its place.
pub fn parse_with_warnings(
    source_name: &str,
    text: &str,
    base_dir: &Path,
    settings: &[Setting],
) -> Result<(Testbed, Option<Diagnostics>), Diagnostics> {
    let mut sink = Sink::default();
    let text = annotated(text, settings);
    let testbed = tree(&text, &mut sink)
        .and_then(|root| records::TestbedRecord::decode(&root, &mut sink))
        .and_then(|record| {
            let testbed = build::build(&record, base_dir, &mut sink)?;
            check::check(&record, &testbed, &mut sink);
            Some(testbed)
        });
    match testbed {
        Some(testbed) if sink.is_empty() => Ok((testbed, sink.finish_warnings(source_name, &text))),
        _ => Err(sink.finish(source_name, &text)),
    }
}

/// Parses an annotated text, and applies the settings that it notes.
fn tree(text: &str, sink: &mut Sink) -> Option<yaml::decode::Node> {
    let mut root = yaml::parse(text, sink)?;
    let (settings, places) = setting::noted(text);
    setting::apply(&mut root, &settings, &places, sink);
    Some(root)
}

/// Reads the retention settings of a testbed file, even if other parts of it are no longer valid. Returns `None` if
/// they cannot be read.
pub fn retentions(text: &str) -> Option<Retentions> {
    let mut sink = Sink::default();
    let record = records::TestbedRecord::decode(&yaml::parse(text, &mut sink)?, &mut sink)?;
    let found = build::retentions(&record.history.retention, &mut sink);
    sink.is_empty().then_some(found)
}

/// Returns a testbed file's text with the settings appended as comments, for the record.
pub fn annotated(text: &str, settings: &[Setting]) -> String {
    setting::annotate(text, settings)
}

/// Returns the JSON Schema (2020-12) of a testbed file.
pub fn schema() -> Json {
    let mut schema = records::TestbedRecord::schema();
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("cotorra testbed file");
    schema
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use proptest::prelude::*;

    use super::*;
    use crate::yaml::decode::Node;
    use cotorra_graph::{
        Driver, HostAddress, NodeId, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork, RosTopics,
        SensorKind, SensorMessage,
    };

    fn testbeds() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds")
    }

    /// Returns how a value violates a schema. Knows the keywords that the schema uses, except patterns.
    fn violation(value: &Json, schema: &Json, path: &str) -> Option<String> {
        if let Some(any) = schema.get("anyOf").or_else(|| schema.get("oneOf")).and_then(Json::as_array) {
            let fitting = any.iter().filter(|s| violation(value, s, path).is_none()).count();
            return (fitting != 1).then(|| format!("{path}: fits {fitting} of {} kinds", any.len()));
        }
        let wrong = |what: &str| Some(format!("{path}: {what}"));
        if schema.get("const").is_some_and(|c| c != value) {
            return wrong("another constant");
        }
        if schema.get("enum").and_then(Json::as_array).is_some_and(|all| !all.contains(value)) {
            return wrong("not in the enumeration");
        }
        let fits = match schema.get("type").and_then(Json::as_str) {
            Some("object") => value.is_object(),
            Some("array") => value.is_array(),
            Some("string") => value.is_string(),
            Some("boolean") => value.is_boolean(),
            Some("number") => value.is_number(),
            Some("integer") => value.is_u64(),
            Some(other) => panic!("{path}: the schema says `{other}`"),
            None => schema.get("const").or(schema.get("enum")).is_some(),
        };
        if !fits {
            return wrong("another type");
        }
        if let Some(object) = value.as_object() {
            for key in schema["required"].as_array().into_iter().flatten().filter_map(Json::as_str) {
                if !object.contains_key(key) {
                    return wrong(&format!("`{key}` is missing"));
                }
            }
            for (key, value) in object {
                let below = format!("{path}/{key}");
                let violation = match (schema["properties"].get(key), schema.get("additionalProperties")) {
                    (None, Some(Json::Bool(false))) => Some(format!("{below}: unknown key")),
                    (Some(schema), _) | (None, Some(schema)) => violation(value, schema, &below),
                    (None, None) => None,
                };
                if violation.is_some() {
                    return violation;
                }
            }
        }
        let mut items = value.as_array().into_iter().flatten().enumerate();
        items.find_map(|(i, item)| violation(item, &schema["items"], &format!("{path}/{i}")))
    }

    fn json_of(text: &str) -> Json {
        let mut sink = Sink::default();
        yaml::parse(text, &mut sink).map(|root: Node| root.to_json()).unwrap()
    }

    #[test]
    fn shipped_files_fit_the_schema() {
        let schema = schema();
        for name in ["corridor.yaml", "two-hosts.yaml", "two-paths.yaml"] {
            let text = std::fs::read_to_string(testbeds().join(name)).unwrap();
            assert_eq!(violation(&json_of(&text), &schema, name), None);
        }
        let wrong = json_of("name: x\nnodes: { a: { kind: switch, tier: fog } }\n");
        assert!(violation(&wrong, &schema, "").is_some());
    }

    /// Every default of the schema is accepted by the decoder of its key, and every key is described.
    #[test]
    fn schema_describes_every_key() {
        fn walk(schema: &Json, path: &str) {
            if let Some(properties) = schema.get("properties").and_then(Json::as_object) {
                for (key, below) in properties {
                    let path = format!("{path}/{key}");
                    assert!(below.get("description").is_some() || below.get("const").is_some(), "{path}");
                    walk(below, &path);
                }
            }
            for (i, below) in
                ["anyOf", "oneOf"].iter().filter_map(|k| schema.get(*k)?.as_array()).flatten().enumerate()
            {
                walk(below, &format!("{path}/{i}"));
            }
            for key in ["items", "additionalProperties"] {
                if let Some(below) = schema.get(key) {
                    walk(below, &format!("{path}/{key}"));
                }
            }
        }
        walk(&schema(), "");
    }

    #[test]
    fn defaults_are_what_the_schema_says() {
        let text = "name: x\nwireless: { w: {} }\nnodes:\n  r: { kind: robot, position: [0, 0] }\n  \
                    U: { kind: radio_unit, position: [0, 0], channel: 1 }\n";
        let testbed = parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"));
        let (_, robot) = testbed.graph.robots().next().unwrap();
        assert_eq!(robot.network, "w");
        assert_eq!(robot.capacity.memory_bytes, 8_000_000_000);
        assert_eq!(testbed.graph.domains, ["local"]);
        assert_eq!(testbed.seed, 1);
    }

    #[test]
    fn a_robot_in_ros_2_is_described_by_a_word_or_at_length() {
        let text = "name: x\nwireless: { w: {} }\nnodes:\n  U: { kind: radio_unit, position: [0, 0], channel: 1 }\n  \
                    a: { kind: robot, position: [0, 0], driver: ros2 }\n  \
                    b: { kind: robot, position: [0, 0], driver: { kind: ros2, domain: 42, interface: 127.0.0.1, \
                    namespace: tb2, topics: { scan: /lidar } } }\n  \
                    c: { kind: robot, position: [0, 0], offer: ros2 }\n  \
                    d: { kind: robot, position: [0, 0], offer: { kind: ros2, network: machine, domain: 0, clock: true } \
                    }\n  \
                    e: { kind: robot, position: [0, 0], driver: { kind: ros2, rmw: zenoh } }\n  \
                    f: { kind: robot, position: [0, 0], driver: { kind: ros2, rmw: zenoh, domain: 3, \
                    router: tcp/tb3.local:7448 } }\n";
        let testbed = parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"));
        let drivers: Vec<_> = testbed.graph.robots().map(|(_, robot)| robot.driver.clone()).collect();
        let over =
            |rmw, domain| Ros2 { rmw, domain, namespace: "/".to_owned(), topics: RosTopics::default() };
        let ros2 = |network, domain| over(Rmw::Dds { network, interface: None }, domain);
        let interface = Some([127, 0, 0, 1].into());
        let mut tb2 = over(Rmw::Dds { network: RosNetwork::Machine, interface }, Some(42));
        tb2.namespace = "/tb2".to_owned();
        tb2.topics.scan = "/lidar".to_owned();
        let offer = |ros2, clock| {
            let ros = Ros::Ros2(Box::new(ros2));
            Driver::Simulated { offer: Some(Offer { ros, clock }) }
        };
        let zenoh = |router: &str, domain| over(Rmw::Zenoh { router: router.to_owned() }, domain);
        assert_eq!(drivers[0], Driver::Ros2(Box::new(ros2(RosNetwork::Machine, None))));
        assert_eq!(tb2.resolved("odom"), "/tb2/odom");
        assert_eq!(drivers[1], Driver::Ros2(Box::new(tb2)));
        assert_eq!(drivers[2], offer(ros2(RosNetwork::Testbed, None), false));
        assert_eq!(drivers[3], offer(ros2(RosNetwork::Machine, Some(0)), true));
        assert_eq!(drivers[4], Driver::Ros2(Box::new(zenoh("tcp/localhost:7447", None))));
        assert_eq!(drivers[5], Driver::Ros2(Box::new(zenoh("tcp/tb3.local:7448", Some(3)))));
        assert_eq!(violation(&json_of(text), &schema(), "x"), None);
    }

    #[test]
    fn sensors_of_a_robot_in_ros_have_topics() {
        let text = "name: x\nwireless: { w: {} }\nnodes:\n  U: { kind: radio_unit, position: [0, 0], channel: 1 }\n  \
                    a: { kind: robot, position: [0, 0], driver: ros2, sensors: { imu: { kind: imu }, \
                    pack: { kind: battery }, front: { kind: lidar }, hand: { kind: vector, size: 2 } } }\n  \
                    b: { kind: robot, position: [0, 0], driver: ros1, sensors: { camera: { kind: camera, keep: 1 MB }, \
                    pi: { kind: camera, topic: /pi/image/compressed }, \
                    imu: { kind: imu, topic: imu/data, rate: 200 Hz }, \
                    hand: { kind: vector, size: 2, topic: hand } } }\n";
        let testbed = parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"));
        let robots: Vec<_> = testbed.graph.robots().map(|(_, robot)| robot.clone()).collect();
        let topics = |topics: &RosTopics| -> Vec<_> {
            let all = topics.sensors.iter();
            all.map(|(sensor, topic)| (sensor.to_string(), topic.name.clone(), topic.message)).collect()
        };
        let topic = |sensor: &str, name: &str, message| (sensor.to_owned(), name.to_owned(), message);
        let (Driver::Ros2(a), Driver::Ros1(b)) = (&robots[0].driver, &robots[1].driver) else { panic!() };
        let (imu, array) = (SensorMessage::Imu, SensorMessage::Float64MultiArray);
        let expected =
            [topic("imu", "imu", imu), topic("pack", "battery_state", SensorMessage::BatteryState)];
        assert_eq!(topics(&a.topics), expected);
        let expected = [
            topic("camera", "camera/image_raw", SensorMessage::Image),
            topic("hand", "hand", array),
            topic("imu", "imu/data", imu),
            topic("pi", "/pi/image/compressed", SensorMessage::CompressedImage),
        ];
        assert_eq!(topics(&b.topics), expected);
        assert_eq!(robots[0].sensors[1].kind, SensorKind::Battery { charge: None });
        assert_eq!(robots[1].sensors[0].kind, SensorKind::Images { keep_bytes: 1_000_000 });
        assert_eq!(violation(&json_of(text), &schema(), "x"), None);
    }

    #[test]
    fn a_robot_in_ros_is_described_by_a_word_or_at_length() {
        let text = "name: x\nwireless: { w: {} }\nnodes:\n  U: { kind: radio_unit, position: [0, 0], channel: 1 }\n  \
                    a: { kind: robot, position: [0, 0], driver: ros1 }\n  \
                    b: { kind: robot, position: [0, 0], driver: { kind: ros1, master: 'http://tb:11311/', \
                    namespace: tb2, topics: { scan: /lidar } } }\n  \
                    c: { kind: robot, position: [0, 0], offer: ros1 }\n  \
                    d: { kind: robot, position: [0, 0], driver: simulated, offer: { kind: ros1, master: U } }\n  \
                    e: { kind: robot, position: [0, 0], offer: { kind: ros1, network: machine } }\n";
        let testbed = parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"));
        let drivers: Vec<_> = testbed.graph.robots().map(|(_, robot)| robot.driver.clone()).collect();
        let ros1 = |master: RosMaster, namespace: &str| Ros1 {
            master,
            namespace: namespace.to_owned(),
            topics: RosTopics::default(),
        };
        let offer = |master| {
            let ros = Ros::Ros1(Box::new(ros1(master, "/")));
            Driver::Simulated { offer: Some(Offer { ros, clock: false }) }
        };
        let node = |name| RosMaster::Node { node: NodeId::new(name).unwrap() };
        let mut tb2 = ros1(RosMaster::Machine { uri: Some("http://tb:11311/".to_owned()) }, "/tb2");
        tb2.topics.scan = "/lidar".to_owned();
        assert_eq!(drivers[0], Driver::Ros1(Box::new(ros1(RosMaster::Machine { uri: None }, "/"))));
        assert_eq!(drivers[1], Driver::Ros1(Box::new(tb2.clone())));
        assert_eq!(
            (tb2.resolved("scan"), tb2.resolved("/lidar")),
            ("/tb2/scan".to_owned(), "/lidar".to_owned())
        );
        assert_eq!(drivers[2..4], [offer(node("c")), offer(node("U"))]);
        assert_eq!(drivers[4], offer(RosMaster::Machine { uri: None }));
        assert_eq!(violation(&json_of(text), &schema(), "x"), None);
    }

    #[test]
    fn images_fit_the_schema() {
        let text = "name: x\nengine: docker\nnodes:\n  a:\n    kind: server\n    tier: fog\n    cpus: 4\n    memory: 8 GB\n    \
                    engine: podman\n    image: ros:jazzy\n    command: [ros2, launch]\n    volumes: [maps:/maps, out:/out:rw]\n    \
                    devices: [/dev/dri]\n    ports: [8080, 8080:8080/tcp, 9000/udp]\n    pull: never\n    env: [A, B=c]\n";
        parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"));
        assert_eq!(violation(&json_of(text), &schema(), "x"), None);
    }

    #[test]
    fn no_more_hosts_than_addresses() {
        let mut text = String::from("name: x\nnodes:\n  lan: { kind: switch }\n");
        for i in 0..=HostAddress::MAX_HOSTS {
            text += &format!("  h{i}: {{ kind: server, tier: fog, cpus: 1, memory: 1 GB }}\n");
        }
        let wrong = parse("x.yaml", &text, Path::new("")).unwrap_err();
        assert_eq!(wrong.list[0].message, "there are 65001 hosts");
    }

    #[test]
    fn more_links_than_the_bound_are_rejected_before_they_are_made() {
        let servers = |side: &str| (0..317).map(|i| format!("{side}{i}")).collect::<Vec<_>>();
        let (first, second) = (servers("a"), servers("b"));
        let mut text = String::from("name: x\nnodes:\n");
        for server in first.iter().chain(&second) {
            text += &format!("  {server}: {{ kind: server, tier: fog, cpus: 1, memory: 1 GB }}\n");
        }
        let ends = format!("[[{}], [{}]]", first.join(", "), second.join(", "));
        text += &format!("links:\n  - {{ ends: {ends} }}\n");
        let set = Setting::new("links.*.delay", "1 ms").unwrap();
        for settings in [vec![], vec![set]] {
            let wrong = parse_with("x.yaml", &text, Path::new(""), &settings).unwrap_err();
            assert_eq!(wrong.list[0].message, "with this entry there are more than 100000 links", "{wrong}");
        }
    }

    #[test]
    fn a_text_beyond_the_bound_is_rejected_in_its_place_without_being_repeated() {
        let text = format!("name: {}\n", "x".repeat(1 << 20));
        let wrong = parse("x.yaml", &text, Path::new("")).unwrap_err();
        assert_eq!(
            wrong.to_string(),
            "x.yaml:1:7: this text has more than 65536 bytes\n  help: keep large data in a file of its own\n"
        );
    }

    #[test]
    fn a_map_or_trace_that_is_a_device_is_rejected_in_its_place() {
        let text =
            "name: x\nmap: /dev/zero\nnodes:\n  a: { kind: server, tier: fog, cpus: 1, memory: 1 GB }\n";
        let wrong = parse("x.yaml", text, Path::new("")).unwrap_err();
        assert_eq!((wrong.list[0].line, wrong.list[0].column), (2, 6));
        assert!(wrong.list[0].message.contains("it is not a regular file"), "{wrong}");
    }

    fn check_places(wrong: &Diagnostics) {
        assert!(!wrong.list.is_empty());
        for d in &wrong.list {
            assert!(wrong.source_text.get(d.span.clone()).is_some(), "{d:?}");
        }
        _ = wrong.to_string();
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC{0,80}|([a-z\\[\\]{}&*!|>'\": \n-]{0,60})") {
            if let Err(wrong) = parse("x.yaml", &text, Path::new("nowhere")) {
                check_places(&wrong);
            }
        }

        /// A setting changes the shipped file, or is rejected with its place.
        #[test]
        fn no_setting_panics(path in "(links|plugins|nodes|walks|plugin|wireless|\\PC{1,5})(\\.[a-zA-Z0-9*-]{1,9}){0,4}", value in "\\PC{0,12}") {
            let text = std::fs::read_to_string(testbeds().join("corridor.yaml")).unwrap();
            let text = text.replace("map: maps/corridor.yaml", "");
            if let Ok(setting) = Setting::new(&path, &value)
                && let Err(wrong) = parse_with("x.yaml", &text, &testbeds(), &[setting])
            {
                check_places(&wrong);
            }
        }

        /// A truncated or overwritten file is accepted, or rejected with a place.
        #[test]
        fn damaged_files_never_panic(at in 0_usize..5000, cut in 0_usize..40, put in "\\PC{0,8}") {
            let text = std::fs::read_to_string(testbeds().join("corridor.yaml")).unwrap();
            let text = text.replace("map: maps/corridor.yaml", "");
            let start = text.floor_char_boundary(at % text.len());
            let end = text.floor_char_boundary((start + cut).min(text.len()));
            let spoilt = [&text[..start], &put, &text[end..]].concat();
            if let Err(wrong) = parse("x.yaml", &spoilt, &testbeds()) {
                check_places(&wrong);
            }
        }
    }
}
