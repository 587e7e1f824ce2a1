//! Indices of ports, and of the robots and radio units among hosts.

/// A port of the fabric. A host's is its index in [`hosts`](cotorra_graph::HardwareGraph::hosts), from 0, and
/// [`HostAddress::of`](cotorra_graph::HostAddress::of) gives the addresses of its interface, unless it is a real server. The
/// ports of [`gateways`](cotorra_graph::HardwareGraph::gateways) follow, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortId(pub usize);

/// A robot's index among the robots that have a wireless network.
pub(crate) type StationIndex = usize;
/// A radio unit's index among those that serve a wireless network.
pub(crate) type RadioUnitIndex = usize;
