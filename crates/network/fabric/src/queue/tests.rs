//! Rules that hold for every discipline.

use cotorra_graph::{BitRate, Codel, FqCodel, Pie, Probability, Red, RedThresholds};
use proptest::prelude::*;

use super::{
    testing::{TestPacket, ms, packet},
    *,
};

fn disciplines() -> Vec<QueueDiscipline> {
    let probability = Probability::new(0.5).unwrap();
    let ecn = true;
    let target = Duration::from_millis(1);
    vec![
        QueueDiscipline::DropTail,
        QueueDiscipline::Codel(Codel { target, interval: Duration::from_millis(5), ecn }),
        QueueDiscipline::FqCodel(FqCodel {
            target,
            interval: Duration::from_millis(5),
            flows: 4,
            quantum: 256,
            ecn,
        }),
        QueueDiscipline::Pie(Pie { target, update: Duration::from_millis(1), burst: Duration::ZERO, ecn }),
        QueueDiscipline::Red(Red {
            thresholds: RedThresholds::Packets { min: 2, max: 6 },
            probability,
            weight: probability,
            ecn,
        }),
    ]
}

fn conditions(queue: QueueLimit, queue_discipline: QueueDiscipline) -> Conditions {
    let rate = Rate::Fixed { bits_per_second: BitRate::from_mbps(8.0).unwrap() };
    Conditions { queue, queue_discipline, rate, ..Conditions::default() }
}

fn queue(limit: QueueLimit, discipline: QueueDiscipline) -> Queue<TestPacket> {
    Queue::new(Timestamp::ZERO, &conditions(limit, discipline), Draws::new(1, "queue"))
}

#[derive(Debug, Clone, Copy)]
enum Step {
    /// A packet of a flow comes.
    Push(u64, u64),
    Pop,
    /// So many milliseconds pass.
    Wait(u8),
    /// Another discipline, by its number, and another limit.
    Change(usize, u32),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        8 => (0..5_u64, 60..1514_u64).prop_map(|(flow, bytes)| Step::Push(flow, bytes)),
        4 => Just(Step::Pop),
        4 => (0..20_u8).prop_map(Step::Wait),
        1 => (0..5_usize, 1..20_u32).prop_map(|(discipline, limit)| Step::Change(discipline, limit)),
    ];
    prop::collection::vec(step, 0..300)
}

proptest! {
    #[test]
    fn every_packet_leaves_or_is_dropped_or_waits_and_flows_keep_their_order(
        first in 0..5_usize,
        steps in steps(),
    ) {
        let mut queue = queue(QueueLimit::Packets(10), disciplines()[first]);
        let (mut now, mut came) = (0.0, 0);
        let (mut sent, mut dropped): (Vec<TestPacket>, Vec<TestPacket>) = Default::default();
        for step in steps {
            match step {
                Step::Push(flow, bytes) => {
                    let packet = TestPacket { flow, bytes, is_capable: flow == 0, ..packet(came, ms(now)) };
                    queue.push(ms(now), packet, &mut |packet| dropped.push(packet));
                    came += 1;
                }
                Step::Pop => sent.extend(queue.pop(ms(now), &mut |packet| dropped.push(packet))),
                Step::Wait(passed) => now += f64::from(passed),
                Step::Change(discipline, limit) => {
                    let to = conditions(QueueLimit::Packets(limit), disciplines()[discipline]);
                    queue.change(ms(now), &to);
                }
            }
            let waiting: Vec<_> = queue.iter().copied().collect();
            prop_assert_eq!(queue.packets(), waiting.len() as u64);
            prop_assert_eq!(queue.bytes, waiting.iter().map(|packet| packet.bytes).sum::<u64>());
            let mut numbers: Vec<_> = [&sent[..], &dropped, &waiting].concat().iter().map(|p| p.number).collect();
            numbers.sort_unstable();
            prop_assert!(numbers.iter().copied().eq(0..came));
        }
        for flow in 0..5 {
            let numbers = sent.iter().filter(|packet| packet.flow == flow).map(|packet| packet.number);
            prop_assert!(numbers.is_sorted());
        }
        prop_assert!(sent.iter().all(|packet| packet.flow == 0 || !packet.is_marked));
    }

    #[test]
    fn the_same_packets_have_the_same_fate(discipline in 0..5_usize, steps in steps()) {
        let fate = || {
            let mut queue = queue(QueueLimit::Bytes(12_000), disciplines()[discipline]);
            let (mut now, mut events) = (0.0, Vec::new());
            for (number, step) in steps.iter().enumerate() {
                match *step {
                    Step::Push(flow, bytes) => {
                        let packet = TestPacket { flow, bytes, ..packet(number as u32, ms(now)) };
                        queue.push(ms(now), packet, &mut |packet| events.push((false, packet)));
                    }
                    Step::Pop => {
                        let packet = queue.pop(ms(now), &mut |packet| events.push((false, packet)));
                        events.extend(packet.map(|packet| (true, packet)));
                    }
                    Step::Wait(passed) => now += f64::from(passed),
                    Step::Change(..) => {}
                }
            }
            events
        };
        prop_assert_eq!(fate(), fate());
    }
}

#[test]
fn no_discipline_exceeds_the_limit() {
    for discipline in disciplines() {
        for limit in [QueueLimit::Packets(7), QueueLimit::Bytes(7999)] {
            let mut queue = queue(limit, discipline);
            let mut dropped = 0;
            for number in 0..100 {
                let packet = TestPacket { flow: u64::from(number) % 3, ..packet(number, ms(0.0)) };
                queue.push(ms(0.0), packet, &mut |_| dropped += 1);
                assert!(queue.packets() <= 7);
            }
            assert_eq!(queue.packets() + dropped, 100);
            assert!(queue.packets() >= 4, "{discipline:?} fills its queue");
        }
    }
}

#[test]
fn a_full_flow_loses_its_own_packets_in_fq_codel() {
    let mut queue = queue(QueueLimit::Packets(10), QueueDiscipline::FqCodel(FqCodel::default()));
    let mut dropped = Vec::new();
    for (flow, packets) in [(1, 9), (2, 4)] {
        for number in 0..packets {
            let packet = TestPacket { flow, ..packet(number, ms(0.0)) };
            queue.push(ms(0.0), packet, &mut |packet| dropped.push((packet.flow, packet.number)));
        }
    }
    assert_eq!(dropped, [(1, 0), (1, 1), (1, 2)]);
}

#[test]
fn a_packet_passes_an_idle_transmitter_whatever_the_limit() {
    for discipline in disciplines() {
        let mut queue = queue(QueueLimit::Bytes(1), discipline);
        let passed = queue.pass(ms(1.0), packet(3, ms(1.0)), &mut |packet| panic!("{packet:?} is dropped"));
        assert_eq!(passed.map(|packet| packet.number), Some(3));
        assert_eq!((queue.packets(), queue.bytes), (0, 0));
    }
}

#[test]
fn another_discipline_and_a_shorter_limit_keep_the_packets_in_order() {
    let all = disciplines();
    for (from, to) in all.iter().flat_map(|from| all.iter().map(move |to| (*from, *to))) {
        let mut queue = queue(QueueLimit::Packets(100), from);
        (0..6).for_each(|number| queue.insert(packet(number, ms(f64::from(number)))));
        queue.change(ms(6.0), &conditions(QueueLimit::Packets(1), to));
        assert!(queue.drain().iter().map(|packet| packet.number).eq(0..6), "{from:?} to {to:?}");
    }
}
