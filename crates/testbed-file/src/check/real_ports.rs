//! Checks of gateways and real servers: the ports of the emulated network on interfaces of this machine.

use std::{
    collections::{HashMap, HashSet},
    net::Ipv4Addr,
};

use cotorra_graph::{Gateway, HardwareGraph, HostAddress, NodeId};

use crate::{
    records::{GatewayRecord, NodeRecord, TestbedRecord},
    yaml::{Sink, decode::Spanned},
};

/// The ports so far.
struct Ports<'a> {
    graph: &'a HardwareGraph,
    /// Interfaces of this machine over which links to real machines lead.
    real_links: HashSet<&'a String>,
    /// The node of each interface, by namespace and name, and whether it is a gateway.
    interfaces: HashMap<(Option<&'a String>, &'a String), (&'a NodeId, bool)>,
    /// The machine of each address.
    addresses: HashMap<Ipv4Addr, &'a NodeId>,
}

/// Every gateway has an interface for itself, and machines with names of their own. Real servers can share an interface.
/// Addresses belong to one machine.
pub(super) fn real_ports(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let here = graph.real_links().filter(|real| real.reached.via.is_none());
    let mut ports = Ports {
        graph,
        real_links: here.map(|real| &real.reached.interface).collect(),
        interfaces: HashMap::new(),
        addresses: HashMap::new(),
    };
    let mut names = HashSet::new();
    for (id, node) in &record.nodes.0 {
        match node {
            NodeRecord::Gateway(gateway) => {
                ports.interface((id, true), &gateway.interface, gateway.netns.as_ref(), sink);
                machines((id, gateway), &mut names, &mut ports, sink);
            }
            NodeRecord::Server(server) => {
                if let Some(interface) = &server.interface {
                    ports.interface((id, false), interface, server.netns.as_ref(), sink);
                }
                if let Some(address) = &server.address {
                    ports.address(&id.value, address, sink);
                }
            }
            _ => {}
        }
    }
}

impl<'a> Ports<'a> {
    /// Adds a node's interface.
    fn interface(
        &mut self,
        (id, is_gateway): (&'a Spanned<NodeId>, bool),
        interface: &'a Spanned<String>,
        netns: Option<&'a Spanned<String>>,
        sink: &mut Sink,
    ) {
        let netns = netns.map(|netns| &netns.value);
        let before = self.interfaces.insert((netns, &interface.value), (&id.value, is_gateway));
        if let Some((other, _)) = before.filter(|(_, other_is_gateway)| is_gateway || *other_is_gateway) {
            let help = if before.is_some_and(|(_, other_is_gateway)| is_gateway && other_is_gateway) {
                "give each an interface of its own"
            } else {
                "give the gateway an interface of its own: only real servers can share one"
            };
            sink.error(
                &interface.span,
                format!("`{other}` and `{}` both have {}", id.value, interface.value),
            )
            .help(help);
        }
        if netns.is_none() && self.real_links.contains(&interface.value) {
            let help = if is_gateway {
                "list that machine under the `machines` of the gateway, and give the gateway's link its conditions"
            } else {
                "reach that machine through another interface, or make it a server, too"
            };
            sink.error(
                &interface.span,
                format!("a link to a real machine leads over {}, too", interface.value),
            )
            .help(help);
        }
    }

    /// Adds a machine's address.
    fn address(&mut self, machine: &'a NodeId, address: &Spanned<Ipv4Addr>, sink: &mut Sink) {
        if let Some(other) = self.addresses.insert(address.value, machine) {
            sink.error(&address.span, format!("`{other}` has the address {}, too", address.value))
                .help("give each machine its own");
        }
        if let Some((problem, help)) = unusable(address.value, self.graph) {
            sink.error(&address.span, format!("{} is {problem}", address.value)).help(help);
        }
    }
}

/// Checks the machines behind a gateway.
fn machines<'a>(
    (id, gateway): (&Spanned<NodeId>, &'a GatewayRecord),
    names: &mut HashSet<&'a NodeId>,
    ports: &mut Ports<'a>,
    sink: &mut Sink,
) {
    let machines = &gateway.machines.value.0;
    if machines.is_empty() || machines.len() > Gateway::MAX_MACHINES {
        sink.error(&gateway.machines.span, format!("`{}` has {} machines", id.value, machines.len()))
            .help(format!("list 1 to {}, such as `machines: {{ arm: 192.168.1.7 }}`", Gateway::MAX_MACHINES));
    }
    for (name, address) in machines {
        if ports.graph.node(&name.value).is_some() || !names.insert(&name.value) {
            sink.error(&name.span, format!("the name `{}` is here twice", name.value))
                .help("rename one of them: nodes and machines have names of their own");
        }
        ports.address(&name.value, address, sink);
    }
}

/// Returns why no real machine can have an address, and what to do.
fn unusable(address: Ipv4Addr, graph: &HardwareGraph) -> Option<(String, String)> {
    let [.., high, low] = address.octets();
    let place = usize::from(u16::from_be_bytes([high, low]));
    let is_near = HostAddress::is_near(address);
    if let (true, Some(host)) = (is_near, place.checked_sub(1).and_then(|place| graph.hosts().nth(place))) {
        let help = "write the address that the machine has, or one from 10.77.254.1 on".to_owned();
        let when = if host.real_server().is_some() { " in virtual time" } else { "" };
        return Some((format!("the address of `{}`{when}", host.id), help));
    }
    let is_group =
        address.is_multicast() || address.is_broadcast() || (is_near && matches!(place, 0 | 0xffff));
    (is_group || address.is_loopback() || address.is_unspecified()).then(|| {
        let help = "write the address of its interface, such as `192.168.1.7`".to_owned();
        ("not the address of one machine".to_owned(), help)
    })
}
