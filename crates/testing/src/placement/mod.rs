//! Placement problems for OKpi: the corridor, and generated graphs of any size.

pub mod check;
pub mod exact;

use std::time::Duration;

use cotorra_graph::{Event, LinkId, NodeId, RobotContext, VnfId};
use cotorra_graph_testing as base;
use cotorra_numbers::seed;
use cotorra_okpi::{Chain, Infrastructure, Link, Node, Vnf};
use serde_json::{Map, Value, json};

/// Returns the settings with the areas in which the published system used each radio unit.
///
/// An edge lies halfway between the places where it changed on the way out and on the way back. These were about 0.8 m to
/// either side.
pub fn survey() -> Map<String, Value> {
    let settings = json!({
        "services": ["navigation"],
        "hysteresis": "0.8 m",
        "coverage": {
            "R1": [[16.8, -60], [60, -60], [60, -25.35], [16.8, -25.35]],
            "R3": [[16.8, -25.35], [60, -25.35], [60, -11.7], [16.8, -11.7]],
            "R2": [[16.8, -11.7], [60, -11.7], [60, 30], [16.8, 30]],
            "R5": [[-30, -60], [16.8, -60], [16.8, 30], [-30, 30]],
        },
    });
    settings.as_object().expect("it is an object").clone()
}

/// Returns κ of the robot at a place, attached to a radio unit.
pub fn context((x, y): (f64, f64), attached: &str) -> Event {
    let pose = base::pose(x, y, 0.0);
    Event::Robot(RobotContext {
        attachments: ["R1", "R2", "R3", "R4", "R5", "R6"]
            .map(|unit| base::attachment(unit, unit == attached, None))
            .into(),
        ..base::robot_context("robot", pose)
    })
}

fn node_id(name: &str) -> NodeId {
    NodeId::new(name).expect("it is a name")
}

/// Draws a graph from a seed: a robot under five radio units, a ring of switches with chords, and servers on the
/// switches.
pub fn generated(nodes: usize, vnfs: usize, reliability: Option<f64>, run: u64) -> (Chain, Infrastructure) {
    let mut drawn = 0;
    let mut below = |limit: usize| {
        drawn += 1;
        (seed::split(run, &drawn.to_string()) % limit as u64) as usize
    };
    let (units, servers) = (nodes / 10, nodes / 5);
    let first_server = nodes - servers;
    let switches = 1 + units..first_server;
    let mut infrastructure = Infrastructure::default();
    for i in 0..nodes {
        let server = i >= first_server;
        infrastructure.nodes.push(Node {
            id: node_id(&format!("n{i}")),
            cpus: if i == 0 { 2.0 } else { 4.0 * f64::from(u8::from(server)) },
            memory_bytes: 8 << 30,
            cost: if server { 1.0 + below(50) as f64 / 10.0 } else { 0.0 },
            reliability: if server { 0.999 - below(100) as f64 / 1e4 } else { 1.0 },
            forwards: i != 0 && !server,
        });
    }
    let mut link = |a: usize, b: usize, us: usize, wireless: bool| {
        let Infrastructure { nodes, links } = &mut infrastructure;
        links.push(Link {
            id: LinkId::between(&nodes[a].id, &nodes[b].id),
            ends: [a, b],
            round_trip: Duration::from_micros(us as u64),
            free_bps: 1e9,
            reliability: 0.9999,
            wireless,
        });
    };
    for unit in 1..=units.min(5) {
        link(0, unit, 1000, true);
    }
    for unit in 1..=units {
        link(unit, switches.start + below(switches.len()), 100 + below(900), false);
    }
    for switch in switches.clone() {
        let next = switches.start + (switch + 1 - switches.start) % switches.len();
        link(switch, next, 50 + below(200), false);
        let chord = 2 + below(switches.len() - 2);
        let across = switches.start + (switch - switches.start + chord) % switches.len();
        link(switch, across, 50 + below(200), false);
    }
    for server in first_server..nodes {
        link(server, switches.start + below(switches.len()), 50 + below(450), false);
    }
    let vnf = |i: usize| Vnf {
        id: VnfId::new(&format!("v{i}")).expect("it is a name"),
        cpus: if i == 0 { 0.0 } else { 2.0 },
        memory_bytes: 1 << 30,
        hosts: if i == 0 { vec![0] } else { (first_server..nodes).collect() },
        rate_bps: 1e6,
        processing: None,
    };
    let service_time = Duration::from_millis(6 + 4 * vnfs as u64);
    (Chain { vnfs: (0..vnfs).map(vnf).collect(), service_time, reliability }, infrastructure)
}

/// Draws a graph from a seed on which every constraint of a placement is tight. Some of these graphs have no placement.
pub fn contested(nodes: usize, run: u64) -> (Chain, Infrastructure) {
    let mut drawn = 0;
    let mut between = |least: u64, most: u64| {
        drawn += 1;
        least + seed::split(run, &format!("contested {drawn}")) % (most - least + 1)
    };
    let vnfs = between(3, 5) as usize;
    let (mut service, mut infrastructure) = generated(nodes, vnfs, None, run);
    for node in infrastructure.nodes.iter_mut().filter(|node| node.cost > 0.0) {
        node.cpus = between(2, 5) as f64;
        node.reliability = 1.0 - between(1, 100) as f64 / 1e4;
    }
    for link in &mut infrastructure.links {
        link.free_bps = if link.wireless { 20e6 } else { between(2, 12) as f64 * 1e6 };
        link.reliability = 1.0 - between(0, 30) as f64 / 1e4;
    }
    for vnf in &mut service.vnfs[1..] {
        vnf.cpus = between(1, 3) as f64;
        vnf.rate_bps = between(1, 4) as f64 * 1e6;
    }
    service.service_time = Duration::from_micros(between(2500, 7000));
    service.reliability = Some(0.95 + between(0, 35) as f64 / 1e3);
    (service, infrastructure)
}
