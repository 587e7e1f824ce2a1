//! Handovers as frames on the air.

use cotorra_graph::Frames;

use super::*;

fn us(us: u64) -> Duration {
    Duration::from_micros(us)
}

fn by_frames(fast_transition: bool) -> WirelessNetwork {
    let frames = Some(Frames { tick: ms(4) });
    WirelessNetwork {
        access: Edca { aggregation: true, rate_control: RateControl::Minstrel, ..base::edca() }.into(),
        fast_transition,
        handover: HandoverTimes { frames, ..network().handover },
        ..network()
    }
}

fn handovers(world: &mut World) -> Vec<(Timestamp, Handover)> {
    let handovers = world.events().into_iter().filter_map(|stamped| match stamped.event {
        Event::Handover(handover) => Some((stamped.at, handover)),
        _ => None,
    });
    handovers.collect()
}

/// Returns the gaps of handovers at these times, each back and forth.
fn gaps(network: WirelessNetwork, times: &[u64]) -> Vec<Duration> {
    let mut world = corridor(network, Roaming::Instructed);
    let mut gaps = Vec::new();
    for (i, time) in times.iter().enumerate() {
        let to = if i % 2 == 0 { "R2" } else { "R1" };
        world.run(at(*time));
        world.radio.attach(at(*time), &id("r"), &id(to)).unwrap();
        world.run(at(time + 900));
        gaps.extend(handovers(&mut world).into_iter().map(|(_, handover)| handover.gap));
    }
    gaps
}

#[test]
fn a_fast_transition_takes_its_four_frames_and_the_waits_for_ticks() {
    // The request takes 1.680 ms at 1 Mbit/s with its preamble, its backoff up to 27 µs after 28 µs, and so on.
    let found = gaps(by_frames(true), &[1000, 2001, 3002, 4003]);
    assert_eq!(found.len(), 4);
    for (phase, gap) in (0..).zip(&found) {
        // From when the radio unit can answer: at 4.01 to 4.05 ms, so at the tick of 8 ms less the phase, or a later one.
        let answer = [8000_u64, 7000, 6000, 5000][phase];
        // The station's next tick, reassociation of 2.656 ms and its answer of 3.248 ms with their SIFS, ACK and backoffs.
        let least = us(answer + 4000 + 2656 + 3248);
        assert!((least..least + us(700)).contains(gap), "{gap:?} {least:?}");
    }
}

#[test]
fn without_fast_transition_the_key_handshake_follows() {
    let [with, without] = [true, false].map(|fast| gaps(by_frames(fast), &[1000])[0]);
    // Other frames are shorter, and the radio unit answers at once. Six frames follow, of 1 to 2 ms.
    assert!(without < with && without > us(10_000), "{without:?} {with:?}");
    let mut world = corridor(by_frames(false), Roaming::Instructed);
    world.radio.attach(at(1000), &id("r"), &id("R2")).unwrap();
    world.run(at(2000));
    let all = handovers(&mut world);
    assert!(matches!(&all[..], [(_, Handover { fast: false, .. })]), "{all:?}");
}

#[test]
fn a_robot_out_of_reach_gives_up_and_looks_for_another_radio_unit() {
    let mut world = corridor(by_frames(true), Roaming::Instructed);
    world.radio.attach(at(1000), &id("r"), &id("R2")).unwrap();
    // No radio hears it there.
    world.radio.move_robot(at(1000), &id("r"), Position::new(100_000.0, 0.0)).unwrap();
    world.run(at(3000));
    let events = world.events();
    let lost = |stamped: &Stamped| matches!(&stamped.event, Event::Detached { from, .. } if from == "R1");
    let lost = events.iter().find(|stamped| lost(stamped)).expect("it has lost R1");
    // Three times eleven tries of 1.7 to 2 ms and more, by the backoff.
    assert!((at(1050)..at(1200)).contains(&lost.at), "{:?}", lost.at);
    assert_eq!(world.attached("r"), None);
}

#[test]
fn packets_of_the_gap_are_lost_and_those_of_a_scan_wait() {
    let mut world = corridor(by_frames(true), Roaming::Instructed);
    world.radio.scan(at(500), &id("r")).unwrap();
    world.up(at(550), "r", 200);
    world.run(at(900));
    world.radio.attach(at(1000), &id("r"), &id("R2")).unwrap();
    for i in 0..10 {
        world.up(at(1000 + i), "r", 200);
        world.down(at(1000 + i), "R1", "r", 200);
    }
    world.run(at(1500));
    world.up(at(1600), "r", 200);
    world.run(at(2000));
    assert_eq!(world.numbers(), [0, 21]);
    assert_eq!(world.counters(at(2000)).lost, 20);
}

#[test]
fn runs_repeat() {
    let once = || gaps(by_frames(true), &[1000, 2002, 3001]);
    assert_eq!(once(), once());
}

#[test]
fn first_data_of_each_direction_bring_a_request_to_aggregate_and_its_answer() {
    let asked = |network: WirelessNetwork| {
        let mut world = corridor(network, Roaming::Instructed);
        world.radio.attach(at(1000), &id("r"), &id("R2")).unwrap();
        world.run(at(1500));
        let before = world.radio.exchanges.count;
        let count = |world: &mut World, until| {
            world.run(at(until));
            world.radio.exchanges.count - before
        };
        let mut counts = vec![count(&mut world, 1600)];
        for i in 0..2 {
            world.up(at(1600 + i), "r", 200);
            world.up(at(1600 + i), "r", 200);
            counts.push(count(&mut world, 1610 + i));
        }
        world.down(at(1700), "R2", "r", 200);
        counts.push(count(&mut world, 1800));
        counts
    };
    assert_eq!(asked(by_frames(true)), [0, 2, 2, 4]);
    let alone = Edca { rate_control: RateControl::Minstrel, ..base::edca() };
    assert_eq!(asked(WirelessNetwork { access: alone.into(), ..by_frames(true) }), [0; 4]);
}
