use cotorra_graph::{QueueLimit, Rate};
use cotorra_numbers::Draws;
use proptest::prelude::*;

use super::*;
use crate::queue::testing::{TestPacket, packet};

/// Rate of the link, bit/s.
const LINK: u64 = 10_000_000;

fn conditions() -> Conditions {
    let rate = Rate::Fixed { bits_per_second: BitRate::from_bits_per_second(LINK).unwrap() };
    Conditions { rate, queue: QueueLimit::Packets(10_000), ..Conditions::default() }
}

/// A reservation for the packets of a flow from 100 on.
fn share(flow: u64, rate_bps: u64, is_limited: bool) -> Share {
    let rate = BitRate::from_bits_per_second(rate_bps).unwrap();
    Share { key: [PortId(flow as usize); 2], rate, is_limited }
}

fn shared(shares: &[Share]) -> Shared<TestPacket> {
    let queue = Queue::new(Timestamp::ZERO, &conditions(), Draws::new(1, "queue"));
    let mut shared = Shared::new(queue);
    shared.reserve(Timestamp::ZERO, shares, &conditions(), LINK as f64);
    shared
}

fn ns(ns: u64) -> Timestamp {
    Timestamp::from_nanos(ns)
}

fn sending_ns(bytes: u64, rate_bps: u64) -> u64 {
    (bytes * 8 * 1_000_000_000).div_ceil(rate_bps)
}

/// A packet that was sent, and when its first and last bits were.
#[derive(Debug, Clone, Copy)]
struct Sent {
    packet: TestPacket,
    began: u64,
    ended: u64,
}

/// Sends packets over a link in their order of arrival. Calls `idle` whenever the transmitter has nothing to send.
fn send(
    shared: &mut Shared<TestPacket>,
    arrivals: &[TestPacket],
    until: u64,
    idle: impl FnMut(&Shared<TestPacket>, u64),
) -> Vec<Sent> {
    send_on(shared, None, arrivals, until, idle)
}

/// The same over a link that is sending until a time.
fn send_on(
    shared: &mut Shared<TestPacket>,
    mut busy_until: Option<u64>,
    arrivals: &[TestPacket],
    until: u64,
    mut idle: impl FnMut(&Shared<TestPacket>, u64),
) -> Vec<Sent> {
    let (mut sent, mut arrivals) = (Vec::new(), arrivals.iter().copied().peekable());
    let no_drop = &mut |packet: TestPacket| panic!("{packet:?} is dropped");
    loop {
        let coming = arrivals.peek().map(|packet| packet.entered.as_nanos());
        let due = busy_until.or_else(|| shared.due().map(Timestamp::as_nanos));
        // An arrival comes before the end of a transmission at the same time.
        let is_arrival = coming.is_some_and(|coming| due.is_none_or(|due| coming <= due));
        let Some(now) = (if is_arrival { coming } else { due }).filter(|now| *now <= until) else {
            return sent;
        };
        let next = if is_arrival {
            let packet = arrivals.next().unwrap();
            if busy_until.is_some() {
                shared.push(ns(now), packet, no_drop);
                continue;
            }
            shared.pass(ns(now), packet, no_drop)
        } else {
            shared.pop(ns(now), no_drop)
        };
        busy_until = next.map(|packet| {
            let ended = now + sending_ns(packet.bytes, LINK);
            sent.push(Sent { packet, began: now, ended });
            ended
        });
        if busy_until.is_none() {
            idle(shared, now);
        }
    }
}

/// Packets of full frames of a flow that all come at time 0.
fn saturating(flow: u64, packets: u32) -> Vec<TestPacket> {
    (0..packets).map(|number| TestPacket { flow, bytes: FULL_FRAME, ..packet(number, ns(0)) }).collect()
}

/// Packets of a flow at a constant rate.
fn steady(flow: u64, rate_bps: u64, bytes: u64, until: u64) -> Vec<TestPacket> {
    let gap = sending_ns(bytes, rate_bps);
    let at = |number: u32| ns(u64::from(number) * gap);
    (0..(until / gap) as u32).map(|number| TestPacket { flow, bytes, ..packet(number, at(number)) }).collect()
}

fn together(parts: &[Vec<TestPacket>]) -> Vec<TestPacket> {
    let mut all = parts.concat();
    all.sort_by_key(|packet| packet.entered);
    all
}

fn bytes(sent: &[Sent], flow: u64) -> u64 {
    sent.iter().filter(|sent| sent.packet.flow == flow).map(|sent| sent.packet.bytes).sum()
}

const SECOND: u64 = 1_000_000_000;

/// Sends saturating loads of these flows for a second. Returns the rate of each, Mbit/s.
fn rates(shares: &[Share], flows: &[u64]) -> Vec<f64> {
    let mut shared = shared(shares);
    let load: Vec<_> = flows.iter().map(|flow| saturating(*flow, 1000)).collect();
    let sent = send(&mut shared, &together(&load), SECOND, |_, _| {});
    flows.iter().map(|flow| bytes(&sent, *flow) as f64 * 8.0 / 1e6).collect()
}

#[test]
fn two_saturated_classes_get_their_rates_within_a_turn() {
    for (a, b) in [(7_500_000, 2_500_000), (6_000_000, 2_000_000), (9_000_000, 1_000_000)] {
        let mut shared = shared(&[share(100, a, false), share(101, b, false)]);
        let load = together(&[saturating(100, 2000), saturating(101, 2000)]);
        let sent = send(&mut shared, &load, SECOND, |_, _| {});
        // The quantum of the smaller class is a full frame, and that of the other is larger by the ratio.
        let ratio = a as f64 / b as f64;
        let within = FULL_FRAME as f64 * ratio + (BURST + 4 * FULL_FRAME) as f64 * (1.0 + ratio);
        for i in (0..sent.len()).step_by(7) {
            let [of_a, of_b] = [100, 101].map(|flow| bytes(&sent[..i], flow) as f64);
            assert!((of_a - ratio * of_b).abs() <= within, "{of_a} and {of_b} after {i} packets");
        }
    }
}

#[test]
fn all_get_what_is_reserved_and_the_rest_gets_the_rest() {
    let shares = [share(100, 6_000_000, false), share(101, 1_000_000, false)];
    let rates = rates(&shares, &[0, 100, 101]);
    for (rate, expected) in rates.iter().zip([3.0, 6.0, 1.0]) {
        assert!((rate - expected).abs() < 0.05, "{rates:?}");
    }
}

#[test]
fn many_small_classes_do_not_take_from_a_large_one() {
    let small = 101..110;
    let shares: Vec<_> = small.clone().map(|flow| share(flow, 500_000, false)).collect();
    let shares = [&[share(100, 5_000_000, false)], &shares[..]].concat();
    let flows: Vec<_> = [0, 100].into_iter().chain(small).collect();
    let rates = rates(&shares, &flows);
    let least = [0.5, 5.0].into_iter().chain([0.5; 9]);
    // The full buckets of the others at the start come first.
    assert!(rates.iter().zip(least).all(|(rate, least)| *rate >= least * 0.95), "{rates:?}");
}

#[test]
fn what_a_class_leaves_over_goes_to_the_others() {
    let shares = [share(100, 6_000_000, false), share(101, 2_000_000, false)];
    assert!((rates(&shares, &[0])[0] - 10.0).abs() < 0.02);
    assert!((rates(&shares, &[101])[0] - 10.0).abs() < 0.02);
    // In proportion to their rates, if several want it.
    let rates = rates(&shares, &[0, 101]);
    assert!((rates[0] - 5.0).abs() < 0.05 && (rates[1] - 5.0).abs() < 0.05, "{rates:?}");
}

#[test]
fn a_limited_class_gets_its_rate_and_no_more() {
    let shares = [share(100, 2_000_000, true)];
    // Its first bucket comes on top.
    assert!((rates(&shares, &[100])[0] - 2.0).abs() < 0.04);
    let rates = rates(&shares, &[0, 100]);
    assert!((rates[0] - 8.0).abs() < 0.05 && (rates[1] - 2.0).abs() < 0.04, "{rates:?}");
}

#[test]
fn a_reserved_flow_waits_no_longer_than_its_burst_and_a_packet_take_at_its_rate() {
    for rate_bps in [500_000, 2_000_000, 4_000_000] {
        for burst in [1, 2, 5, 20] {
            for size in [100, 700, FULL_FRAME] {
                let mut shared = shared(&[share(100, rate_bps, false)]);
                // As many packets come at once as its rate allows, beside a load that fills the link.
                let gap = sending_ns(size, rate_bps) * burst;
                let flow: Vec<_> = (0..SECOND / gap)
                    .flat_map(|i| (0..burst).map(move |j| (i * burst + j, i * gap)))
                    .map(|(number, at)| TestPacket {
                        flow: 100,
                        bytes: size,
                        ..packet(number as u32, ns(at))
                    })
                    .collect();
                let load = together(&[saturating(0, 1000), flow]);
                let sent = send(&mut shared, &load, SECOND, |_, _| {});
                let delays = sent.iter().filter(|sent| sent.packet.flow == 100);
                let longest = delays.map(|sent| sent.ended - sent.packet.entered.as_nanos()).max().unwrap();
                let bound = sending_ns(burst * size + FULL_FRAME, rate_bps);
                assert!(longest <= bound, "{longest} ns of {bound}: {rate_bps} bit/s, {burst} of {size} B");
            }
        }
    }
}

#[test]
fn without_a_reservation_the_same_flow_waits_for_all_others() {
    let load = together(&[saturating(0, 1000), steady(100, 500_000, 700, SECOND)]);
    let sent = send(&mut shared(&[]), &load, SECOND, |_, _| {});
    assert!(bytes(&sent, 100) <= 700, "the load came first");
}

#[derive(Debug, Clone, Copy)]
struct Coming {
    flow: u64,
    bytes: u64,
    after_us: u64,
}

fn comings() -> impl Strategy<Value = Vec<Coming>> {
    let flow = prop_oneof![Just(0_u64), 100..104_u64];
    let coming = (flow, 60..=FULL_FRAME, prop_oneof![3 => Just(0_u64), 1 => 0..4000_u64]);
    let coming = coming.prop_map(|(flow, bytes, after_us)| Coming { flow, bytes, after_us });
    prop::collection::vec(coming, 1..300)
}

fn arrivals(comings: &[Coming]) -> Vec<TestPacket> {
    let mut at = 0;
    let arrival = |(number, coming): (usize, &Coming)| {
        at += coming.after_us * 1000;
        TestPacket { flow: coming.flow, bytes: coming.bytes, ..packet(number as u32, ns(at)) }
    };
    comings.iter().enumerate().map(arrival).collect()
}

fn reservations() -> impl Strategy<Value = Vec<Share>> {
    prop::collection::vec((1_000..3_000_000_u64, any::<bool>()), 0..=4).prop_map(|shares| {
        let share =
            |(i, (rate, is_limited)): (usize, &(u64, bool))| share(100 + i as u64, *rate, *is_limited);
        shares.iter().enumerate().map(share).collect()
    })
}

proptest! {
    #[test]
    fn the_link_is_idle_only_if_nothing_waits_or_all_that_waits_is_at_its_limit(
        shares in reservations(),
        comings in comings(),
    ) {
        let limited: Vec<_> =
            shares.iter().filter(|share| share.is_limited).map(|share| share.key[0].0 as u64).collect();
        let mut idle_with = Vec::new();
        let arrivals = arrivals(&comings);
        let sent = send(&mut shared(&shares), &arrivals, u64::MAX, |shared, now| {
            idle_with.extend(shared.iter().map(|packet| packet.flow));
            assert!(shared.due().is_none_or(|due| due > ns(now)));
        });
        prop_assert!(idle_with.iter().all(|flow| limited.contains(flow)), "{:?}", idle_with);
        prop_assert_eq!(sent.len(), arrivals.len());
        prop_assert!(sent.windows(2).all(|pair| pair[0].ended <= pair[1].began));
    }

    #[test]
    fn each_class_keeps_its_order(shares in reservations(), comings in comings()) {
        let sent = send(&mut shared(&shares), &arrivals(&comings), u64::MAX, |_, _| {});
        for flow in [0, 100, 101, 102, 103] {
            let of_flow = sent.iter().filter(|sent| sent.packet.flow == flow);
            prop_assert!(of_flow.map(|sent| sent.packet.number).is_sorted());
        }
    }

    /// Between any two of its packets, a limited class begins no more than its rate and a burst allow.
    #[test]
    fn no_limited_class_exceeds_its_rate_over_any_time(shares in reservations(), comings in comings()) {
        let sent = send(&mut shared(&shares), &arrivals(&comings), u64::MAX, |_, _| {});
        for share in shares.iter().filter(|share| share.is_limited) {
            let rate = share.rate.bits_per_second() as f64;
            let bucket = BURST as f64 + FULL_FRAME as f64 * (shares.len() + 1) as f64 * rate / LINK as f64;
            let of_class: Vec<_> =
                sent.iter().filter(|sent| sent.packet.flow == share.key[0].0 as u64).collect();
            for (i, first) in of_class.iter().enumerate() {
                let mut bytes = 0;
                for last in &of_class[i..] {
                    let passed = (last.began - first.began) as f64 / 1e9;
                    let allowed = passed * rate / 8.0 + bucket;
                    // Its last packet may owe tokens.
                    prop_assert!(bytes as f64 <= allowed + 1.0, "{} of {} bytes", bytes, allowed);
                    bytes += last.packet.bytes;
                }
            }
        }
    }

    #[test]
    fn other_reservations_keep_all_packets_and_their_order(
        before in reservations(),
        after in reservations(),
        comings in comings(),
    ) {
        let mut shared = shared(&before);
        let arrivals = arrivals(&comings);
        let (first, second) = arrivals.split_at(arrivals.len() / 2);
        let now = first.last().map_or(0, |packet| packet.entered.as_nanos());
        let mut sent = send(&mut shared, first, now, |_, _| {});
        let begun = sent.last().map_or(now, |sent| sent.ended.max(now));
        shared.reserve(ns(now), &after, &conditions(), LINK as f64);
        prop_assert_eq!(shared.packets() as usize, first.len() - sent.len());
        sent.extend(send_on(&mut shared, Some(begun), second, u64::MAX, |_, _| {}));
        prop_assert_eq!(sent.len(), arrivals.len());
        for flow in [0, 100, 101, 102, 103] {
            let of_flow = sent.iter().filter(|sent| sent.packet.flow == flow);
            prop_assert!(of_flow.map(|sent| sent.packet.number).is_sorted());
        }
    }
}
