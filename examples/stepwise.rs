//! A cotorra plug-in in Rust, as a program of its own: robots roam by periodic scans, and navigation takes a step to
//! the next dearer server when answers are late six times in a row; from the dearest back to the cheapest.
//!
//! `cargo build --release -p cotorra-plugin --example stepwise`, then name it in a testbed file as
//! `command: [../target/release/examples/stepwise]`. Its setting is `scan_every`, in seconds, by default 10.

use std::{collections::BTreeSet, time::Duration};

use cotorra_graph::{
    Event, Instruction, NodeId, NodeKind, RobotContext, ServiceId, ServiceTime, Testbed, Timestamp, VnfId,
};
use cotorra_plugin::{Actions, Plugin, client};

/// So many late answers in a row are neither a scan nor a handover any more.
const PATIENCE: u32 = 6;

struct Stepwise {
    scan_every: Duration,
    next_scan: Timestamp,
    robots: Vec<NodeId>,
    /// Robots whose next context has fresh signals.
    scanned: BTreeSet<NodeId>,
    /// From the cheapest to the dearest.
    servers: Vec<NodeId>,
    services: Vec<Service>,
}

struct Service {
    id: ServiceId,
    vnf: VnfId,
    target: Duration,
    late: u32,
}

impl Plugin for Stepwise {
    fn start(&mut self, now: Timestamp, testbed: &Testbed, _actions: &mut Actions) {
        self.next_scan = now + self.scan_every;
        self.robots = testbed.graph.robots().map(|(node, _)| node.id.clone()).collect();
        let mut servers: Vec<_> = testbed
            .graph
            .nodes
            .iter()
            .filter_map(|node| match &node.kind {
                NodeKind::Server(server) => Some((server.cost, node.id.clone())),
                _ => None,
            })
            .collect();
        servers.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.servers = servers.into_iter().map(|(_, id)| id).collect();
        let movable = |service: &cotorra_graph::Service| {
            let vnf = service.vnfs.iter().find(|vnf| vnf.pinned_to.is_none())?.id.clone();
            Some(Service { id: service.id.clone(), vnf, target: service.kpis.service_time, late: 0 })
        };
        let navigation = testbed.services.iter().filter(|service| service.navigates());
        self.services = navigation.filter_map(movable).collect();
    }

    fn handle(&mut self, _now: Timestamp, event: &Event, actions: &mut Actions) {
        match event {
            Event::Scanned { robot } => drop(self.scanned.insert(robot.clone())),
            Event::Robot(context) if self.scanned.remove(&context.robot) => roam(context, actions),
            Event::ServiceTime(sample) => self.step(sample, actions),
            _ => {}
        }
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        Some(self.next_scan)
    }

    fn expire(&mut self, now: Timestamp, actions: &mut Actions) {
        self.next_scan = now + self.scan_every;
        self.robots.iter().for_each(|robot| actions.instruct(Instruction::Scan { robot: robot.clone() }));
    }
}

impl Stepwise {
    fn step(&mut self, sample: &ServiceTime, actions: &mut Actions) {
        let Some(service) = self.services.iter_mut().find(|s| s.id == sample.service) else { return };
        let is_late = sample.took.is_none_or(|took| took > service.target);
        service.late = if is_late { service.late + 1 } else { 0 };
        if service.late == PATIENCE {
            service.late = 0;
            let here = self.servers.iter().position(|server| *server == sample.server).unwrap_or(0);
            let node = self.servers[(here + 1) % self.servers.len()].clone();
            let place = Instruction::Place { vnf: service.vnf.clone(), node: node.into() };
            actions.instruct_because(place, format!("{PATIENCE} answers in a row were late"));
        }
    }
}

/// Attaches a robot to the radio unit that it receives best.
fn roam(context: &RobotContext, actions: &mut Actions) {
    let heard = context.attachments.iter().filter_map(|a| Some((a.signal?.0, a)));
    let Some((signal, best)) = heard.max_by(|a, b| a.0.total_cmp(&b.0)) else { return };
    if !best.attached {
        let (robot, radio_unit) = (context.robot.clone(), best.radio_unit.clone());
        actions.instruct_because(Instruction::Attach { robot, radio_unit }, format!("{signal:.1} dBm"));
    }
}

fn main() -> Result<(), client::ClientError> {
    let every = client::settings()?.get("scan_every").and_then(serde_json::Value::as_f64).unwrap_or(10.0);
    client::run(&mut Stepwise {
        scan_every: Duration::from_secs_f64(every),
        next_scan: Timestamp::ZERO,
        robots: Vec::new(),
        scanned: BTreeSet::new(),
        servers: Vec::new(),
        services: Vec::new(),
    })
}
