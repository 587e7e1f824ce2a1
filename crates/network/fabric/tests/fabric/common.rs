//! Builds small networks, and numbered frames to send over them.

use std::{collections::BTreeMap, time::Duration};

use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_graph::{
    Access, BitRate, Capacity, Conditions, Dbm, Driver, GapPolicy, HandoverTimes, HardwareGraph, HostAddress,
    Link, LinkContext, Loss, Node, NodeKind, PathLoss, Position, RadioUnit, Rate, Roaming, Robot, RobotModel,
    Server, Shadowing, Tier, Timestamp, WifiStandard, WirelessNetwork,
};

/// A builder of networks.
pub struct Network(HardwareGraph);

impl Network {
    /// No nodes, and a wireless network `air` without randomness: 1 ms of delay, and the standard's rate.
    pub fn new() -> Self {
        let air = WirelessNetwork {
            standard: WifiStandard::N,
            delay: Duration::from_millis(1),
            rate: None,
            loss: Loss::None,
            fast_transition: true,
            mobility_domain: 1,
            path_loss: PathLoss::LogDistance { exponent: 3.0 },
            walls: None,
            access: Access::Turns,
            shadowing: Shadowing { deviation_db: 0.0, correlation_m: 5.0 },
            fading: None,
            noise_floor: Dbm(-95.0),
            hysteresis_db: 4.0,
            time_to_trigger: Duration::from_millis(500),
            handover: HandoverTimes {
                scan: Duration::from_millis(100),
                visits: None,
                authenticate: Duration::from_millis(10),
                reassociate: Duration::from_millis(20),
                handshake: Duration::from_millis(40),
                variation: 0.0,
                frames: None,
            },
            gap: GapPolicy::Hold,
        };
        let domains = vec!["home".parse().unwrap()];
        let wireless = BTreeMap::from([("air".to_owned(), air)]);
        Self(HardwareGraph { domains, nodes: vec![], links: vec![], wireless })
    }

    fn node(mut self, name: &str, x: f64, kind: NodeKind) -> Self {
        let domain = self.0.domains[0].clone();
        let position = Some(Position::new(x, 0.0));
        self.0.nodes.push(Node { id: name.parse().unwrap(), domain, position, kind });
        self
    }

    pub fn server(self, name: &str) -> Self {
        let server = Server { tier: Tier::Edge, capacity: CAPACITY, cost: 1.0, reliability: 1.0, real: None };
        self.node(name, 0.0, NodeKind::Server(server))
    }

    /// Adds a radio unit, `x` metres to the east.
    pub fn radio_unit(self, name: &str, x: f64) -> Self {
        let unit = RadioUnit {
            capacity: CAPACITY,
            network: "air".into(),
            channel: 1,
            tx_power: Dbm(20.0),
            serving: true,
            deployment: Duration::ZERO,
            agent: None,
            radio: None,
        };
        self.node(name, x, NodeKind::RadioUnit(unit))
    }

    /// Adds a robot, `x` metres to the east, that roams by instruction only.
    pub fn robot(self, name: &str, x: f64) -> Self {
        let robot = Robot {
            capacity: CAPACITY,
            model: RobotModel::Turtlebot2,
            network: "air".into(),
            tx_power: Dbm(20.0),
            heading: 0.0,
            roaming: Roaming::Instructed,
            driver: Driver::default(),
            sensors: Vec::new(),
            radio: None,
        };
        self.node(name, x, NodeKind::Robot(robot))
    }

    pub fn servers(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.server(name))
    }

    pub fn switches(self, names: &[&str]) -> Self {
        names.iter().fold(self, |network, name| network.node(name, 0.0, NodeKind::Switch))
    }

    /// Adds a link `<a>-<b>` over a medium of 100 Gbit/s, with the same conditions in both directions.
    pub fn link(mut self, a: &str, b: &str, conditions: Conditions) -> Self {
        self.0.links.push(Link {
            id: format!("{a}-{b}").parse().unwrap(),
            ends: [a.parse().unwrap(), b.parse().unwrap()],
            forward: conditions.clone(),
            backward: conditions,
            medium: BitRate::from_mbps(100_000.0).unwrap(),
            medium_delay: Duration::ZERO,
            scales: Default::default(),
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

const CAPACITY: Capacity = Capacity { cpus: 4.0, memory_bytes: 8 << 30 };

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
