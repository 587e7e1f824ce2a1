//! Testbeds without what ns-3 has no part for.

use std::time::Duration;

use cotorra_graph::{
    Access, Arrivals, Conditions, HardwareGraph, Loss, NodeId, NodeKind, Probability, Rate, RateControl,
    Requests, Roaming, Testbed, TrafficSource, UdpRate, WirelessNetwork,
};

use crate::scenario::Load;

/// A testbed for both sides.
#[derive(Debug, Clone, PartialEq)]
pub struct Plain {
    /// The testbed without what ns-3 has no part for.
    pub testbed: Testbed,
    /// What neither side has: one line each.
    pub left_out: Vec<String>,
    /// What our side has and ns-3 has not, or has otherwise: one line each.
    pub unlike: Vec<String>,
}

/// Takes out of a testbed what ns-3 has no part for.
pub fn plain(mut testbed: Testbed) -> Plain {
    let mut lines = Lines::default();
    let HardwareGraph { wireless, links, .. } = &mut testbed.graph;
    for (name, network) in wireless {
        plain_network(name, network, &mut lines);
    }
    for link in links {
        let conditions = plain_wire(&link.forward);
        if conditions != link.forward || conditions != plain_wire(&link.backward) {
            lines.left_out(format!(
                "jitter, loss, damage and traces of link {}, and what differs backward",
                link.id
            ));
        }
        (link.forward, link.backward) = (conditions.clone(), conditions);
        link.scales = Default::default();
    }
    if !testbed.script.schedule.is_empty() || testbed.script.replay.is_some() {
        lines.left_out("the schedule of conditions".to_owned());
        testbed.script = Default::default();
    }
    if testbed.probes.take().is_some() {
        lines.left_out("probes of links".to_owned());
    }
    if !testbed.graph.links.is_empty() {
        lines.unlike("headers on wires: 2 bytes in ns-3, and 14 here".to_owned());
    }
    if testbed.graph.links.iter().any(|link| matches!(link.forward.rate, Rate::Fixed { .. })) {
        lines.unlike(
            "queues of wires: in ns-3 one packet more waits behind each, 1.2 ms at 10 Mbit/s".to_owned(),
        );
    }
    plain_traffic(&mut testbed, &mut lines);
    for vnf in testbed.services.iter_mut().flat_map(|service| &mut service.vnfs) {
        if vnf.computing.take().is_some() {
            lines.left_out(format!("the demand of VNF {}: in ns-3 answers take no time of a CPU", vnf.id));
        }
    }
    for service in &testbed.services {
        if service.kpis.flow.is_some() {
            lines.unlike(format!("service {}: programs do not run in virtual time, nor in ns-3", service.id));
        }
        if service.requests != Requests::One {
            lines.unlike(format!("service {}: ns-3 sends requests to one instance", service.id));
        }
    }
    if testbed.graph.robots().any(|(_, robot)| robot.roaming != Default::default())
        || !testbed.plugins.is_empty()
    {
        lines.unlike(
            "handovers and scans: ns-3 changes over at once, so that requests near them are left out"
                .to_owned(),
        );
    }
    Plain { testbed, left_out: lines.left_out, unlike: lines.unlike }
}

/// Leaves the sources of traffic from robots and servers to others. A connection of a robot that changes over would end in
/// ns-3, and two robots have no path to each other there.
fn plain_traffic(testbed: &mut Testbed, lines: &mut Lines) {
    let Testbed { graph, traffic, .. } = testbed;
    let has_plugins = !testbed.plugins.is_empty();
    let kind = |end: &NodeId| graph.node(end).map(|node| &node.kind);
    let stays = |end: &NodeId| matches!(kind(end), Some(NodeKind::Robot(robot)) if robot.roaming == Roaming::default() && !has_plugins);
    let is_server = |end: &NodeId| matches!(kind(end), Some(NodeKind::Server(_)));
    traffic.retain(|source| {
        if load(source).is_none() {
            lines.left_out(format!(
                "traffic of {}: in ns-3 it is UDP of one size, constant, at random or saturated, or a TCP connection, from host \
                 to host",
                source.id
            ));
            return false;
        }
        let ends = [&source.from, &source.to];
        let is_plain = ends.iter().all(|end| stays(end) || is_server(end)) && ends.iter().any(|end| is_server(end));
        if !is_plain {
            lines.left_out(format!(
                "traffic of {}: in ns-3 it goes between a server and another, or a robot that keeps its radio unit",
                source.id
            ));
        }
        is_plain
    });
}

#[derive(Default)]
struct Lines {
    left_out: Vec<String>,
    unlike: Vec<String>,
}

impl Lines {
    fn left_out(&mut self, line: String) {
        self.left_out.push(line);
    }

    fn unlike(&mut self, line: String) {
        self.unlike.push(line);
    }
}

fn plain_network(name: &str, network: &mut WirelessNetwork, lines: &mut Lines) {
    let mut out = |is: bool, what: &str| {
        if is {
            lines.left_out(format!("{what} of network {name}"));
        }
    };
    out(network.shadowing.deviation_db != 0.0, "shadowing");
    network.shadowing.deviation_db = 0.0;
    out(network.fading.take().is_some(), "fading");
    out(network.walls.take().is_some(), "walls");
    out(network.loss != Loss::None, "loss");
    network.loss = Loss::None;
    out(network.rate.take().is_some(), "the highest rate of a station");
    out(!network.delay.is_zero(), "the delay beyond the airtime");
    network.delay = Duration::ZERO;
    match &mut network.access {
        Access::Turns => {
            lines.unlike(format!("network {name}: senders take turns here, and contend in ns-3"))
        }
        Access::Contention(contention) => {
            out(!contention.interference.is_empty(), "interference");
            contention.interference.clear();
            out(contention.edca.power_save.take().is_some(), "sleep");
            out(!contention.edca.queue_discipline.is_drop_tail(), "FQ-CoDel and shares of airtime");
            (contention.edca.queue, contention.edca.queue_discipline) = Default::default();
            out(contention.software.take().is_some(), "hostapd and wpa_supplicant");
        }
    }
}

fn plain_wire(conditions: &Conditions) -> Conditions {
    let Conditions { delay, rate, queue, queue_discipline, .. } = conditions.clone();
    let rate = match rate {
        Rate::Trace { .. } | Rate::NamedTrace(_) => Rate::Unlimited,
        rate => rate,
    };
    let none = Probability::ZERO;
    Conditions {
        delay,
        rate,
        queue,
        queue_discipline,
        jitter: None,
        loss: Loss::None,
        duplication: none,
        corruption: none,
        reordering: none,
    }
}

/// Returns how a network's stations choose their rates, and whether they aggregate.
pub(crate) fn stations(network: &WirelessNetwork) -> (RateControl, bool) {
    network.access.edca().map_or((RateControl::Ideal, true), |edca| (edca.rate_control, edca.aggregation))
}

/// Whether a node is a radio unit that serves.
pub(crate) fn serves(kind: &NodeKind) -> bool {
    matches!(kind, NodeKind::RadioUnit(unit) if unit.serving)
}

/// Returns the load of a source of traffic for ns-3; `None` if ns-3 has none like it.
pub(crate) fn load(source: &TrafficSource) -> Option<Load> {
    use cotorra_graph::{DatagramSize::Constant, Load as Ours, Sends::Stream};
    match source.load {
        _ if source.over.is_some() => None,
        Ours::Udp { rate, size: Constant(bytes), arrivals } => Some(Load::Udp {
            bytes,
            rate_bps: match rate {
                UdpRate::Saturated => None,
                UdpRate::Rate(rate) => Some(rate.bits_per_second()),
            },
            poisson: match arrivals {
                Arrivals::Constant => false,
                Arrivals::Poisson => true,
                Arrivals::OnOff(_) => return None,
            },
        }),
        Ours::Tcp { congestion_control, sends: Stream(bytes) } => {
            Some(Load::Tcp { congestion_control, bytes })
        }
        Ours::Udp { .. } | Ours::Replay(_) | Ours::Tcp { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ns3_lacks_is_taken_out_and_listed() {
        let text = "\
name: lab
wireless:
  lab:
    fading: rayleigh
    loss: 1 %
    interference: { oven: { kind: device, channel: 1, position: [0, 0], on: 10 ms, off: 10 ms } }
  old: { access: turns, delay: 0 ms, shadowing: { deviation: 0 dB } }
nodes:
  R: { kind: radio_unit, network: lab, position: [0, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
  cloud: { kind: server, tier: cloud, cpus: 1, memory: 1 GB }
  switch: { kind: switch }
links:
  - { ends: [R, switch], delay: 5 ms, jitter: 1 ms, rate: 10 Mbit/s }
  - { ends: [switch, edge], delay: 1 ms }
  - { ends: [switch, cloud], delay: 5 ms }
traffic:
  bulk: { from: cloud, to: edge, protocol: tcp }
  up: { from: R, to: edge, protocol: tcp }
";
        let testbed = cotorra_testbed_file::parse("lab.yaml", text, ".".as_ref()).unwrap();
        let Plain { testbed: plain, left_out, unlike } = plain(testbed.clone());
        let network = &plain.graph.wireless["lab"];
        assert_eq!((network.fading, network.loss, network.delay), (None, Loss::None, Duration::ZERO));
        assert!(network.access.interference().is_empty());
        assert_eq!(
            (plain.graph.links[0].forward.jitter, plain.graph.links[0].forward.delay.as_millis()),
            (None, 5)
        );
        let listed = |what: &str| left_out.iter().any(|line| line.starts_with(what));
        let all = [
            "shadowing",
            "fading",
            "loss",
            "the delay",
            "interference",
            "jitter, loss",
            "probes",
            "traffic of up",
        ];
        for what in all {
            assert!(listed(what), "{what}: {left_out:?}");
        }
        assert_eq!(
            unlike,
            [
                "network old: senders take turns here, and contend in ns-3",
                "headers on wires: 2 bytes in ns-3, and 14 here",
                "queues of wires: in ns-3 one packet more waits behind each, 1.2 ms at 10 Mbit/s",
            ]
        );
        // What is plain stays as it is.
        assert_eq!(super::plain(plain.clone()), Plain { testbed: plain, left_out: Vec::new(), unlike });
    }
}
