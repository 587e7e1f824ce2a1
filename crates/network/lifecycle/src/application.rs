//! An instance of an application, and who sees it.

use cotorra_graph::{DomainId, NodeId, VnfId};

/// Returns how many objects an owner may have, where the operator may have `most`. Each domain has a share of its own, so that
/// nobody takes the place of another.
pub(crate) const fn share(owner: Option<&DomainId>, most: usize) -> usize {
    if owner.is_some() { most / 4 } else { most }
}

/// The stage of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Stage {
    /// It is known. It may have a node.
    Defined,
    /// It can be started.
    Configured,
    /// Its VNF was added or placed, and this is the last that was seen of it.
    Started(VnfId, Seen),
}

/// The visible state of the VNF of a started instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Seen {
    /// It does not serve yet.
    Starting,
    /// It serves.
    Serves,
    /// It ended, and is started again.
    Restarts,
    /// It cannot be started, for this reason.
    Failed(String),
    /// It is gone: others removed it.
    Gone,
}

/// The part of a VNF's log that is of one instance. VNFs before and after it may have had the same name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Output {
    /// The VNF.
    pub vnf: VnfId,
    /// First byte.
    pub from: u64,
    /// End, once it was stopped.
    pub to: Option<u64>,
}

/// An instance of an application.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Application {
    /// Its identifier.
    pub id: String,
    /// The catalog's identifier of its descriptor.
    pub descriptor: String,
    /// Its name, if MEC gave it one.
    pub name: Option<String>,
    /// Its description, if MEC gave it one.
    pub description: Option<String>,
    /// Its node, once it has one.
    pub node: Option<NodeId>,
    /// Its stage.
    pub stage: Stage,
    pub(crate) owner: Option<DomainId>,
    /// The output of its last start.
    pub(crate) output: Option<Output>,
    /// Whether an operation is under way.
    pub(crate) is_busy: bool,
    /// Whether it was found running, and nobody defined it: an instance of a service's VNF.
    pub(crate) is_found: bool,
}

impl Application {
    /// Returns its VNF, if it is started.
    pub(crate) fn vnf(&self) -> Option<&VnfId> {
        match &self.stage {
            Stage::Started(vnf, _) => Some(vnf),
            Stage::Defined | Stage::Configured => None,
        }
    }
}

pub(crate) fn sees(viewer: Option<&DomainId>, owner: Option<&DomainId>) -> bool {
    viewer.is_none() || viewer == owner
}
