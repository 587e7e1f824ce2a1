//! Checks of agents.

use std::collections::HashMap;

use cotorra_graph::AgentId;

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

fn agent(node: &NodeRecord) -> Option<&Spanned<AgentId>> {
    match node {
        NodeRecord::Server(server) => server.agent.as_ref(),
        NodeRecord::Machine(machine) => machine.agent.as_ref(),
        NodeRecord::RadioUnit(unit) => unit.agent.as_ref(),
        NodeRecord::Robot(robot) => robot.agent.as_ref(),
        NodeRecord::Switch(_) | NodeRecord::Gateway(_) => None,
    }
}
