//! Airtime of robots' radios.

use super::{contention::contending, *};
use crate::radio::Airtime;

fn airtimes(world: &World) -> Vec<Airtime> {
    world.radio.airtimes().into_values().collect()
}

#[test]
fn a_frame_counts_for_its_sender_and_for_its_receiver_whoever_has_the_channel() {
    // At 8 Mbit/s, 1000 bytes take a millisecond, and the signal loses none.
    for network in [network(), WirelessNetwork { rate: Some(mbps(8.0)), ..contending() }] {
        let nodes = vec![
            robot("r", 5.0, Roaming::Instructed),
            robot("s", 5.0, Roaming::Instructed),
            unit("R1", 0.0, 36),
        ];
        let mut world = World::new(network, nodes);
        (0..5).for_each(|i| world.up(at(10 + 10 * i), "r", 1000));
        (0..3).for_each(|i| world.down(at(105 + 10 * i), "R1", "r", 1000));
        world.run(at(1000));
        assert_eq!(world.arrived.len(), 8);
        let airtime = Airtime { sending: ms(5), receiving: ms(3) };
        assert_eq!(airtimes(&world), [airtime, Airtime::default()]);
    }
}

#[test]
fn a_frame_to_all_counts_for_each_station() {
    let nodes =
        vec![robot("r", 5.0, Roaming::Instructed), robot("s", 6.0, Roaming::Instructed), unit("R1", 0.0, 36)];
    let mut world = World::new(contending(), nodes);
    let frame = world.frame(500);
    let (unit, elsewhere) = (world.port("R1"), PortId(99));
    world.radio.push_group(at(10), unit, elsewhere, frame);
    world.run(at(1000));
    let [r, s] = airtimes(&world)[..] else { panic!("two robots") };
    // At the lowest basic rate of 802.11a, 500 bytes and their headers take more than 500 · 8 / 6 µs.
    assert!(r == s && r.sending.is_zero() && r.receiving > Duration::from_micros(666), "{r:?}");
}
