//! Builds small networks, and numbered frames to send over them.

use std::{collections::BTreeMap, time::Duration};

use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_graph::{
    BitRate, Conditions, HardwareGraph, HostAddress, LinkContext, Node, NodeKind, Position, Rate, Timestamp,
};
use cotorra_graph_testing as base;

/// A builder of networks.
pub struct Network(HardwareGraph);

impl Network {
    /// No nodes, and a wireless network `air` without randomness: 1 ms of delay, and the standard's rate.
    pub fn new() -> Self {
        let wireless = BTreeMap::from([("air".to_owned(), base::wireless())]);
        Self(HardwareGraph { domains: vec![base::id("home")], wireless, ..base::graph(vec![], vec![]) })
    }

    fn node(mut self, name: &str, x: f64, kind: NodeKind) -> Self {
        let position = Some(Position::new(x, 0.0));
        self.0.nodes.push(Node { position, ..base::node(name, kind) });
        self
    }

    pub fn server(self, name: &str) -> Self {
        self.node(name, 0.0, NodeKind::Server(base::server()))
    }

    /// Adds a radio unit, `x` metres to the east.
    pub fn radio_unit(self, name: &str, x: f64) -> Self {
        self.node(name, x, NodeKind::RadioUnit(base::radio_unit("air")))
    }

    /// Adds a robot, `x` metres to the east, that roams by instruction only.
    pub fn robot(self, name: &str, x: f64) -> Self {
        self.node(name, x, NodeKind::Robot(base::robot("air")))
    }

    pub fn servers(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.server(name))
    }

    pub fn switches(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.node(name, 0.0, NodeKind::Switch))
    }

    /// Adds a link `<a>-<b>` over a medium of 100 Gbit/s, with the same conditions in both directions.
    pub fn link(mut self, a: &str, b: &str, conditions: Conditions) -> Self {
        self.0.links.push(base::link(a, b, conditions));
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

/// A delivered frame: when, where and what.
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
