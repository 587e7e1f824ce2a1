//! Checks of agents, and of radios at agents.

use std::collections::HashMap;

use cotorra_graph::{AgentId, HardwareGraph, NodeKind};

use crate::{
    records::{NodeRecord, TestbedRecord},
    yaml::{Sink, decode::Spanned},
};

/// Every agent is that of one node.
pub(super) fn agents(record: &TestbedRecord, sink: &mut Sink) {
    let mut nodes = HashMap::new();
    for (id, node) in &record.nodes.0 {
        let Some(agent) = agent(node) else { continue };
        if let Some(other) = nodes.insert(&agent.value, &id.value) {
            sink.error(&agent.span, format!("`{other}` has the agent `{}`, too", agent.value))
                .help("name the agent of this machine: each runs one, with a name of its own");
        }
    }
}

/// A robot with a real radio has no services: cotorra does not carry its packets.
pub(super) fn services(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    for (service, its) in &record.services.0 {
        let node = graph.node(&its.robot.value);
        if let Some(NodeKind::Robot(robot)) = node.map(|node| &node.kind)
            && robot.radio.is_some()
        {
            let wrong = format!("the service `{}` of a robot with a real radio", service.value);
            sink.error(&its.robot.span, wrong).help(format!(
                "leave it out, because cotorra does not carry the packets of real radios, or take the model by \
                 `--set wireless.{}.wifi=model`",
                robot.network
            ));
        }
    }
}

fn agent(node: &NodeRecord) -> Option<&Spanned<AgentId>> {
    match node {
        NodeRecord::Server(server) => server.agent.as_ref(),
        NodeRecord::Machine(machine) => machine.agent.as_ref(),
        NodeRecord::RadioUnit(unit) => unit.agent.as_ref(),
        NodeRecord::Robot(robot) => robot.agent.as_ref(),
        NodeRecord::Switch(_) | NodeRecord::Gateway(_) => None,
    }
}
