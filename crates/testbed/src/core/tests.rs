//! The core with a real server, which is outside of the emulated network: here the test answers in its place.

use std::{net::Ipv4Addr, path::Path};

use cotorra_engine::InMemoryEngine;
use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_flows::headers::{ETHERNET, ETHERTYPE_IPV4, IPV4, Ipv4, PROTOCOL_UDP, UDP, udp_header};
use cotorra_graph::{HostAddress, ServiceTime};
use cotorra_plugin::wire::{self, NavigationPacket, PositionPacket};

use super::*;
use crate::{real::robots::simulated, virtual_time::VirtualNetwork};

/// The robot is the first host.
const ROBOT: PortId = PortId(0);
const ROBOT_PORT: u16 = 40_000;
/// The real server's network card, and its address of the testbed file.
const ITS_MAC: [u8; 6] = [0x52, 0x54, 0, 1, 2, 3];
const ITS_ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 77, 3);
/// Time that it takes for an answer.
const WORK: Duration = Duration::from_millis(3);

fn frame(macs: [[u8; 6]; 2], [source, destination]: [SocketAddrV4; 2], payload: &[u8]) -> Frame {
    let [from, to] = macs;
    let (fragment, protocol) = (Ipv4::DONT_FRAGMENT, PROTOCOL_UDP);
    let (sender, receiver) = (*source.ip(), *destination.ip());
    let header =
        Ipv4 { identification: 0, fragment, ttl: 64, protocol, source: sender, destination: receiver };
    let mut bytes = [to, from].concat();
    bytes.extend(ETHERTYPE_IPV4.to_be_bytes());
    bytes.extend(header.header(UDP + payload.len()));
    bytes.extend(udp_header(source.port(), destination.port(), payload.len()));
    bytes.extend(payload);
    Frame::new(bytes)
}

/// The testbed with real servers, driven by hand.
struct Driven {
    core: Core<VirtualNetwork, InMemoryEngine>,
    network: VirtualNetwork,
    robot: NodeId,
    /// The socket of the navigation VNF.
    server: SocketAddrV4,
    /// Answers that the server is working on, and when they are due.
    working: VecDeque<(Timestamp, Frame)>,
}

impl Driven {
    fn start() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/real-servers.yaml");
        let testbed = Arc::new(cotorra_testbed_file::load(file).unwrap());
        let mut fabric = Fabric::new(&testbed.graph, 1).unwrap();
        // By this the fabric knows where the server's card is, as by its answer to ARP.
        let robot = SocketAddrV4::new(HostAddress::of(0).ipv4, ROBOT_PORT);
        let port = wire::port(&testbed, &"navigation".parse().unwrap()).unwrap();
        let server = SocketAddrV4::new(ITS_ADDRESS, port);
        let first = frame([ITS_MAC, HostAddress::of(0).mac], [server, robot], b"");
        let at_edge = fabric.port(&"edge".parse().unwrap()).unwrap();
        fabric.push(Timestamp::ZERO, at_edge, first);
        let network = VirtualNetwork::new(fabric);
        let script = Script::load(&testbed).unwrap().0;
        let (engine, nonces) = (InMemoryEngine::default(), Nonces::seeded(1));
        let mut core =
            Core::new(Arc::clone(&testbed), 1, nonces, network.clone(), engine, script, simulated).unwrap();
        core.start(Timestamp::ZERO);
        Self { core, network, robot: "robot".parse().unwrap(), server, working: VecDeque::new() }
    }

    /// Goes on for a second in steps of 0.1 ms. The server answers from this socket. Returns the service times.
    fn answered_from(&mut self, from: SocketAddrV4) -> Vec<ServiceTime> {
        let (begin, mut samples) = (self.network.with(|_, now| now).unwrap(), Vec::new());
        for step in 1..=10_000 {
            let now = begin + Duration::from_micros(100) * step;
            self.network.set_now(now);
            self.core.advance(now).unwrap();
            let robot = SocketAddrV4::new(HostAddress::of(0).ipv4, ROBOT_PORT);
            while let Some(datagram) = self.core.poll_transmit(now) {
                assert_eq!(datagram.to, self.server, "the real server's own address, and the VNF's port");
                let sent = frame([HostAddress::of(0).mac, ITS_MAC], [robot, datagram.to], &datagram.bytes);
                self.network.with(move |fabric, now| fabric.push(now, ROBOT, sent)).unwrap();
            }
            while self.working.front().is_some_and(|(due, _)| *due <= now) {
                let (due, answer) = self.working.pop_front().unwrap();
                let edge = "edge".parse().unwrap();
                self.network
                    .with(move |fabric, _| fabric.push(due, fabric.port(&edge).unwrap(), answer))
                    .unwrap();
            }
            let delivered = self.network.with(|fabric, now| {
                let mut delivered = Vec::new();
                fabric.poll(now, &mut |port, frame| delivered.push((port == ROBOT, frame.into_bytes())));
                delivered
            });
            for (is_robots, bytes) in delivered.unwrap() {
                let payload = &bytes[ETHERNET + IPV4 + UDP..];
                if is_robots {
                    self.core.receive(now, &self.robot, from, payload);
                } else if let Ok(position) = PositionPacket::decode(payload) {
                    let mut answer = Vec::new();
                    NavigationPacket::answering(&position, 1, Default::default()).encode(&mut answer);
                    let answer = frame([ITS_MAC, HostAddress::of(0).mac], [from, robot], &answer);
                    self.working.push_back((now + WORK, answer));
                }
            }
            while let Some(event) = self.core.poll_event() {
                if let Event::ServiceTime(sample) = event.event {
                    samples.push(sample);
                }
            }
        }
        samples
    }
}

#[test]
fn position_packets_go_to_a_real_server_and_its_work_is_its_part_of_the_time() {
    let mut driven = Driven::start();
    let samples = driven.answered_from(driven.server);
    let answered: Vec<_> = samples.iter().filter(|sample| sample.took.is_some()).collect();
    assert!(answered.len() > 2, "{samples:?}");
    for sample in answered {
        let parts = sample.parts.as_ref().unwrap();
        assert_eq!((sample.server.as_str(), parts.vnf), ("edge", WORK));
        let crossed = |link: &str| parts.links.iter().filter(|on| on.link.as_str() == link).count();
        assert_eq!((crossed("lan-edge"), crossed("lan-fog")), (2, 0), "there and back");
    }
}

#[test]
fn answers_from_other_addresses_than_the_real_servers_are_rejected() {
    let mut driven = Driven::start();
    let other = SocketAddrV4::new(Ipv4Addr::new(192, 168, 77, 4), driven.server.port());
    let samples = driven.answered_from(other);
    assert!(!samples.is_empty() && samples.iter().all(|sample| sample.took.is_none()), "{samples:?}");
}
