//! The delay that a gateway adds, beside a bridge of the kernel: round trips of UDP packets from one namespace, which is the
//! real machine, to a host behind a gateway and to a namespace behind a bridge, in turn. Run it as root: `cargo bench -p
//! cotorra-datapath --bench gateway`.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures real time")]
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    process::Command,
    thread,
    time::{Duration, Instant},
};

use cotorra_datapath::{Datapath, Namespace, Options};
use cotorra_fabric::Fabric;
use cotorra_graph::{BitRate, Conditions, Gateway, HardwareGraph, HostAddress, Link, NodeId, NodeKind};
use cotorra_graph_testing as base;

const PACKETS: usize = 20_000;
const WARM_UP: usize = 500;
const PORT: u16 = 7000;
const MACHINE: Ipv4Addr = Ipv4Addr::new(192, 168, 77, 2);
const BRIDGED: Ipv4Addr = Ipv4Addr::new(192, 168, 77, 3);

/// Runs `ip` in a namespace.
fn ip(inside: &Namespace, commands: &[&str]) {
    for command in commands {
        let run = || Command::new("ip").args(command.split(' ')).status().unwrap();
        assert!(inside.run(run).success(), "ip {command}");
    }
}

fn graph(gateway: Gateway) -> (HardwareGraph, NodeId) {
    let nodes = vec![
        base::node("host", NodeKind::Server(base::server())),
        base::node("gate", NodeKind::Gateway(gateway)),
    ];
    let medium = BitRate::from_bits_per_second(10_000_000_000).unwrap();
    let link = Link { medium, ..base::link("host", "gate", Conditions::default()) };
    (base::graph(nodes, vec![link]), base::id("host"))
}

fn echo(inside: &Namespace) {
    let socket = inside.udp_socket((Ipv4Addr::UNSPECIFIED, PORT)).unwrap();
    thread::spawn(move || {
        let mut packet = [0; 64];
        while let Ok((length, from)) = socket.recv_from(&mut packet) {
            socket.send_to(&packet[..length], from).unwrap();
        }
    });
}

fn round_trip(socket: &UdpSocket, to: SocketAddr) -> Duration {
    let begin = Instant::now();
    socket.send_to(&[0; 64], to).unwrap();
    socket.recv_from(&mut [0; 64]).unwrap();
    begin.elapsed()
}

/// Returns half of the round trip at a quantile, µs.
fn one_way_us(trips: &[Duration], quantile: f64) -> f64 {
    trips[((trips.len() - 1) as f64 * quantile) as usize].as_secs_f64() * 1e6 / 2.0
}

fn main() {
    let [machine, wire, bridged] = [(); 3].map(|()| Namespace::new().unwrap());
    ip(&wire, &["link set lo up", "link add br0 type bridge", "link set br0 up"]);
    for (namespace, name, address) in [(&machine, "vm", MACHINE), (&bridged, "vb", BRIDGED)] {
        let path = namespace.path();
        ip(&wire, &[&format!("link add {name} type veth peer name eth0 netns {}", path.display())]);
        ip(&wire, &[&format!("link set {name} master br0"), &format!("link set {name} up")]);
        ip(namespace, &["link set lo up", &format!("address add {address}/24 dev eth0"), "link set eth0 up"]);
    }
    let path = wire.path();
    ip(&machine, &[&format!("link add eth1 type veth peer name gate netns {}", path.display())]);
    ip(&wire, &["link set gate up"]);
    ip(&machine, &["link set eth1 up", &format!("route add {} dev eth1", HostAddress::NETWORK)]);

    let gateway = Gateway {
        interface: "gate".to_owned(),
        netns: Some(path.display().to_string()),
        machines: [(NodeId::new("machine").unwrap(), MACHINE)].into(),
    };
    let (graph, host) = graph(gateway);
    let fabric = Fabric::new(&graph, 1).unwrap();
    let datapath = Datapath::start(&graph, fabric, Options::default()).unwrap();
    echo(datapath.namespace(&host).unwrap());
    echo(&bridged);
    let socket = machine.udp_socket((MACHINE, 0)).unwrap();
    let ends = [BRIDGED, HostAddress::of(0).ipv4].map(|address| SocketAddr::from((address, PORT)));
    let mut trips = [const { Vec::new() }; 2];
    for packet in 0..WARM_UP + PACKETS {
        for (end, trips) in ends.into_iter().zip(&mut trips) {
            let trip = round_trip(&socket, end);
            if packet >= WARM_UP {
                trips.push(trip);
            }
        }
    }
    trips.iter_mut().for_each(|trips| trips.sort_unstable());
    println!("one way, of {PACKETS} round trips each:    p50        p99");
    let [bridge, gateway] = trips.map(|trips| [0.5, 0.99].map(|quantile| one_way_us(&trips, quantile)));
    for (name, [p50, p99]) in [
        ("a bridge of the kernel", bridge),
        ("a gateway and a link without delay", gateway),
        ("what the gateway adds", [gateway[0] - bridge[0], gateway[1] - bridge[1]]),
    ] {
        println!("{name:<36} {p50:>7.1} µs {p99:>7.1} µs");
    }
    let passed = datapath.gateways().remove(0).passed;
    println!("as the gateway reports: in {:?}", passed.received_lateness);
    println!("                       out {:?}", passed.sent_lateness);
}
