//! The real part of G: its real servers, gateways, and links over interfaces of this machine.

use std::{collections::HashMap, net::Ipv4Addr};

use crate::{
    driver::{Driver, Kobuki},
    hardware::{Direction, HardwareGraph, Link, Node, NodeKind},
    id::AgentId,
    real_machine::{Gateway, Reached, RealRadio, RealServer},
};

/// A port of the emulated network on an interface of this machine: a gateway's, or a real server's.
#[derive(Debug, Clone)]
pub struct RealPort<'a> {
    /// The node.
    pub node: &'a Node,
    /// The interface, as `ip link` names it.
    pub interface: &'a str,
    /// Network namespace of the interface; `None` for this machine's.
    pub netns: Option<&'a str>,
    /// Addresses of the real machines there. No other machine passes.
    pub machines: Vec<Ipv4Addr>,
}

/// A link over a real interface.
#[derive(Debug, Clone, Copy)]
pub struct RealLink<'a> {
    /// The link.
    pub link: &'a Link,
    /// Owner of the interface, and the address of the other machine.
    pub reached: &'a Reached,
    /// The direction in which packets leave by the interface; in the other one they arrive.
    pub leaving: Direction,
}

impl HardwareGraph {
    /// The gateways, in order.
    pub fn gateways(&self) -> impl Iterator<Item = (&Node, &Gateway)> {
        self.nodes.iter().filter_map(|n| if let NodeKind::Gateway(g) = &n.kind { Some((n, g)) } else { None })
    }

    /// The ports of the emulated network on interfaces of this machine: those of real servers and of gateways, in order.
    pub fn real_ports(&self) -> impl Iterator<Item = RealPort<'_>> {
        self.nodes.iter().filter_map(Node::real_port)
    }

    /// The real servers, in order.
    pub fn real_servers(&self) -> impl Iterator<Item = (&Node, &RealServer)> {
        self.servers().filter_map(|(node, server)| Some((node, server.real.as_ref()?)))
    }

    /// The robots whose serial ports are at agents, in order.
    pub fn robots_at_agents(&self) -> impl Iterator<Item = (&Node, &Kobuki, &AgentId)> {
        self.robots().filter_map(|(node, robot)| match &robot.driver {
            Driver::Kobuki(kobuki) => Some((node, &**kobuki, kobuki.agent.as_ref()?)),
            _ => None,
        })
    }

    /// The nodes whose machines have agents, in order.
    pub fn agents(&self) -> impl Iterator<Item = (&Node, &AgentId)> {
        self.nodes.iter().filter_map(|node| Some((node, node.agent()?)))
    }

    /// Makes all real servers emulated ones, and robots at agents simulated ones, as in virtual time.
    pub fn emulate_agents(&mut self) {
        for node in &mut self.nodes {
            match &mut node.kind {
                NodeKind::Server(server) => server.real = None,
                NodeKind::Robot(robot) if robot.driver.agent().is_some() => robot.driver = Driver::default(),
                _ => {}
            }
        }
    }

    /// The links over real interfaces, of this machine and of agents' machines, in order.
    pub fn real_links(&self) -> impl Iterator<Item = RealLink<'_>> {
        let nodes: HashMap<_, _> = self.nodes.iter().map(|node| (&node.id, node)).collect();
        self.links.iter().filter_map(move |link| {
            let [Some(a), Some(b)] = link.ends.each_ref().map(|end| nodes.get(end).copied()) else {
                return None;
            };
            let over = |reached, leaving| RealLink { link, reached, leaving };
            let forward = b.reached_from(a).map(|reached| over(reached, Direction::Forward));
            forward.or_else(|| Some(over(a.reached_from(b)?, Direction::Backward)))
        })
    }

    /// The graph without real machines and the links between them: what is emulated as a whole.
    pub fn without_machines(&self) -> Self {
        let real: Vec<_> = self.real_links().map(|real| real.link.id.clone()).collect();
        let mut graph = self.clone();
        graph.nodes.retain(|node| !matches!(node.kind, NodeKind::Machine(_)));
        graph.links.retain(|link| !real.contains(&link.id));
        graph
    }
}

impl Node {
    /// Returns the real machine that a server is, if it is one.
    pub fn real_server(&self) -> Option<&RealServer> {
        if let NodeKind::Server(server) = &self.kind { server.real.as_ref() } else { None }
    }

    /// Returns the agent of its machine, if it has one.
    pub fn agent(&self) -> Option<&AgentId> {
        match &self.kind {
            NodeKind::Server(server) => server.real.as_ref().map(|real| &real.agent),
            NodeKind::Machine(machine) => machine.agent.as_ref(),
            NodeKind::RadioUnit(unit) => unit.agent.as_ref(),
            NodeKind::Robot(robot) => robot.driver.agent().or(robot.radio.as_ref().map(|radio| &radio.agent)),
            NodeKind::Switch | NodeKind::Gateway(_) => None,
        }
    }

    /// Returns the real radio of a robot or a radio unit, if it has one.
    pub fn radio(&self) -> Option<&RealRadio> {
        match &self.kind {
            NodeKind::Robot(robot) => robot.radio.as_ref(),
            NodeKind::RadioUnit(unit) => unit.radio.as_ref(),
            _ => None,
        }
    }

    /// Returns the port of the emulated network on an interface of this machine, if the node has one.
    fn real_port(&self) -> Option<RealPort<'_>> {
        match (&self.kind, self.real_server()) {
            (_, Some(real)) => Some(RealPort {
                node: self,
                interface: &real.interface,
                netns: real.netns.as_deref(),
                machines: vec![real.address],
            }),
            (NodeKind::Gateway(gateway), _) => Some(RealPort {
                node: self,
                interface: &gateway.interface,
                netns: gateway.netns.as_deref(),
                machines: gateway.machines.values().copied().collect(),
            }),
            _ => None,
        }
    }

    /// Returns how a real machine other than this one is reached.
    pub fn reached(&self) -> Option<&Reached> {
        match &self.kind {
            NodeKind::Machine(machine) => machine.reached.as_ref(),
            _ => None,
        }
    }

    /// Returns how a real machine is reached over its link to another node: by an interface of that node's machine.
    pub fn reached_from(&self, near: &Self) -> Option<&Reached> {
        let is_near = |reached: &&Reached| match &reached.via {
            Some(agent) => near.agent() == Some(agent),
            None => near.reached().is_none(),
        };
        self.reached().filter(is_near)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::{Capacity, HostAddress, Machine, Server, Tier};

    fn node(place: usize, kind: NodeKind) -> Node {
        let (id, domain) = (format!("n{place}").parse().unwrap(), "local".parse().unwrap());
        Node { id, domain, position: None, kind }
    }

    fn server(place: usize, is_real: bool) -> Node {
        let real = is_real.then(|| RealServer {
            agent: format!("a{place}").parse().unwrap(),
            interface: "eth1".to_owned(),
            netns: None,
            address: Ipv4Addr::new(192, 168, 1, place as u8),
        });
        let capacity = Capacity { cpus: 1.0, memory_bytes: 1, accelerators: None };
        node(
            place,
            NodeKind::Server(Server {
                tier: Tier::Edge,
                capacity,
                cost: 1.0,
                used_cost: 0.0,
                memory_cost: 0.0,
                migration_cost: 0.0,
                reliability: 1.0,
                speed: 1.0,
                power: None,
                real,
            }),
        )
    }

    /// Each kind is 0 for a switch, 1 for an emulated server, 2 for a real one, and 3 for a gateway.
    fn graph(kinds: &[u8]) -> HardwareGraph {
        let gateway = Gateway { interface: "eth2".to_owned(), netns: None, machines: BTreeMap::new() };
        let nodes = kinds.iter().enumerate().map(|(place, kind)| match kind {
            0 => node(place, NodeKind::Switch),
            3 => node(place, NodeKind::Gateway(gateway.clone())),
            kind => server(place, *kind == 2),
        });
        HardwareGraph {
            domains: Vec::new(),
            nodes: nodes.collect(),
            links: Vec::new(),
            wireless: BTreeMap::new(),
        }
    }

    proptest! {
        #[test]
        fn emulating_servers_changes_the_addresses_of_no_other_node(kinds in prop::collection::vec(0_u8..4, 0..20)) {
            let graph = graph(&kinds);
            let mut emulated = graph.clone();
            emulated.emulate_agents();
            prop_assert!(emulated.real_servers().next().is_none());
            let names = |graph: &HardwareGraph| graph.ports().map(|node| node.id.clone()).collect::<Vec<_>>();
            prop_assert_eq!(names(&graph), names(&emulated), "nor ports");
            for (node, kind) in graph.nodes.iter().zip(&kinds) {
                let (before, after) = (graph.address(&node.id), emulated.address(&node.id));
                if *kind == 2 {
                    prop_assert_eq!(before, None);
                    prop_assert_eq!(graph.ipv4(&node.id), node.real_server().map(|real| real.address));
                    prop_assert!(after.is_some_and(|after| HostAddress::is_near(after.ipv4)));
                } else {
                    prop_assert_eq!(before, after);
                    prop_assert_eq!(graph.ipv4(&node.id), before.map(|address| address.ipv4));
                }
            }
            prop_assert_eq!(graph.real_ports().count(), kinds.iter().filter(|kind| **kind >= 2).count());
        }
    }

    #[test]
    fn real_servers_survive_json_beside_what_makes_them_servers() {
        let node = server(7, true);
        let json = serde_json::to_value(&node).unwrap();
        assert_eq!((&json["kind"], &json["real"]["agent"]), (&"server".into(), &"a7".into()));
        assert_eq!(json["real"]["address"], "192.168.1.7");
        assert_eq!(serde_json::from_value::<Node>(json).unwrap(), node);
        let emulated = serde_json::to_value(server(7, false)).unwrap();
        assert_eq!(emulated.get("real"), None);
    }

    #[test]
    fn nodes_with_agents_are_servers_machines_and_radio_units() {
        let machine = |place, agent: Option<&str>| {
            let agent = agent.map(|agent| agent.parse().unwrap());
            node(place, NodeKind::Machine(Machine { reached: None, agent }))
        };
        let unit = serde_json::from_value::<Node>(serde_json::json!({
            "id": "R1", "domain": "local", "position": [0.0, 0.0, 0.0], "kind": "radio_unit", "network": "lab", "channel": 1,
            "capacity": { "cpus": 1.0, "memory_bytes": 1 }, "tx_power_dbm": 15.0, "agent": "ap1",
        }));
        let graph = HardwareGraph {
            nodes: vec![
                server(1, true),
                server(2, false),
                machine(3, Some("desk1")),
                machine(4, None),
                unit.unwrap(),
            ],
            ..graph(&[])
        };
        let agents = |graph: &HardwareGraph| {
            graph.agents().map(|(node, agent)| format!("{} {agent}", node.id)).collect::<Vec<_>>()
        };
        assert_eq!(agents(&graph), ["n1 a1", "n3 desk1", "R1 ap1"]);
        let json = serde_json::to_value(&graph).unwrap();
        assert_eq!(json["nodes"][3].get("agent"), None);
        assert_eq!(serde_json::from_value::<HardwareGraph>(json).unwrap(), graph);
    }
}
