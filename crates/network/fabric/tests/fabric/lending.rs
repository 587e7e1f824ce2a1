//! Packets of robots whose antennas are lent.

use std::{sync::mpsc::channel, time::Duration};

use cotorra_fabric::{
    Antenna, Association, Category, Datagrams, Fabric, FabricError, Followed, PhyRate, PortId, RateTries,
    Receiver, RoundTrip, Transmission, Trip,
};
use cotorra_graph::{AccessPoint, Conditions, Event, Handover, NodeId, Position, Stamped};
use cotorra_graph_testing as base;

use crate::{
    common::{Network, frame, frame_to, ms, number, run},
    following::datagram,
};

const B: PortId = PortId(0);
const R1: PortId = PortId(1);
const R2: PortId = PortId(2);
const P: PortId = PortId(3);

fn id(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// The server b, and the radio units R1 and R2 behind a switch, with the robot p; all antennas are lent.
fn lent() -> Fabric {
    lent_but(&[])
}

/// The same, but for these antennas.
fn lent_but(own: &[&str]) -> Fabric {
    let network = Network::new().server("b").switches(&["s"]).radio_unit("R1", 0.0).radio_unit("R2", 9.0);
    let network = ["R1", "R2", "b"]
        .iter()
        .fold(network.robot("p", 2.0), |network, end| network.link(end, "s", Conditions::default()));
    let mut graph = network.graph();
    graph.wireless.get_mut("air").unwrap().access = base::edca().into();
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    for node in ["p", "R1", "R2"].into_iter().filter(|node| !own.contains(node)) {
        fabric.lend_antenna(ms(0.0), &node.parse().unwrap()).unwrap();
    }
    fabric
}

/// Returns which ports get a frame from b to p.
fn reached(fabric: &mut Fabric, now: f64) -> Vec<PortId> {
    fabric.push(ms(now), B, frame(B, P, 1, 100));
    let mut ports: Vec<_> = run(fabric, ms(now), ms(now + 50.0)).into_iter().map(|d| d.port).collect();
    ports.sort_unstable();
    ports
}

#[test]
fn packets_to_a_robot_go_where_its_packets_came_from_last() {
    let mut fabric = lent();
    assert_eq!(reached(&mut fabric, 0.0), [], "nobody knows where it is");
    assert_eq!(fabric.drops().unroutable, 1);
    for (at, unit) in [(100.0, R1), (200.0, R2)] {
        // A bridge brings its packet from the radio.
        fabric.push(ms(at), unit, frame(P, B, 7, 100));
        let out = run(&mut fabric, ms(at), ms(at + 50.0));
        assert_eq!(out.iter().map(|d| (d.port, number(&d.frame))).collect::<Vec<_>>(), [(B, 7)]);
        assert_eq!(reached(&mut fabric, at + 50.0), [unit]);
    }
    let balance = fabric.balance();
    assert_eq!((balance.sent, balance.delivered, balance.stranded), (5, 4, 1));
}

#[test]
fn packets_to_a_robot_go_to_the_radio_unit_that_it_is_associated_with() {
    let mut fabric = lent();
    let [r1, r2, p] = ["R1", "R2", "p"].map(id);
    for (at, name, port) in [(0.0, &r1, R1), (100.0, &r2, R2), (200.0, &r1, R1)] {
        fabric.associate(ms(at), &p, name, Association { began: ms(at), fast: true }).unwrap();
        assert_eq!(reached(&mut fabric, at), [port]);
    }
    fabric.disassociate(ms(300.0), &p).unwrap();
    assert_eq!(reached(&mut fabric, 300.0), []);
}

#[test]
fn an_associated_robot_counts_as_attached() {
    let mut fabric = lent();
    let [r1, r2, p] = ["R1", "R2", "p"].map(id);
    let stations = |fabric: &Fabric, unit: usize| {
        let stations = &fabric.radio_contexts(ms(0.0))[unit].stations;
        stations.iter().map(|station| station.robot.clone()).collect::<Vec<_>>()
    };
    assert_eq!(fabric.attached_to(&p), None);
    assert_eq!(fabric.next_event(), None);
    fabric.associate(ms(10.0), &p, &r1, Association { began: ms(7.0), fast: false }).unwrap();
    assert_eq!(fabric.attached_to(&p), Some(&r1));
    assert_eq!(fabric.route(&p, &id("b")).unwrap(), ["p~R1", "R1-s", "b-s"]);
    assert_eq!((stations(&fabric, 0), stations(&fabric, 1)), (vec![p.clone()], vec![]));
    // Again, which is nothing new.
    fabric.associate(ms(11.0), &p, &r1, Association { began: ms(7.0), fast: false }).unwrap();
    fabric.associate(ms(60.0), &p, &r2, Association { began: ms(20.0), fast: true }).unwrap();
    assert_eq!((stations(&fabric, 0), stations(&fabric, 1)), (vec![], vec![p.clone()]));
    fabric.disassociate(ms(70.0), &p).unwrap();
    fabric.disassociate(ms(71.0), &p).unwrap();
    assert_eq!((fabric.attached_to(&p), stations(&fabric, 1)), (None, vec![]));
    fabric.scanned(ms(80.0), &p).unwrap();
    let handover = |from: Option<&NodeId>, to: &NodeId, fast, gap_ms| {
        let gap = Duration::from_millis(gap_ms);
        Event::Handover(Handover { robot: p.clone(), from: from.cloned(), to: to.clone(), fast, gap })
    };
    let expected = [
        (ms(10.0), handover(None, &r1, false, 3)),
        (ms(60.0), handover(Some(&r1), &r2, true, 40)),
        (ms(70.0), Event::Detached { robot: p.clone(), from: r2.clone() }),
        (ms(80.0), Event::Scanned { robot: p.clone() }),
    ];
    let events = std::iter::from_fn(|| fabric.next_event()).map(|Stamped { at, event }| (at, event));
    assert_eq!(events.collect::<Vec<_>>(), expected);
}

#[test]
fn a_robots_signals_are_those_of_its_radio_unit_now_and_of_others_at_its_last_scan() {
    let mut fabric = lent();
    let [r1, p] = ["R1", "p"].map(id);
    let signals = |fabric: &Fabric| {
        let attachments = fabric.attachments(ms(40.0), &p);
        attachments.iter().map(|to| (to.attached, to.signal.map(|dbm| dbm.0))).collect::<Vec<_>>()
    };
    fabric.associate(ms(0.0), &p, &r1, Association { began: ms(0.0), fast: false }).unwrap();
    let before = signals(&fabric);
    fabric.move_robot(ms(10.0), &p, Position::new(8.0, 0.0)).unwrap();
    let moved = signals(&fabric);
    assert_eq!((before[0].0, moved[0].0, moved[1].0), (true, true, false));
    assert!(moved[0].1 < before[0].1, "{before:?} and {moved:?}");
    assert_eq!([before[1].1, moved[1].1], [None, None], "it has not scanned");
    fabric.scanned(ms(20.0), &p).unwrap();
    let scanned = signals(&fabric);
    assert!(scanned[0].1 == moved[0].1 && scanned[1].1.is_some(), "{moved:?} and {scanned:?}");
    // A radio unit that is off is not heard.
    fabric.switch_off(ms(30.0), &id("R2")).unwrap();
    fabric.scanned(ms(30.0), &p).unwrap();
    assert_eq!(signals(&fabric)[1], (false, None));
}

#[test]
fn robots_lose_a_radio_unit_that_is_switched_off() {
    let mut fabric = lent();
    let [r1, p] = ["R1", "p"].map(id);
    fabric.associate(ms(0.0), &p, &r1, Association { began: ms(0.0), fast: false }).unwrap();
    fabric.next_event().unwrap();
    fabric.switch_off(ms(10.0), &r1).unwrap();
    assert_eq!(fabric.next_event().unwrap().event, Event::Detached { robot: p.clone(), from: r1.clone() });
    assert_eq!(fabric.attached_to(&p), None);
    assert_eq!(reached(&mut fabric, 10.0), []);
    let vap = AccessPoint { ssid: "air".to_owned(), mobility_domain: 1, key: None, core: None };
    fabric.switch_on(ms(70.0), &r1, vap).unwrap();
    assert_eq!(fabric.attached_to(&p), None, "its own software decides");
}

#[test]
fn group_packets_cross_each_port_once() {
    let everywhere = |fabric: &mut Fabric, at: PortId, from: PortId| {
        fabric.push(ms(100.0), at, frame_to([0xff; 6], from, 1, 100));
        let out = run(fabric, ms(100.0), ms(200.0));
        let mut ports: Vec<_> = out.iter().map(|d| d.port).collect();
        ports.sort_unstable();
        ports
    };
    let mut fabric = lent();
    fabric.associate(ms(0.0), &id("p"), &id("R1"), Association { began: ms(0.0), fast: false }).unwrap();
    assert_eq!(everywhere(&mut fabric, B, B), [R1, R2]);
    assert_eq!(everywhere(&mut fabric, R1, P), [B, R2], "its own radio unit has it");
    assert_eq!(everywhere(&mut fabric, R1, R1), [B, R2]);
}

#[test]
fn packets_do_not_leave_at_the_port_that_they_came_to() {
    let mut fabric = lent();
    fabric.associate(ms(0.0), &id("p"), &id("R1"), Association { began: ms(0.0), fast: false }).unwrap();
    fabric.push(ms(0.0), R1, frame(R1, P, 1, 100));
    assert_eq!(run(&mut fabric, ms(0.0), ms(50.0)), []);
    fabric.push(ms(50.0), R2, frame(R2, P, 2, 100));
    let out = run(&mut fabric, ms(50.0), ms(100.0));
    assert_eq!(out.iter().map(|d| (d.port, number(&d.frame))).collect::<Vec<_>>(), [(R1, 2)]);
}

#[test]
fn a_robots_round_trips_are_measured_at_its_radio_units_port() {
    let mut fabric = lent();
    fabric.associate(ms(0.0), &id("p"), &id("R1"), Association { began: ms(0.0), fast: false }).unwrap();
    let (sender, trips) = channel();
    let followed = Datagrams { from: id("p"), port: 7711, id_at: 0 };
    fabric.follow(
        &[followed],
        Box::new(move |followed| {
            if let Followed::RoundTrip(trip) = followed {
                sender.send(trip).unwrap();
            }
        }),
    );
    fabric.push(ms(1.0), R1, datagram((P, 40_000), (B, 7711), 5));
    run(&mut fabric, ms(1.0), ms(10.0));
    fabric.push(ms(10.0), B, datagram((B, 7711), (P, 40_000), 5));
    run(&mut fabric, ms(10.0), ms(20.0));
    let RoundTrip { from, id, out, back } = trips.try_recv().unwrap();
    let links = |trip: &Trip| trip.links.iter().map(|on| on.link.to_string()).collect::<Vec<_>>();
    assert_eq!((from.as_str(), id, out.entered, back.entered), ("p", 5, ms(1.0), ms(10.0)));
    assert_eq!(
        (links(&out), links(&back)),
        (vec!["R1-s".into(), "b-s".into()], vec!["b-s".into(), "R1-s".into()])
    );
}

#[test]
fn only_lent_antennas_are_associated() {
    let mut fabric = lent_but(&["R2"]);
    let [r1, r2, p, x] = ["R1", "R2", "p", "x"].map(id);
    let as_if = Association { began: ms(0.0), fast: false };
    assert_eq!(fabric.associate(ms(0.0), &p, &r2, as_if), Err(FabricError::NotLent(r2.clone())));
    assert_eq!(fabric.associate(ms(0.0), &x, &r1, as_if), Err(FabricError::UnknownRobot(x.clone())));
    assert_eq!(fabric.associate(ms(0.0), &p, &x, as_if), Err(FabricError::UnknownRadioUnit(x)));
    assert_eq!(reached(&mut fabric, 0.0), []);
    let mut fabric = lent_but(&["p"]);
    assert_eq!(fabric.associate(ms(0.0), &p, &r1, as_if), Err(FabricError::NotLent(p.clone())));
    assert_eq!(fabric.disassociate(ms(0.0), &p), Err(FabricError::NotLent(p.clone())));
    assert_eq!(fabric.scanned(ms(0.0), &p), Err(FabricError::NotLent(p.clone())));
    assert_eq!(fabric.attach(ms(0.0), &p, &r1), Err(FabricError::Lent(r1)));
    assert_eq!(fabric.attached_to(&p), None, "its radio unit is gone, and no other is the fabric's");
}

#[test]
fn the_fabrics_own_radios_there_are_silent() {
    let mut fabric = lent();
    fabric.push(ms(0.0), P, frame(P, B, 1, 100));
    fabric.push(ms(0.0), R1, frame(R1, B, 2, 100));
    let out = run(&mut fabric, ms(0.0), ms(5000.0));
    assert_eq!(out.iter().map(|d| (d.port, number(&d.frame))).collect::<Vec<_>>(), [(B, 2)]);
    let p = "p".parse().unwrap();
    assert_eq!(fabric.lend_antenna(ms(5000.0), &p), Err(FabricError::Lent(p)));
    assert_eq!(fabric.next_report(), None);
}

#[test]
fn frames_that_are_reported_late_count_as_late() {
    let mut fabric = lent_but(&["p", "R1", "R2"]);
    let antennas = ["p", "R1"].map(|node| fabric.lend_antenna(ms(0.0), &id(node)).unwrap());
    let rate = RateTries { rate: PhyRate::legacy(10, false).unwrap(), tries: 1, rts: false };
    for (number, from) in antennas.into_iter().enumerate() {
        let transmission = Transmission {
            id: number as u64,
            frequency_mhz: 2412,
            psdu_bytes: 100,
            category: Category::BestEffort,
            to: Receiver::All,
            packet_bytes: None,
            aggregates: false,
            rates: vec![rate],
        };
        fabric.transmit(ms(5.0 * number as f64), from, transmission);
    }
    fabric.poll(ms(30.0), &mut |_, _| {});
    assert_eq!(fabric.lateness().frames, 0);
    while fabric.next_report().is_some() {}
    // The other one hears each. The first ended at 1 ms, and the second at 6 ms.
    let lateness = fabric.lateness();
    assert_eq!(lateness.frames, 2);
    assert!((23_000.0..26_000.0).contains(&lateness.p50_us), "{lateness:?}");
}

#[test]
fn rates_of_a_station_are_those_that_its_radio_and_the_radio_units_chose() {
    let mut fabric = lent_but(&["p", "R1"]);
    let [p, r1] = ["p", "R1"].map(id);
    let [station, unit] = [&p, &r1].map(|node| fabric.lend_antenna(ms(0.0), node).unwrap());
    fabric.associate(ms(0.0), &p, &r1, Association { began: ms(0.0), fast: false }).unwrap();
    let rates = |fabric: &Fabric, at: f64| {
        let contexts = fabric.radio_contexts(ms(at));
        let station = &contexts.iter().find(|context| context.radio_unit == r1).unwrap().stations[0];
        (station.downlink_bps / 1e6, station.uplink_bps / 1e6)
    };
    let send = |fabric: &mut Fabric, at: f64, [from, to]: [Antenna; 2], packet_bytes, mbps: u16| {
        let rate = PhyRate::legacy(10 * mbps, false).unwrap();
        let rates = vec![RateTries { rate, tries: 7, rts: false }];
        let (to, frequency_mhz) = (Receiver::One(to), 2412);
        let transmission = Transmission {
            id: at as u64,
            frequency_mhz,
            psdu_bytes: 136,
            category: Category::BestEffort,
            to,
            packet_bytes,
            aggregates: false,
            rates,
        };
        fabric.transmit(ms(at), from, transmission);
        // Reports that are not taken stay due.
        fabric.poll(ms(at + 50.0), &mut |_, _| {});
        while fabric.next_report().is_some() {}
    };
    let modelled = rates(&fabric, 0.0);
    // The station has sent nothing, so no other knows that it listens.
    send(&mut fabric, 100.0, [unit, station], Some(100), 12);
    assert_eq!(rates(&fabric, 150.0), modelled);
    send(&mut fabric, 200.0, [station, unit], Some(100), 24);
    send(&mut fabric, 300.0, [unit, station], Some(100), 48);
    assert_eq!(rates(&fabric, 350.0), (48.0, 24.0));
    // Management frames have other rates than packets.
    send(&mut fabric, 400.0, [unit, station], None, 1);
    assert_eq!(rates(&fabric, 450.0), (48.0, 24.0));
}
