//! Datagrams that a robot sends faster than its radio can, with and without protected management frames, beside the fabric's own
//! radio at the same place.
#![allow(clippy::disallowed_methods, reason = "senders and radios run by the kernel's clock")]

use std::{
    env,
    net::{SocketAddr, UdpSocket},
    thread,
    time::Duration,
};

use cotorra_datapath::{Clock, Datapath, Options};
use cotorra_fabric::Fabric;
use cotorra_testbed_file::parse;
use cotorra_wifi::Protection;

use super::{FLOOR, Floor, WLAN, id, iw};

/// Bytes of a datagram.
const PAYLOAD: usize = 1400;
/// Datagrams each millisecond: 134 Mbit/s.
const EACH_MILLISECOND: usize = 12;

/// Whether all is to be measured, for long.
fn is_full() -> bool {
    env::var_os("COTORRA_FULL").is_some()
}

/// Returns how long rate control has to find its rates, and how long it is measured then.
fn times() -> [Duration; 2] {
    let [found, measured] = if is_full() { [1000, 1000] } else { [700, 300] };
    [found, measured].map(Duration::from_millis)
}

/// Sends for a while. Returns what arrives meanwhile, in Mbit/s of the datagrams' payload.
fn throughput(clock: Clock, [from, to]: &[UdpSocket; 2], server: SocketAddr, time: Duration) -> f64 {
    let end = clock.now() + time;
    to.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let bytes: usize = thread::scope(|scope| {
        let receiver = scope.spawn(|| {
            let mut buffer = [0; PAYLOAD];
            let next = || to.recv(&mut buffer).ok().filter(|_| clock.now() < end);
            std::iter::from_fn(next).sum()
        });
        while clock.now() < end {
            // A radio lets its senders wait. Other interfaces drop what is too much.
            (0..EACH_MILLISECOND).for_each(|_| drop(from.send_to(&[0; PAYLOAD], server)));
            thread::sleep(Duration::from_millis(1));
        }
        receiver.join().unwrap()
    });
    8e-6 * bytes as f64 / time.as_secs_f64()
}

/// Returns the throughput of the fabric's own radio, which has one stream.
fn of_the_model() -> f64 {
    let graph = parse("floor", &FLOOR.replace("wifi: hwsim", ""), "".as_ref()).unwrap().graph;
    let options = Options { let_cores_sleep: true, ..Options::default() };
    let datapath = Datapath::start(&graph, Fabric::new(&graph, 1).unwrap(), options).unwrap();
    let socket = |node: &str| datapath.namespace(&id(node)).unwrap().udp_socket("[::]:7711").unwrap();
    let sockets = ["robot", "edge"].map(socket);
    let server = (graph.address(&id("edge")).unwrap().ipv4, 7711).into();
    // It joins within a second.
    thread::sleep(Duration::from_secs(1));
    let [_, measured] = times().map(|time| throughput(datapath.clock(), &sockets, server, time));
    measured
}

/// With `COTORRA_FULL`, without protected management frames, and with two streams, too.
#[test]
fn frames_are_aggregated_with_and_without_protected_management_frames() {
    let mut one_stream = Vec::new();
    for (name, protection) in [("plain", Protection::Off), ("protected", Protection::Required)] {
        if protection == Protection::Off && !is_full() {
            continue;
        }
        let Some(floor) = Floor::protected(name, protection) else { return };
        let server = (floor.address("edge").ipv4, 7711).into();
        floor.round_trip(server);
        let clock = floor.datapath.clock();
        let measure = || times().map(|time| throughput(clock, &floor.sockets, server, time))[1];
        let two = is_full().then(measure);
        iw(
            &floor,
            "robot",
            &["dev", WLAN, "set", "bitrates", "ht-mcs-2.4", "0", "1", "2", "3", "4", "5", "6", "7"],
        );
        let one = measure();
        eprintln!("{protection:?}: {one:.1} Mbit/s with one stream, {two:.1?} with two");
        one_stream.push(one);
    }
    let model = of_the_model();
    eprintln!("model: {model:.1} Mbit/s with one stream");
    for measured in one_stream {
        assert!((measured / model - 1.0).abs() < 0.05, "{measured:.1} instead of {model:.1} Mbit/s");
    }
}
