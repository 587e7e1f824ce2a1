//! The applications of a platform: the VNFs of one domain. An application instance has the name of its VNF.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::Ipv4Addr,
};

use cotorra_graph::{HardwareGraph, NodeId, Nodes, Placement, Program, Testbed, Timestamp, Vnf, VnfId};
use cotorra_mec::RequestError;

/// The fixed part: a domain's nodes, and the VNFs of its testbed file.
#[derive(Debug)]
pub struct Site {
    nodes: BTreeSet<NodeId>,
    /// The robot that each VNF serves; `None` for a VNF without a service.
    vnfs: BTreeMap<VnfId, Option<NodeId>>,
    ports: BTreeMap<VnfId, u16>,
    addresses: BTreeMap<NodeId, Ipv4Addr>,
}

/// The applications at a time.
#[derive(Debug, Clone, Default)]
pub struct Applications {
    /// Time of the survey.
    pub at: Timestamp,
    all: BTreeMap<VnfId, Application>,
}

/// An application that is placed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Application {
    /// The nodes of its instances.
    pub(crate) nodes: Nodes,
    /// The nodes that it is moving to.
    pub(crate) target: Option<Nodes>,
}

impl Site {
    /// Collects the nodes and VNFs of a domain's `part` of the testbed with a graph. `port` returns the port at which a VNF
    /// serves, if the testbed knows it.
    pub fn new(whole: &HardwareGraph, part: &Testbed, port: impl Fn(&VnfId) -> Option<u16>) -> Self {
        let of_services = part
            .services
            .iter()
            .flat_map(|service| service.vnfs.iter().map(move |vnf| (vnf, Some(service.robot.clone()))));
        let others = part.containers.hosts.iter().map(|vnf| (vnf, None));
        let all: Vec<_> =
            of_services.chain(others).filter(|(vnf, _)| vnf.program != Program::RobotDriver).collect();
        let graph = &part.graph;
        Self {
            nodes: graph.nodes.iter().map(|node| node.id.clone()).collect(),
            ports: all.iter().filter_map(|(vnf, _)| Some((vnf.id.clone(), port(&vnf.id)?))).collect(),
            vnfs: all.into_iter().map(|(vnf, robot)| (vnf.id.clone(), robot)).collect(),
            addresses: graph
                .hosts()
                // Addresses follow the order of all hosts.
                .filter_map(|node| Some((node.id.clone(), whole.address(&node.id)?.ipv4)))
                .collect(),
        }
    }

    /// Surveys the applications: the domain's VNFs that are placed, and those `added` on its nodes during the run. `wanted` has
    /// the nodes of the last accepted placements.
    pub fn survey(
        &self,
        at: Timestamp,
        placements: &BTreeMap<VnfId, Placement>,
        wanted: &BTreeMap<VnfId, Nodes>,
        added: &BTreeMap<VnfId, Vnf>,
    ) -> Applications {
        let is_own = |vnf: &VnfId| {
            self.vnfs.contains_key(vnf)
                || added
                    .get(vnf)
                    .is_some_and(|vnf| vnf.node.all().iter().all(|node| self.nodes.contains(node)))
        };
        let own = placements.values().filter(|placement| is_own(&placement.vnf));
        let application = |placement: &Placement| {
            let target = wanted.get(&placement.vnf).filter(|wanted| **wanted != placement.node).cloned();
            (placement.vnf.clone(), Application { nodes: placement.node.clone(), target })
        };
        Applications { at, all: own.map(application).collect() }
    }

    /// Returns the address of the robot that an application serves.
    pub(crate) fn served(&self, application: &VnfId) -> Option<Ipv4Addr> {
        self.addresses.get(self.vnfs.get(application)?.as_ref()?).copied()
    }

    /// Returns the address of an emulated node, and the port of an application there; 0 if the testbed does not know it.
    pub(crate) fn endpoint(&self, application: &VnfId, node: &NodeId) -> Option<(Ipv4Addr, u16)> {
        Some((*self.addresses.get(node)?, self.ports.get(application).copied().unwrap_or_default()))
    }
}

impl Applications {
    /// Returns the application instance with this identifier.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub(crate) fn find(&self, id: &str) -> Result<&VnfId, RequestError> {
        let found = self.all.keys().find(|vnf| **vnf == *id);
        found.ok_or_else(|| RequestError::NotFound { what: "application instance", id: id.to_owned() })
    }

    pub(crate) fn has(&self, id: &VnfId) -> bool {
        self.all.contains_key(id)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&VnfId, &Application)> {
        self.all.iter()
    }
}
