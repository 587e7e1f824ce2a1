//! Channels on which stations contend: throughput, collisions, hidden nodes, capture, aggregation and interference.

use cotorra_graph::{
    FixedRate, FqCodel, Interferer, InterfererKind, PowerSave, Presence, QueueDiscipline, RateControl,
};

use super::*;

/// A network whose stations contend one frame at a time, with 802.11a's rates and frames limited by the air alone.
pub(super) fn contending() -> WirelessNetwork {
    WirelessNetwork {
        standard: WifiStandard::A,
        delay: Duration::ZERO,
        rate: None,
        access: base::edca().into(),
        ..network()
    }
}

/// Stations at these places, all with a radio unit at 0.
fn stations(network: WirelessNetwork, places: &[f64]) -> World {
    let mut nodes = vec![unit("R", 0.0, 36)];
    nodes.extend(places.iter().enumerate().map(|(i, x)| robot(&format!("r{i}"), *x, Roaming::Instructed)));
    World::new(network, nodes)
}

/// Fills the queues of all stations, and returns the frames that arrived by a time.
fn saturate(world: &mut World, senders: usize, bytes: usize, until: Timestamp) -> u64 {
    for sender in 0..senders {
        (0..1000).for_each(|_| world.up(Timestamp::ZERO, &format!("r{sender}"), bytes));
    }
    world.run(until);
    world.arrived.iter().filter(|(due, ..)| *due <= until).count() as u64
}

/// Frames per second of `senders` that all hear each other, by Bianchi, Performance analysis of the IEEE 802.11 distributed
/// coordination function, IEEE JSAC 18(3), 2000: a window of 16 slots that doubles six times, frames that hold the channel for
/// `busy_us` and AIFS of 43 µs.
pub(super) fn bianchi(senders: i32, busy_us: f64) -> f64 {
    let tau =
        |p: f64| 2.0 * (1.0 - 2.0 * p) / ((1.0 - 2.0 * p) * 17.0 + p * 16.0 * (1.0 - (2.0 * p).powi(6)));
    let (mut low, mut high) = (0.0, 0.999_999);
    for _ in 0..100 {
        let p: f64 = 0.5 * (low + high);
        if 1.0 - (1.0 - tau(p)).powi(senders - 1) > p { low = p } else { high = p }
    }
    let tau = tau(low);
    let idle = (1.0 - tau).powi(senders);
    let one = f64::from(senders) * tau * (1.0 - tau).powi(senders - 1);
    one / (idle * 9e-6 + (1.0 - idle) * (busy_us + 43.0) * 1e-6)
}

#[test]
fn saturation_throughput_is_that_of_bianchi_within_2_percent() {
    for senders in [1, 2, 5, 10, 20] {
        // As many places at one distance as there are robots, so that no robot captures the radio unit.
        let places: Vec<_> = (0..senders).map(|i| if i % 2 == 0 { 5.0 } else { -5.0 }).collect();
        let mut world = stations(contending(), &places);
        let seconds = f64::min(0.3 * f64::from(senders), 2.0);
        let until = Timestamp::from_nanos((seconds * 1e9) as u64);
        let measured = saturate(&mut world, senders as usize, 1000, until) as f64 / seconds;
        // 1038 bytes at 54 Mbit/s: 20 µs and 39 symbols; SIFS and an acknowledgement at 24 Mbit/s.
        let model = bianchi(senders, 20.0 + 4.0 * 39.0 + 16.0 + 28.0);
        assert!(
            (measured / model - 1.0).abs() < 0.02,
            "{senders} senders: {measured:.0}/s, not {model:.0}/s"
        );
    }
}

#[test]
fn a_frame_on_an_idle_channel_goes_at_the_next_slot_boundary() {
    let mut world = stations(contending(), &[5.0]);
    world.up(at(10), "r0", 1000);
    world.run(at(20));
    // Boundaries are at 43 µs and each 9 µs from then on; a frame takes 20 µs and 39 symbols.
    assert_eq!(world.arrivals_us(), [10_006.0 + 176.0]);
}

#[test]
fn frames_that_end_their_backoff_together_collide_and_are_sent_again() {
    let mut world = stations(contending(), &[5.0, -5.0]);
    world.up(at(10), "r0", 1000);
    world.up(at(10), "r1", 1000);
    world.run(at(20));
    let arrivals = world.arrivals_us();
    assert_eq!(arrivals.len(), 2);
    // Both began at once, and waited for an acknowledgement and AIFS before they tried again.
    assert!(arrivals[0] >= 10_006.0 + 176.0 + 44.0 + 43.0 + 176.0, "{arrivals:?}");
}

#[test]
fn the_stronger_of_two_frames_is_captured() {
    let mut world = stations(contending(), &[2.0, -40.0]);
    world.up(at(10), "r0", 1000);
    world.up(at(10), "r1", 1000);
    world.run(at(20));
    assert_eq!(world.numbers(), [0, 1]);
    assert_eq!(world.arrivals_us()[0], 10_006.0 + 176.0, "the near one is not disturbed");
}

#[test]
fn hidden_nodes_lose_throughput_and_frames() {
    // Log-distance with n = 3: at 20 dBm, stations hear each other up to about 140 m.
    let both = |places: [f64; 2]| {
        let mut world = stations(contending(), &places);
        let frames = saturate(&mut world, 2, 1000, at(400));
        (frames as f64, world.counters(at(400)).lost)
    };
    let ((visible, no_losses), (hidden, losses)) = (both([80.0, 80.0]), both([80.0, -80.0]));
    assert_eq!(no_losses, 0);
    println!("{visible} frames where stations hear each other, {hidden} where not");
    assert!(hidden < 0.7 * visible && losses > 0, "{hidden} of {visible}, {losses} lost");
}

#[test]
fn hidden_nodes_destroy_only_the_frames_of_an_aggregate_that_they_overlap_with() {
    let ht = WirelessNetwork {
        standard: WifiStandard::Ac,
        access: Edca { aggregation: true, rate_control: RateControl::Minstrel, ..base::edca() }.into(),
        ..contending()
    };
    let frames = |places: [f64; 2]| saturate(&mut stations(ht.clone(), &places), 2, 1000, at(1000));
    let (visible, hidden) = (frames([80.0, 80.0]), frames([80.0, -80.0]));
    println!("{visible} frames where stations hear each other, {hidden} where not");
    assert!(hidden > visible / 4 && hidden < visible, "{hidden} of {visible}");
}

#[test]
fn another_network_shares_the_channel_by_its_load() {
    let throughput = |load: f64| {
        let mut ht = WirelessNetwork {
            standard: WifiStandard::N,
            access: Edca { aggregation: true, ..base::edca() }.into(),
            ..contending()
        };
        let kind = InterfererKind::Network { load: Probability::new(load).unwrap(), airtime: ms(2) };
        ht.access.contention_mut().unwrap().interference = vec![interferer(kind, 10.0)];
        let mut world = stations(ht, &[5.0]);
        for i in 0..40 {
            (0..500).for_each(|_| world.up(at(50 * i), "r0", 1514));
            world.run(at(50 * (i + 1)));
        }
        world.arrived.len() as f64 * 1514.0 * 8.0 / 2e6
    };
    for load in [0.1, 0.25, 0.5] {
        let left = throughput(load);
        println!("a network of {:.0} % leaves {left:.1} Mbit/s", 100.0 * load);
        // Without it, there are 60 Mbit/s. Collisions cost some more than its share.
        let share = 1.0 - left / 60.0;
        assert!((0.8 * load..1.3 * load).contains(&share), "{load}: {left}");
    }
}

#[test]
fn beacons_take_airtime_and_delay_frames() {
    let network = WirelessNetwork { standard: WifiStandard::G, ..contending() };
    let nodes = vec![unit("R", 0.0, 1), robot("r0", 5.0, Roaming::Instructed)];
    let mut world = World::new(network, nodes);
    (0..2000).for_each(|i| world.up(at(10 * i), "r0", 100));
    world.run(at(20_000));
    // 250 bytes at 1 Mbit/s take 192 + 2000 µs, each 102.4 ms.
    let load = world.radio.contexts(at(20_000))[0].load.unwrap();
    let beacons = 2.192 / 102.4;
    assert!((load - beacons - 0.01).abs() < 0.005, "{load}");
    let mut delays: Vec<_> =
        world.arrivals_us().iter().zip(0..).map(|(due, i)| due - 10_000.0 * f64::from(i)).collect();
    delays.sort_by(f64::total_cmp);
    let delayed = delays.iter().filter(|delay| **delay > 100.0).count() as f64 / 2000.0;
    assert!((delayed / beacons - 1.0).abs() < 0.2, "{delayed}");
    assert!((1000.0..2400.0).contains(&delays[1990]), "{}", delays[1990]);
}

#[test]
fn aggregation_raises_the_throughput_to_what_its_overhead_allows() {
    let ht = |aggregation| WirelessNetwork {
        standard: WifiStandard::N,
        access: Edca { aggregation, ..base::edca() }.into(),
        ..contending()
    };
    let rate = |aggregation, until: u64| {
        let mut world = stations(ht(aggregation), &[5.0]);
        let frames = saturate(&mut world, 1, 1514, at(until));
        frames as f64 * 1514.0 * 8.0 / world.arrivals_us()[frames as usize - 1]
    };
    let [single, aggregated] = [(false, 300), (true, 130)].map(|(on, until)| rate(on, until));
    // At 65 Mbit/s, a subframe has 1556 bytes. 28 of them take 36 + 4·1341 + 6 µs within 5.484 ms. With SIFS, a block
    // acknowledgement of 38 µs, AIFS and 7.5 slots on average, that is 5.6 ms.
    let model = 28.0 * 1514.0 * 8.0 / (36.0 + 4.0 * 1341.0 + 6.0 + 10.0 + 38.0 + 37.0 + 67.5);
    assert!((aggregated / model - 1.0).abs() < 0.02, "{aggregated:.1} Mbit/s, not {model:.1}");
    // A frame by itself takes 36 + 4·48 + 6 µs, and an acknowledgement 34 µs.
    let model = 1514.0 * 8.0 / (36.0 + 4.0 * 48.0 + 6.0 + 10.0 + 34.0 + 37.0 + 67.5);
    println!("one frame at a time {single:.1} Mbit/s, aggregated {aggregated:.1} Mbit/s");
    assert!((single / model - 1.0).abs() < 0.02, "{single:.1} Mbit/s, not {model:.1}");
}

#[test]
fn wider_channels_and_a_second_stream_raise_the_throughput() {
    use cotorra_graph::ChannelWidth::{Mhz20, Mhz40, Mhz80};
    let rate = |(width, streams)| {
        let network = WirelessNetwork {
            standard: WifiStandard::Ax,
            width,
            streams,
            access: Edca { aggregation: true, rate_control: RateControl::Ideal, ..base::edca() }.into(),
            ..contending()
        };
        let mut world = stations(network, &[2.0]);
        let frames = saturate(&mut world, 1, 1514, at(400));
        frames as f64 * 1514.0 * 8.0 / world.arrivals_us()[frames as usize - 1]
    };
    let rates = [(Mhz20, 1), (Mhz20, 2), (Mhz40, 2), (Mhz80, 2)].map(rate);
    println!("20 MHz, two streams, 40 MHz and 80 MHz: {rates:.0?} Mbit/s");
    assert!(rates.is_sorted_by(|a, b| 1.3 * a < *b), "{rates:?}");
    // 256 frames at 1201 Mbit/s take 50.4 µs and 196 symbols. With SIFS, a block acknowledgement of 40 µs, AIFS and 7.5 slots on
    // average, that is 2883 µs.
    let model = 256.0 * 1514.0 * 8.0 / (50.4 + 13.6 * 196.0 + 16.0 + 40.0 + 43.0 + 67.5);
    assert!((rates[3] / model - 1.0).abs() < 0.08, "{rates:?}, not {model:.0}");
}

#[test]
fn urgent_frames_overtake_others() {
    let mut world = stations(contending(), &[5.0, -5.0]);
    for _ in 0..50 {
        world.up(at(10), "r0", 1000);
        world.up(at(10), "r1", 1000);
    }
    let mut voice = vec![0; 1000];
    voice[12..16].copy_from_slice(&[0x08, 0x00, 0x45, 46 << 2]);
    world.radio.push_up(at(12), world.ports["r0"], Frame::new(voice));
    world.run(at(100));
    let place = world.arrived.iter().position(|(_, _, frame)| frame.bytes()[15] == 46 << 2).unwrap();
    let before = world.arrived[..place].iter().filter(|(due, ..)| *due > at(12)).count();
    assert!(before <= 3, "{before} frames went first");
}

/// A contending network with this discipline of its queues.
fn queueing(queue_discipline: QueueDiscipline) -> WirelessNetwork {
    WirelessNetwork { access: Edca { queue_discipline, ..base::edca() }.into(), ..contending() }
}

const FAIR: QueueDiscipline = QueueDiscipline::FqCodel(FqCodel::MAC80211);

#[test]
fn a_packet_of_another_flow_does_not_wait_for_a_burst() {
    let delay = |discipline| {
        let mut world = stations(queueing(discipline), &[5.0]);
        (0..50).for_each(|_| world.up(at(10), "r0", 1500));
        world.radio.push_up(at(12), world.ports["r0"], Frame::new(vec![1; 100]));
        world.run(at(100));
        assert_eq!(world.arrived.len(), 51);
        let small = world.arrived.iter().find(|(_, _, frame)| frame.bytes().len() == 100);
        small.unwrap().0.since(at(12))
    };
    // A frame of the burst takes 0.4 ms with its backoff. The packet waits for the one on the air.
    assert!(delay(QueueDiscipline::DropTail) > ms(15));
    assert!(delay(FAIR) < ms(2));
}

#[test]
fn a_radio_unit_gives_stations_equal_airtime() {
    // A station near its radio unit at 65 Mbit/s, and one far away at 6.5 Mbit/s: frames that each gets in a second.
    let frames = |queue_discipline, robots: &[&str]| {
        let edca = Edca { queue: QueueLimit::Packets(5000), queue_discipline, ..base::edca() };
        let network =
            WirelessNetwork { standard: WifiStandard::N, access: edca.into(), ..queueing(queue_discipline) };
        let mut world = stations(network, &[5.0, 125.0]);
        (0..5000).for_each(|_| robots.iter().for_each(|robot| world.down(at(0), "R", robot, 1500)));
        let until = at(1000);
        world.run(until);
        ["r0", "r1"].map(|robot| {
            let port = world.ports[robot];
            world.arrived.iter().filter(|(due, at, _)| *at == port && *due <= until).count() as f64
        })
    };
    // Without AIFS of 37 µs and 7.5 slots of backoff, what is left of a second of one alone is the airtime of its frames.
    let airtimes_us = [("r0", 0), ("r1", 1)].map(|(robot, i)| 1e6 / frames(FAIR, &[robot])[i] - 37.0 - 67.5);
    let both = |discipline| frames(discipline, &["r0", "r1"]);
    let (tail, fair) = (both(QueueDiscipline::DropTail), both(FAIR));
    println!("frames of {airtimes_us:.0?} us: {tail:?} in turns, {fair:?} by airtime");
    assert!(airtimes_us[1] > 6.0 * airtimes_us[0], "{airtimes_us:?}");
    assert!((tail[0] / tail[1] - 1.0).abs() < 0.02, "{tail:?}");
    let ratio = fair[0] * airtimes_us[0] / (fair[1] * airtimes_us[1]);
    assert!((ratio - 1.0).abs() < 0.03, "{fair:?} of {airtimes_us:?} us");
}

#[test]
fn a_station_that_begins_goes_before_those_that_wait() {
    let mean_ms = |discipline| {
        let mut world = stations(queueing(discipline), &[80.0, 80.0, 80.0, 80.0, 80.0, 80.0, 5.0]);
        let far: Vec<_> = (0..6).map(|i| format!("r{i}")).collect();
        (0..100).for_each(|_| far.iter().for_each(|robot| world.down(at(0), "R", robot, 1500)));
        let sent: Vec<_> = (4..24).map(|i| at(5 * i)).collect();
        for now in &sent {
            world.run(*now);
            world.down(*now, "R", "r6", 100);
        }
        world.run(at(150));
        let port = world.ports["r6"];
        let arrived = world.arrived.iter().filter(|(_, at, _)| *at == port);
        let waited: Duration = arrived.zip(&sent).map(|((due, ..), sent)| due.since(*sent)).sum();
        waited.as_secs_f64() * 1e3 / sent.len() as f64
    };
    // A far station's frame takes 1.2 ms with its backoff. In turns, two or three of the six are left after 5 ms.
    let (tail, fair) = (mean_ms(QueueDiscipline::DropTail), mean_ms(FAIR));
    assert!(tail > 2.0 && fair < 1.5, "{tail:.2} and {fair:.2} ms");
}

#[test]
fn frames_that_codel_drops_are_counted_and_shorten_the_wait() {
    let run = |discipline| {
        let mut world = stations(queueing(discipline), &[5.0]);
        // A frame takes 0.4 ms with its backoff: twice the load that the channel carries, and packets of another flow.
        for now in 0..2000 {
            (0..5).for_each(|_| world.up(at(now), "r0", 1500));
            world.run(at(now));
        }
        world.run(at(10_000));
        (world.pushed, world.arrived.len() as u64, world.counters(at(10_000)))
    };
    let (pushed, arrived, counters) = run(FAIR);
    assert!(counters.overflowed > 100, "{counters:?}");
    assert_eq!(arrived + counters.overflowed + counters.lost, pushed);
    let (pushed, arrived, counters) = run(QueueDiscipline::DropTail);
    assert_eq!(arrived + counters.overflowed + counters.lost, pushed);
}

fn interferer(kind: InterfererKind, x: f64) -> Interferer {
    Interferer {
        name: "neighbour".into(),
        channel: 36,
        position: Position::new(x, 0.0),
        tx_power: Dbm(20.0),
        kind,
        presence: None,
    }
}

/// Returns the delays of single frames that are sent every 10 ms, in µs, with the channel's load.
fn delays(interference: Vec<Interferer>) -> (Vec<u64>, f64) {
    let mut network = contending();
    network.access.contention_mut().unwrap().interference = interference;
    let mut world = stations(network, &[5.0]);
    (0..1000).for_each(|i| world.up(at(10 * i), "r0", 1000));
    world.run(at(10_000));
    let load = world.radio.contexts(at(10_000))[0].load.unwrap();
    let mut delays: Vec<_> = world
        .arrived
        .iter()
        .map(|(due, _, frame)| {
            let number = u64::from_be_bytes(frame.bytes()[14..22].try_into().unwrap());
            due.since(at(10 * number)).as_micros() as u64
        })
        .collect();
    delays.sort_unstable();
    (delays, load)
}

#[test]
fn another_network_takes_its_share_and_delays_frames() {
    let kind = InterfererKind::Network { load: Probability::new(0.3).unwrap(), airtime: ms(2) };
    let (delays, load) = delays(vec![interferer(kind, 10.0)]);
    assert_eq!(delays.len(), 1000);
    assert!((load - 0.3).abs() < 0.1, "{load}");
    let undisturbed = delays.iter().filter(|delay| **delay <= 185).count();
    assert!((600..800).contains(&undisturbed), "{undisturbed} of 1000 frames found the channel idle");
    assert!(delays[990] > 1500, "the last percent waits for a frame of 2 ms: {}", delays[990]);
}

#[test]
fn a_device_that_does_not_listen_destroys_frames() {
    // Too weak to be sensed, and strong enough to disturb. A frame of 176 µs meets a pulse of 3 ms in 10.3 ms by 31 %.
    let kind = InterfererKind::Device { on: ms(3), off: Duration::from_micros(7300) };
    let weak = Interferer { tx_power: Dbm(0.0), ..interferer(kind, -3.0) };
    let (delays, _) = delays(vec![weak]);
    let disturbed = delays.iter().filter(|delay| **delay > 185).count() + 1000 - delays.len();
    assert!((280..350).contains(&disturbed), "{disturbed}");
}

#[test]
fn interference_comes_and_goes() {
    let kind = InterfererKind::Network { load: Probability::new(0.9).unwrap(), airtime: ms(2) };
    let presence = Some(Presence { on: ms(500), off: ms(1500) });
    let (delays, _) = delays(vec![Interferer { presence, ..interferer(kind, 10.0) }]);
    let undisturbed = delays.iter().filter(|delay| **delay <= 185).count();
    assert!((600..950).contains(&undisturbed), "{undisturbed}");
}

#[test]
fn held_frames_follow_a_contending_station_in_order() {
    for aggregation in [false, true] {
        let network = WirelessNetwork {
            standard: WifiStandard::N,
            access: Edca { aggregation, ..base::edca() }.into(),
            ..contending()
        };
        let mut world = corridor(network, Roaming::Instructed);
        (0..300).for_each(|_| world.up(at(10), "r", 1000));
        (0..300).for_each(|_| world.down(at(10), "R1", "r", 1000));
        world.run(at(20));
        let before = world.arrived.len();
        assert!((1..500).contains(&before), "{before}");
        world.radio.attach(at(20), &id("r"), &id("R2")).unwrap();
        world.run(at(1000));
        let numbers = world.numbers();
        let [up, down]: [Vec<u64>; 2] =
            [0..300, 300..600].map(|range| numbers.iter().copied().filter(|n| range.contains(n)).collect());
        assert_eq!(up, (0..300).collect::<Vec<_>>());
        assert_eq!(down, (300..600).collect::<Vec<_>>());
    }
}

#[test]
fn the_rate_control_of_linux_comes_near_to_the_ideal_rate() {
    let arrived = |rate_control, x: f64| {
        let network = WirelessNetwork {
            standard: WifiStandard::N,
            access: Edca { aggregation: true, rate_control, ..base::edca() }.into(),
            ..contending()
        };
        let mut world = stations(network, &[x]);
        for i in 0..40 {
            (0..250).for_each(|_| world.up(at(50 * i), "r0", 1514));
            world.run(at(50 * i + 49));
        }
        let last = world.arrived.iter().filter(|(due, ..)| *due > at(1000)).count() as f64;
        (last, world.counters(at(2000)).lost)
    };
    for x in [5.0, 30.0, 60.0] {
        let ((learned, lost), (ideal, _)) =
            (arrived(RateControl::Minstrel, x), arrived(RateControl::Ideal, x));
        println!("{x} m: {learned} frames by Minstrel-HT, {ideal} by the ideal rate");
        assert!(learned > 0.9 * ideal, "{learned} and {ideal} frames at {x} m");
        assert!(lost <= 20, "{lost} frames lost at {x} m");
    }
}

#[test]
fn a_fixed_rate_stays_whatever_the_signal_is() {
    // MCS 4 has 39 Mbit/s: at 5 m its rate limits it, and at 100 m nearly nothing arrives.
    let network = |standard, rate| WirelessNetwork {
        standard,
        access: Edca {
            aggregation: standard == WifiStandard::N,
            rate_control: RateControl::Fixed(rate),
            ..base::edca()
        }
        .into(),
        ..contending()
    };
    let rate = |network, x: f64| {
        let mut world = stations(network, &[x]);
        for i in 0..40 {
            (0..250).for_each(|_| world.up(at(50 * i), "r0", 1514));
            world.run(at(50 * i + 49));
        }
        let arrived = world.arrived.iter().filter(|(due, ..)| *due > at(1000)).count() as f64;
        let [context] = &world.radio.contexts(at(2000))[..] else { panic!("there is one radio unit") };
        (arrived * 1514.0 * 8.0 / 1e6, context.stations[0].uplink_bps / 1e6)
    };
    let mcs = |mcs| network(WifiStandard::N, FixedRate::Mcs(mcs));
    let (near, shown) = rate(mcs(4), 5.0);
    assert!((33.0..39.0).contains(&near), "{near} Mbit/s");
    assert_eq!(shown, 39.0);
    let (far, shown) = rate(mcs(4), 100.0);
    assert!(far < 0.1 * near, "{far} Mbit/s");
    assert_eq!(shown, 39.0);
    let (slow, _) = rate(mcs(0), 5.0);
    assert!((5.0..6.5).contains(&slow), "{slow} Mbit/s");
    let of_12 = FixedRate::BitsPerSecond(BitRate::from_mbps(12.0).unwrap());
    let (legacy, shown) = rate(network(WifiStandard::A, of_12), 5.0);
    assert!((9.0..12.0).contains(&legacy), "{legacy} Mbit/s");
    assert_eq!(shown, 12.0);
}

#[test]
fn a_fixed_rate_that_the_standard_lacks_is_rejected() {
    let access = Edca { rate_control: RateControl::Fixed(FixedRate::Mcs(8)), ..base::edca() }.into();
    let network = WirelessNetwork { standard: WifiStandard::N, streams: 1, access, ..contending() };
    let wireless = [("air".to_owned(), network)].into();
    let graph = HardwareGraph { wireless, ..base::graph(Vec::new(), Vec::new()) };
    let error = Radio::new(&graph, 1).unwrap_err().to_string();
    assert!(error.contains("802.11n has no MCS 8"), "{error}");
}

/// Sends frames down to a station that sleeps after 100 ms, one each 250 ms. Returns their delays, µs.
fn delays_to_sleeper(world: &mut World) -> Vec<u64> {
    (0..40).for_each(|i| world.down(at(250 * i), "R", "r0", 500));
    world.run(at(10_500));
    let delay = |(due, _, frame): &(Timestamp, PortId, Frame)| {
        let number = u64::from_be_bytes(frame.bytes()[14..22].try_into().unwrap());
        due.since(at(250 * number)).as_micros() as u64
    };
    world.arrived.iter().map(delay).collect()
}

fn sleeping() -> WirelessNetwork {
    let power_save = Some(PowerSave { idle: ms(100), dtim_period: 2 });
    let access = Edca { power_save, ..base::edca() };
    WirelessNetwork { access: access.into(), ..contending() }
}

#[test]
fn frames_for_a_station_that_sleeps_wait_for_a_beacon() {
    let delays = delays_to_sleeper(&mut stations(sleeping(), &[5.0]));
    assert_eq!(delays.len(), 40);
    // The first comes while it is awake. Frames and beacons have no common period: the waits spread evenly.
    assert!(delays[0] < 1000, "{delays:?}");
    let waits = &delays[1..];
    assert!(waits.iter().all(|wait| *wait < 102_400 + 1000), "{waits:?}");
    let mean = waits.iter().sum::<u64>() as f64 / waits.len() as f64;
    assert!((40_000.0..62_000.0).contains(&mean), "{mean}");
}

#[test]
fn a_station_that_sends_is_awake() {
    let mut world = stations(sleeping(), &[5.0]);
    for i in 0..100 {
        world.up(at(50 * i), "r0", 500);
        world.down(at(50 * i + 30), "R", "r0", 500);
    }
    world.run(at(6000));
    let worst = |parity: u64, offset: u64| {
        let of = |frame: &Frame| u64::from_be_bytes(frame.bytes()[14..22].try_into().unwrap());
        let frames = world.arrived.iter().filter(|(_, _, frame)| of(frame) % 2 == parity);
        frames.map(|(due, _, frame)| due.since(at(50 * (of(frame) / 2) + offset)).as_micros()).max()
    };
    assert!(worst(0, 0) < Some(1000));
    assert!(worst(1, 30) < Some(1000));
}

#[test]
fn group_frames_wait_for_a_dtim_if_a_station_sleeps() {
    let mut world = stations(sleeping(), &[5.0, -5.0]);
    for i in 0..20 {
        let frame = world.frame(500);
        world.radio.push_group(at(1000 + 300 * i), world.ports["R"], world.ports["r0"], frame);
    }
    world.run(at(10_000));
    assert_eq!(world.arrived.len(), 20);
    for (due, ..) in &world.arrived {
        // Every second beacon, each 204.8 ms.
        let after = due.as_nanos() % 204_800_000;
        assert!(after < 2_000_000, "{due}");
    }
}
