//! Conditions of wired links, and their changes in place.

use std::{sync::Arc, time::Duration};

use cotorra_fabric::FabricError;
use cotorra_graph::{
    ConditionChange, Conditions, Correlation, CorrelationTime, Direction, Jitter, JitterDistribution, LinkId,
    Loss, Probability, QueueLimit, Rate, Scale, Timestamp, Trace,
};

use crate::common::{A, B, Delivery, Network, context, delay, frame, ms, number, pair, rate, run};

fn p(p: f64) -> Probability {
    Probability::new(p).unwrap()
}

fn link() -> LinkId {
    "a-b".parse().unwrap()
}

fn arrivals(out: &[Delivery]) -> Vec<(u32, Timestamp)> {
    out.iter().map(|d| (number(&d.frame), d.at)).collect()
}

/// 8 Mbit/s: a frame of 1000 bytes takes a millisecond.
fn slow() -> Conditions {
    Conditions { rate: rate(8.0), ..Conditions::default() }
}

#[test]
fn frames_are_sent_one_after_the_other() {
    let mut fabric = pair(Conditions { delay: Duration::from_millis(5), ..slow() }, 1);
    (0..3).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
    let out = run(&mut fabric, ms(0.0), ms(100.0));
    assert_eq!(arrivals(&out), [(0, ms(6.0)), (1, ms(7.0)), (2, ms(8.0))]);
    let context = context(&mut fabric, ms(8.0), "a-b");
    assert_eq!(context.delay, Some(Duration::from_millis(7)));
    assert_eq!((context.counters.packets, context.counters.bytes), (3, 3000));
}

#[test]
fn the_rate_is_kept_over_many_packets() {
    for (mbps, length) in [(0.5, 60), (8.0, 1514), (300.0, 700), (10_000.0, 60)] {
        let queue = QueueLimit::Packets(5000);
        let mut fabric = pair(Conditions { rate: rate(mbps), queue, ..Conditions::default() }, 1);
        (0..5000).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, length)));
        let out = run(&mut fabric, ms(0.0), Timestamp::MAX);
        let seconds = out.last().unwrap().at.as_secs_f64();
        let got = 5000.0 * length as f64 * 8.0 / seconds / 1e6;
        assert!((got / mbps - 1.0).abs() < 0.005, "{got} instead of {mbps} Mbit/s");
    }
}

#[test]
fn a_full_queue_drops_at_its_tail() {
    for (queue, kept) in [(QueueLimit::Packets(3), 4), (QueueLimit::Bytes(2999), 3)] {
        let mut fabric = pair(Conditions { queue, ..slow() }, 1);
        (0..10).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        let numbers: Vec<_> = out.iter().map(|d| number(&d.frame)).collect();
        // The frame in transmission does not count.
        assert_eq!(numbers, (0..kept).collect::<Vec<_>>());
        assert_eq!(context(&mut fabric, ms(100.0), "a-b").counters.overflowed, u64::from(10 - kept));
    }
}

#[test]
fn full_frames_follow_a_traces_opportunities() {
    let trace = Arc::new(Trace::parse("2\n2\n10").unwrap());
    let mut fabric = pair(Conditions { rate: Rate::Trace { trace }, ..delay(1) }, 1);
    (0..4).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1514)));
    let out = run(&mut fabric, ms(0.0), ms(100.0));
    assert_eq!(arrivals(&out), [(0, ms(3.0)), (1, ms(3.0)), (2, ms(11.0)), (3, ms(13.0))]);
}

#[test]
fn a_change_by_a_traces_name_keeps_that_trace_and_no_other() {
    let trace = Arc::new(Trace::parse("2\n2\n10").unwrap().in_file("air.trace"));
    let named = Rate::NamedTrace(Box::new(trace.name().clone()));
    let mut fabric = pair(Conditions { rate: Rate::Trace { trace: Arc::clone(&trace) }, ..delay(1) }, 1);
    let change = ConditionChange { rate: Some(named.clone()), ..ConditionChange::default() };
    fabric.change(ms(0.0), &link(), None, &change).unwrap();
    fabric.push(ms(0.0), A, frame(A, B, 0, 1514));
    assert_eq!(arrivals(&run(&mut fabric, ms(0.0), ms(100.0))), [(0, ms(3.0))]);
    let mut other = pair(delay(1), 1);
    let refused = other.change(ms(0.0), &link(), None, &change);
    assert_eq!(refused.unwrap_err(), FabricError::UnknownTrace(trace.name().sha256.clone()));
}

#[test]
fn a_million_packets_lose_the_requested_share() {
    let conditions = Conditions { loss: Loss::Independent { rate: p(0.02) }, ..Conditions::default() };
    let mut fabric = pair(conditions, 11);
    let mut delivered = 0u32;
    for i in 0..10_000 {
        let now = ms(f64::from(i));
        for n in 0..100 {
            let mut bytes = fabric.buffer(60);
            bytes.extend_from_slice(frame(A, B, n, 60).bytes());
            fabric.push(now, A, cotorra_fabric::Frame::new(bytes));
        }
        let mut out = Vec::with_capacity(100);
        fabric.poll(now, &mut |_, frame| out.push(frame));
        delivered += out.len() as u32;
        out.into_iter().for_each(|frame| fabric.recycle(frame));
    }
    let lost = 1e6 - f64::from(delivered);
    let bound = 2.576 * (1e6 * 0.02 * 0.98f64).sqrt();
    assert!((lost - 20_000.0).abs() <= bound, "{lost} lost");
    assert_eq!(context(&mut fabric, ms(1e4), "a-b").counters.lost, lost as u64);
}

#[test]
fn jitter_keeps_order_and_its_mean() {
    for distribution in [JitterDistribution::Uniform, JitterDistribution::Normal, JitterDistribution::Pareto]
    {
        let jitter = Some(Jitter { deviation: Duration::from_millis(2), distribution, ..Jitter::default() });
        let mut fabric = pair(Conditions { jitter, ..delay(20) }, 5);
        let mut out = Vec::new();
        // Packets so far apart that keeping order changes nothing.
        for i in 0..5000 {
            let now = ms(100.0 * f64::from(i));
            fabric.push(now, A, frame(A, B, i, 60));
            out.extend(run(&mut fabric, now, now + Duration::from_millis(100)));
        }
        let late = |d: &Delivery| d.at.as_secs_f64() * 1e3 - 100.0 * f64::from(number(&d.frame));
        let mean = out.iter().map(late).sum::<f64>() / 5000.0;
        assert!((mean - 20.0).abs() < 0.1, "{distribution:?}: {mean} ms");
        // Packets so close that order matters.
        (0..5000).for_each(|i| fabric.push(ms(1e6 + 0.01 * f64::from(i)), A, frame(A, B, i, 60)));
        let out = run(&mut fabric, ms(1e6), Timestamp::MAX);
        assert!(out.is_sorted_by_key(|d| number(&d.frame)));
    }
}

#[test]
fn jitter_over_time_does_not_depend_on_other_packets() {
    /// Packets of navigation, 200 ms apart.
    const PACKETS: u32 = 5000;
    let p95 = |over: Option<u64>, camera: bool| {
        let over = over.map(Duration::from_millis).and_then(CorrelationTime::new);
        let jitter = Jitter {
            deviation: Duration::from_millis(3),
            distribution: JitterDistribution::Pareto,
            over,
            ..Jitter::default()
        };
        let mut fabric = pair(Conditions { jitter: Some(jitter), ..delay(20) }, 5);
        let mut took = Vec::new();
        let mut poll = |fabric: &mut cotorra_fabric::Fabric, from, until| {
            let navigation = run(fabric, from, until).into_iter().filter(|d| number(&d.frame) < PACKETS);
            took.extend(navigation.map(|d| d.at.as_secs_f64() * 1e3 - 200.0 * f64::from(number(&d.frame))));
        };
        for i in 0..PACKETS {
            let start = 200.0 * f64::from(i);
            fabric.push(ms(start), A, frame(A, B, i, 60));
            let mut now = ms(start);
            // 15 images a second, of 25 packets that leave within 5 ms, not in step with navigation.
            for packet in (0..75).filter(|_| camera) {
                let at =
                    start + f64::from(i % 66) + 66.0 * f64::from(packet / 25) + 0.2 * f64::from(packet % 25);
                if at >= start + 200.0 {
                    break;
                }
                poll(&mut fabric, now, ms(at));
                now = ms(at);
                fabric.push(now, A, frame(A, B, PACKETS + 1, 1400));
            }
            poll(&mut fabric, now, ms(start + 200.0));
        }
        took.sort_by(f64::total_cmp);
        took[took.len() * 95 / 100]
    };
    // The quantile: 20 ms + 3 ms · (0.05^(-1/3) - 1.5) / √0.75, with a standard error of 0.2 ms.
    let expected = 20.0 + 3.0 * (0.05f64.powf(-1.0 / 3.0) - 1.5) / 0.75f64.sqrt();
    for camera in [false, true] {
        let got = p95(Some(50), camera);
        assert!((got - expected).abs() < 0.7, "camera {camera}: {got} ms, not {expected} ms");
    }
    // Drawn for each packet, the longest of many holds up all that follow.
    let [alone, beside] = [false, true].map(|camera| p95(None, camera));
    assert!((alone - expected).abs() < 0.7 && beside > expected + 3.0, "{alone} and {beside} ms");
}

#[test]
fn correlated_jitter_keeps_the_spacing_of_packets() {
    let spread = |correlation| {
        let correlation = Correlation::new(correlation).unwrap();
        let jitter = Jitter { deviation: Duration::from_millis(2), correlation, ..Jitter::default() };
        let mut fabric = pair(Conditions { jitter: Some(jitter), ..delay(50) }, 5);
        let mut out = Vec::new();
        // Packets so far apart that keeping order changes little.
        for i in 0..2000 {
            let now = ms(10.0 * f64::from(i));
            fabric.push(now, A, frame(A, B, i, 60));
            out.extend(run(&mut fabric, now, now + Duration::from_millis(10)));
        }
        let gaps = out.windows(2).map(|pair| pair[1].at.since(pair[0].at).as_secs_f64() * 1e3);
        let squares: Vec<f64> = gaps.map(|gap| (gap - 10.0).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    // The difference of two normal jitters has the deviation σ·√(2 - 2ρ).
    for correlation in [0.0, 0.5, 0.98f64] {
        let expected = 2.0 * (2.0 - 2.0 * correlation).sqrt();
        let got = spread(correlation);
        assert!((got / expected - 1.0).abs() < 0.1, "{correlation}: {got} ms instead of {expected} ms");
    }
}

#[test]
fn reordered_packets_skip_the_delay() {
    let mut fabric = pair(Conditions { reordering: p(0.3), ..delay(10) }, 3);
    let mut out = Vec::new();
    for i in 0..1000 {
        let now = ms(f64::from(i));
        fabric.push(now, A, frame(A, B, i, 60));
        out.extend(run(&mut fabric, now, now + Duration::from_nanos(999_999)));
    }
    out.extend(run(&mut fabric, ms(1000.0), Timestamp::MAX));
    let at_once = out.iter().filter(|d| d.at == ms(f64::from(number(&d.frame)))).count();
    let delayed = out.iter().filter(|d| d.at == ms(f64::from(number(&d.frame)) + 10.0)).count();
    assert_eq!(at_once + delayed, 1000);
    assert!((250..350).contains(&at_once), "{at_once}");
}

#[test]
fn duplicates_arrive_twice_and_corrupted_packets_differ_by_a_bit() {
    let conditions = Conditions { duplication: p(0.2), corruption: p(0.1), ..delay(1) };
    let mut fabric = pair(conditions, 3);
    (0..1000).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 200)));
    let out = run(&mut fabric, ms(0.0), ms(10.0));
    let counters = context(&mut fabric, ms(10.0), "a-b").counters;
    assert_eq!(counters.packets, 1000 + counters.duplicated);
    assert_eq!(out.len() as u64, counters.packets);
    assert!((160..240).contains(&counters.duplicated) && (70..130).contains(&counters.corrupted));
    let sent: Vec<_> = (0..1000).map(|i| frame(A, B, i, 200)).collect();
    let flipped = |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum::<u32>();
    let mut original = 0;
    let mut bits = 0;
    for pair in out.chunk_by(|a, b| a.frame == b.frame) {
        let flips = flipped(pair[0].frame.bytes(), sent[original].bytes());
        assert_eq!(pair[0].frame.bytes()[..14], sent[original].bytes()[..14]);
        assert!(flips <= 1);
        bits += u64::from(flips);
        original += 1;
    }
    assert_eq!((original, bits), (1000, counters.corrupted));
}

#[test]
fn a_lower_delay_brings_packets_in_flight_forward() {
    let mut fabric = pair(delay(100), 1);
    [0.0, 30.0, 60.0].into_iter().zip(0..).for_each(|(at, i)| fabric.push(ms(at), A, frame(A, B, i, 60)));
    let lower = ConditionChange { delay_ms: Some(20.0), ..ConditionChange::default() };
    fabric.change(ms(70.0), &link(), None, &lower).unwrap();
    fabric.push(ms(70.0), A, frame(A, B, 3, 60));
    let out = run(&mut fabric, ms(70.0), Timestamp::MAX);
    assert_eq!(arrivals(&out), [(0, ms(70.0)), (1, ms(70.0)), (2, ms(80.0)), (3, ms(90.0))]);
}

#[test]
fn a_higher_delay_leaves_packets_in_flight() {
    let mut fabric = pair(delay(10), 1);
    fabric.push(ms(0.0), A, frame(A, B, 0, 60));
    let higher = ConditionChange { delay_scale: Some(3.0), ..ConditionChange::default() };
    fabric.change(ms(5.0), &link(), Some(Direction::Forward), &higher).unwrap();
    fabric.push(ms(5.0), A, frame(A, B, 1, 60));
    fabric.push(ms(5.0), B, frame(B, A, 2, 60));
    let out = run(&mut fabric, ms(5.0), Timestamp::MAX);
    assert_eq!(arrivals(&out), [(0, ms(10.0)), (2, ms(15.0)), (1, ms(35.0))]);
}

#[test]
fn a_lower_delay_keeps_each_packets_jitter() {
    let jitter = Some(Jitter {
        deviation: Duration::from_millis(2),
        distribution: JitterDistribution::Uniform,
        ..Jitter::default()
    });
    let mut fabric = pair(Conditions { jitter, ..delay(50) }, 1);
    (0..10).for_each(|i| fabric.push(ms(5.0 * f64::from(i)), A, frame(A, B, i, 60)));
    let lower = ConditionChange { delay_ms: Some(49.0), ..ConditionChange::default() };
    fabric.change(ms(46.0), &link(), None, &lower).unwrap();
    let out = run(&mut fabric, ms(46.0), Timestamp::MAX);
    let off: Vec<_> =
        out.iter().map(|d| d.at.as_secs_f64() * 1e3 - 49.0 - 5.0 * f64::from(number(&d.frame))).collect();
    assert!(off.iter().any(|o| *o > 0.2) && off.iter().any(|o| *o < -0.2), "{off:?}");
    assert!(off.iter().all(|o| o.abs() <= 2.0), "{off:?}");
}

#[test]
fn a_new_rate_applies_to_the_rest_of_the_current_frame() {
    let trace = Rate::Trace { trace: Arc::new(Trace::parse("1").unwrap()) };
    for (to, first, second) in [
        (rate(16.0), 0.75, 1.25),
        (rate(4.0), 1.5, 3.5),
        (Rate::Unlimited, 0.5, 0.5),
        // 500 bytes are left. The rest of the first opportunity and the second carry the other frame.
        (trace, 1.5, 1.5),
    ] {
        let mut fabric = pair(slow(), 1);
        (0..2).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
        let change = ConditionChange { rate: Some(to), ..ConditionChange::default() };
        fabric.change(ms(0.5), &link(), None, &change).unwrap();
        let out = run(&mut fabric, ms(0.5), Timestamp::MAX);
        assert_eq!(arrivals(&out), [(0, ms(first)), (1, ms(second))]);
    }
}

#[test]
fn a_shorter_queue_keeps_its_packets() {
    let mut fabric = pair(slow(), 1);
    (0..10).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
    let shorter = ConditionChange { queue: Some(QueueLimit::Packets(2)), ..ConditionChange::default() };
    fabric.change(ms(0.5), &link(), None, &shorter).unwrap();
    fabric.push(ms(0.5), A, frame(A, B, 10, 1000));
    let numbers: Vec<_> = arrivals(&run(&mut fabric, ms(0.5), Timestamp::MAX)).iter().map(|a| a.0).collect();
    assert_eq!(numbers, (0..10).collect::<Vec<_>>());
}

#[test]
fn a_rejected_change_changes_neither_direction() {
    let mut fabric = pair(delay(1), 1);
    let halve = ConditionChange { drop_scale: Some(2.0), ..ConditionChange::default() };
    fabric.change(ms(0.0), &link(), Some(Direction::Forward), &halve).unwrap();
    let before = fabric.link_contexts(ms(0.0));
    // Forward: 50 Gbit/s over 2; backward: 200 Gbit/s.
    let faster =
        ConditionChange { rate: Some(rate(200_000.0)), delay_ms: Some(9.0), ..ConditionChange::default() };
    let error = fabric.change(ms(0.0), &link(), None, &faster).unwrap_err();
    assert!(matches!(error, FabricError::AboveMedium { .. }), "{error}");
    assert_eq!(fabric.link_contexts(ms(0.0)), before);
    let unknown: LinkId = "a-c".parse().unwrap();
    assert_eq!(fabric.change(ms(0.0), &unknown, None, &faster), Err(FabricError::UnknownLink(unknown)));
}

#[test]
fn contexts_report_requested_and_effective_conditions_and_measurements() {
    let mut fabric = pair(Conditions { rate: rate(100.0), ..delay(10) }, 1);
    let change =
        ConditionChange { delay_scale: Some(2.0), drop_scale: Some(4.0), ..ConditionChange::default() };
    fabric.change(ms(0.0), &link(), Some(Direction::Forward), &change).unwrap();
    let mut now = ms(0.0);
    // 1250 bytes each 10 ms are 1 Mbit/s.
    for i in 0..200 {
        now = ms(10.0 * f64::from(i));
        fabric.push(now, A, frame(A, B, i, 1250));
    }
    let forward = context(&mut fabric, now, "a-b");
    assert_eq!((forward.asked.delay, forward.asked.rate), (Duration::from_millis(10), rate(100.0)));
    assert_eq!((forward.effective.delay, forward.effective.rate), (Duration::from_millis(20), rate(25.0)));
    assert_eq!((forward.scale.delay_scale, forward.scale.drop_scale), (2.0, 4.0));
    assert_eq!(forward.delay, Some(Duration::from_micros(20_400)));
    assert!((forward.throughput_bps / 1e6 - 1.0).abs() < 0.06, "{}", forward.throughput_bps);
    let backward = &fabric.link_contexts(now)[1];
    assert_eq!(
        (backward.direction, backward.delay, backward.throughput_bps),
        (Direction::Backward, None, 0.0)
    );
    assert_eq!(backward.effective, backward.asked);
}

#[test]
fn contexts_have_the_longest_queue_of_the_last_second() {
    let mut fabric = pair(slow(), 1);
    (0..10).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
    // The frame in transmission does not wait.
    assert_eq!(context(&mut fabric, ms(0.0), "a-b").queued_packets, Some(9));
    assert_eq!(run(&mut fabric, ms(0.0), ms(100.0)).len(), 10);
    assert_eq!(context(&mut fabric, ms(900.0), "a-b").queued_packets, Some(9));
    assert_eq!(fabric.link_contexts(ms(900.0))[1].queued_packets, Some(0));
    assert_eq!(context(&mut fabric, ms(1100.0), "a-b").queued_packets, Some(0));

    // A frame each second, of which none is new.
    let mut fabric = pair(Conditions { rate: rate(0.008), ..Conditions::default() }, 1);
    (0..6).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
    let queued = [500.0, 1500.0, 2500.0, 4500.0, 7000.0]
        .map(|now| context(&mut fabric, ms(now), "a-b").queued_packets.unwrap());
    assert_eq!(queued, [5, 5, 4, 2, 0]);
}

#[test]
fn links_begin_with_the_scales_of_the_graph() {
    let mut graph = Network::new().servers(&["a", "b"]).link("a", "b", delay(10)).graph();
    graph.links[0].scales[0] = Scale { delay_scale: 3.0, drop_scale: 1.0 };
    let mut fabric = cotorra_fabric::Fabric::new(&graph, 1).unwrap();
    let [forward, backward] = &fabric.link_contexts(ms(0.0))[..] else { panic!("two directions") };
    assert_eq!((forward.asked.delay.as_millis(), forward.effective.delay.as_millis()), (10, 30));
    assert_eq!((forward.scale.delay_scale, backward.effective.delay.as_millis()), (3.0, 10));
}

#[test]
fn impossible_conditions_are_rejected() {
    let loss = Loss::Bursty { rate: p(0.9), mean_burst: 2.0 };
    let graph = Network::new().servers(&["a", "b"]).link("a", "b", Conditions { loss, ..delay(1) }).graph();
    let error = cotorra_fabric::Fabric::new(&graph, 1).unwrap_err();
    assert_eq!(
        error.to_string(),
        "`a-b`: a share of 0.9 cannot be lost in bursts of 2: they must be 9.000 or longer"
    );
}
