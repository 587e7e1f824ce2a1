//! Images, engines and compose files become VNFs and containers of the testbed.

use std::{fs, path::Path, time::Duration};

use cotorra_graph::{
    EngineKind, Granted, Image, LinuxCapability, ListenPort, NodeId, PluginProgram, Program, Pull, Rights,
    Testbed, Transport, Vnf, Volume,
};

fn parse(text: &str, folder: &Path) -> Testbed {
    cotorra_testbed_file::parse("x.yaml", text, folder).unwrap_or_else(|wrong| panic!("{wrong}"))
}

const GRAPH: &str = "name: x
wireless: { w: {} }
nodes:
  r: { kind: robot, position: [0, 0], engine: docker, image: 'robot:1', cpus: 3, memory: 2 GB, capabilities: [net_raw] }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
  cloud: { kind: server, tier: cloud, cpus: 8, memory: 8 GB, engine: process }
links: [{ ends: [R1, [edge, cloud]] }]
";

fn vnf<'a>(testbed: &'a Testbed, name: &str) -> &'a Vnf {
    testbed
        .services
        .iter()
        .flat_map(|s| &s.vnfs)
        .find(|vnf| vnf.id.as_str() == name)
        .expect("the VNF is there")
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).expect("a name")
}

#[test]
fn a_vnf_has_an_image_with_its_own_or_other_words() {
    let services = "services:
  s:
    robot: r
    kpis: { service_time: 15 ms }
    vnfs:
      planner:
        image: ghcr.io/lab/planner:2
        command: [plan, --fast]
        env: [DISPLAY, MODE=a=b]
        capabilities: [net_admin]
        volumes: [data:/data, '/srv:/srv:rw']
        devices: [/dev/dri]
        ports: [8080, 9000/udp]
        pull: always
        start_time: 2 s
        processing_delay: 5 ms
        node: [edge, r]
      own: { image: x, node: edge }
";
    let testbed = parse(&format!("{GRAPH}{services}"), Path::new(""));
    let planner = vnf(&testbed, "planner");
    assert_eq!(planner.program, Program::Command(vec!["plan".to_owned(), "--fast".to_owned()]));
    assert_eq!(planner.env, ["DISPLAY", "MODE=a=b"]);
    let granted = Granted { capabilities: vec![LinuxCapability::NetAdmin], readable: Vec::new() };
    assert_eq!(planner.rights, Rights::Confined(granted));
    let volume = |source: &str, target: &str, writable| Volume {
        source: source.into(),
        target: target.into(),
        writable,
    };
    let image = Image {
        reference: "ghcr.io/lab/planner:2".to_owned(),
        pull: Pull::Always,
        volumes: vec![volume("data", "/data", false), volume("/srv", "/srv", true)],
        devices: vec!["/dev/dri".into()],
        ports: vec![
            ListenPort { port: 8080, transport: Transport::Tcp },
            ListenPort { port: 9000, transport: Transport::Udp },
        ],
        init: false,
        start: Duration::from_secs(2),
        processing: Duration::from_millis(5),
    };
    assert_eq!(planner.image.as_deref(), Some(&image));
    let own = vnf(&testbed, "own");
    assert_eq!(own.program, Program::Command(Vec::new()));
    assert_eq!(own.image.as_deref(), Some(&Image { reference: "x".to_owned(), ..Image::default() }));
}

#[test]
fn an_image_takes_the_place_of_a_bundled_program() {
    let services = "walks: { r: { waypoints: [[0, 0], [5, 0]] } }
services:
  s:
    robot: r
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r }
      navigation: { program: navigation, image: 'brain:1', env: [A=1], node: edge }
";
    let testbed = parse(&format!("{GRAPH}{services}"), Path::new(""));
    let navigation = vnf(&testbed, "navigation");
    assert_eq!(navigation.program, Program::Navigation);
    assert_eq!(navigation.image.as_ref().unwrap().reference, "brain:1");
    assert!(testbed.services[0].navigates());
}

#[test]
fn nodes_are_containers_with_engines_of_their_own() {
    let testbed = parse(GRAPH, Path::new(""));
    let containers = &testbed.containers;
    let engines = ["r", "R1", "edge", "cloud"].map(|node| containers.engine(&id(node)));
    use EngineKind::{Docker, Podman, Process};
    assert_eq!(engines, [Docker, Podman, Podman, Process]);
    let [host] = &containers.hosts[..] else { panic!("{containers:?}") };
    assert_eq!(host.id.as_str(), "r");
    assert_eq!(host.program, Program::Host(Vec::new()));
    assert_eq!((host.pinned_to.as_ref(), host.node.only()), (Some(&id("r")), Some(&id("r"))));
    assert_eq!((host.cpus, host.memory_bytes), (3.0, 2_000_000_000));
    assert_eq!(host.image.as_ref().unwrap().reference, "robot:1");
    let docker = parse(&format!("engine: docker\n{GRAPH}"), Path::new("")).containers;
    assert_eq!(docker.engine(&id("edge")), Docker);
}

#[test]
fn services_of_a_compose_file_follow_the_vnfs() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("stack")).unwrap();
    let compose = "services:\n  detector: { image: 'd:1', volumes: ['./data:/data'] }\n  \
                   tracker: { image: 't:1', x-cotorra: { node: r } }\n";
    fs::write(folder.path().join("stack/compose.yaml"), compose).unwrap();
    let services = "services:
  s:
    robot: r
    kpis: { service_time: 15 ms }
    vnfs:
      camera: { command: [x], pinned_to: r }
    compose: { file: stack/compose.yaml, node: edge }
    virtual_links: [{ from: camera, to: detector, rate: 1 Mbit/s }]
  t:
    robot: r
    kpis: { service_time: 15 ms, flow: { protocol: udp, port: 9000 } }
";
    let testbed = parse(&format!("{GRAPH}{services}"), folder.path());
    let all: Vec<_> = testbed.services[0]
        .vnfs
        .iter()
        .map(|vnf| (vnf.id.as_str(), vnf.node.first().as_str(), vnf.image.is_some()))
        .collect();
    assert_eq!(all, [("camera", "r", false), ("detector", "edge", true), ("tracker", "r", true)]);
    let volumes = &vnf(&testbed, "detector").image.as_ref().unwrap().volumes;
    assert_eq!(volumes[0].source, Path::new("stack/data"));
    assert!(testbed.services[1].vnfs.is_empty());
    // A setting names another node.
    let setting = "services.s.compose.node=r".parse().unwrap();
    let text = format!("{GRAPH}{services}");
    let moved = cotorra_testbed_file::parse_with("x.yaml", &text, folder.path(), &[setting]).unwrap();
    assert_eq!(vnf(&moved, "detector").node.only(), Some(&id("r")));
}

#[test]
fn a_plug_in_gets_variables_with_values() {
    let plugins = "plugins: [{ id: p, command: [x], env: [TOKEN, MODE=fast] }]\n";
    let testbed = parse(&format!("{GRAPH}{plugins}"), Path::new(""));
    assert!(matches!(testbed.plugins[0].program, PluginProgram::Command(_)));
    assert_eq!(testbed.plugins[0].env, ["TOKEN", "MODE=fast"]);
}
