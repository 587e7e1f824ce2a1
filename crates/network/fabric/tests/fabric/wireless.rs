//! Robots on the fabric: frames over the air and between radio units.

use cotorra_fabric::{Checksum, Frame, GraphError, Offload, PortId, Segmentation, SegmentationKind};
use cotorra_graph::{Conditions, Event, HostAddress, Timestamp};

use crate::common::{Network, delay, frame, frame_to, ms, number, run};

/// Robots p and q near R1, r near R2, the server b behind a switch.
fn floor() -> Network {
    let network = Network::new().server("b").switches(&["s"]).radio_unit("R1", 0.0).radio_unit("R2", 100.0);
    network
        .robot("p", 2.0)
        .robot("q", 5.0)
        .robot("r", 95.0)
        .link("R1", "s", delay(3))
        .link("R2", "s", delay(4))
        .link("s", "b", Conditions::default())
}

const B: PortId = PortId(0);
const R1: PortId = PortId(1);
const P: PortId = PortId(3);
const Q: PortId = PortId(4);
const R: PortId = PortId(5);
/// The air's delay.
const AIR: f64 = 1.0;

#[test]
fn robots_reach_servers_and_each_other() {
    for (from, to, took) in [
        (P, B, AIR + 3.0),
        (B, P, AIR + 3.0),
        (P, Q, 2.0 * AIR),
        (P, R, 2.0 * AIR + 7.0),
        (P, R1, AIR),
        (R1, P, AIR),
        (R1, R, AIR + 7.0),
    ] {
        let mut fabric = floor().fabric(1);
        fabric.push(ms(0.0), from, frame(from, to, 1, 60));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        assert_eq!(out.iter().map(|d| d.port).collect::<Vec<_>>(), [to]);
        assert!((out[0].at.as_secs_f64() * 1e3 - took).abs() < 0.5, "{from:?} to {to:?}: {}", out[0].at);
    }
}

#[test]
fn broadcast_reaches_each_robot_once() {
    for sender in (0..6).map(PortId) {
        let mut fabric = floor().fabric(1);
        fabric.push(ms(0.0), sender, frame_to([0xff; 6], sender, 1, 60));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        let mut reached: Vec<_> = out.iter().map(|d| d.port.0).collect();
        reached.sort_unstable();
        assert_eq!(reached, (0..6).filter(|i| *i != sender.0).collect::<Vec<_>>());
    }
}

#[test]
fn frames_follow_a_robot_to_its_next_radio_unit() {
    let mut fabric = floor().fabric(1);
    let (p, r1, r2) = ("p".parse().unwrap(), "R1".parse().unwrap(), "R2".parse().unwrap());
    let b = "b".parse().unwrap();
    assert_eq!(fabric.attached_to(&p), Some(&r1));
    assert_eq!(fabric.route(&p, &b).unwrap(), ["p~R1", "R1-s", "s-b"]);
    assert_eq!(fabric.route(&"q".parse().unwrap(), &p).unwrap(), ["q~R1", "p~R1"]);
    fabric.move_robot(ms(0.0), &p, cotorra_graph::Position::new(50.0, 0.0)).unwrap();
    fabric.attach(ms(0.0), &p, &r2).unwrap();
    let mut out = Vec::new();
    for i in 0..100 {
        let now = ms(f64::from(i));
        fabric.push(now, B, frame(B, P, i, 60));
        out.extend(run(&mut fabric, now, now + std::time::Duration::from_nanos(999_999)));
    }
    out.extend(run(&mut fabric, ms(100.0), ms(1000.0)));
    assert!(matches!(fabric.next_event().unwrap().event, Event::Handover(_)));
    assert_eq!(fabric.attached_to(&p), Some(&r2));
    assert_eq!(fabric.route(&b, &p).unwrap(), ["s-b", "R2-s", "p~R2"]);
    // Frames are held in the gap. Those on their way to R1 at its end move on to R2 and are overtaken.
    let numbers: Vec<_> = out.iter().map(|d| number(&d.frame)).collect();
    let overtaken: Vec<_> = numbers.windows(2).filter(|pair| pair[1] < pair[0]).map(|pair| pair[1]).collect();
    assert_eq!(overtaken, [27, 28, 29]);
    assert!((0..100).all(|i| numbers.iter().filter(|n| **n == i).count() == 1));
}

#[test]
fn super_packets_are_cut_for_the_air() {
    let mut bytes = vec![0; 54 + 3000];
    bytes[..6].copy_from_slice(&HostAddress::of(P.0).mac);
    bytes[12..15].copy_from_slice(&[0x08, 0x00, 0x45]);
    bytes[16..18].copy_from_slice(&3040u16.to_be_bytes());
    bytes[23] = 6;
    bytes[46] = 0x50;
    let segmentation = Segmentation { kind: SegmentationKind::Tcp4, size: 1000, header_len: 54 };
    let checksum = Checksum { start: 34, offset: 16 };
    let offload = Offload { checksum: Some(checksum), segmentation: Some(segmentation) };
    for (from, to) in [(B, P), (P, B)] {
        bytes[..6].copy_from_slice(&HostAddress::of(to.0).mac);
        bytes[6..12].copy_from_slice(&HostAddress::of(from.0).mac);
        bytes[26..30].copy_from_slice(&HostAddress::of(from.0).ipv4.octets());
        let mut fabric = floor().fabric(1);
        fabric.push(ms(0.0), from, Frame::with_offload(bytes.clone(), offload));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        assert_eq!(out.iter().map(|d| d.frame.len()).collect::<Vec<_>>(), [1054; 3]);
    }
}

#[test]
fn wired_robots_are_rejected() {
    let graph = floor().link("p", "s", delay(1)).graph();
    let error = cotorra_fabric::Fabric::new(&graph, 1).unwrap_err();
    assert!(matches!(error, GraphError::WiredRobot { .. }), "{error}");
}

#[test]
fn robots_without_a_radio_unit_are_unreachable() {
    let mut fabric = Network::new().server("b").radio_unit("R1", 0.0).robot("p", 1e5).fabric(1);
    fabric.push(Timestamp::ZERO, PortId(0), frame(PortId(0), PortId(2), 1, 60));
    assert!(run(&mut fabric, Timestamp::ZERO, ms(100.0)).is_empty());
    assert_eq!(fabric.drops().unroutable, 1);
    assert_eq!(fabric.route(&"b".parse().unwrap(), &"p".parse().unwrap()), None);
}
