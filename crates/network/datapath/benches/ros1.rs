//! Measures how long a 360-beam scan takes to a peer and back through the emulated network, at 100 Hz. Two ROS 1
//! nodes run in two network namespaces, 5 ms apart each way. A bare UDP packet serves as reference.
//!
//! Run with `cargo bench -p cotorra-datapath --bench ros1`. On a busy machine, run the program that this prints under
//! `chrt -f 5`.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures real time")]
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::{
    fs, panic,
    path::Path,
    process, thread,
    time::{Duration, Instant},
};

use cotorra_datapath::{Datapath, Namespace, Options, enter_user_namespace_if_needed};
use cotorra_fabric::Fabric;
use cotorra_graph::NodeId;
use cotorra_ros1::{
    Endpoint, MasterServer, Node, NodeConfig, PublishOptions, SubscribeOptions,
    messages::{Header, LaserScan},
};
use parking_lot::Mutex;

const TESTBED: &str = "
name: path
nodes:
  near: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  far: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [near, lan], delay: 2 ms }
  - { ends: [lan, far], delay: 3 ms }
";
const INTERVAL: Duration = Duration::from_millis(10);
const WARM_UP: u32 = 100;
const SAMPLES: u32 = 2000;
/// Time without any arrival after which the remaining packets count as lost.
const PATIENCE: Duration = Duration::from_secs(2);

/// Sends a number every 10 ms without waiting for earlier ones, and prints the distribution of their transit times.
fn measure(what: &str, mut send: impl FnMut(u32) + Send, mut receive: impl FnMut() -> Option<u32>) {
    let sent = Mutex::new(Vec::new());
    let mut took = Vec::new();
    thread::scope(|scope| {
        scope.spawn(|| {
            let begin = Instant::now();
            for number in 0..WARM_UP + SAMPLES {
                thread::sleep((INTERVAL * number).saturating_sub(begin.elapsed()));
                sent.lock().push(Instant::now());
                send(number);
            }
        });
        // Short queues drop what a busy machine leaves unread and keep what is new.
        while let Some(number) = receive() {
            let at = Instant::now();
            if number >= WARM_UP {
                took.push(at.duration_since(sent.lock()[number as usize]).as_secs_f64() * 1e3);
            }
            if number + 1 == WARM_UP + SAMPLES {
                break;
            }
        }
    });
    took.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| took[((took.len() - 1) as f64 * share) as usize];
    let lost = SAMPLES as usize - took.len();
    println!("| {what} | {:.2} ms | {:.2} ms | {:.2} ms | {lost} |", at(0.5), at(0.99), at(1.0));
}

fn load_average() -> String {
    fs::read_to_string("/proc/loadavg").unwrap_or_default().trim().to_owned()
}

/// Makes any panicking thread end the benchmark. The other threads would otherwise wait for ever.
fn end_at_panics() {
    let tell = panic::take_hook();
    panic::set_hook(Box::new(move |what| {
        tell(what);
        process::exit(1);
    }));
}

fn main() {
    end_at_panics();
    enter_user_namespace_if_needed().unwrap();
    let graph = cotorra_testbed_file::parse("path", TESTBED, Path::new("")).unwrap().graph;
    let fabric = Fabric::new(&graph, 1).unwrap();
    let datapath = Datapath::start(&graph, fabric, Options::default()).unwrap();
    let place = |name: &str| {
        let id = NodeId::new(name).unwrap();
        let address = graph.address(&id).unwrap().ipv4.to_string();
        (datapath.namespace(&id).unwrap(), address)
    };
    let ((near, near_ip), (far, far_ip)) = (place("near"), place("far"));
    println!("load average before: {}", load_average());
    println!("| over 5 ms each way | p50 | p99 | max | lost |\n|---|---|---|---|---|");

    let echo = far.udp_socket((far_ip.as_str(), 7)).unwrap();
    thread::spawn(move || {
        let mut packet = [0; 2048];
        while let Ok((length, sender)) = echo.recv_from(&mut packet) {
            let _ = echo.send_to(&packet[..length], sender);
        }
    });
    let socket = near.udp_socket((near_ip.as_str(), 0)).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let send = |number: u32| {
        let mut packet = [0; 1400];
        packet[..4].copy_from_slice(&number.to_be_bytes());
        socket.send_to(&packet, (far_ip.as_str(), 7)).unwrap();
    };
    let receive = || {
        let mut packet = [0; 1400];
        socket.recv(&mut packet).ok()?;
        Some(u32::from_be_bytes([packet[0], packet[1], packet[2], packet[3]]))
    };
    measure("a UDP packet of 1400 bytes", send, receive);

    let master = far.run(|| MasterServer::start(&far_ip, 11311)).unwrap();
    let node = |namespace: &Namespace, name: &str, host: &str| {
        let master = Endpoint { host: far_ip.clone(), port: 11311 };
        let config = NodeConfig { master, host: Some(host.to_owned()), ..NodeConfig::new(name) };
        namespace.run(|| Node::new(config)).unwrap()
    };
    let (pitcher, catcher) = (node(near, "pitcher", &near_ip), node(far, "catcher", &far_ip));
    let (there, back) = near.run(|| {
        let there = pitcher.publish::<LaserScan>("there", PublishOptions::default()).unwrap();
        (there, pitcher.subscribe::<LaserScan>("back", SubscribeOptions::default()).unwrap())
    });
    let (thrown, caught) = far.run(|| {
        let back = catcher.publish::<LaserScan>("back", PublishOptions::default()).unwrap();
        (catcher.subscribe::<LaserScan>("there", SubscribeOptions::default()).unwrap(), back)
    });
    let catching = thread::spawn(move || {
        while let Some(scan) = thrown.recv() {
            caught.publish(&scan);
        }
    });
    while there.subscribers() == 0 || back.publishers() == 0 {
        thread::sleep(INTERVAL);
    }
    let mut scan = LaserScan {
        header: Header { frame_id: "laser".to_owned(), ..Header::default() },
        ranges: (0..360).map(|beam| 1.0 + beam as f32 / 100.0).collect(),
        ..LaserScan::default()
    };
    let send = |number| {
        scan.header.stamp.nanosec = number;
        there.publish(&scan);
    };
    let receive = || Some(back.recv_timeout(PATIENCE).ok()?.header.stamp.nanosec);
    measure("a LaserScan of 360 beams to a node of ROS 1 and back", send, receive);
    pitcher.shut_down();
    catcher.shut_down();
    catching.join().unwrap();
    // It ends by connecting to itself.
    far.run(|| drop(master));
    println!("load average after: {}", load_average());
}
