//! Small networks, and hosts that send numbered frames over them.

use std::{collections::BTreeMap, time::Duration};

use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_graph::{
    BitRate, Capacity, Conditions, HardwareGraph, HostAddress, Link, LinkContext, Node, NodeKind, Rate,
    Server, Tier, Timestamp,
};

/// A wired network in the making.
pub struct Network(HardwareGraph);

impl Network {
    pub fn new() -> Self {
        let domains = vec!["home".parse().unwrap()];
        Self(HardwareGraph { domains, nodes: vec![], links: vec![], wireless: BTreeMap::new() })
    }

    fn node(mut self, name: &str, kind: NodeKind) -> Self {
        let domain = self.0.domains[0].clone();
        self.0.nodes.push(Node { id: name.parse().unwrap(), domain, position: None, kind });
        self
    }

    pub fn server(self, name: &str) -> Self {
        let capacity = Capacity { cpus: 4.0, memory_bytes: 8 << 30 };
        self.node(name, NodeKind::Server(Server { tier: Tier::Edge, capacity, cost: 1.0, reliability: 1.0 }))
    }

    pub fn servers(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.server(name))
    }

    pub fn switches(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.node(name, NodeKind::Switch))
    }

    /// A link `<a>-<b>` over a medium of 100 Gbit/s, the same both ways.
    pub fn link(mut self, a: &str, b: &str, conditions: Conditions) -> Self {
        self.0.links.push(Link {
            id: format!("{a}-{b}").parse().unwrap(),
            ends: [a.parse().unwrap(), b.parse().unwrap()],
            forward: conditions.clone(),
            backward: conditions,
            medium: BitRate::from_mbps(100_000.0).unwrap(),
            reliability: 1.0,
        });
        self
    }

    pub fn graph(self) -> HardwareGraph {
        self.0
    }

    pub fn fabric(self, seed: u64) -> Fabric {
        Fabric::new(&self.0, seed).unwrap()
    }
}

/// Two servers `a` and `b` and the link `a-b`.
pub fn pair(conditions: Conditions, seed: u64) -> Fabric {
    Network::new().servers(&["a", "b"]).link("a", "b", conditions).fabric(seed)
}

pub const A: PortId = PortId(0);
pub const B: PortId = PortId(1);

pub fn ms(ms: f64) -> Timestamp {
    Timestamp::from_nanos((ms * 1e6) as u64)
}

pub fn delay(ms: u64) -> Conditions {
    Conditions { delay: Duration::from_millis(ms), ..Conditions::default() }
}

pub fn rate(mbps: f64) -> Rate {
    Rate::Fixed { bits_per_second: BitRate::from_mbps(mbps).unwrap() }
}

/// A frame of `length` bytes with a number in it.
pub fn frame(from: PortId, to: PortId, number: u32, length: usize) -> Frame {
    frame_to(HostAddress::of(to.0).mac, from, number, length)
}

pub fn frame_to(destination: [u8; 6], from: PortId, number: u32, length: usize) -> Frame {
    let mut bytes = vec![0; length.max(18)];
    bytes[..6].copy_from_slice(&destination);
    bytes[6..12].copy_from_slice(&HostAddress::of(from.0).mac);
    bytes[12..14].copy_from_slice(&[0x88, 0xb5]);
    bytes[14..18].copy_from_slice(&number.to_be_bytes());
    Frame::new(bytes)
}

pub fn number(frame: &Frame) -> u32 {
    u32::from_be_bytes(frame.bytes()[14..18].try_into().unwrap())
}

/// What came out: when, where and what.
#[derive(Debug, Clone, PartialEq)]
pub struct Delivery {
    pub at: Timestamp,
    pub port: PortId,
    pub frame: Frame,
}

/// Runs in virtual time until nothing more is due up to `until`.
pub fn run(fabric: &mut Fabric, from: Timestamp, until: Timestamp) -> Vec<Delivery> {
    let mut out = Vec::new();
    let mut now = from;
    loop {
        let next = fabric.poll(now, &mut |port, frame| out.push(Delivery { at: now, port, frame }));
        match next {
            Some(next) if next <= until => now = next,
            _ => return out,
        }
    }
}

pub fn context(fabric: &mut Fabric, now: Timestamp, link: &str) -> LinkContext {
    fabric.link_contexts(now).into_iter().find(|c| c.link == *link).unwrap()
}
