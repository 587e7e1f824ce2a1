//! Wired links that keep reservations, beside the kernel's HTB under the same loads, and beside the closed form.
//!
//! Nothing is adjusted to the kernel: HTB has the defaults of `tc`. Needs `COTORRA_KERNEL` and a kernel in virtual time, such as
//! that of `scripts/uml --radios 0`. Elsewhere only the fabric stands beside the closed form.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "tests may panic; HTB works by the kernel's clock"
)]

use std::{
    collections::BTreeMap,
    env,
    net::UdpSocket,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use cotorra_datapath::Namespace;
use cotorra_fabric::{Fabric, Frame, PinnedPath, Reservation};
use cotorra_graph::{BitRate, HardwareGraph, Timestamp};
use cotorra_numbers::quantile;

/// Rate of the link, Mbit/s.
const LINK: f64 = 10.0;
/// Packets that may wait in each class.
const LIMIT: u32 = 50;
/// What is measured begins after the first second.
const MEASURED: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(6)];
/// Bytes of a frame besides the payload of UDP.
const HEADERS: usize = 42;
const FULL: usize = 1514;

/// A reservation and the load of its packets.
#[derive(Debug, Clone, Copy)]
struct Class {
    /// The reserved rate, or what is not reserved for the class of all other packets, Mbit/s.
    rate: f64,
    /// Whether that is also the most.
    is_limited: bool,
    /// Offered load, Mbit/s of frames.
    offered: f64,
    /// Bytes of each frame.
    bytes: usize,
    /// Frames that come at once.
    burst: u64,
}

const fn class(rate: f64, offered: f64) -> Class {
    Class { rate, is_limited: false, offered, bytes: FULL, burst: 1 }
}

/// The last class is that of all other packets.
const CASES: [(&str, [Class; 3]); 5] = [
    ("all are backlogged", [class(6.0, 12.0), class(1.0, 12.0), class(3.0, 12.0)]),
    ("one is idle", [class(6.0, 0.0), class(1.0, 12.0), class(3.0, 12.0)]),
    ("one is limited", [Class { is_limited: true, ..class(2.0, 12.0) }, class(1.0, 0.5), class(7.0, 12.0)]),
    (
        "small packets come steadily",
        [Class { bytes: 200, ..class(1.0, 0.5) }, class(4.0, 12.0), class(5.0, 12.0)],
    ),
    (
        "small packets come in bursts of ten",
        [Class { bytes: 200, burst: 10, ..class(1.0, 0.8) }, class(4.0, 12.0), class(5.0, 12.0)],
    ),
];

/// A packet to send.
#[derive(Debug, Clone, Copy)]
struct Packet {
    class: usize,
    bytes: usize,
    at: Duration,
}

/// What became of a class.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Outcome {
    /// Throughput, Mbit/s of frames.
    mbps: f64,
    /// Median and 95th percentile of the time from a packet's arrival to the start of its transmission, ms.
    waits_ms: Option<[f64; 2]>,
}

/// Returns the packets of all classes, in order.
fn load(classes: &[Class]) -> Vec<Packet> {
    let mut packets = Vec::new();
    for (place, class) in classes.iter().enumerate().filter(|(_, class)| class.offered > 0.0) {
        let gap = class.bytes as f64 * 8e-6 * class.burst as f64 / class.offered;
        // Classes do not begin at the same moment.
        let first = place as f64 * 1e-4;
        let bursts = ((MEASURED[1].as_secs_f64() - first) / gap) as u64;
        for burst in 0..bursts {
            let at = Duration::from_secs_f64(first + burst as f64 * gap);
            packets.extend((0..class.burst).map(|_| Packet { class: place, bytes: class.bytes, at }));
        }
    }
    packets.sort_by_key(|packet| packet.at);
    packets
}

/// Returns the outcome of a class from the arrivals of its packets and their waits.
fn outcome(arrivals: &[(usize, Duration, Duration)], class: usize) -> Outcome {
    let [begin, end] = MEASURED;
    let of_class = arrivals.iter().filter(|(place, at, _)| *place == class && (begin..end).contains(at));
    let mut waits: Vec<_> = of_class.map(|(_, _, wait)| wait.as_secs_f64() * 1e3).collect();
    waits.sort_by(f64::total_cmp);
    let at = |share| quantile(&waits, share);
    Outcome {
        mbps: waits.len() as f64 / (end - begin).as_secs_f64(),
        waits_ms: at(0.5).zip(at(0.95)).map(Into::into),
    }
}

fn outcomes(classes: &[Class], arrivals: &[(usize, Duration, Duration)]) -> Vec<Outcome> {
    let of = |(place, class): (usize, &Class)| {
        let outcome = outcome(arrivals, place);
        Outcome { mbps: outcome.mbps * class.bytes as f64 * 8e-6, ..outcome }
    };
    classes.iter().enumerate().map(of).collect()
}

/// Returns what each class gets, Mbit/s: its own rate as far as it has packets, and of what is left over a share in proportion to
/// its rate, up to its load and its limit.
fn closed_form(classes: &[Class]) -> Vec<f64> {
    let most = |class: &Class| if class.is_limited { class.offered.min(class.rate) } else { class.offered };
    let mut got: Vec<_> = classes.iter().map(|class| most(class).min(class.rate)).collect();
    loop {
        let left = LINK - got.iter().sum::<f64>();
        let wanting: Vec<_> = (0..classes.len()).filter(|i| most(&classes[*i]) - got[*i] > 1e-9).collect();
        if left < 1e-9 || wanting.is_empty() {
            return got;
        }
        let weights: f64 = wanting.iter().map(|i| classes[*i].rate).sum();
        for i in wanting {
            let class = &classes[i];
            got[i] = most(class).min(got[i] + left * class.rate / weights);
        }
    }
}

/// One host for each class, and a link that all of them share.
fn funnel() -> HardwareGraph {
    let host = "{ kind: server, tier: edge, cpus: 1, memory: 1 GB }";
    let text = format!(
        "name: funnel\nnodes:\n  c0: {host}\n  c1: {host}\n  c2: {host}\n  lan: {{ kind: switch }}\n  sink: {host}\n\
         links:\n  - {{ ends: [lan, [c0, c1, c2]], queue: {LIMIT} packets }}\n  \
         - {{ id: shared, ends: [lan, sink], rate: {LINK} Mbit/s, queue: {LIMIT} packets }}\n"
    );
    cotorra_testbed_file::parse("funnel.yaml", &text, ".".as_ref()).unwrap().graph
}

fn by_the_fabric(classes: &[Class; 3]) -> Vec<Outcome> {
    let graph = funnel();
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    let node = |name: &str| name.parse().unwrap();
    let paths = classes[..2].iter().enumerate().map(|(place, class)| PinnedPath {
        from: node(&format!("c{place}")),
        to: node("sink"),
        links: [format!("lan-c{place}"), "shared".to_owned()].map(|link| link.parse().unwrap()).to_vec(),
        reservation: BitRate::from_mbps(class.rate)
            .map(|rate| Reservation { rate, is_limited: class.is_limited }),
    });
    fabric.pin(Timestamp::ZERO, &paths.collect::<Vec<_>>()).unwrap();
    let sink = graph.address(&node("sink")).unwrap().mac;
    let time = |at: Duration| Timestamp::ZERO + at;
    let mut arrivals = Vec::new();
    let mut deliver = |now: Timestamp, frame: &Frame| {
        let bytes = frame.bytes();
        let sent = Duration::from_nanos(u64::from_ne_bytes(bytes[15..23].try_into().unwrap()));
        let now = now.since(Timestamp::ZERO);
        let transmission = Duration::from_secs_f64(bytes.len() as f64 * 8e-6 / LINK);
        arrivals.push((usize::from(bytes[14]), now, now.saturating_sub(sent + transmission)));
    };
    let mut packets = load(classes).into_iter().peekable();
    let mut due = None;
    loop {
        let coming = packets.peek().map(|packet| time(packet.at));
        let Some(now) = coming.into_iter().chain(due).min().filter(|now| *now <= time(MEASURED[1])) else {
            return outcomes(classes, &arrivals);
        };
        while let Some(packet) = packets.next_if(|packet| time(packet.at) <= now) {
            let name = node(&format!("c{}", packet.class));
            let mut bytes = [&sink[..], &graph.address(&name).unwrap().mac, &[0x88, 0xb6]].concat();
            bytes.push(packet.class as u8);
            bytes.extend((packet.at.as_nanos() as u64).to_ne_bytes());
            bytes.resize(packet.bytes, 0);
            fabric.push(now, fabric.port(&name).unwrap(), Frame::new(bytes));
        }
        due = fabric.poll(now, &mut |_, frame| deliver(now, &frame));
    }
}

fn sh(namespace: &Namespace, line: &str) {
    let output = namespace.run(|| Command::new("sh").args(["-ec", line]).output().unwrap());
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Port of the first class.
const PORT: u16 = 7700;

fn by_htb(classes: &[Class; 3]) -> Vec<Outcome> {
    let [from, to] = [Namespace::new().unwrap(), Namespace::new().unwrap()];
    sh(
        &from,
        &format!(
            "ip link add va type veth peer name vb netns {}
             ip address add 10.0.0.1/24 dev va; ip link set va up
             tc qdisc add dev va root handle 1: htb default 12
             tc class add dev va parent 1: classid 1:1 htb rate {LINK}mbit ceil {LINK}mbit",
            to.path().display()
        ),
    );
    sh(&to, "ip address add 10.0.0.2/24 dev vb; ip link set vb up");
    for (place, class) in classes.iter().enumerate() {
        let (rate, ceil) = (class.rate, if class.is_limited { class.rate } else { LINK });
        sh(
            &from,
            &format!(
                "tc class add dev va parent 1:1 classid 1:1{place} htb rate {rate}mbit ceil {ceil}mbit
                 tc qdisc add dev va parent 1:1{place} pfifo limit {LIMIT}
                 tc filter add dev va parent 1: protocol ip u32 match ip dport {} 0xffff flowid 1:1{place}",
                PORT + place as u16
            ),
        );
    }
    let sockets: Vec<_> = (0..3).map(|place| to.udp_socket(("10.0.0.2", PORT + place)).unwrap()).collect();
    // One for each class: a full buffer of one socket would hold up the others.
    let senders = [(); 3].map(|()| from.udp_socket("10.0.0.1:0").unwrap());
    sockets.iter().for_each(|socket| socket.set_read_timeout(Some(Duration::from_secs(2))).unwrap());
    let start = Instant::now() + Duration::from_millis(100);
    let receive = |(place, socket): (usize, UdpSocket)| {
        let mut arrivals = Vec::new();
        let mut buffer = [0; FULL];
        while let Ok(length) = socket.recv(&mut buffer) {
            let sent = Duration::from_nanos(u64::from_ne_bytes(buffer[..8].try_into().unwrap()));
            let now = start.elapsed();
            assert!(length >= 8);
            arrivals.push((place, now, now.saturating_sub(sent)));
        }
        arrivals
    };
    let arrivals: Vec<_> = thread::scope(|scope| {
        let receivers: Vec<_> =
            sockets.into_iter().enumerate().map(|of| scope.spawn(move || receive(of))).collect();
        for packet in load(classes) {
            thread::sleep((start + packet.at).saturating_duration_since(Instant::now()));
            let mut payload = (start.elapsed().as_nanos() as u64).to_ne_bytes().to_vec();
            payload.resize(packet.bytes - HEADERS, 0);
            let port = PORT + packet.class as u16;
            senders[packet.class].send_to(&payload, ("10.0.0.2", port)).unwrap();
        }
        receivers.into_iter().flat_map(|receiver| receiver.join().unwrap()).collect()
    });
    outcomes(classes, &arrivals)
}

fn text(outcome: &Outcome) -> String {
    match outcome.waits_ms {
        Some([median, p95]) => format!("{:.2} Mbit/s, {median:.2} ms, {p95:.2} ms", outcome.mbps),
        None => "nothing".to_owned(),
    }
}

#[test]
fn the_fabric_shares_a_link_as_the_closed_form_says_and_stands_beside_the_kernels_htb() {
    let has_kernel = env::var_os("COTORRA_KERNEL").is_some();
    let mut farthest: BTreeMap<&str, f64> = BTreeMap::new();
    for (name, classes) in &CASES {
        println!("{name}: throughput, median wait, 95th percentile");
        let fabric = by_the_fabric(classes);
        let htb = has_kernel.then(|| by_htb(classes));
        for (place, expected) in closed_form(classes).into_iter().enumerate() {
            let ours = &fabric[place];
            let beside = htb.as_ref().map_or("not here".to_owned(), |htb| text(&htb[place]));
            println!("  {place}: closed form {expected:.2} Mbit/s; fabric {}; HTB {beside}", text(ours));
            let others = [("fabric", Some(ours.mbps)), ("HTB", htb.as_ref().map(|htb| htb[place].mbps))];
            for (who, mbps) in others {
                let distance = mbps.map_or(0.0, |mbps| (mbps - expected).abs());
                // A hundredth of the link.
                assert!(distance <= 0.1, "{name}: {who} gives class {place} {mbps:?} of {expected}");
                let most = farthest.entry(who).or_default();
                *most = most.max(distance);
            }
        }
    }
    println!("farthest from the closed form, Mbit/s: {farthest:.3?}");
}
