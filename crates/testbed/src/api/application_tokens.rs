//! How applications on nodes reach the services of ETSI MEC: the platform's address on the emulated network, and a token of
//! each application.

use std::{
    collections::BTreeMap,
    io,
    net::{Ipv4Addr, SocketAddrV4},
    sync::Arc,
};

use cotorra_graph::{DomainId, NodeId, Testbed, VnfId};
use parking_lot::Mutex;

use super::token::Token;

/// TCP port of the platform on its node.
pub(crate) const PORT: u16 = 7700;

/// Variable with the URL below which an application finds the services.
const URL: &str = "COTORRA_MEC";
/// Variable with the application's token.
const TOKEN: &str = "COTORRA_MEC_TOKEN";

/// The applications of a run. Clones share their tokens.
#[derive(Debug, Clone, Default)]
pub(crate) struct Applications(Option<Arc<Platform>>);

#[derive(Debug)]
struct Platform {
    node: NodeId,
    address: SocketAddrV4,
    /// The domain of each VNF of a service: that of its robot.
    of_services: BTreeMap<VnfId, DomainId>,
    of_nodes: BTreeMap<NodeId, DomainId>,
    tokens: Mutex<BTreeMap<VnfId, (DomainId, Token)>>,
}

impl Applications {
    /// Prepares access to the platform, if the testbed has one.
    pub(crate) fn new(testbed: &Testbed) -> Self {
        let graph = &testbed.graph;
        let of_nodes: BTreeMap<_, _> =
            graph.nodes.iter().map(|node| (node.id.clone(), node.domain.clone())).collect();
        let of_services = testbed.services.iter().flat_map(|service| {
            let domain = of_nodes.get(&service.robot);
            service.vnfs.iter().filter_map(move |vnf| Some((vnf.id.clone(), domain?.clone())))
        });
        let of_services = of_services.collect();
        let platform = testbed.core.as_ref().and_then(|node| {
            let address = graph.address(node)?.ipv4;
            let address = SocketAddrV4::new(address, PORT);
            Some(Platform { node: node.clone(), address, of_services, of_nodes, tokens: Mutex::default() })
        });
        Self(platform.map(Arc::new))
    }

    /// Returns the node of the platform, and the address where it listens there.
    pub(crate) fn listen_at(&self) -> Option<(&NodeId, (Ipv4Addr, u16))> {
        self.0.as_deref().map(|platform| (&platform.node, (*platform.address.ip(), platform.address.port())))
    }

    /// Returns the variables of an application that starts on a node: where the services are, and its token. Empty without a
    /// platform.
    ///
    /// # Errors
    /// The error of the system if there is no randomness for a token.
    pub(crate) fn environment(&self, vnf: &VnfId, node: &NodeId) -> io::Result<Vec<(&'static str, String)>> {
        let Some(platform) = self.0.as_deref() else { return Ok(Vec::new()) };
        let own = platform.of_services.get(vnf).or_else(|| platform.of_nodes.get(node));
        let Some(domain) = own else { return Ok(Vec::new()) };
        let mut tokens = platform.tokens.lock();
        // A VNF of another domain that has the name of a removed one does not get its token.
        let kept = tokens.get(vnf).filter(|(of, _)| of == domain).map(|(_, token)| token.clone());
        let token = kept.map_or_else(Token::random, Ok)?;
        let secret = token.secret().to_owned();
        tokens.insert(vnf.clone(), (domain.clone(), token));
        Ok(vec![(URL, format!("http://{}/domains/{domain}", platform.address)), (TOKEN, secret)])
    }

    /// Returns the application of a token, and its domain. All tokens are compared, so that the time does not reveal the owner.
    pub(super) fn find(&self, shown: &str) -> Option<(VnfId, DomainId)> {
        let tokens = self.0.as_deref()?.tokens.lock();
        tokens.iter().fold(
            None,
            |found, (vnf, (domain, token))| {
                if token.is(shown) { Some((vnf.clone(), domain.clone())) } else { found }
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const FILE: &str = "
name: rooms
domains: [hall, annex]
wireless: { lab: {} }
nodes:
  r: { kind: robot, position: [0, 0], domain: hall }
  edge: { kind: server, tier: edge, cpus: 2, memory: 2 GB, domain: annex }
  unit: { kind: radio_unit, position: [0, 1], channel: 1, domain: hall }
  lan: { kind: switch }
links:
  - { ends: [lan, [edge, unit]] }
services:
  s:
    robot: r
    kpis: { service_time: 1 s }
    vnfs: { planner: { command: [sleep, '1'], node: edge, cpus: 1, memory: 1 GB } }
";

    fn applications(more: &str) -> Applications {
        let testbed = cotorra_testbed_file::parse("rooms.yaml", &format!("{FILE}{more}"), Path::new(""));
        Applications::new(&testbed.unwrap())
    }

    #[test]
    fn each_application_has_a_token_of_its_own_for_its_domain() {
        let applications = applications("core: { node: edge }\n");
        let edge = NodeId::new("edge").unwrap();
        let ask = |vnf: &str| applications.environment(&VnfId::new(vnf).unwrap(), &edge).unwrap();
        let [planner, added] = ["planner", "added"].map(ask);
        // A VNF of a service is of its robot's domain, wherever it runs; any other is of its node's.
        assert_eq!(planner[0], ("COTORRA_MEC", "http://10.77.0.2:7700/domains/hall".to_owned()));
        assert_eq!(added[0], ("COTORRA_MEC", "http://10.77.0.2:7700/domains/annex".to_owned()));
        assert_eq!(ask("planner"), planner, "it keeps its token");
        let find = |secret: &str| applications.find(secret).map(|(vnf, domain)| format!("{vnf} of {domain}"));
        assert_eq!(find(&planner[1].1).as_deref(), Some("planner of hall"));
        assert_eq!(find(&added[1].1).as_deref(), Some("added of annex"));
        assert_eq!(find("0123456789abcdef"), None);
    }

    #[test]
    fn applications_have_no_access_without_a_platform() {
        let applications = applications("");
        let [vnf, node] = ["planner", "edge"];
        let variables = applications.environment(&VnfId::new(vnf).unwrap(), &NodeId::new(node).unwrap());
        assert_eq!(variables.unwrap(), []);
        assert_eq!(applications.listen_at(), None);
    }
}
