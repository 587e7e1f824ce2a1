//! The ports at which hosts are.

/// A host's place in [`hosts`](cotorra_graph::HardwareGraph::hosts), from 0; its interface has the addresses [`HostAddress::of`](cotorra_graph::HostAddress::of) that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortId(pub usize);
