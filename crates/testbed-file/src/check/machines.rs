//! Checks of real machines and the links between them. They are a network of their own: packets pass from it to the
//! emulated one at a gateway only.

use std::collections::{HashMap, HashSet};

use cotorra_graph::{HardwareGraph, IpNetwork, NodeKind, Rate};

use crate::{
    records::{LinkRecord, TestbedRecord},
    yaml::Sink,
};

/// Every real machine is reached from this one, over one link, by packets that are no other's. One with an agent may have no
/// link, and only report its context.
pub(super) fn machines(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    media(record, graph, sink);
    if !graph.nodes.iter().any(|node| matches!(node.kind, NodeKind::Machine(_))) {
        return;
    }
    let mut this = None;
    let mut taken: HashMap<(&str, Option<IpNetwork>), _> = HashMap::new();
    for ((id, _), node) in record.nodes.0.iter().zip(&graph.nodes) {
        let NodeKind::Machine(machine) = &node.kind else { continue };
        let Some(reached) = &machine.reached else {
            if let Some(first) = this.replace(&node.id) {
                sink.error(&id.span, format!("`{first}` and `{}` are both this machine", node.id))
                    .help("say through which `interface` the other is reached, or leave one out");
            }
            continue;
        };
        if let Some(other) = taken.insert((&reached.interface, reached.address), &node.id) {
            let what = match reached.address {
                Some(address) => format!("{address}, which is reached"),
                None => "all that is reached".to_owned(),
            };
            sink.error(
                &id.span,
                format!("`{other}` and `{}` are both {what} through {}", node.id, reached.interface),
            )
            .help("give each an `address` of its own, such as `address: 192.168.1.7`");
        }
        let links = graph.links.iter().filter(|link| link.ends.contains(&node.id)).count();
        let only_reports = links == 0 && machine.agent.is_some();
        if links != 1 && !only_reports {
            sink.error(&id.span, format!("`{}` has {links} links", node.id))
                .help("link it once, to this machine: to a node with `kind: machine` and no `interface`");
        }
    }
    links(record, graph, sink);
}

/// Only what is not emulated has a delay of its own, which is declared or measured.
fn media(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let declares = |link: &LinkRecord| link.medium_delay.is_some();
    if !record.links.iter().any(declares) {
        return;
    }
    let real: HashMap<_, _> = graph.real_links().map(|real| (&real.link.id, real.reached)).collect();
    let mut told = HashSet::new();
    for (link, (of, _)) in graph.links.iter().zip(record.link_entries()) {
        let Some(declared) = &record.links[of].medium_delay else { continue };
        let (what, help) = match real.get(&link.id) {
            None => (
                format!("`{}` is emulated, and has no medium with a delay of its own", link.id),
                "write `delay`, which is the link's whole delay",
            ),
            Some(reached) if reached.reflector => (
                format!("the delay of `{}` is declared here, and measured by a reflector", link.id),
                "leave out `medium_delay`, or the `reflector`",
            ),
            Some(_) => continue,
        };
        if told.insert(of) {
            sink.error(&declared.span, what).help(help);
        }
    }
}

/// A link of a real machine leads from this one to another.
fn links(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let is_reached = |id| match &graph.node(id)?.kind {
        NodeKind::Machine(machine) => Some(machine.reached.is_some()),
        _ => None,
    };
    let is_trace = |rate: &Rate| matches!(rate, Rate::Trace { .. });
    for (link, place) in graph.links.iter().zip(record.link_places()) {
        let (what, help) = match link.ends.each_ref().map(is_reached) {
            [None, None] => continue,
            [Some(a), Some(b)] if a != b => {
                if !is_trace(&link.forward.rate) && !is_trace(&link.backward.rate) {
                    continue;
                }
                (
                    "leads over a real interface, where NetEm plays no packet-delivery traces",
                    "give it a `rate` in place of the `trace`",
                )
            }
            [Some(_), Some(_)] => (
                "does not lead over an interface of this machine",
                "one end is this machine, `kind: machine` and no `interface`; the other one has an `interface`",
            ),
            _ => (
                "leads from what is emulated to a real machine, and no packet passes there",
                "reach it through a gateway: `gate: { kind: gateway, interface: eth1, machines: { arm: 192.168.1.7 } }`",
            ),
        };
        sink.error(place, format!("`{}` {what}", link.id)).help(help);
    }
}
