//! Links to real machines.

use std::path::Path;

use cotorra_graph::Direction;

#[test]
fn links_via_agents_and_those_of_this_machine_lead_over_their_own_interfaces() {
    let text = "\
name: x
nodes:
  desk: { kind: machine }
  gate: { kind: machine, agent: gate1, interface: eth1, address: 192.168.9.2 }
  cell: { kind: machine, agent: cell1 }
  arm: { kind: machine, interface: eth1, address: 192.168.1.7, via: gate, reflector: true }
  leg: { kind: machine, interface: eth1, via: cell }
links:
  - { ends: [desk, gate] }
  - { ends: [arm, gate], delay: 20 ms, medium_delay: 2 ms }
  - { ends: [cell, leg] }
services: {}
";
    let testbed = cotorra_testbed_file::parse("x.yaml", text, Path::new(".")).unwrap();
    let real = testbed.graph.real_links().map(|real| {
        let via = real.reached.via.as_ref().map(ToString::to_string);
        (real.link.id.to_string(), via, real.leaving)
    });
    let via = |agent: &str| Some(agent.to_owned());
    let expected = [
        ("desk-gate".to_owned(), None, Direction::Forward),
        ("arm-gate".to_owned(), via("gate1"), Direction::Backward),
        ("cell-leg".to_owned(), via("cell1"), Direction::Forward),
    ];
    assert_eq!(real.collect::<Vec<_>>(), expected);
    let needed: Vec<_> = testbed.agents_at_start().map(|(node, _)| node.id.as_str()).collect();
    assert_eq!(needed, ["gate", "cell"]);
    assert_eq!(testbed.graph.without_machines().nodes, []);
}
