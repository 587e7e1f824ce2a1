//! Robots that roam as wpa_supplicant decides.

use cotorra_graph::{BackgroundScan, Fading};

use super::*;

/// Returns the policy with scans every so many seconds, whatever the signal.
pub(super) fn every(seconds: u64) -> Roaming {
    let interval = Duration::from_secs(seconds);
    Roaming::Supplicant(BackgroundScan {
        short_interval: interval,
        long_interval: interval,
        ..Default::default()
    })
}

/// A network with so much noise that no signal more than a few metres from a radio unit is great.
fn noisy() -> WirelessNetwork {
    WirelessNetwork { noise_floor: Dbm(-80.0), ..network() }
}

/// Returns the times of a robot's scans, ms.
fn scans(events: &[Stamped]) -> Vec<u64> {
    let scans = events.iter().filter(|s| matches!(s.event, Event::Scanned { .. }));
    scans.map(|s| s.at.as_nanos() / 1_000_000).collect()
}

#[test]
fn a_supplicant_scans_in_the_background_and_stays_with_a_good_signal() {
    let mut world = corridor(network(), every(10));
    world.run(at(45_000));
    // Each scan takes 100 ms, and the interval runs from its end.
    assert_eq!(scans(&world.events()), [10_100, 20_200, 30_300, 40_400]);
    assert_eq!(world.attached("r"), Some(world.port("R1")));
    let mut world = corridor(network(), Roaming::Supplicant(BackgroundScan::default()));
    world.run(at(290_000));
    assert_eq!(scans(&world.events()), [0; 0]);
}

#[test]
fn a_supplicant_roams_to_what_a_scan_hears() {
    let mut world = corridor(noisy(), every(10));
    let events = walk(&mut world, 5.0, 28.0, at(0));
    // At 10 s the robot is at 15 m, where both are as strong. At 20 s it is at 25 m.
    let found = handovers(&events);
    assert_eq!(found.iter().map(|(_, to)| *to).collect::<Vec<_>>(), ["R2"], "{events:?}");
    assert_eq!(found[0].0, at(20_230), "a scan, and 30 ms to attach");
}

#[test]
fn a_supplicant_scans_at_once_where_the_signal_falls_below_the_threshold() {
    let roaming = Roaming::Supplicant(BackgroundScan { threshold: Dbm(-60.0), ..Default::default() });
    let mut world = corridor(noisy(), roaming);
    let events = walk(&mut world, 5.0, 28.0, at(0));
    // 20 dBm less 40.2 dB at the first metre and 30 dB a decade: -61.5 dBm at 24 m, 19 s on the way.
    let first = scans(&events)[0];
    assert!((18_500..19_500).contains(&first), "{first}");
    assert_eq!(handovers(&events).len(), 1);
}

#[test]
fn a_scan_on_request_counts_for_a_supplicant() {
    let mut world = corridor(noisy(), Roaming::Supplicant(BackgroundScan::default()));
    walk(&mut world, 5.0, 28.0, at(0));
    assert_eq!(world.attached("r"), Some(world.port("R1")));
    world.radio.scan(at(30_000), &id("r")).unwrap();
    world.run(at(31_000));
    assert_eq!(world.attached("r"), Some(world.port("R2")));
}

/// One supplicant at a distance from one radio unit.
fn far(metres: f64) -> World {
    World::new(network(), vec![robot("r", metres, every(3000)), unit("R1", 0.0, 1)])
}

#[test]
fn beacons_are_lost_at_the_error_rate_of_their_signal() {
    for metres in [200.0, 230.0, 240.0, 250.0, 300.0] {
        let mut world = far(5.0);
        world.radio.robots[0].position = Position::new(metres, 0.0);
        let received = (0..2000).filter(|_| world.radio.receive_beacon(at(0), 0, 0).is_some()).count();
        let rate = 1.0 - received as f64 / 2000.0;
        let expected = world.radio.receptions(0, 0, 0.0)[1].group_error_rate(212);
        assert!((rate - expected).abs() < 0.04, "{rate} of the beacons at {metres} m, not {expected}");
    }
}

#[test]
fn beacons_are_lost_in_fades() {
    let lost = |fading| {
        let nodes = vec![robot("r", 32.0, every(3000)), unit("R1", 0.0, 1)];
        let mut world = World::new(WirelessNetwork { fading, ..noisy() }, nodes);
        let beacons = (0..3000).map(|i| world.radio.receive_beacon(at(i * 102), 0, 0));
        beacons.filter(Option::is_none).count()
    };
    assert_eq!(lost(None), 0);
    // The mean SNR is 14.7 dB. A beacon needs about 3 dB: 1 - exp(-10^(-1.17)) of all moments are below.
    let share = lost(Some(Fading { k_factor_db: None, motion_mps: 5.0 })) as f64 / 3000.0;
    assert!((share - 0.065).abs() < 0.02, "{share}");
}

#[test]
fn a_beacon_has_the_signal_of_its_moment() {
    let signals = |fading| {
        let mut world = World::new(
            WirelessNetwork { fading, ..network() },
            vec![robot("r", 5.0, every(3000)), unit("R1", 0.0, 1)],
        );
        let [_, mean] = world.radio.signals(0, 0);
        let beacons = (0..3000).filter_map(|i| world.radio.receive_beacon(at(i * 102), 0, 0));
        beacons.map(|signal| 10f64.powf((signal.0 - mean.0) / 10.0)).collect::<Vec<_>>()
    };
    assert!(signals(None).iter().all(|gain| (gain - 1.0).abs() < 1e-9));
    // Near the radio unit none is lost, so that the mean power stays. Rayleigh fading halves it in 39 % of all moments.
    let faded = signals(Some(Fading { k_factor_db: None, motion_mps: 5.0 }));
    let mean = faded.iter().sum::<f64>() / faded.len() as f64;
    let deep = faded.iter().filter(|gain| **gain < 0.5).count() as f64 / faded.len() as f64;
    assert!((mean - 1.0).abs() < 0.1 && (deep - 0.39).abs() < 0.05, "{mean}, {deep}");
}

#[test]
fn a_probe_keeps_a_radio_unit_whose_beacons_are_lost() {
    let mut world = far(5.0);
    // Too weak to be heard in a scan, and most beacons are lost. Short null frames are not.
    world.radio.move_robot(at(50), &id("r"), Position::new(258.0, 0.0)).unwrap();
    assert!(world.radio.receptions(0, 0, 0.0)[1].group_error_rate(212) > 0.8);
    assert_eq!(world.radio.hears(0, 0), None);
    world.run(at(60_000));
    assert_eq!(world.attached("r"), Some(world.port("R1")));
    assert_eq!(world.events(), []);
}

#[test]
fn a_radio_unit_out_of_reach_is_lost_after_seven_beacons() {
    let mut world = far(5.0);
    world.radio.move_robot(at(1000), &id("r"), Position::new(9000.0, 0.0)).unwrap();
    world.run(at(5000));
    let lost = Event::Detached { robot: id("r"), from: id("R1") };
    assert_eq!(world.events()[0], Stamped { at: Timestamp::from_nanos(16 * 102_400_000), event: lost });
}

#[test]
fn a_standing_supplicant_searches_until_it_finds_a_radio_unit() {
    let mut world = corridor(network(), every(3000));
    for unit in ["R1", "R2"] {
        world.radio.switch_off(at(1000), &id(unit)).unwrap();
    }
    world.run(at(10_000));
    assert_eq!(world.attached("r"), None);
    world.radio.switch_on(at(10_000), &id("R2"), access_point(1, None)).unwrap();
    world.run(at(12_000));
    assert_eq!(world.attached("r"), Some(world.port("R2")));
}
