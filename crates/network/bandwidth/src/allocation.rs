//! Allocations and their paths.

use cotorra_graph::{BitRate, Instruction, LinkId, MapReservation, NodeId, Reservations};

use crate::{
    consumer::Consumer,
    session::{Mapped, Survey},
    types::BwInfo,
};

/// An allocation, and the paths that it reserves.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Allocation {
    pub(crate) info: BwInfo,
    pub(crate) owner: Consumer,
    pub(crate) version: u64,
    /// The application's node when the paths were allocated.
    pub(crate) node: NodeId,
    pub(crate) paths: Vec<Path>,
}

impl Allocation {
    /// Returns why it has ended: its application has, it was an application's own and that has left the node, or its nodes have
    /// another mapping. `None` while it has not.
    pub(crate) fn end(&self, now: &Survey) -> Option<String> {
        let app = &self.info.app_ins_id;
        let nodes = now.nodes.iter().find(|(vnf, _)| **vnf == **app).map(|(_, nodes)| nodes);
        let Some(nodes) = nodes.filter(|nodes| !nodes.is_empty()) else {
            return Some(format!("`{app}` has ended"));
        };
        if self.owner.application().is_some() && *nodes != [self.node.clone()] {
            return Some(format!("`{app}` has left its node"));
        }
        let other = self.paths.iter().find(|path| !path.is_in_force(now))?;
        let [from, to] = &other.ends;
        Some(format!("the packets from `{from}` to `{to}` have another mapping, or none"))
    }
}

/// A reserved path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    pub(crate) ends: [NodeId; 2],
    pub(crate) links: Vec<LinkId>,
    pub(crate) rate: BitRate,
    pub(crate) kept: Reservations,
}

impl Path {
    /// Whether the testbed has it as it was allocated.
    pub(crate) fn is_in_force(&self, now: &Survey) -> bool {
        now.mapped.get(&self.ends) == Some(&self.mapped())
    }

    /// Returns the mapping that keeps it.
    fn mapped(&self) -> Mapped {
        let reservation = MapReservation { kept: self.kept, rate: Some(self.rate) };
        Mapped { links: self.links.clone(), reservation: Some(reservation) }
    }

    pub(crate) fn map(&self) -> Instruction {
        let [from, to] = self.ends.clone();
        let Mapped { links, reservation } = self.mapped();
        Instruction::Map { from, to, links, reservation }
    }

    pub(crate) fn unmap(&self) -> Instruction {
        let [from, to] = self.ends.clone();
        Instruction::Map { from, to, links: Vec::new(), reservation: None }
    }
}
