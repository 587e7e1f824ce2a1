//! Builders of the graph's types, with defaults, for tests: a new field of such a type changes this crate and no test.
//!
//! Only ever a dev-dependency. A test changes what matters to it: `Vnf { cpus: 2.0, ..vnf("brain", "edge") }`.
#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, reason = "a fixture that fails, fails the test")]

use std::{fmt::Debug, str::FromStr, time::Duration};

use cotorra_graph::{
    Access, Attachment, BitRate, Capacity, Conditions, Dbm, Direction, Driver, Edca, GapPolicy,
    HandoverTimes, HardwareGraph, Kpis, Link, LinkContext, Loss, MachineContext, Node, NodeKind, PathLoss,
    Pose, PoseSource, Program, QueueDiscipline, QueueLimit, RadioUnit, RateControl, Roaming, Robot,
    RobotClock, RobotContext, RobotModel, SensorData, Server, Service, ServiceTime, Shadowing, Testbed, Tier,
    Timestamp, Velocity, VirtualLink, Vnf, WifiStandard, WirelessNetwork,
};

const CAPACITY: Capacity = Capacity { cpus: 4.0, memory_bytes: 8 << 30, accelerators: None };

/// Returns a name of any kind.
pub fn id<T: FromStr<Err: Debug>>(name: &str) -> T {
    name.parse().unwrap()
}

/// Returns a graph of these nodes and links, in the domains of the nodes, without wireless networks.
pub fn graph(nodes: Vec<Node>, links: Vec<Link>) -> HardwareGraph {
    let mut domains = Vec::new();
    for node in &nodes {
        if !domains.contains(&node.domain) {
            domains.push(node.domain.clone());
        }
    }
    HardwareGraph { domains, nodes, links, wireless: Default::default() }
}

/// Returns a node of the domain `home`, without a position.
pub fn node(name: &str, kind: NodeKind) -> Node {
    Node { id: id(name), domain: id("home"), position: None, kind }
}

/// Returns a server at the edge that costs 1 and never fails.
pub fn server() -> Server {
    Server {
        tier: Tier::Edge,
        capacity: CAPACITY,
        cost: 1.0,
        used_cost: 0.0,
        memory_cost: 0.0,
        migration_cost: 0.0,
        reliability: 1.0,
        speed: 1.0,
        power: None,
        real: None,
    }
}

/// Returns a simulated TurtleBot 2 in a network, which roams by instruction only.
pub fn robot(network: &str) -> Robot {
    Robot {
        capacity: Capacity { cpus: 2.0, ..CAPACITY },
        model: RobotModel::Turtlebot2,
        network: network.to_owned(),
        tx_power: Dbm(20.0),
        heading: 0.0,
        roaming: Roaming::Instructed,
        driver: Driver::default(),
        sensors: Vec::new(),
        clock: RobotClock::default(),
        radio: None,
        power: None,
    }
}

/// Returns a radio unit on channel 1 that serves a network from the start.
pub fn radio_unit(network: &str) -> RadioUnit {
    RadioUnit {
        capacity: CAPACITY,
        network: network.to_owned(),
        channel: 1,
        tx_power: Dbm(20.0),
        serving: true,
        deployment: Duration::ZERO,
        agent: None,
        radio: None,
    }
}

/// Returns a link `<a>-<b>` over a medium of 100 Gbit/s, with the same conditions in both directions.
pub fn link(a: &str, b: &str, conditions: Conditions) -> Link {
    Link {
        id: id(&format!("{a}-{b}")),
        ends: [id(a), id(b)],
        forward: conditions.clone(),
        backward: conditions,
        scales: Default::default(),
        medium: BitRate::from_mbps(100_000.0).unwrap(),
        medium_delay: Duration::ZERO,
        cost: 0.0,
        reliability: 1.0,
    }
}

/// Returns contention one frame at a time at the best rates, with queues that drop at their tail.
pub fn edca() -> Edca {
    Edca {
        aggregation: false,
        rate_control: RateControl::Ideal,
        power_save: None,
        queue: QueueLimit::default(),
        queue_discipline: QueueDiscipline::DropTail,
    }
}

/// Returns a wireless network without randomness: 1 ms of delay, the standard's rate, and handovers of 170 ms.
pub fn wireless() -> WirelessNetwork {
    let ms = Duration::from_millis;
    WirelessNetwork {
        standard: WifiStandard::N,
        width: Default::default(),
        streams: 1,
        guard_interval: Default::default(),
        delay: ms(1),
        rate: None,
        loss: Loss::None,
        fast_transition: true,
        mobility_domain: 1,
        path_loss: PathLoss::LogDistance { exponent: 3.0 },
        walls: None,
        access: Access::Turns,
        shadowing: Shadowing { deviation_db: 0.0, correlation_m: 5.0 },
        fading: None,
        noise_floor: Dbm(-95.0),
        hysteresis_db: 4.0,
        time_to_trigger: ms(500),
        handover: HandoverTimes {
            scan: ms(100),
            visits: None,
            scan_first: false,
            scan_every: None,
            authenticate: ms(10),
            reassociate: ms(20),
            handshake: ms(40),
            variation: 0.0,
            frames: None,
        },
        gap: GapPolicy::Hold,
    }
}

/// Returns a testbed of this graph, without services and walks.
pub fn testbed(graph: HardwareGraph) -> Testbed {
    Testbed {
        name: "test".to_owned(),
        description: String::new(),
        currency: None,
        folder: Default::default(),
        graph,
        services: Vec::new(),
        map: None,
        walks: Vec::new(),
        plugins: Vec::new(),
        seed: 1,
        wais: Default::default(),
        core: None,
        emulation: Default::default(),
        script: Default::default(),
        probes: None,
        retention: Default::default(),
        containers: Default::default(),
        border: None,
        without_port_security: Vec::new(),
        traffic: Vec::new(),
        reservations: Default::default(),
    }
}

/// Returns a service `navigation` of a robot, without virtual links.
pub fn service(robot: &str, vnfs: Vec<Vnf>) -> Service {
    Service {
        id: id("navigation"),
        robot: id(robot),
        vnfs,
        virtual_links: Vec::new(),
        kpis: kpis(Duration::from_millis(15)),
        requests: Default::default(),
        policy: None,
    }
}

/// Returns KPIs of a service time alone.
pub fn kpis(service_time: Duration) -> Kpis {
    Kpis {
        service_time,
        kept: None,
        reliability: None,
        area: None,
        radio: None,
        flow: None,
        require: Vec::new(),
    }
}

/// Returns a VNF that navigates, on a node.
pub fn vnf(name: &str, node: &str) -> Vnf {
    Vnf {
        id: id(name),
        program: Program::Navigation,
        cpus: 1.0,
        cpu_limit: None,
        memory_bytes: 64 << 20,
        pinned_to: None,
        node: id::<cotorra_graph::NodeId>(node).into(),
        env: Vec::new(),
        rights: Default::default(),
        keep: false,
        image: None,
        start: Default::default(),
        computing: None,
        state: None,
    }
}

/// Returns a testbed for services of applications: a robot at a radio unit, whose navigation is in the cloud, and an
/// application `planner` at the edge. The edge and the cloud are in these domains, and all
/// else in `home`.
pub fn applications(domains: [&str; 2]) -> Testbed {
    let server = |name: &str, domain: &str| Node {
        domain: id(domain),
        ..node(name, NodeKind::Server(self::server()))
    };
    let nodes = vec![
        node("robot", NodeKind::Robot(robot("lab"))),
        node("unit", NodeKind::RadioUnit(radio_unit("lab"))),
        node("lan", NodeKind::Switch),
        server("edge", domains[0]),
        server("cloud", domains[1]),
    ];
    let links = ["unit", "edge", "cloud"].map(|end| link("lan", end, Conditions::default()));
    let mut graph = graph(nodes, links.to_vec());
    graph.wireless.insert("lab".to_owned(), wireless());
    let driver = Vnf { program: Program::RobotDriver, ..vnf("robot-driver", "robot") };
    let planner = Vnf { program: command(["sleep", "1"]), ..vnf("planner", "edge") };
    let navigation = VirtualLink {
        from: id("robot-driver"),
        to: id("navigation"),
        rate: BitRate::from_mbps(1.0).unwrap(),
    };
    let service = Service {
        virtual_links: vec![navigation],
        ..service("robot", vec![driver, vnf("navigation", "cloud"), planner])
    };
    Testbed { services: vec![service], ..testbed(graph) }
}

/// Returns words as a command.
pub fn command<const N: usize>(words: [&str; N]) -> Program {
    Program::Command(words.map(str::to_owned).into())
}

/// Returns a pose on the floor without uncertainty, metres and radians.
pub fn pose(x: f64, y: f64, heading: f64) -> Pose {
    Pose::planar(x, y, heading, [0.0; 9], PoseSource::Simulator)
}

/// Returns sensors of a robot that stands at a pose.
pub fn sensors(pose: Pose) -> SensorData {
    SensorData {
        pose,
        odometry: pose,
        velocity: Velocity::default(),
        bumper: false,
        nearest_obstacle_m: None,
    }
}

/// Returns κ of a robot that stands at a pose and hears no radio unit.
pub fn robot_context(robot: &str, pose: Pose) -> RobotContext {
    RobotContext {
        robot: id(robot),
        attachments: Vec::new(),
        sensors: sensors(pose),
        waypoint: 0,
        health: Vec::new(),
        speed_limit_mps: None,
        localization_error_m: None,
    }
}

/// Returns how a robot hears a radio unit, dBm.
pub fn attachment(radio_unit: &str, attached: bool, signal: Option<f64>) -> Attachment {
    Attachment { radio_unit: id(radio_unit), attached, signal: signal.map(Dbm), age: None }
}

/// Returns δ of a link whose conditions are the default ones, forward.
pub fn link_context(link: &str) -> LinkContext {
    LinkContext {
        link: id(link),
        direction: Direction::Forward,
        delay: None,
        throughput_bps: 0.0,
        queued_packets: None,
        probed: None,
        tested: None,
        asked: Conditions::default(),
        scale: Default::default(),
        effective: Conditions::default(),
        counters: Default::default(),
    }
}

/// Returns the context of a machine of which nothing is known.
pub fn machine_context(node: &str) -> MachineContext {
    MachineContext {
        node: id(node),
        reading: None,
        cpu: None,
        load_average: None,
        memory: None,
        interfaces: Vec::new(),
        interfaces_left_out: 0,
        wifi: Vec::new(),
        wifi_left_out: 0,
    }
}

/// Returns a service time of `robot` in `navigation`, by `server`, from a packet that was emitted then.
pub fn service_time(server: &str, emitted: Timestamp, took: Option<Duration>) -> ServiceTime {
    ServiceTime {
        service: id("navigation"),
        robot: id("robot"),
        sequence: 0,
        emitted,
        took,
        attachment: None,
        server: id(server),
        parts: None,
        lost_at: None,
    }
}
