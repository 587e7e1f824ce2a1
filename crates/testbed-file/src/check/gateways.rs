//! Checks of gateways and the real machines behind them.

use std::{
    collections::{HashMap, HashSet},
    net::Ipv4Addr,
};

use cotorra_graph::{Gateway, HardwareGraph, HostAddress};

use crate::{
    records::{NodeRecord, TestbedRecord},
    yaml::Sink,
};

/// Every gateway has an interface for itself, and machines with names and addresses of their own.
pub(super) fn gateways(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let emulated: HashSet<_> = graph.real_links().map(|real| &real.reached.interface).collect();
    let (mut interfaces, mut names, mut addresses) = (HashMap::new(), HashSet::new(), HashMap::new());
    for (id, node) in &record.nodes.0 {
        let NodeRecord::Gateway(gateway) = node else { continue };
        let interface = &gateway.interface;
        let netns = gateway.netns.as_ref().map(|netns| &netns.value);
        if let Some(other) = interfaces.insert((netns, &interface.value), &id.value) {
            sink.error(
                &interface.span,
                format!("`{other}` and `{}` both have {}", id.value, interface.value),
            )
            .help("give each an interface of its own");
        }
        if netns.is_none() && emulated.contains(&interface.value) {
            sink.error(&interface.span, format!("a link to a real machine leads over {}, too", interface.value))
                .help("list that machine under the `machines` of the gateway, and give the gateway's link its conditions");
        }
        let machines = &gateway.machines.value.0;
        if machines.is_empty() || machines.len() > Gateway::MAX_MACHINES {
            sink.error(&gateway.machines.span, format!("`{}` has {} machines", id.value, machines.len()))
                .help(format!(
                    "list 1 to {}, such as `machines: {{ arm: 192.168.1.7 }}`",
                    Gateway::MAX_MACHINES
                ));
        }
        for (name, address) in machines {
            if graph.node(&name.value).is_some() || !names.insert(&name.value) {
                sink.error(&name.span, format!("the name `{}` is here twice", name.value))
                    .help("rename one of them: nodes and machines have names of their own");
            }
            if let Some(other) = addresses.insert(address.value, &name.value) {
                sink.error(&address.span, format!("`{other}` has the address {}, too", address.value))
                    .help("give each machine its own");
            }
            if let Some((problem, help)) = unusable(address.value, graph) {
                sink.error(&address.span, format!("{} is {problem}", address.value)).help(help);
            }
        }
    }
}

/// Returns why no machine behind a gateway can have an address, and what to do.
fn unusable(address: Ipv4Addr, graph: &HardwareGraph) -> Option<(String, String)> {
    let [.., high, low] = address.octets();
    let place = usize::from(u16::from_be_bytes([high, low]));
    let is_near = HostAddress::is_near(address);
    if let (true, Some(host)) = (is_near, place.checked_sub(1).and_then(|place| graph.hosts().nth(place))) {
        let help = "write the address that the machine has, or one from 10.77.254.1 on".to_owned();
        return Some((format!("the address of `{}`", host.id), help));
    }
    let is_group =
        address.is_multicast() || address.is_broadcast() || (is_near && matches!(place, 0 | 0xffff));
    (is_group || address.is_loopback() || address.is_unspecified()).then(|| {
        let help = "write the address of its interface, such as `192.168.1.7`".to_owned();
        ("not the address of one machine".to_owned(), help)
    })
}
