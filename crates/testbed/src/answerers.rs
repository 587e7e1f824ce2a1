//! Who answers robots: the instances of their navigation and localization VNFs, and which of them a request goes to.

use cotorra_graph::{NodeId, Program, Requests, Service, Testbed, VnfId};
use cotorra_network_control::{Network, NetworkControl, vim::Engine};
use cotorra_plugin::wire;

/// A VNF that answers a robot, or receives its images.
#[derive(Debug)]
pub(crate) struct Answerer {
    pub(crate) vnf: VnfId,
    /// Where each instance listens, on its node.
    pub(crate) port: u16,
    requests: Requests,
    /// Nodes of its instances, the nearest first, as they were found last.
    pub(crate) nearest: Vec<NodeId>,
}

impl Answerer {
    /// The VNF of a service that runs this program.
    pub(crate) fn of(testbed: &Testbed, service: &Service, program: &Program) -> Option<Self> {
        let vnf = service.vnfs.iter().find(|vnf| vnf.program == *program)?;
        Some(Self {
            vnf: vnf.id.clone(),
            port: wire::port(testbed, &vnf.id)?,
            requests: service.requests,
            nearest: Vec::new(),
        })
    }

    /// The first instance of a VNF that serves.
    pub(crate) fn first_of(testbed: &Testbed, vnf: &VnfId) -> Option<Self> {
        let (vnf, port) = (vnf.clone(), wire::port(testbed, vnf)?);
        Some(Self { vnf, port, requests: Requests::One, nearest: Vec::new() })
    }

    /// Whether the distances of its instances matter.
    pub(crate) fn is_by_distance(&self) -> bool {
        self.requests == Requests::Nearest
    }

    /// The nodes of the instances that a request goes to now; where none serves, the node where one is to.
    pub(crate) fn asked<N: Network, E: Engine>(&self, control: &NetworkControl<N, E>) -> Vec<NodeId> {
        let mut asked = control.serving(&self.vnf);
        if self.is_by_distance() {
            // One that came since distances were looked at waits for the next look.
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
