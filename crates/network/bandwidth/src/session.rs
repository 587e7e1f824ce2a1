//! The two nodes that an allocation is between.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::IpAddr,
};

use cotorra_graph::{HardwareGraph, LinkId, MapReservation, NodeId, Testbed, Timestamp, VnfId};
use cotorra_mec::InvalidRequest;

use crate::{
    consumer::Consumer,
    error::BandwidthError,
    types::{BwInfo, SessionFilter},
};

/// What an allocation needs to know of the running testbed.
#[derive(Debug, Clone, Default)]
pub struct Survey {
    /// Time of the survey.
    pub at: Timestamp,
    /// The nodes of each VNF's instances.
    pub nodes: BTreeMap<VnfId, Vec<NodeId>>,
    /// The radio units that robots are attached to.
    pub attached: BTreeMap<NodeId, NodeId>,
    /// The mapped paths from one node to another.
    pub mapped: BTreeMap<[NodeId; 2], Mapped>,
}

/// A mapped path.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapped {
    /// Its links, in order.
    pub links: Vec<LinkId>,
    /// The reservation of its own.
    pub reservation: Option<MapReservation>,
}

/// What a consumer may use of the testbed at a time.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// The consumer.
    pub consumer: &'a Consumer,
    /// Its part of the testbed.
    pub part: &'a Testbed,
    /// The part's VNFs, and all robots and mappings.
    pub survey: &'a Survey,
}

impl Seen<'_> {
    fn only_node(&self, vnf: &VnfId) -> Result<&NodeId, BandwidthError> {
        match self.survey.nodes.get(vnf).map(Vec::as_slice) {
            Some([node]) if self.part.graph.node(node).is_some() => Ok(node),
            Some([node]) => {
                Err(BandwidthError::Refused(format!("the application's node `{node}` is of another domain")))
            }
            Some(_) => Err(InvalidRequest::Unsupported(
                "the application has several instances: only one can be allocated to",
            )
            .into()),
            None => Err(InvalidRequest::Malformed(format!(
                "there is no application `{vnf}`: an appInsId is a VNF's name"
            ))
            .into()),
        }
    }

    /// Returns the node of the application, and the other end. `whole` is the graph of the testbed.
    pub(crate) fn ends(&self, whole: &HardwareGraph, info: &BwInfo) -> Result<[NodeId; 2], BandwidthError> {
        let app: VnfId = info
            .app_ins_id
            .parse()
            .or_else(|_| InvalidRequest::malformed(format!("`{}` is no VNF's name", info.app_ins_id)))?;
        if let Some(own) = self.consumer.application().filter(|own| **own != app) {
            let reason = format!("the token is of the application `{own}`, not of `{app}`");
            return Err(BandwidthError::Refused(reason));
        }
        let here = self.only_node(&app)?;
        let there = match (info.request_type, info.session_filter.as_deref().unwrap_or_default()) {
            (0, []) => self.only_peer(&app, here),
            (0, _) => InvalidRequest::malformed("a sessionFilter is for requestType 1"),
            (1, [filter]) => self.of_session(whole, filter, here),
            (1, _) => InvalidRequest::malformed("requestType 1 has one sessionFilter, for a single session"),
            _ => InvalidRequest::malformed("requestType is 0 or 1"),
        };
        Ok([here.clone(), there?])
    }

    /// Returns the one node that an application's virtual links lead to.
    fn only_peer(&self, app: &VnfId, here: &NodeId) -> Result<NodeId, InvalidRequest> {
        let links = self.part.services.iter().flat_map(|service| &service.virtual_links);
        let others = links.filter_map(|link| match () {
            () if link.from == *app => Some(&link.to),
            () if link.to == *app => Some(&link.from),
            () => None,
        });
        let nodes: BTreeSet<_> = others
            .filter_map(|vnf| self.survey.nodes.get(vnf))
            .flatten()
            .filter(|node| *node != here)
            .collect();
        let mut nodes = nodes.into_iter();
        match (nodes.next(), nodes.next()) {
            (Some(node), None) => Ok(node.clone()),
            _ => Err(InvalidRequest::Unsupported(
                "the virtual links of the application do not lead to exactly one other node: name a session (requestType 1)",
            )),
        }
    }

    /// Returns the other end of a session of the application's node.
    fn of_session(
        &self,
        whole: &HardwareGraph,
        filter: &SessionFilter,
        here: &NodeId,
    ) -> Result<NodeId, InvalidRequest> {
        if filter.source_port.is_some() || filter.dst_port.is_some() || filter.protocol.is_some() {
            return Err(InvalidRequest::Unsupported(
                "links keep a rate for all packets between two nodes: leave ports and protocol out",
            ));
        }
        let node = |name: &str, address: &Option<String>| {
            let Some(text) = address else {
                return InvalidRequest::malformed(format!("`{name}` is missing"));
            };
            let Ok(ip) = text.parse::<IpAddr>() else {
                return InvalidRequest::malformed(format!(
                    "`{name}` is the address of one node, not `{text}`"
                ));
            };
            // Addresses follow the order of all nodes.
            let has = |node: &&NodeId| {
                whole.address(node).is_some_and(|of| ip == IpAddr::V4(of.ipv4) || ip == IpAddr::V6(of.ipv6))
            };
            let found = self.part.graph.nodes.iter().map(|node| &node.id).find(has);
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
}
