//! Paths of least delay through G.

use std::{path::Path, time::Duration};

use cotorra_graph::{HardwareGraph, LinkId, NodeId, Topology};

fn graph(links: &str) -> HardwareGraph {
    let server = "{ kind: server, tier: fog, cpus: 1, memory: 1 GB }";
    let text = format!(
        "name: x\nwireless: {{ w: {{ delay: 3 ms }} }}\nnodes:\n  a: {server}\n  b: {server}\n  \
         s1: {{ kind: switch }}\n  s2: {{ kind: switch }}\n  s3: {{ kind: switch }}\n  \
         r: {{ kind: robot, position: [0, 0] }}\n  q: {{ kind: robot, position: [0, 0] }}\n  \
         U: {{ kind: radio_unit, position: [0, 0], channel: 1 }}\nlinks:\n{links}"
    );
    cotorra_testbed_file::parse("x.yaml", &text, Path::new(""))
        .unwrap_or_else(|wrong| panic!("{wrong}"))
        .graph
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).expect("a name")
}

const LINKS: &str = "  - { ends: [a, [s1, s2, s3]] }\n  - { ends: [s1, b], delay: 2 ms }\n  \
                     - { ends: [s2, b], delay: 1 ms, backward: { delay: 9 ms } }\n  \
                     - { ends: [s3, [s1, U]] }\n";

#[test]
fn least_delay_in_each_direction_then_fewest_hops() {
    let graph = graph(LINKS);
    let route = |from, to| graph.route(&id(from), &id(to), |_| None).map(|route| (route.links, route.delay));
    let ms = Duration::from_millis;
    assert_eq!(
        route("a", "b"),
        Some((vec![LinkId::between(&id("a"), &id("s2")), LinkId::between(&id("s2"), &id("b"))], ms(1)))
    );
    // The way back is slow through s2; of the two ways through s1, the one without s3.
    let (links, delay) = route("b", "a").unwrap();
    assert_eq!((links.iter().map(LinkId::as_str).collect::<Vec<_>>(), delay), (vec!["s1-b", "a-s1"], ms(2)));
    // s2 is reached through servers only, which do not forward.
    assert_eq!(route("s2", "U"), None);
    assert_eq!(route("a", "nowhere"), None);
}

#[test]
fn robots_are_reached_where_they_are_attached() {
    let graph = graph(LINKS);
    let unit = id("U");
    let route = |attached: bool| {
        graph.route(&id("r"), &id("q"), |_| attached.then_some(&unit)).map(|route| (route.links, route.delay))
    };
    let hops = vec![LinkId::wireless(&id("r"), &unit), LinkId::wireless(&id("q"), &unit)];
    assert_eq!(route(true), Some((hops, Duration::from_millis(6))));
    assert_eq!(route(false), None);
}

#[test]
fn detaching_undoes_attaching() {
    let graph = graph(LINKS);
    let neighbours = |topology: &Topology<'_>| {
        (0..graph.nodes.len()).map(|at| topology.neighbours(at)).collect::<Vec<_>>()
    };
    let mut topology = Topology::new(&graph);
    let before = neighbours(&topology);
    topology.attach(&id("r"), &id("U"));
    topology.attach(&id("r"), &id("U"));
    topology.attach(&id("a"), &id("U"));
    topology.detach(&id("r"));
    assert_eq!(neighbours(&topology), before);
}
