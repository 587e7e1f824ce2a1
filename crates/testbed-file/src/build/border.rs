//! The border to the cores of other domains.

use std::net::SocketAddr;

use cotorra_graph::{Border, NodeId};

use super::builder::{Builder, each};
use crate::{records::BorderRecord, yaml::decode::Spanned};

impl Builder<'_> {
    /// The border, or `None` without one; nothing if it is wrong.
    pub(super) fn border(&mut self) -> Option<Option<Border>> {
        let Some(record) = &self.record.border else { return Some(None) };
        let node = self.emulated_server(&record.node);
        let address = self.border_address(record);
        if record.visitors.len() > Border::MOST_VISITORS {
            self.sink
                .error(
                    &record.visitors[Border::MOST_VISITORS].span,
                    format!("a border has at most {} visitors", Border::MOST_VISITORS),
                )
                .help("remove this one and those after it");
            return None;
        }
        let visitors: Option<Vec<_>> = each(&record.visitors, |visitor| self.visitor(visitor));
        Some(Some(Border { node: node?, address: address?, visitors: visitors? }))
    }

    fn border_address(&mut self, record: &BorderRecord) -> Option<SocketAddr> {
        let address: Option<SocketAddr> = record.address.value.parse().ok();
        let fits = |address: &SocketAddr| {
            address.port() != 0 && !address.ip().is_unspecified() && !address.ip().is_multicast()
        };
        let address = address.filter(fits);
        if address.is_none() {
            self.sink
                .error(&record.address.span, "this is no address at which others reach this machine")
                .help("write an address of one of its interfaces and a port, such as `192.168.77.1:7450`");
        }
        address
    }

    /// A robot that stands for one of another core.
    fn visitor(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        let robot = self.robot(id)?;
        let name = robot.as_str();
        let record = self.record;
        let used = record.walks.0.iter().any(|(walker, _)| walker.value == robot)
            || record.services.0.iter().any(|(_, service)| service.robot.value == robot);
        if used {
            self.sink
                .error(&id.span, format!("`{name}` has a walk or a service, and stands for no other robot"))
                .help("name a robot of its own: its position and its packets come from the other core");
            return None;
        }
        let twice = record.border.iter().flat_map(|border| &border.visitors);
        if twice.filter(|other| other.value == robot).count() > 1 {
            self.sink
                .error(&id.span, format!("the visitor `{name}` is here twice"))
                .help("remove one of them");
            return None;
        }
        Some(robot)
    }
}
