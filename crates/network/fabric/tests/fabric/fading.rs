//! Fading of single frames on the air.

use std::time::Duration;

use cotorra_fabric::{Fabric, PortId};
use cotorra_graph::{Access, Edca, Fading, HardwareGraph, NodeId, Position, RateControl, Timestamp};
use cotorra_graph_testing as base;

use crate::common::{Delivery, Network, frame, frame_to, ms, run};

const R1: PortId = PortId(0);
const P: PortId = PortId(1);
const RAYLEIGH: Option<Fading> = Some(Fading { k_factor_db: None, motion_mps: 0.0 });

/// The radio unit R1, and the robot p so many metres to the east, on air without a delay of its own.
fn floor(fading: Option<Fading>, metres: f64) -> HardwareGraph {
    let mut graph = Network::new().radio_unit("R1", 0.0).robot("p", metres).graph();
    let air = graph.wireless.get_mut("air").unwrap();
    air.delay = Duration::ZERO;
    air.fading = fading;
    graph
}

/// Returns contention of stations that never sleep.
fn contention(aggregation: bool, rate_control: RateControl) -> Access {
    Edca { aggregation, rate_control, ..base::edca() }.into()
}

fn id(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// Sends a frame, and returns its time on the air, µs; `None` if it is lost.
fn airtime(fabric: &mut Fabric, now: Timestamp, from: PortId, to: PortId) -> Option<u64> {
    fabric.push(now, from, frame(from, to, 1, 1000));
    let out = run(fabric, now, now + Duration::from_millis(900));
    out.first().map(|delivery| (delivery.at.as_nanos() - now.as_nanos()) / 1000)
}

/// Sends a frame to the robot and one from it every 20 ms, while it drives for 2 s.
fn drive(fading: Option<Fading>, access: &Access) -> Vec<Delivery> {
    let mut graph = floor(fading, 50.0);
    graph.wireless.get_mut("air").unwrap().access = access.clone();
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    let mut out = Vec::new();
    for i in 0..100 {
        let now = ms(f64::from(i) * 20.0);
        fabric.move_robot(now, &id("p"), Position::new(50.0 + f64::from(i) * 0.01, 0.0)).unwrap();
        fabric.push(now, R1, frame(R1, P, i, 1000));
        fabric.push(now, P, frame(P, R1, i, 1000));
        out.extend(run(&mut fabric, now, now + Duration::from_nanos(19_999_999)));
    }
    out
}

#[test]
fn an_overwhelming_line_of_sight_is_no_fading() {
    for access in [Access::Turns, contention(true, RateControl::Ideal)] {
        let without = drive(None, &access);
        assert_eq!(without.len(), 200);
        assert_eq!(drive(Some(Fading { k_factor_db: Some(200.0), motion_mps: 1.0 }), &access), without);
        assert_ne!(drive(RAYLEIGH, &access), without);
    }
}

#[test]
fn a_run_with_fading_repeats_by_its_seed() {
    let fading = Some(Fading { k_factor_db: Some(3.0), motion_mps: 0.5 });
    assert_eq!(drive(fading, &Access::Turns), drive(fading, &Access::Turns));
}

#[test]
fn reports_and_decisions_have_the_mean_signal() {
    let mut open = Fabric::new(&floor(None, 20.0), 1).unwrap();
    let mut faded = Fabric::new(&floor(RAYLEIGH, 20.0), 1).unwrap();
    for x in 0..50 {
        let place = Position::new(20.0 + f64::from(x) * 0.37, 3.0);
        for fabric in [&mut open, &mut faded] {
            fabric.move_robot(ms(0.0), &id("p"), place).unwrap();
        }
        assert_eq!(open.reach(&id("p"), &id("R1")).unwrap(), faded.reach(&id("p"), &id("R1")).unwrap());
        assert_eq!(open.attachments(ms(0.0), &id("p")), faded.attachments(ms(0.0), &id("p")));
        assert_eq!(open.radio_contexts(ms(0.0)), faded.radio_contexts(ms(0.0)));
    }
}

#[test]
fn both_directions_fade_alike() {
    let mut fabric = Fabric::new(&floor(RAYLEIGH, 50.0), 7).unwrap();
    let mut alike = 0;
    let mut airtimes = std::collections::BTreeSet::new();
    for x in 0..60 {
        let now = Timestamp::from_secs_f64(f64::from(2 * x));
        fabric.move_robot(now, &id("p"), Position::new(50.0 + f64::from(x) * 0.2, 0.0)).unwrap();
        let up = airtime(&mut fabric, now, P, R1);
        let down = airtime(&mut fabric, now + Duration::from_secs(1), R1, P);
        // A frame that is lost at the first attempt takes longer.
        alike += i32::from(up == down);
        airtimes.extend(up);
    }
    assert!(alike > 50, "{alike} of 60 frames take as long in both directions");
    assert!(airtimes.len() > 5, "frames take {airtimes:?} µs");
}

#[test]
fn only_motion_changes_the_signal_of_a_standing_robot() {
    let airtimes = |motion_mps| {
        let fading = Some(Fading { k_factor_db: None, motion_mps });
        let mut fabric = Fabric::new(&floor(fading, 60.0), 3).unwrap();
        let at = |i| airtime(&mut fabric, Timestamp::from_secs_f64(f64::from(i)), R1, P);
        (0..40).map(at).collect::<Vec<_>>()
    };
    // The share of frames with the most frequent airtime. Retries are rare.
    let usual = |airtimes: &[Option<u64>]| {
        let like = |one| airtimes.iter().filter(|other| *other == one).count();
        airtimes.iter().map(like).max()
    };
    let [still, moving] = [0.0, 0.3].map(airtimes);
    assert!(usual(&still) > Some(35), "{still:?}");
    assert!(usual(&moving) < Some(30), "{moving:?}");
}

/// Returns the share of group frames that are lost at 100 m, with or without contention.
fn lost(k_factor_db: Option<f64>, access: &Access) -> f64 {
    let mut graph = floor(Some(Fading { k_factor_db, motion_mps: 5.0 }), 100.0);
    graph.wireless.get_mut("air").unwrap().access = access.clone();
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    let mut received = 0;
    for i in 0..4000 {
        let now = ms(f64::from(i) * 20.0);
        fabric.push(now, R1, frame_to([0xff; 6], R1, i, 1000));
        received += run(&mut fabric, now, now + Duration::from_nanos(19_999_999)).len();
    }
    1.0 - received as f64 / 4000.0
}

#[test]
fn group_frames_are_lost_in_deep_fades() {
    // At 100 m the mean SNR is 15 dB. The slowest rate needs 3.3 to 3.9 dB, which is 11.1 to 11.7 dB less. A share of
    // 1 - exp(-10^(-1.17)) to 1 - exp(-10^(-1.11)) of Rayleigh fading is below, and 1 % of Rician fading with 6 dB.
    for access in [Access::Turns, contention(false, RateControl::Ideal)] {
        let [rayleigh, rician, none] =
            [None, Some(6.0), Some(100.0)].map(|k_factor_db| lost(k_factor_db, &access));
        assert!((0.055..0.085).contains(&rayleigh), "{rayleigh}");
        assert!((0.003..0.02).contains(&rician), "{rician}");
        assert_eq!(none, 0.0);
    }
}

/// Returns the frames of 1000 bytes that a robot with a mean SNR of 24 dB gets in 2 s, on a channel that is always busy.
fn carried(fading: Option<Fading>, rate_control: RateControl) -> usize {
    let mut graph = floor(fading, 50.0);
    graph.wireless.get_mut("air").unwrap().access = contention(false, rate_control);
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    let mut received = 0;
    for i in 0..200 {
        let now = ms(f64::from(i) * 10.0);
        (0..40).for_each(|_| fabric.push(now, R1, frame(R1, P, i, 1000)));
        received += run(&mut fabric, now, now + Duration::from_nanos(9_999_999)).len();
    }
    received
}

#[test]
fn learned_rates_lag_behind_fading() {
    let share = |fading| {
        let [ideal, learned] =
            [RateControl::Ideal, RateControl::Minstrel].map(|control| carried(fading, control) as f64);
        learned / ideal
    };
    let [still, slow, walking] = [None, Some(0.05), Some(0.5)]
        .map(|speed| share(speed.map(|motion_mps| Fading { k_factor_db: None, motion_mps })));
    assert!(still > 0.95, "{still} of the ideal throughput without fading");
    assert!((0.75..0.95).contains(&slow), "{slow} of it at 0.05 m/s");
    assert!((0.55..0.80).contains(&walking), "{walking} of it at 0.5 m/s");
}
