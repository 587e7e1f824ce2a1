//! Frames that named another sender than their host, in a run's summary and in its verdict.

use cotorra_fabric::{ForgedFrames, ForgedSources};
use cotorra_graph::NodeId;
use serde::Serialize;

use super::fidelity::Fidelity;

/// Frames of a node that named another sender, by the protocol.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ForgedSummary {
    /// The node.
    pub node: NodeId,
    /// Whether they were delivered: the node has `port_security: false`.
    pub allowed: bool,
    /// Frames with another MAC address.
    pub forged_ethernet: u64,
    /// ARP with another sender.
    pub forged_arp: u64,
    /// IPv6 neighbour discovery for another node, or as a router.
    pub forged_neighbour_discovery: u64,
    /// Frames with another IPv4 address.
    pub forged_ipv4: u64,
    /// Frames with another IPv6 address.
    pub forged_ipv6: u64,
}

impl From<ForgedSources> for ForgedSummary {
    fn from(ForgedSources { node, allowed, frames }: ForgedSources) -> Self {
        let ForgedFrames { ethernet, arp, neighbour_discovery, ipv4, ipv6 } = frames;
        Self {
            node,
            allowed,
            forged_ethernet: ethernet,
            forged_arp: arp,
            forged_neighbour_discovery: neighbour_discovery,
            forged_ipv4: ipv4,
            forged_ipv6: ipv6,
        }
    }
}

impl ForgedSummary {
    fn total(&self) -> u64 {
        self.forged_ethernet
            + self.forged_arp
            + self.forged_neighbour_discovery
            + self.forged_ipv4
            + self.forged_ipv6
    }

    /// Describes them in a sentence.
    pub fn sentence(&self) -> String {
        let Self { node, allowed, .. } = self;
        let end = match allowed {
            true => "they were delivered, because the node has `port_security: false`",
            false => "the emulated network dropped them",
        };
        format!("node {node} sent {} frames with forged sources; {end}", self.total())
    }
}

impl Fidelity {
    /// Adds to the reason of a valid verdict which nodes may have answered as others. Frames that were dropped harm no figure.
    pub(super) fn with_forged(mut self, forged: &[ForgedSummary]) -> Self {
        let allowed: Vec<_> =
            forged.iter().filter(|its| its.allowed).map(|its| format!("`{}`", its.node)).collect();
        if self.valid && !allowed.is_empty() {
            self.reason += &format!(
                "; answers may be forged: frames from {} had sources of others, which `port_security: false` allows",
                allowed.join(", ")
            );
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Lateness;

    use super::{super::measured_frames::MeasuredFrames, *};

    fn forged(allowed: bool) -> ForgedSummary {
        let frames = ForgedFrames { arp: 100, ipv4: 20, ..ForgedFrames::default() };
        ForgedSources { node: "edge".parse().unwrap(), allowed, frames }.into()
    }

    #[test]
    fn the_verdict_names_nodes_whose_forged_frames_were_delivered() {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let valid = || Fidelity::of(MeasuredFrames::All, good, 0, false);
        assert_eq!(valid().with_forged(&[forged(false)]), valid());
        let doubtful = valid().with_forged(&[forged(false), forged(true)]);
        assert!(doubtful.valid && doubtful.reason.contains("frames from `edge` had"), "{doubtful:?}");
        let sentence = forged(false).sentence();
        assert_eq!(
            sentence,
            "node edge sent 120 frames with forged sources; the emulated network dropped them"
        );
        assert!(forged(true).sentence().ends_with("`port_security: false`"));
    }
}
