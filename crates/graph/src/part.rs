//! Parts of the testbed, each of which belongs to a domain.

use crate::id::{LinkId, NodeId, PluginId, VnfId};

/// A part of the testbed that an event is about, or that an instruction changes.
#[derive(Debug, Clone, Copy)]
pub enum Part<'a> {
    /// A node.
    Node(&'a NodeId),
    /// All of these nodes.
    Nodes(&'a [NodeId]),
    /// A link.
    Link(&'a LinkId),
    /// All of these links.
    Links(&'a [LinkId]),
    /// A VNF.
    Vnf(&'a VnfId),
    /// A plug-in.
    Plugin(&'a PluginId),
    /// The emulator, which no domain owns.
    Emulator,
}
