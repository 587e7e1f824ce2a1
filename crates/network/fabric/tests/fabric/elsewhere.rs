//! Robots that are with a radio unit of another core.

use cotorra_fabric::{Departure, Fabric, FabricError, PortId};
use cotorra_graph::{Conditions, Direction, Event, Handover, HostAddress, Position, Timestamp};

use crate::common::{Network, delay, frame, frame_to, ms, number, run};

/// The robot p near R1, the server b, and the border x, all behind a switch.
fn floor() -> Network {
    let network = Network::new().servers(&["b", "x"]).switches(&["s"]).radio_unit("R1", 0.0).robot("p", 2.0);
    network.link("R1", "s", delay(3)).link("x", "s", delay(5)).link("s", "b", Conditions::default())
}

const B: PortId = PortId(0);
const X: PortId = PortId(1);
const P: PortId = PortId(3);

/// A floor whose robot has departed.
fn departed() -> Fabric {
    let mut fabric = floor().fabric(1);
    let (p, x) = ("p".parse().unwrap(), "x".parse().unwrap());
    fabric.depart(ms(0.0), &p, 1, Some(&x)).unwrap();
    fabric
}

fn departures(fabric: &mut Fabric) -> Vec<(Direction, u32)> {
    let all = std::iter::from_fn(|| fabric.next_departure());
    all.map(|one| (one.direction, number(&cotorra_fabric::Frame::new(one.bytes)))).collect()
}

/// A packet of IPv4.
fn arrival(direction: Direction, from: PortId, to: PortId) -> Departure {
    let mut bytes = frame(from, to, 7, 60).into_bytes();
    bytes[12..14].copy_from_slice(&[0x08, 0x00]);
    bytes[26..30].copy_from_slice(&HostAddress::of(from.0).ipv4.octets());
    Departure { robot: "p".parse().unwrap(), direction, bytes }
}

/// The same with other bytes at a place.
fn changed(at: usize, bytes: &[u8]) -> Departure {
    let mut arrival = arrival(Direction::Forward, P, B);
    arrival.bytes[at..at + bytes.len()].copy_from_slice(bytes);
    arrival
}

/// A neighbour advertisement of IPv6 of host `from`, for `target`.
fn advertisement(from: PortId, target: PortId) -> Departure {
    let [from, of] = [from, target].map(|port| HostAddress::of(port.0));
    let header = [&[0x86, 0xdd, 0x60, 0, 0, 0, 0, 32, 58, 255][..], &from.ipv6.octets(), &of.ipv6.octets()];
    let message = [&[136, 0, 0, 0, 0, 0, 0, 0][..], &of.ipv6.octets(), &[2, 1], &from.mac].concat();
    let bytes = [&[0xff; 6][..], &from.mac, &header.concat(), &message].concat();
    Departure { robot: "p".parse().unwrap(), direction: Direction::Forward, bytes }
}

#[test]
fn frames_of_and_to_a_departed_robot_leave_at_its_radio_and_at_the_border() {
    let mut fabric = departed();
    fabric.push(ms(0.0), P, frame(P, B, 1, 60));
    assert_eq!(departures(&mut fabric), [(Direction::Forward, 1)]);
    fabric.push(ms(0.0), B, frame(B, P, 2, 60));
    assert_eq!(run(&mut fabric, ms(0.0), ms(4.9)), []);
    assert_eq!(departures(&mut fabric), [], "it is on the link to the border");
    assert_eq!(run(&mut fabric, ms(5.0), ms(10.0)), []);
    assert_eq!(departures(&mut fabric), [(Direction::Backward, 2)]);
    fabric.push(ms(20.0), B, frame_to([0xff; 6], B, 3, 60));
    assert!(run(&mut fabric, ms(20.0), ms(40.0)).iter().all(|delivery| delivery.port != P));
    assert_eq!(departures(&mut fabric), [(Direction::Backward, 3)]);
    assert!(fabric.balance().stranded == 0 && fabric.drops().unroutable == 0);
}

#[test]
fn frames_of_a_departed_robot_arrive_at_the_border_and_those_to_it_at_the_robot() {
    let mut fabric = departed();
    fabric.arrive(ms(0.0), arrival(Direction::Forward, P, B));
    let out = run(&mut fabric, ms(0.0), ms(10.0));
    assert_eq!(out.iter().map(|d| (d.at, d.port)).collect::<Vec<_>>(), [(ms(5.0), B)]);
    fabric.arrive(ms(20.0), arrival(Direction::Backward, B, P));
    let out = run(&mut fabric, ms(20.0), ms(30.0));
    assert_eq!(out.iter().map(|d| (d.at, d.port)).collect::<Vec<_>>(), [(ms(20.0), P)]);
    fabric.arrive(ms(40.0), arrival(Direction::Forward, P, X));
    let out = run(&mut fabric, ms(40.0), ms(50.0));
    assert_eq!(out.iter().map(|d| (d.at, d.port)).collect::<Vec<_>>(), [(ms(40.0), X)]);
}

#[test]
fn another_core_speaks_only_for_a_robot_that_is_with_it() {
    let forged = [
        arrival(Direction::Forward, B, X),
        arrival(Direction::Backward, P, B),
        Departure { bytes: vec![0; 3], ..arrival(Direction::Forward, P, B) },
        // Of other protocols than hosts speak, and of IPv4, IPv6 and ARP in the name of another host.
        changed(12, &[0x88, 0xb5]),
        changed(26, &HostAddress::of(X.0).ipv4.octets()),
        changed(12, &[0x86, 0xdd]),
        changed(12, &[0x08, 0x06]),
        advertisement(P, B),
        Departure { robot: "R1".parse().unwrap(), ..arrival(Direction::Forward, P, B) },
        Departure { robot: "nobody".parse().unwrap(), ..arrival(Direction::Forward, P, B) },
    ];
    for forged in forged {
        let mut fabric = departed();
        fabric.arrive(ms(0.0), forged);
        assert_eq!(run(&mut fabric, ms(0.0), ms(50.0)), []);
        assert_eq!(fabric.drops().unroutable, 1);
    }
    let own = HostAddress::of(P.0);
    let arp = [&[0x08, 0x06, 0, 1, 8, 0, 6, 4, 0, 1][..], &own.mac, &own.ipv4.octets()].concat();
    let mut fabric = departed();
    fabric.arrive(ms(0.0), changed(12, &arp));
    assert_eq!(run(&mut fabric, ms(0.0), ms(50.0)).len(), 1);
    fabric.arrive(ms(50.0), advertisement(P, P));
    assert!(!run(&mut fabric, ms(50.0), ms(100.0)).is_empty());
    let mut at_home = floor().fabric(1);
    at_home.arrive(ms(0.0), arrival(Direction::Forward, P, B));
    assert_eq!(run(&mut at_home, ms(0.0), ms(50.0)), []);
}

#[test]
fn a_departed_robot_is_silent_until_it_attaches_by_fast_transition() {
    let mut fabric = departed();
    let (p, r1) = ("p".parse().unwrap(), "R1".parse().unwrap());
    assert_eq!(fabric.attached_to(&p), None);
    assert_eq!(fabric.scan(ms(1.0), &p), Err(FabricError::Elsewhere("p".parse().unwrap())));
    fabric.move_robot(ms(1.0), &p, Position::new(3.0, 0.0)).unwrap();
    run(&mut fabric, ms(1.0), ms(5000.0));
    assert_eq!(fabric.next_event(), None, "it does not look for radio units of this graph");
    assert!(fabric.reach(&p, &r1).unwrap().is_some());

    fabric.attach(ms(6000.0), &p, &r1).unwrap();
    fabric.push(ms(6000.0), P, frame(P, B, 4, 60));
    fabric.push(ms(6000.0), B, frame(B, P, 5, 60));
    let out = run(&mut fabric, ms(6000.0), ms(7000.0));
    let mut numbers: Vec<_> = out.iter().map(|delivery| number(&delivery.frame)).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, [4, 5], "they wait for the radio unit");
    assert_eq!(departures(&mut fabric), []);
    let Event::Handover(Handover { from, to, fast, gap, .. }) = fabric.next_event().unwrap().event else {
        panic!("another event")
    };
    assert_eq!((from, to, fast, gap.as_millis()), (None, r1, true, 30));
}

#[test]
fn a_robot_of_another_mobility_domain_does_the_handshakes() {
    let mut fabric = floor().fabric(1);
    let (p, r1) = ("p".parse().unwrap(), "R1".parse().unwrap());
    fabric.depart(ms(0.0), &p, 2, None).unwrap();
    fabric.push(ms(0.0), P, frame(P, B, 1, 60));
    assert_eq!((departures(&mut fabric), run(&mut fabric, ms(0.0), ms(50.0))), (vec![], vec![]));
    fabric.attach(ms(50.0), &p, &r1).unwrap();
    run(&mut fabric, ms(50.0), ms(500.0));
    let event = fabric.next_event().unwrap().event;
    assert!(matches!(event, Event::Handover(Handover { fast: false, .. })), "{event:?}");
}

#[test]
fn a_robot_that_lost_the_other_core_scans_for_a_radio_unit() {
    let mut fabric = departed();
    let p = "p".parse().unwrap();
    fabric.come_back(ms(10.0), &p).unwrap();
    assert!(fabric.come_back(ms(10.0), &p).is_err());
    run(&mut fabric, ms(10.0), ms(1000.0));
    assert_eq!(fabric.attached_to(&p), Some(&"R1".parse().unwrap()));
    fabric.push(ms(1000.0), P, frame(P, B, 1, 60));
    assert_eq!(run(&mut fabric, ms(1000.0), ms(1100.0)).len(), 1);
}

#[test]
fn robots_that_are_busy_or_unknown_do_not_depart() {
    let mut fabric = floor().fabric(1);
    let p = "p".parse().unwrap();
    let x = "x".parse().unwrap();
    let nobody = "nobody".parse().unwrap();
    assert!(fabric.depart(Timestamp::ZERO, &nobody, 1, Some(&x)).is_err());
    assert!(fabric.depart(Timestamp::ZERO, &p, 1, Some(&nobody)).is_err());
    fabric.scan(Timestamp::ZERO, &p).unwrap();
    assert!(matches!(fabric.depart(Timestamp::ZERO, &p, 1, Some(&x)), Err(FabricError::Busy(_))));
    run(&mut fabric, Timestamp::ZERO, ms(1000.0));
    assert!(fabric.attached_to(&p).is_some());
}
