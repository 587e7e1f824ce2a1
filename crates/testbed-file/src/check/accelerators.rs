//! Accelerators have room for the models on them, and robots follow models that are there.

use std::collections::HashMap;

use cotorra_graph::{Node, NodeId, Program, Service, Testbed, Vnf};

use crate::{
    records::ServiceRecord,
    yaml::{Sink, Span, decode::words},
};

/// Memory that models take of each accelerator of nodes.
#[derive(Default)]
pub(super) struct AcceleratorsInUse<'a>(HashMap<&'a NodeId, Vec<u64>>);

impl<'a> AcceleratorsInUse<'a> {
    /// Gives a VNF an accelerator of a node, or reports that none has room. `able` are the nodes that could carry it alone.
    pub(super) fn place(&mut self, node: &'a Node, vnf: &Vnf, place: &Span, able: &[&str], sink: &mut Sink) {
        let needed = vnf.accelerator_bytes();
        let alone = match able {
            [] => "give a node `accelerators` with more memory".to_owned(),
            able => format!("`{}` alone would fit {}", vnf.id, words(able)),
        };
        let Some(accelerators) = node.capacity().and_then(|capacity| capacity.accelerators) else {
            sink.error(place, format!("`{}` has no accelerator, and `{}` needs one", node.id, vnf.id))
                .help(alone);
            return;
        };
        let taken = self.0.entry(&node.id).or_insert_with(|| accelerators.taken([]));
        match accelerators.place(taken, needed) {
            Some(free) => taken[free] += needed,
            None => {
                let gb = |bytes: u64| format!("{:.2} GB", bytes as f64 / 1e9);
                let most = accelerators.memory_bytes - taken.iter().min().copied().unwrap_or_default();
                sink.error(place, format!("no accelerator of `{}` has {} free", node.id, gb(needed)))
                    .label(format!("{} at most are free", gb(most)))
                    .help(alone);
            }
        }
    }
}

/// A robot follows one model, which is there and whose chunks are long enough.
pub(super) fn policy(record: &ServiceRecord, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    let (Some(its), Some(policy)) = (&record.policy, &service.policy) else { return };
    if service.kpis.flow.is_some() || service.vnfs.iter().any(|vnf| vnf.program == Program::RobotDriver) {
        sink.error(&its.span, "a policy in a service whose time is another one")
            .help("describe the policy in a service of its own; it may have `vnfs: {}`");
    }
    let servers = || testbed.vnfs().filter_map(|vnf| Some((&vnf.id, vnf.policy_server()?)));
    let Some((_, server)) = servers().find(|(id, _)| **id == policy.server) else {
        let names = servers().map(|(id, _)| id.as_str());
        sink.unknown_name(&its.value.server.span, "policy server named", policy.server.as_str(), names);
        return;
    };
    if policy.request_ahead >= server.chunk.actions && policy.request_ahead > 0 {
        let actions = server.chunk.actions;
        sink.error(
            &its.value.request_ahead.span,
            format!("observes with {} actions left, of chunks of {actions}", policy.request_ahead),
        )
        .help(format!("write a number below {actions}: the robot would observe all the time"));
    }
}
