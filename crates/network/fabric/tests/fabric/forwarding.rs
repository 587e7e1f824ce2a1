//! Unicast frames take the shortest path, and group frames reach every host once.

use crate::common::{A, B, Network, delay, frame, frame_to, ms, number, pair, run};
use cotorra_fabric::PortId;
use cotorra_graph::{ConditionChange, Conditions, Timestamp};

const BROADCAST: [u8; 6] = [0xff; 6];

fn clear() -> Conditions {
    Conditions::default()
}

#[test]
fn a_frame_crosses_a_link_after_its_delay() {
    let mut fabric = pair(delay(5), 1);
    fabric.push(ms(1.0), A, frame(A, B, 7, 60));
    let out = run(&mut fabric, ms(1.0), ms(100.0));
    assert_eq!(out.len(), 1);
    assert_eq!((out[0].at, out[0].port, number(&out[0].frame)), (ms(6.0), B, 7));
}

#[test]
fn a_frame_crosses_a_clear_path_at_once() {
    let network = Network::new().servers(&["a", "b"]).switches(&["s", "t"]);
    let mut fabric =
        network.link("a", "s", clear()).link("s", "t", clear()).link("t", "b", clear()).fabric(1);
    fabric.push(ms(1.0), A, frame(A, B, 7, 60));
    let mut out = Vec::new();
    assert_eq!(fabric.poll(ms(1.0), &mut |port, frame| out.push((port, number(&frame)))), None);
    assert_eq!(out, [(B, 7)]);
}

#[test]
fn a_late_poll_delays_only_the_delivery() {
    let network = Network::new().servers(&["a", "b"]).switches(&["s"]);
    let mut fabric = network.link("a", "s", delay(5)).link("s", "b", delay(5)).fabric(1);
    fabric.push(Timestamp::ZERO, A, frame(A, B, 1, 60));
    assert_eq!(fabric.poll(ms(7.5), &mut |_, _| panic!("too early")), Some(ms(10.0)));
    assert_eq!(run(&mut fabric, ms(10.5), ms(20.0)).len(), 1);
    let lateness = fabric.lateness();
    assert_eq!((lateness.frames, lateness.max_us), (1, 500.0));
}

/// A ring of four switches with a host at each, and a server connected to two of them, which does not forward.
fn ring() -> Network {
    let network = Network::new().servers(&["a", "b", "c", "d", "e"]).switches(&["s1", "s2", "s3", "s4"]);
    network
        .link("a", "s1", delay(1))
        .link("b", "s2", delay(1))
        .link("c", "s3", delay(1))
        .link("d", "s4", delay(1))
        .link("s1", "s2", delay(2))
        .link("s2", "s3", delay(2))
        .link("s3", "s4", delay(2))
        .link("s4", "s1", delay(1))
        .link("e", "s1", clear())
        .link("e", "s3", clear())
}

#[test]
fn broadcast_reaches_every_other_host_once() {
    let multicast = [0x33, 0x33, 0, 0, 0, 1];
    let unknown = [0x02, 0x42, 0, 0, 0, 9];
    for destination in [BROADCAST, multicast, unknown] {
        for sender in (0..5).map(PortId) {
            let mut fabric = ring().fabric(1);
            fabric.push(Timestamp::ZERO, sender, frame_to(destination, sender, 3, 60));
            let out = run(&mut fabric, Timestamp::ZERO, Timestamp::MAX);
            let mut reached: Vec<_> = out.iter().map(|d| d.port.0).collect();
            reached.sort_unstable();
            let others: Vec<_> = (0..5).filter(|i| *i != sender.0).collect();
            assert_eq!(reached, others);
            assert_eq!(fabric.in_flight(), 0);
        }
    }
}

#[test]
fn unicast_takes_the_fastest_path_around_servers() {
    let mut fabric = ring().fabric(1);
    let (a, c) = (PortId(0), PortId(2));
    fabric.push(Timestamp::ZERO, a, frame(a, c, 1, 60));
    let out = run(&mut fabric, Timestamp::ZERO, Timestamp::MAX);
    // The path over `e` would take 2 ms, but servers do not forward.
    assert_eq!(out.iter().map(|d| (d.at, d.port)).collect::<Vec<_>>(), [(ms(5.0), c)]);
    let route = fabric.route(&"a".parse().unwrap(), &"c".parse().unwrap()).unwrap();
    assert_eq!(route, ["a-s1", "s4-s1", "s3-s4", "c-s3"]);
}

#[test]
fn a_changed_delay_reroutes_later_frames() {
    let mut fabric = ring().fabric(1);
    let (a, c) = (PortId(0), PortId(2));
    fabric.push(Timestamp::ZERO, a, frame(a, c, 1, 60));
    let slow = ConditionChange { delay_ms: Some(50.0), ..ConditionChange::default() };
    // By then, the first frame is on its way from s1 to s4 and continues from there.
    fabric.change(ms(1.5), &"s4-s1".parse().unwrap(), None, &slow).unwrap();
    fabric.push(ms(2.0), a, frame(a, c, 2, 60));
    let out = run(&mut fabric, ms(2.0), Timestamp::MAX);
    assert_eq!(
        out.iter().map(|d| (d.at, number(&d.frame))).collect::<Vec<_>>(),
        [(ms(5.0), 1), (ms(8.0), 2)]
    );
    let route = fabric.route(&"a".parse().unwrap(), &"c".parse().unwrap()).unwrap();
    assert_eq!(route, ["a-s1", "s1-s2", "s2-s3", "c-s3"]);
}

#[test]
fn hops_then_order_decide_between_equal_delays() {
    let network = Network::new().servers(&["a", "b"]).switches(&["s", "t", "u", "v"]);
    let fabric = network
        .link("a", "s", clear())
        .link("s", "t", clear())
        .link("t", "b", clear())
        .link("a", "u", clear())
        .link("u", "b", clear())
        .link("a", "v", clear())
        .link("v", "b", clear())
        .fabric(1);
    let route = fabric.route(&"a".parse().unwrap(), &"b".parse().unwrap()).unwrap();
    assert_eq!(route, ["a-u", "u-b"]);
}

#[test]
fn addresses_are_learnt_from_frames_and_follow_their_host() {
    let mut fabric = ring().fabric(1);
    for host in ["c", "d"] {
        fabric.disable_port_security(&host.parse().unwrap());
    }
    let container = [0x02, 0x42, 0xac, 0x11, 0, 2];
    let (a, c, d) = (PortId(0), PortId(2), PortId(3));
    let reached = |fabric: &mut cotorra_fabric::Fabric, now| {
        fabric.push(now, a, frame_to(container, a, 1, 60));
        run(fabric, now, now + std::time::Duration::from_secs(1)).iter().map(|d| d.port).collect::<Vec<_>>()
    };
    assert_eq!(reached(&mut fabric, ms(0.0)).len(), 4);
    for (i, host) in [c, d].into_iter().enumerate() {
        let now = ms(2000.0 * (i + 1) as f64);
        let mut hello = frame(host, a, 1, 60).into_bytes();
        hello[6..12].copy_from_slice(&container);
        fabric.push(now, host, cotorra_fabric::Frame::new(hello));
        assert_eq!(run(&mut fabric, now, now + std::time::Duration::from_millis(500)).len(), 1);
        assert_eq!(reached(&mut fabric, now + std::time::Duration::from_millis(500)), [host]);
    }
}

#[test]
fn no_host_takes_another_hosts_address() {
    let mut fabric = ring().fabric(1);
    fabric.disable_port_security(&"d".parse().unwrap());
    let (a, c, d) = (PortId(0), PortId(2), PortId(3));
    // d claims to be c.
    fabric.push(ms(0.0), d, frame(c, a, 1, 60));
    run(&mut fabric, ms(0.0), ms(100.0));
    fabric.push(ms(100.0), a, frame(a, c, 2, 60));
    let out = run(&mut fabric, ms(100.0), ms(200.0));
    assert_eq!(out.iter().map(|d| d.port).collect::<Vec<_>>(), [c]);
}

#[test]
fn frames_to_their_sender_or_without_a_header_are_dropped_and_counted() {
    let mut fabric = pair(clear(), 1);
    fabric.push(ms(0.0), A, frame(A, A, 1, 60));
    fabric.push(ms(0.0), A, cotorra_fabric::Frame::new(vec![0xff; 13]));
    fabric.push(ms(0.0), PortId(9), frame(A, B, 1, 60));
    assert!(run(&mut fabric, ms(0.0), ms(1.0)).is_empty());
    let drops = fabric.drops();
    assert_eq!((drops.malformed, drops.unroutable), (1, 2));
}
