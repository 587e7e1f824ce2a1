//! The two nodes that an allocation is between.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::IpAddr,
};

use cotorra_graph::{NodeId, Testbed, VnfId};
use cotorra_mec::InvalidRequest;

use crate::types::{BwInfo, SessionFilter};

/// What an allocation needs to know of the running testbed.
#[derive(Debug, Clone, Default)]
pub struct Survey {
    /// The nodes of each VNF's instances.
    pub nodes: BTreeMap<VnfId, Vec<NodeId>>,
    /// The radio units that robots are attached to.
    pub attached: BTreeMap<NodeId, NodeId>,
    /// The VNFs at both ends of virtual links whose paths are mapped.
    pub mapped: BTreeSet<(VnfId, VnfId)>,
}

impl Survey {
    /// Whether packets from one node to another take a mapped path of their virtual links.
    pub(crate) fn is_mapped(&self, from: &NodeId, to: &NodeId) -> bool {
        let is_on =
            |vnf: &VnfId, node: &NodeId| self.nodes.get(vnf).is_some_and(|nodes| nodes.contains(node));
        self.mapped.iter().any(|(a, b)| is_on(a, from) && is_on(b, to))
    }

    fn only_node(&self, vnf: &VnfId) -> Result<&NodeId, InvalidRequest> {
        match self.nodes.get(vnf).map(Vec::as_slice) {
            Some([node]) => Ok(node),
            Some(_) => Err(InvalidRequest::Unsupported(
                "the application has several instances: only one can be allocated to",
            )),
            None => InvalidRequest::malformed(format!(
                "there is no application `{vnf}`: an appInsId is a VNF's name"
            )),
        }
    }
}

/// Returns the node of the application, and the other end.
pub(crate) fn ends(testbed: &Testbed, survey: &Survey, info: &BwInfo) -> Result<[NodeId; 2], InvalidRequest> {
    let app: VnfId = info
        .app_ins_id
        .parse()
        .or_else(|_| InvalidRequest::malformed(format!("`{}` is no VNF's name", info.app_ins_id)))?;
    let here = survey.only_node(&app)?;
    match (info.request_type, info.session_filter.as_deref().unwrap_or_default()) {
        (0, []) => Ok([here.clone(), only_peer(testbed, survey, &app, here)?]),
        (0, _) => InvalidRequest::malformed("a sessionFilter is for requestType 1"),
        (1, [filter]) => Ok([here.clone(), of_session(testbed, filter, here)?]),
        (1, _) => InvalidRequest::malformed("requestType 1 has one sessionFilter, for a single session"),
        _ => InvalidRequest::malformed("requestType is 0 or 1"),
    }
}

/// Returns the one node that an application's virtual links lead to.
fn only_peer(
    testbed: &Testbed,
    survey: &Survey,
    app: &VnfId,
    here: &NodeId,
) -> Result<NodeId, InvalidRequest> {
    let links = testbed.services.iter().flat_map(|service| &service.virtual_links);
    let others = links.filter_map(|link| match () {
        () if link.from == *app => Some(&link.to),
        () if link.to == *app => Some(&link.from),
        () => None,
    });
    let nodes: BTreeSet<_> =
        others.filter_map(|vnf| survey.nodes.get(vnf)).flatten().filter(|node| *node != here).collect();
    let mut nodes = nodes.into_iter();
    match (nodes.next(), nodes.next()) {
        (Some(node), None) => Ok(node.clone()),
        _ => Err(InvalidRequest::Unsupported(
            "the virtual links of the application do not lead to exactly one other node: name a session (requestType 1)",
        )),
    }
}

/// Returns the other end of a session of the application's node.
fn of_session(testbed: &Testbed, filter: &SessionFilter, here: &NodeId) -> Result<NodeId, InvalidRequest> {
    if filter.source_port.is_some() || filter.dst_port.is_some() || filter.protocol.is_some() {
        return Err(InvalidRequest::Unsupported(
            "links keep a rate for all packets between two nodes: leave ports and protocol out",
        ));
    }
    let node = |name: &str, address: &Option<String>| {
        let Some(text) = address else { return InvalidRequest::malformed(format!("`{name}` is missing")) };
        let Ok(ip) = text.parse::<IpAddr>() else {
            return InvalidRequest::malformed(format!("`{name}` is the address of one node, not `{text}`"));
        };
        let has = |node: &&NodeId| {
            testbed
                .graph
                .address(node)
                .is_some_and(|of| ip == IpAddr::V4(of.ipv4) || ip == IpAddr::V6(of.ipv6))
        };
        let found = testbed.graph.nodes.iter().map(|node| &node.id).find(has);
        found.cloned().ok_or_else(|| InvalidRequest::Malformed(format!("no node has the address {ip}")))
    };
    let ends = [node("sourceIp", &filter.source_ip)?, node("dstAddress", &filter.dst_address)?];
    match ends {
        [a, b] if a == *here && b != *here => Ok(b),
        [a, b] if b == *here && a != *here => Ok(a),
        _ => InvalidRequest::malformed(format!(
            "the session does not lead from or to the application's node `{here}`"
        )),
    }
}
