//! The energy of a run: what servers and robots took of whose power the testbed file speaks.
//!
//! A server's energy is that of its idle power, and of its load by the CPU time that it spent. The load is shared among services by
//! the CPU time of their VNFs; the idle part is no service's.

use cotorra_graph::{DomainId, NodeId, ServiceId, Timestamp};
use serde::Serialize;

use super::amount::amount;

/// Energy of servers and robots.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergySummary {
    /// All of it, as far as it is known.
    pub total_energy_wh: f64,
    /// The load by the VNFs of each service, in the file's order.
    pub services: Vec<ServiceEnergy>,
    /// Servers with a power, in the file's order.
    pub servers: Vec<ServerEnergy>,
    /// Robots with a power, in the file's order.
    pub robots: Vec<RobotEnergy>,
    /// Nodes of each domain together, in the file's order.
    pub domains: Vec<DomainEnergy>,
}

/// Energy of the CPU time of a service's VNFs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceEnergy {
    pub service: ServiceId,
    /// The robot that it serves.
    pub robot: NodeId,
    /// On servers and robots with a power; `None` if their CPU time is not known.
    pub energy_wh: Option<f64>,
}

/// Energy of a server.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServerEnergy {
    pub server: NodeId,
    /// That of its idle power.
    pub idle_energy_wh: f64,
    /// That of its load beyond that; `None` if its load is not known.
    pub load_energy_wh: Option<f64>,
    /// Both.
    pub energy_wh: f64,
}

/// Energy of a robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotEnergy {
    pub robot: NodeId,
    /// Time for which it moved or turned, milliseconds.
    pub driving_ms: f64,
    /// Its base.
    pub base_energy_wh: f64,
    /// Its CPUs; `None` if their load is not known.
    pub computing_energy_wh: Option<f64>,
    /// Its radio, if it is declared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radio: Option<RadioEnergy>,
    /// All of it.
    pub energy_wh: f64,
    /// Its battery, if it has one.
    #[serde(flatten)]
    pub battery: Option<Battery>,
}

/// Energy of a robot's radio.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RadioEnergy {
    pub energy_wh: f64,
    /// Time of frames that it sent, milliseconds.
    pub transmit_airtime_ms: f64,
    /// Time of frames to it, milliseconds.
    pub receive_airtime_ms: f64,
}

/// A robot's battery at the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Battery {
    /// Its energy at the start.
    pub battery_wh: f64,
    /// Share that is left.
    pub battery_left: f64,
    /// Time at which it was empty; `None` if it was not. The robot goes on.
    #[serde(rename = "battery_empty_ns", skip_serializing_if = "Option::is_none")]
    pub empty: Option<Timestamp>,
}

/// Energy of the nodes of a domain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DomainEnergy {
    pub domain: DomainId,
    pub energy_wh: f64,
}

impl EnergySummary {
    /// Returns the energy of a service; `None` if it is not known.
    pub(super) fn of_service(&self, service: &ServiceId) -> Option<f64> {
        self.services.iter().find(|its| its.service == *service)?.energy_wh
    }

    /// Returns the energy of a robot with all of its parts; `None` if one of them is not known.
    pub(super) fn of_robot(&self, robot: &NodeId) -> Option<f64> {
        let its = self.robots.iter().find(|its| its.robot == *robot)?;
        its.computing_energy_wh.map(|_| its.energy_wh)
    }

    /// Returns the share that is left of a robot's battery.
    pub(super) fn battery_left(&self, robot: &NodeId) -> Option<f64> {
        let its = self.robots.iter().find(|its| its.robot == *robot)?;
        its.computing_energy_wh.and(its.battery).map(|battery| battery.battery_left)
    }

    /// Returns all energy; `None` if a part of it is not known.
    pub(super) fn total(&self) -> Option<f64> {
        let is_known = self.servers.iter().all(|its| its.load_energy_wh.is_some())
            && self.robots.iter().all(|its| its.computing_energy_wh.is_some());
        is_known.then_some(self.total_energy_wh)
    }

    /// Returns the energy of each server and each robot.
    pub fn nodes(&self) -> impl Iterator<Item = (&NodeId, f64)> {
        let servers = self.servers.iter().map(|its| (&its.server, its.energy_wh));
        servers.chain(self.robots.iter().map(|its| (&its.robot, its.energy_wh)))
    }

    /// Describes it in one line, such as `1.39 Wh: edge 1.11, robot 0.28`. Of many nodes, it names the servers only.
    pub fn sentence(&self) -> String {
        const MOST_NODES: usize = 5;
        let named = if self.nodes().count() <= MOST_NODES { usize::MAX } else { self.servers.len() };
        let of_nodes = self.nodes().take(named.min(MOST_NODES));
        let mut parts: Vec<_> = of_nodes.map(|(node, wh)| format!("{node} {}", amount(wh))).collect();
        let robots: f64 = self.robots.iter().map(|its| its.energy_wh).sum();
        if named < usize::MAX && !self.robots.is_empty() {
            parts.push(format!("{} robots {}", self.robots.len(), amount(robots)));
        }
        let least = if self.total().is_none() { "at least " } else { "" };
        format!("{least}{} Wh: {}", amount(self.total_energy_wh), parts.join(", "))
    }

    /// Describes each battery that was empty before the end.
    pub fn empty_batteries(&self) -> impl Iterator<Item = String> {
        self.robots.iter().filter_map(|its| {
            let empty = its.battery?.empty?.as_secs_f64();
            let robot = &its.robot;
            Some(format!("the battery of {robot} was empty after {empty:.1} s, and the robot went on"))
        })
    }
}
