//! Measures the round trip of a 360-beam scan to a peer over loopback, 100 times a second. Peers are a node of this crate
//! and one of rospy. Bare sockets in Rust and in Python show what these add.
//!
//! `cargo bench -p cotorra-ros1 --bench round_trip`
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures real time")]
#![allow(clippy::unwrap_used, reason = "a failed benchmark ends")]

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    thread,
    time::{Duration, Instant},
};

use cotorra_ros1::{
    MasterServer, Message, Node, NodeConfig, PublishOptions, SubscribeOptions,
    messages::{Header, LaserScan},
};
use cotorra_testing::{
    process::{PATIENCE, until},
    ros1::Ros,
};
use hdrhistogram::Histogram;

const INTERVAL: Duration = Duration::from_millis(10);
const WARM_UP: u32 = 100;
const SAMPLES: u32 = 2000;

fn scan() -> LaserScan {
    LaserScan {
        header: Header { frame_id: "laser".to_owned(), ..Header::default() },
        ranges: (0..360).map(|beam| 1.0 + beam as f32 / 100.0).collect(),
        ..LaserScan::default()
    }
}

/// Measures `round_trip`, which gets a running number, and prints percentiles.
fn measure(peer: &str, mut round_trip: impl FnMut(u32)) {
    let mut took = Histogram::<u64>::new(3).unwrap();
    let mut due = Instant::now();
    for number in 0..WARM_UP + SAMPLES {
        due += INTERVAL;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let began = Instant::now();
        round_trip(number);
        if number >= WARM_UP {
            took.record(u64::try_from(began.elapsed().as_nanos()).unwrap()).unwrap();
        }
    }
    let at = |percentile| took.value_at_quantile(percentile) as f64 / 1e6;
    println!("| {peer} | {:.3} ms | {:.3} ms | {:.3} ms |", at(0.5), at(0.99), at(1.0));
}

/// Measures the round trip to a bare socket that returns what it reads.
fn measure_socket(peer: &str, mut stream: TcpStream) {
    let mut bytes = Vec::new();
    scan().encode_ros1(&mut bytes);
    stream.set_nodelay(true).unwrap();
    let mut back = vec![0; bytes.len()];
    measure(peer, |_| {
        stream.write_all(&bytes).unwrap();
        stream.read_exact(&mut back).unwrap();
    });
}

fn node(master: &MasterServer, name: &str) -> Node {
    Node::new(NodeConfig { master: master.endpoint().clone(), ..NodeConfig::new(name) }).unwrap()
}

fn measure_node(peer: &str, master: &MasterServer) {
    let node = node(master, "pitcher");
    let there = node.publish::<LaserScan>("there", PublishOptions::default()).unwrap();
    let back = node.subscribe::<LaserScan>("back", SubscribeOptions::default()).unwrap();
    until("the peer is connected", || there.subscribers() == 1 && back.publishers() == 1);
    let mut scan = scan();
    measure(peer, |number| {
        scan.header.seq = number;
        there.publish(&scan);
        assert_eq!(back.recv_timeout(PATIENCE).unwrap().ranges.len(), 360);
    });
}

const ECHO: &str = r#"
import rospy
from sensor_msgs.msg import LaserScan
rospy.init_node("echo")
back = rospy.Publisher("back", LaserScan, queue_size=None)
rospy.Subscriber("there", LaserScan, back.publish, tcp_nodelay=True)
rospy.spin()
"#;

const SOCKET: &str = r#"
import socket, sys
server = socket.create_server(("127.0.0.1", 0))
print(server.getsockname()[1], flush=True)
peer = server.accept()[0]
peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
while data := peer.recv(65536):
    peer.sendall(data)
"#;

fn main() {
    let master = MasterServer::start("127.0.0.1", 0).unwrap();
    println!("| peer | p50 | p99 | max |\n|---|---|---|---|");

    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let echo = thread::spawn(move || {
        let (mut peer, _) = listener.accept().unwrap();
        peer.set_nodelay(true).unwrap();
        let mut piece = [0; 65536];
        while let Ok(read @ 1..) = peer.read(&mut piece) {
            peer.write_all(&piece[..read]).unwrap();
        }
    });
    measure_socket("a bare socket in Rust", TcpStream::connect(address).unwrap());
    echo.join().unwrap();

    let echo = node(&master, "echo");
    let back = echo.publish::<LaserScan>("back", PublishOptions::default()).unwrap();
    let there = echo.subscribe::<LaserScan>("there", SubscribeOptions::default()).unwrap();
    let catcher = thread::spawn(move || {
        while let Some(scan) = there.recv() {
            back.publish(&scan);
        }
    });
    measure_node("a node of this crate", &master);
    echo.shut_down();
    catcher.join().unwrap();

    let Some(ros) = Ros::with_master(master.endpoint().port) else { return };
    let python = ros.python("socket_echo.py", SOCKET);
    until("the socket listens", || python.output().ends_with('\n'));
    let port: u16 = python.output().trim().parse().unwrap();
    measure_socket("a bare socket in Python", TcpStream::connect(("127.0.0.1", port)).unwrap());
    drop(python);

    let rospy = ros.python("echo.py", ECHO);
    measure_node("a node of rospy", &master);
    drop(rospy);
}
