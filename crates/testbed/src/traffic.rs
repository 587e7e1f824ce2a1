//! Sources of traffic of a testbed, at the ports of its fabric.

use cotorra_fabric::Fabric;
use cotorra_graph::{Direction, NodeId, OverLink, RadioKind, Testbed, TrafficSource};
use cotorra_traffic::Sources;

use crate::error::RunError;

/// Creates the sources of a testbed.
pub(crate) fn sources(testbed: &Testbed, fabric: &Fabric, seed: u64) -> Sources {
    let places = |TrafficSource { from, to, over, .. }: &TrafficSource| match over {
        None => Some([fabric.port(from)?.0, fabric.port(to)?.0]),
        Some(OverLink { link, direction }) => {
            let [first, second] = fabric.link_ends(link)?.map(|end| end.0);
            Some(match direction {
                Direction::Forward => [first, second],
                Direction::Backward => [second, first],
            })
        }
    };
    Sources::new(&testbed.traffic, places, seed)
}

/// Checks that the fabric carries all packets of a testbed's sources in a run with real packets.
pub(crate) fn check_real(testbed: &Testbed) -> Result<(), RunError> {
    let graph = &testbed.graph;
    let has_real_radio = |end: &NodeId| {
        let kinds = [RadioKind::Hwsim, RadioKind::Hardware];
        kinds.into_iter().any(|kind| graph.nodes_with(kind).any(|node| node.id == *end))
    };
    let is_real = |end: &NodeId| graph.node(end).is_some_and(|node| node.real_server().is_some());
    for source in testbed.traffic.iter().filter(|source| source.over.is_none()) {
        for end in [&source.from, &source.to] {
            let reason = match end {
                end if has_real_radio(end) => format!("`{end}` has a radio of real Wi-Fi software"),
                end if is_real(end) => format!("`{end}` is a real machine"),
                _ => continue,
            };
            return Err(RunError::RealTraffic { traffic: source.id.clone(), reason });
        }
    }
    Ok(())
}

/// Rejects the sources of a testbed if packets bypass the fabric for this reason.
pub(crate) fn reject_real(testbed: &Testbed, reason: &str) -> Result<(), RunError> {
    match testbed.traffic.first() {
        Some(source) => Err(RunError::RealTraffic { traffic: source.id.clone(), reason: reason.to_owned() }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn testbed(edge: &str, source: &str) -> Testbed {
        let text = format!(
            "name: busy\nnodes:\n  fog: {{ kind: server, tier: fog, cpus: 1, memory: 1 GB }}\n  \
             edge: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB{edge} }}\nlinks:\n  \
             - {{ ends: [fog, edge], delay: 1 ms }}\ntraffic:\n  bulk: {{ {source}, protocol: tcp }}\n"
        );
        cotorra_testbed_file::parse("busy.yaml", &text, Path::new("")).unwrap()
    }

    #[test]
    fn sources_at_real_machines_are_rejected_with_real_packets() {
        let real = ", agent: e1, interface: eth1, address: 192.168.1.7";
        let between = "from: fog, to: edge";
        assert!(check_real(&testbed("", between)).is_ok());
        assert!(check_real(&testbed(real, "on: fog-edge")).is_ok());
        let error = check_real(&testbed(real, between)).unwrap_err().to_string();
        assert!(error.starts_with("`bulk` is a source of traffic, and `edge` is a real machine"), "{error}");
        let error = reject_real(&testbed("", between), "why").unwrap_err().to_string();
        assert!(error.contains("and why, so") && error.contains("--simulate"), "{error}");
    }
}
