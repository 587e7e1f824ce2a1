//! Measures the energy of a run: from the contexts of robots and machines, the CPU time of VNFs and the airtime of radios.

use std::{collections::BTreeMap, time::Duration};

use cotorra_fabric::Airtime;
use cotorra_graph::{
    DomainId, Event, Node, NodeId, RobotContext, RobotPower, ServerPower, ServiceId, Stamped, Testbed,
    Timestamp, VnfId, millis,
};

use super::energy::{
    Battery, DomainEnergy, EnergySummary, RadioEnergy, RobotEnergy, ServerEnergy, ServiceEnergy,
};
use crate::computed::ComputedSoFar;

/// Speed from which a robot drives: odometry of one that stands is not always zero.
const DRIVES_MPS: f64 = 0.005;
/// Turning rate from which it does.
const TURNS_RADPS: f64 = 0.01;

/// A node whose power is known.
#[derive(Debug, Clone)]
struct Metered<P> {
    node: NodeId,
    domain: DomainId,
    cpus: f64,
    power: P,
    /// Time that all of its CPUs were busy by its contexts, and the time of the last of them.
    told: Option<(Timestamp, Duration)>,
}

/// Movements of a robot.
#[derive(Debug, Clone, Default)]
struct Movements {
    /// Each time at which it began to move or to stand. It stands at the start.
    changes: Vec<Timestamp>,
}

/// Measures the energy of a run.
#[derive(Debug, Clone)]
pub(super) struct Metering {
    domains: Vec<DomainId>,
    services: Vec<(ServiceId, NodeId)>,
    /// The service of each VNF.
    vnfs: BTreeMap<VnfId, ServiceId>,
    servers: Vec<Metered<ServerPower>>,
    robots: Vec<(Metered<RobotPower>, Movements)>,
}

/// What is known of a run beside its events.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) computed: &'a ComputedSoFar,
    /// Whether a node that is not there computed nothing.
    pub(super) is_all: bool,
    /// Of robots with emulated radios.
    pub(super) airtimes: &'a BTreeMap<NodeId, Airtime>,
}

impl<P> Metered<P> {
    fn new(node: &Node, power: P) -> Self {
        let cpus = node.capacity().map_or(0.0, |capacity| capacity.cpus);
        Self { node: node.id.clone(), domain: node.domain.clone(), cpus, power, told: None }
    }

    /// Adds the busy share of its CPUs since the last context.
    fn tell(&mut self, at: Timestamp, busy: f64) {
        let (since, before) = self.told.unwrap_or_default();
        self.told = Some((at, before + at.since(since).mul_f64(busy)));
    }

    /// Returns the CPU time that it spent; `None` if that is not known.
    fn cpu_time(&self, known: &Known<'_>) -> Option<Duration> {
        let computed = known.computed.nodes.iter().find(|its| its.node == self.node);
        let told = || self.told.map(|(_, busy)| busy.mul_f64(self.cpus));
        let nothing = || known.is_all.then_some(Duration::ZERO);
        computed.map(|its| its.cpu_time).or_else(told).or_else(nothing)
    }
}

impl Movements {
    fn absorb(&mut self, at: Timestamp, context: &RobotContext) {
        let velocity = context.sensors.velocity;
        let moves =
            velocity.linear.hypot(velocity.vertical) >= DRIVES_MPS || velocity.angular.abs() >= TURNS_RADPS;
        if moves != self.is_moving() {
            self.changes.push(at);
        }
    }

    fn is_moving(&self) -> bool {
        self.changes.len() % 2 == 1
    }

    /// Returns the stretches up to a time, each with its beginning, its end, and whether the robot moves.
    fn stretches(&self, end: Timestamp) -> impl Iterator<Item = (Timestamp, Timestamp, bool)> {
        let begins = [Timestamp::ZERO].into_iter().chain(self.changes.iter().copied());
        let ends = self.changes.iter().copied().chain([end]);
        begins.zip(ends).enumerate().map(|(i, (from, to))| (from, to, i % 2 == 1))
    }

    fn driving(&self, end: Timestamp) -> Duration {
        self.stretches(end).filter(|(.., moves)| *moves).map(|(from, to, _)| to.since(from)).sum()
    }
}

impl Metering {
    /// Returns the meters of a testbed; `None` if no node has a power.
    pub(super) fn new(testbed: &Testbed) -> Option<Self> {
        let graph = &testbed.graph;
        let server = |(node, server): (&Node, &cotorra_graph::Server)| {
            Some(Metered::new(node, **server.power.as_ref()?))
        };
        let robot = |(node, robot): (&Node, &cotorra_graph::Robot)| {
            let power = **robot.power.as_ref()?;
            // Nobody reports what a real radio sends.
            let radio = power.radio.filter(|_| robot.radio.is_none());
            Some((Metered::new(node, RobotPower { radio, ..power }), Movements::default()))
        };
        let servers: Vec<_> = graph.servers().filter_map(server).collect();
        let robots: Vec<_> = graph.robots().filter_map(robot).collect();
        let vnfs = testbed
            .services
            .iter()
            .flat_map(|service| service.vnfs.iter().map(|vnf| (vnf.id.clone(), service.id.clone())));
        (!servers.is_empty() || !robots.is_empty()).then(|| Self {
            domains: graph.domains.clone(),
            services: testbed.services.iter().map(|its| (its.id.clone(), its.robot.clone())).collect(),
            vnfs: vnfs.collect(),
            servers,
            robots,
        })
    }

    /// Adds an event.
    pub(super) fn absorb(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::Robot(context) => {
                let its = self.robots.iter_mut().find(|(its, _)| its.node == context.robot);
                if let Some((_, movements)) = its {
                    movements.absorb(*at, context);
                }
            }
            Event::Machine(context) => {
                let Some(busy) = context.cpu.and_then(|cpu| cpu.busy) else { return };
                let busy = busy.get();
                if let Some(its) = self.servers.iter_mut().find(|its| its.node == context.node) {
                    its.tell(*at, busy);
                }
                if let Some((its, _)) = self.robots.iter_mut().find(|(its, _)| its.node == context.node) {
                    its.tell(*at, busy);
                }
            }
            _ => {}
        }
    }

    /// Returns the energy of a run that ended at `end`.
    pub(super) fn summary(&self, end: Timestamp, known: &Known<'_>) -> EnergySummary {
        let servers: Vec<_> = self.servers.iter().map(|its| server(its, end, known)).collect();
        let robots: Vec<_> =
            self.robots.iter().map(|(its, movements)| robot(its, movements, end, known)).collect();
        let services = self.services.iter().map(|(service, robot)| ServiceEnergy {
            service: service.clone(),
            robot: robot.clone(),
            energy_wh: (known.is_all || !known.computed.vnfs.is_empty())
                .then(|| self.of_service(service, known)),
        });
        let domain = |domain: &DomainId| {
            let of_servers = self.servers.iter().zip(&servers).filter(|(its, _)| its.domain == *domain);
            let of_robots = self.robots.iter().zip(&robots).filter(|((its, _), _)| its.domain == *domain);
            let of_robots = of_robots.map(|(_, its)| its.energy_wh);
            let of_nodes = of_servers.map(|(_, its)| its.energy_wh).chain(of_robots);
            // A sum of no numbers is -0.
            let energy_wh = of_nodes.fold(0.0, |sum, wh| sum + wh);
            DomainEnergy { domain: domain.clone(), energy_wh }
        };
        let domains: Vec<_> = self.domains.iter().map(domain).collect();
        EnergySummary {
            total_energy_wh: domains.iter().map(|its| its.energy_wh).sum(),
            services: services.collect(),
            servers,
            robots,
            domains,
        }
    }

    /// Returns the energy of the CPU time of a service's VNFs.
    fn of_service(&self, service: &ServiceId, known: &Known<'_>) -> f64 {
        let its = known.computed.vnfs.iter().filter(|its| self.vnfs.get(&its.vnf) == Some(service));
        let energy = its.filter_map(|its| {
            let cpu_time = its.load.cpu_time();
            let of_server = self.servers.iter().find(|server| server.node == its.node);
            let of_robot = self.robots.iter().find(|(robot, _)| robot.node == its.node);
            of_server
                .map(|server| server.power.load_wh(cpu_time, server.cpus))
                .or_else(|| of_robot.map(|(robot, _)| robot.power.computing_wh(cpu_time, robot.cpus)))
        });
        energy.fold(0.0, |sum, wh| sum + wh)
    }
}

fn server(its: &Metered<ServerPower>, end: Timestamp, known: &Known<'_>) -> ServerEnergy {
    let idle_energy_wh = its.power.idle_wh(end.since(Timestamp::ZERO));
    let load = |cpu_time| its.power.load_wh(cpu_time, its.cpus);
    // Where load takes nothing, it need not be known.
    let without_load = (its.power.full_w == its.power.idle_w).then_some(0.0);
    let load_energy_wh = its.cpu_time(known).map(load).or(without_load);
    let energy_wh = idle_energy_wh + load_energy_wh.unwrap_or_default();
    ServerEnergy { server: its.node.clone(), idle_energy_wh, load_energy_wh, energy_wh }
}

fn robot(its: &Metered<RobotPower>, movements: &Movements, end: Timestamp, known: &Known<'_>) -> RobotEnergy {
    let (power, time) = (&its.power, end.since(Timestamp::ZERO));
    let driving = movements.driving(end);
    let base_energy_wh = power.base_wh(time, driving);
    let computing = |cpu_time| power.computing_wh(cpu_time, its.cpus);
    let without_load = (power.computing_w == 0.0).then_some(0.0);
    let computing_energy_wh = its.cpu_time(known).map(computing).or(without_load);
    let airtime = known.airtimes.get(&its.node);
    let radio = power.radio.zip(airtime).map(|(radio, Airtime { sending, receiving })| RadioEnergy {
        energy_wh: radio.energy_wh(time, *sending, *receiving),
        transmit_airtime_ms: millis::of(*sending),
        receive_airtime_ms: millis::of(*receiving),
    });
    let others_wh = computing_energy_wh.unwrap_or_default() + radio.map_or(0.0, |radio| radio.energy_wh);
    let energy_wh = base_energy_wh + others_wh;
    let battery = power.battery_wh.map(|battery_wh| Battery {
        battery_wh,
        battery_left: (1.0 - energy_wh / battery_wh).max(0.0),
        empty: emptied(power, movements, others_wh, end, battery_wh),
    });
    RobotEnergy {
        robot: its.node.clone(),
        driving_ms: millis::of(driving),
        base_energy_wh,
        computing_energy_wh,
        radio,
        energy_wh,
        battery,
    }
}

/// Returns the time at which a battery was empty, if it was. CPUs and radio take their energy evenly over the run.
fn emptied(
    power: &RobotPower,
    movements: &Movements,
    others_wh: f64,
    end: Timestamp,
    battery_wh: f64,
) -> Option<Timestamp> {
    let run = end.since(Timestamp::ZERO).as_secs_f64();
    let mut left = battery_wh;
    for (from, to, moves) in movements.stretches(end) {
        let time = to.since(from);
        let share = if run > 0.0 { time.as_secs_f64() / run } else { 0.0 };
        let takes = power.base_wh(time, if moves { time } else { Duration::ZERO }) + others_wh * share;
        if takes > 0.0 && takes >= left {
            return Some(from + time.mul_f64(left / takes));
        }
        left -= takes;
    }
    None
}

#[cfg(test)]
mod tests;
