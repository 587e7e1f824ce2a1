//! The instances of VNFs that answer robots, and the choice of those that a request goes to.

use cotorra_engine::Engine;
use cotorra_graph::{NodeId, Program, Requests, Service, Testbed, VnfId};
use cotorra_network_control::{Network, NetworkControl};
use cotorra_plugin::wire;

/// A VNF that answers a robot, or receives its images.
#[derive(Debug)]
pub(crate) struct Answerer {
    pub(crate) vnf: VnfId,
    /// UDP port of each instance on its node.
    pub(crate) port: u16,
    requests: Requests,
    /// Nodes of the instances, the nearest first, as of the last measurement.
    pub(crate) nearest: Vec<NodeId>,
}

impl Answerer {
    /// Returns the VNF of a service that runs this program.
    pub(crate) fn of(testbed: &Testbed, service: &Service, program: &Program) -> Option<Self> {
        let vnf = service.vnfs.iter().find(|vnf| vnf.program == *program)?;
        Self::asking(testbed, &vnf.id, service.requests)
    }

    /// Returns a VNF of which the first serving instance is used.
    pub(crate) fn first_of(testbed: &Testbed, vnf: &VnfId) -> Option<Self> {
        Self::asking(testbed, vnf, Requests::One)
    }

    /// Returns a VNF of any service whose instances are chosen in that way.
    pub(crate) fn asking(testbed: &Testbed, vnf: &VnfId, requests: Requests) -> Option<Self> {
        let (vnf, port) = (vnf.clone(), wire::port(testbed, vnf)?);
        Some(Self { vnf, port, requests, nearest: Vec::new() })
    }

    /// Whether the distances of instances matter.
    pub(crate) fn is_by_distance(&self) -> bool {
        self.requests == Requests::Nearest
    }

    /// Returns the nodes of the instances that a request goes to now. Without a serving instance, the node where one is
    /// planned.
    pub(crate) fn asked<N: Network, E: Engine>(&self, control: &NetworkControl<N, E>) -> Vec<NodeId> {
        let mut asked = control.serving(&self.vnf);
        if self.is_by_distance() {
            // An instance that came after the last measurement has to wait for the next one.
            let rank =
                |node: &&NodeId| self.nearest.iter().position(|near| near == *node).unwrap_or(usize::MAX);
            asked.sort_by_key(rank);
        }
        if asked.is_empty() {
            asked.extend(control.node(&self.vnf));
        }
        if self.requests != Requests::All {
            asked.truncate(1);
        }
        asked.into_iter().cloned().collect()
    }
}
