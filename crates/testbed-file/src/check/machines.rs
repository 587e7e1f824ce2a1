//! Checks of real machines and the links between them. They are a network of their own: packets pass from it to the
//! emulated one at a gateway only.

use std::collections::{HashMap, HashSet};

use cotorra_graph::{AgentId, HardwareGraph, IpNetwork, Jitter, Link, Node, NodeKind, Rate, Reached};

use crate::{
    records::{LinkRecord, TestbedRecord},
    yaml::Sink,
};

/// Every real machine is reached from this one or from that of an agent, over one link, by packets that are no other's. One
/// with an agent may have no link, and only report its context.
pub(super) fn machines(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    media(record, graph, sink);
    if !graph.nodes.iter().any(|node| matches!(node.kind, NodeKind::Machine(_))) {
        return;
    }
    let carriers = Carriers::of(graph);
    let mut this = None;
    let mut taken: HashMap<(&Option<AgentId>, &str, Option<IpNetwork>), _> = HashMap::new();
    let mut via: HashMap<&AgentId, usize> = HashMap::new();
    for ((id, _), node) in record.nodes.0.iter().zip(&graph.nodes) {
        let NodeKind::Machine(machine) = &node.kind else { continue };
        let Some(reached) = &machine.reached else {
            if carriers.has(node) {
                continue;
            }
            if let Some(first) = this.replace(&node.id) {
                sink.error(&id.span, format!("`{first}` and `{}` are both this machine", node.id))
                    .help("say through which `interface` the other is reached, or leave one out");
            }
            continue;
        };
        if let Some(other) = taken.insert((&reached.via, &reached.interface, reached.address), &node.id) {
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
        if let Some(agent) = &reached.via {
            let count = via.entry(agent).or_default();
            *count += 1;
            if *count == Reached::MOST_VIA_AGENT + 1 {
                sink.error(
                    &id.span,
                    format!("more than {} machines are reached via `{agent}`", Reached::MOST_VIA_AGENT),
                )
                .help("give several of them one `address`, such as `address: 192.168.1.0/24`");
            }
        }
        let links = graph.links.iter().filter(|link| leads_to(graph, link, node)).count();
        let only_reports = links == 0 && machine.agent.is_some() && reached.via.is_none();
        if links != 1 && !only_reports {
            let near = match &reached.via {
                None => "to this machine: to a node with `kind: machine` and no `interface`".to_owned(),
                Some(agent) => format!("to the machine of the agent `{agent}`"),
            };
            sink.error(&id.span, format!("`{}` has {links} links", node.id))
                .help(format!("link it once, {near}"));
        }
    }
    links(record, graph, &carriers, sink);
}

/// The agents via which machines are reached.
struct Carriers<'a>(HashSet<&'a AgentId>);

impl<'a> Carriers<'a> {
    fn of(graph: &'a HardwareGraph) -> Self {
        Self(graph.nodes.iter().filter_map(|node| node.reached()?.via.as_ref()).collect())
    }

    /// Whether machines are reached via a node.
    fn has(&self, node: &Node) -> bool {
        node.agent().is_some_and(|agent| self.0.contains(agent))
    }

    /// Returns how a machine is reached over its link to another.
    fn reached<'n>(&self, far: &'n Node, near: &Node) -> Option<&'n Reached> {
        // A machine without an interface is this one, or that of an agent.
        far.reached_from(near).filter(|reached| reached.via.is_some() || !self.has(near))
    }
}

/// Whether a link leads to a machine, and not from it to one that is reached via it.
fn leads_to(graph: &HardwareGraph, link: &Link, node: &Node) -> bool {
    let is_via_it = |id| {
        let other = graph.node(id).and_then(Node::reached);
        other.is_some_and(|reached| reached.via.is_some() && reached.via.as_ref() == node.agent())
    };
    link.ends.contains(&node.id) && !link.ends.iter().any(is_via_it)
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
            Some(reached) if reached.reflector && reached.via.is_none() => (
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

/// A link of a real machine leads to another, from this one or from that of an agent.
fn links(record: &TestbedRecord, graph: &HardwareGraph, carriers: &Carriers<'_>, sink: &mut Sink) {
    let is_correlated = |jitter: Option<Jitter>| jitter.is_some_and(|jitter| jitter.is_correlated());
    let is_trace = |rate: &Rate| rate.trace_name().is_some();
    for (link, place) in graph.links.iter().zip(record.link_places()) {
        let ends = link.ends.each_ref().map(|end| graph.node(end));
        let is_machine = |end: &&Node| matches!(end.kind, NodeKind::Machine(_));
        let (a, b) = match ends.map(|end| end.filter(is_machine)) {
            [None, None] => continue,
            [Some(a), Some(b)] => (a, b),
            _ => {
                sink.error(
                    place,
                    format!(
                        "`{}` leads from what is emulated to a real machine, and no packet passes there",
                        link.id
                    ),
                )
                .help(
                    "reach it through a gateway: `gate: { kind: gateway, interface: eth1, machines: { arm: \
                     192.168.1.7 } }`",
                );
                continue;
            }
        };
        let (what, help) = match (carriers.reached(b, a), carriers.reached(a, b)) {
            (Some(_), Some(_)) => (
                "has two ends that are reached via each other",
                "leave out one `via`: one of them has the interface",
            ),
            (Some(_), None) | (None, Some(_)) => {
                let directions = [&link.forward, &link.backward];
                if directions.iter().any(|conditions| is_trace(&conditions.rate)) {
                    (
                        "leads over a real interface, where NetEm plays no packet-delivery traces",
                        "give it a `rate` in place of the `trace`",
                    )
                } else if directions.iter().any(|conditions| !conditions.queue_discipline.is_drop_tail()) {
                    (
                        "leads over a real interface, where NetEm's queue drops at its tail only",
                        "give its `queue` only a limit, such as `queue: 100 packets`",
                    )
                } else if directions.iter().any(|conditions| is_correlated(conditions.jitter)) {
                    (
                        "leads over a real interface, where NetEm cannot correlate jitter without narrowing it",
                        "leave out `correlation` and `over` of its `jitter`",
                    )
                } else {
                    continue;
                }
            }
            (None, None) if [a, b].into_iter().any(is_via) => (
                "does not lead to a machine from the one that its `via` names",
                "link it to that machine, or name the machine at the other end in its `via`",
            ),
            (None, None) if carriers.has(a) || carriers.has(b) => (
                "does not lead over an interface of this machine",
                "name the machine that has the interface in `via`, or link the other one to this machine",
            ),
            (None, None) => (
                "does not lead over an interface of this machine",
                "one end is this machine, `kind: machine` and no `interface`; the other one has an `interface`",
            ),
        };
        sink.error(place, format!("`{}` {what}", link.id)).help(help);
    }
}

/// Whether a machine is reached via an agent.
fn is_via(node: &Node) -> bool {
    node.reached().is_some_and(|reached| reached.via.is_some())
}
