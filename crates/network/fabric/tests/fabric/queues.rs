//! Disciplines of the queues of wired links, with senders that adapt and senders that do not.

use std::time::Duration;

use cotorra_fabric::{Fabric, Frame};
use cotorra_graph::{
    Codel, ConditionChange, Conditions, FqCodel, HostAddress, Pie, Probability, QueueDiscipline, QueueLimit,
    Red, RedThresholds, Timestamp,
};

use crate::common::{A, B, context, frame, ms, pair, rate, run};

const LIMIT: QueueLimit = QueueLimit::Packets(100);
const BYTES: usize = 1514;

/// A link of 10 Mbit/s with 20 ms each way, and room for 100 packets, which take 121 ms.
fn bottleneck(queue_discipline: QueueDiscipline) -> Fabric {
    let delay = Duration::from_millis(20);
    let conditions =
        Conditions { delay, rate: rate(10.0), queue: LIMIT, queue_discipline, ..Conditions::default() };
    pair(conditions, 1)
}

fn codel() -> QueueDiscipline {
    QueueDiscipline::Codel(Codel::default())
}

/// An Ethernet frame with a UDP packet over IPv4 from `A` to `B`, from a port, with ECN bits and a number.
fn datagram(port: u16, ecn: u8, number: u32, bytes: usize) -> Frame {
    let mut frame = vec![0; bytes];
    frame[..6].copy_from_slice(&HostAddress::of(1).mac);
    frame[6..12].copy_from_slice(&HostAddress::of(0).mac);
    frame[12..16].copy_from_slice(&[0x08, 0x00, 0x45, ecn]);
    frame[16..18].copy_from_slice(&(bytes as u16 - 14).to_be_bytes());
    frame[23] = 17;
    frame[26..34].copy_from_slice(&[10, 77, 0, 1, 10, 77, 0, 2]);
    let checksum = !ones_complement(&frame[14..34]);
    frame[24..26].copy_from_slice(&checksum.to_be_bytes());
    frame[34..36].copy_from_slice(&port.to_be_bytes());
    frame[42..46].copy_from_slice(&number.to_be_bytes());
    Frame::new(frame)
}

fn ones_complement(bytes: &[u8]) -> u16 {
    let words = bytes.chunks(2).map(|pair| u32::from(pair[0]) << 8 | u32::from(pair[1]));
    words.fold(0, |sum, word| {
        let sum = u32::from(sum) + word;
        (sum & 0xffff) as u16 + (sum >> 16) as u16
    })
}

fn word(frame: &Frame, at: usize) -> u32 {
    u32::from_be_bytes(frame.bytes()[at..at + 4].try_into().unwrap())
}

/// A sender with a window: it grows by a packet per acknowledgement until the first loss, then by one per round trip. A loss
/// halves it, once per round trip. If all packets were lost, it begins anew.
struct Sender {
    window: f64,
    threshold: f64,
    next: u32,
    /// The lowest number that is not acknowledged yet.
    awaited: u32,
    /// Losses of numbers below this one belong to the last halving.
    recovered: u32,
    sent: Vec<Timestamp>,
}

impl Sender {
    fn acknowledge(&mut self, number: u32) {
        if number > self.awaited && self.awaited >= self.recovered {
            self.threshold = (self.window / 2.0).max(2.0);
            self.window = self.threshold;
            self.recovered = self.next;
        }
        let slow_start = self.window < self.threshold;
        self.window += if slow_start { 1.0 } else { 1.0 / self.window };
        self.awaited = number + 1;
    }

    /// Everything under way was lost.
    fn time_out(&mut self) {
        self.threshold = (self.window / 2.0).max(2.0);
        (self.window, self.awaited, self.recovered) = (1.0, self.next, self.next);
    }

    fn send(&mut self, now: Timestamp, fabric: &mut Fabric) {
        while f64::from(self.next - self.awaited) < self.window {
            fabric.push(now, A, datagram(1, 0, self.next, BYTES));
            self.sent.push(now);
            self.next += 1;
        }
    }
}

/// Sends for ten seconds. Returns the mean time in the queue over the second half, in milliseconds, and the share of the rate
/// that was used in it.
fn settle(mut fabric: Fabric) -> (f64, f64) {
    let mut sender =
        Sender { window: 2.0, threshold: f64::INFINITY, next: 0, awaited: 0, recovered: 0, sent: Vec::new() };
    let (mut now, mut queueing_ms, mut arrived) = (ms(0.0), 0.0, 0);
    let alone_ms = 20.0 + BYTES as f64 * 8.0 / 10e3;
    sender.send(now, &mut fabric);
    while now < ms(10_000.0) {
        let mut out = Vec::new();
        fabric.poll(now, &mut |port, frame| out.push((port, frame)));
        for (port, frame) in out {
            if port == B {
                let number = word(&frame, 42);
                if now >= ms(5000.0) {
                    let took = now.since(sender.sent[number as usize]);
                    queueing_ms += took.as_secs_f64() * 1e3 - alone_ms;
                    arrived += 1;
                }
                fabric.push(now, B, crate::common::frame(B, A, number, 60));
            } else {
                sender.acknowledge(word(&frame, 14));
                sender.send(now, &mut fabric);
            }
        }
        now = fabric.poll(now, &mut |_, _| ()).unwrap_or_else(|| {
            let later = now + Duration::from_millis(200);
            sender.time_out();
            sender.send(later, &mut fabric);
            later
        });
    }
    (queueing_ms / f64::from(arrived), f64::from(arrived) * BYTES as f64 * 8.0 / 5.0 / 10e6)
}

#[test]
fn codel_settles_near_its_target_where_drop_tail_fills_the_queue() {
    let (filled_ms, _) = settle(bottleneck(QueueDiscipline::DropTail));
    let (settled_ms, used) = settle(bottleneck(codel()));
    assert!(filled_ms > 60.0, "drop tail: {filled_ms} ms");
    assert!((1.0..8.0).contains(&settled_ms), "CoDel: {settled_ms} ms");
    assert!(used > 0.85, "{used} of the rate");
}

#[test]
fn pie_settles_near_its_target() {
    let (settled_ms, used) = settle(bottleneck(QueueDiscipline::Pie(Pie::default())));
    assert!((4.0..25.0).contains(&settled_ms), "{settled_ms} ms");
    assert!(used > 0.85, "{used} of the rate");
}

/// Between the thresholds of 5 and 15 packets the queue takes 6 to 18 ms.
#[test]
fn red_settles_between_its_thresholds() {
    let (settled_ms, used) = settle(bottleneck(QueueDiscipline::Red(Red::default())));
    assert!((3.0..20.0).contains(&settled_ms), "{settled_ms} ms");
    assert!(used > 0.85, "{used} of the rate");
}

/// A flow that overloads the link, and another one with a small packet every 20 ms.
fn delays_of_a_sparse_flow(queue_discipline: QueueDiscipline) -> Vec<f64> {
    let mut fabric = bottleneck(queue_discipline);
    let mut delays = Vec::new();
    for i in 0..2000 {
        let now = ms(f64::from(i));
        fabric.push(now, A, datagram(1, 0, 0, BYTES));
        if i % 20 == 0 {
            fabric.push(now, A, datagram(2, 0, i, 100));
        }
        for delivery in run(&mut fabric, now, now + Duration::from_micros(999)) {
            let bytes = delivery.frame.bytes();
            if bytes[34..36] == [0, 2] && i > 1000 {
                delays.push(delivery.at.as_secs_f64() * 1e3 - f64::from(word(&delivery.frame, 42)));
            }
        }
    }
    delays
}

#[test]
fn fq_codel_isolates_a_sparse_flow_from_a_greedy_one() {
    let isolated = delays_of_a_sparse_flow(QueueDiscipline::FqCodel(FqCodel::default()));
    assert!(isolated.len() > 40, "none is lost");
    // It waits for the packet that is being sent, which takes 1.2 ms.
    assert!(isolated.iter().all(|delay| *delay < 20.0 + 1.3 + 0.1), "{isolated:?}");
    let mixed = delays_of_a_sparse_flow(QueueDiscipline::DropTail);
    assert!(mixed.iter().all(|delay| *delay > 100.0), "{mixed:?}");
}

#[test]
fn capable_packets_are_marked_and_arrive_all() {
    let red = Red {
        thresholds: RedThresholds::Packets { min: 2, max: 60 },
        weight: Probability::new(0.5).unwrap(),
        ecn: true,
        ..Red::default()
    };
    let disciplines = [
        QueueDiscipline::Codel(Codel { ecn: true, ..Codel::default() }),
        QueueDiscipline::FqCodel(FqCodel { ecn: true, ..FqCodel::default() }),
        QueueDiscipline::Pie(Pie { ecn: true, ..Pie::default() }),
        QueueDiscipline::Red(red),
    ];
    for discipline in disciplines {
        for (ecn, is_capable) in [(0b10, true), (0b00, false)] {
            let mut fabric = bottleneck(discipline);
            (0..50).for_each(|number| fabric.push(ms(0.0), A, datagram(1, ecn, number, BYTES)));
            let mut out = run(&mut fabric, ms(0.0), ms(20.0));
            // As fast as the link sends, so that the queue neither grows nor shrinks.
            for i in 0..700 {
                let now = ms(20.0 + f64::from(i) * 1.2112);
                fabric.push(now, A, datagram(1, ecn, i, BYTES));
                out.extend(run(&mut fabric, now, now + Duration::from_micros(1211)));
            }
            out.extend(run(&mut fabric, ms(900.0), ms(2000.0)));
            let counters = context(&mut fabric, ms(2000.0), "a-b").counters;
            let marked = out.iter().filter(|delivery| delivery.frame.bytes()[15] & 3 == 3).count();
            assert_eq!(out.len() as u64 + counters.overflowed, 750);
            assert_eq!((marked > 0, counters.overflowed == 0), (is_capable, is_capable), "{discipline:?}");
            assert!(out.iter().all(|delivery| ones_complement(&delivery.frame.bytes()[14..34]) == 0xffff));
        }
    }
}

#[test]
fn another_discipline_in_place_keeps_what_waits() {
    let mut fabric = bottleneck(QueueDiscipline::DropTail);
    (0..60).for_each(|number| fabric.push(ms(0.0), A, frame(A, B, number, BYTES)));
    let fq = QueueDiscipline::FqCodel(FqCodel::default());
    let change = ConditionChange { queue_discipline: Some(fq), ..ConditionChange::default() };
    fabric.change(ms(1.0), &"a-b".parse().unwrap(), None, &change).unwrap();
    assert_eq!(context(&mut fabric, ms(1.0), "a-b").effective.queue_discipline, fq);
    assert_eq!(context(&mut fabric, ms(1.0), "a-b").effective.queue, LIMIT);
    assert_eq!(fabric.in_flight(), 60);
    let out = run(&mut fabric, ms(1.0), ms(1000.0));
    assert!(out.iter().map(|delivery| crate::common::number(&delivery.frame)).eq(0..60));
    assert!(fabric.balance().is_even());
}

#[test]
fn impossible_disciplines_are_rejected_with_a_reason() {
    let mut fabric = bottleneck(codel());
    let wrong = Codel { target: Duration::ZERO, ..Codel::default() };
    let change = ConditionChange {
        queue_discipline: Some(QueueDiscipline::Codel(wrong)),
        ..ConditionChange::default()
    };
    let error = fabric.change(ms(1.0), &"a-b".parse().unwrap(), None, &change).unwrap_err();
    assert!(error.to_string().contains("a target of 0ns cannot be"), "{error}");
    assert_eq!(context(&mut fabric, ms(1.0), "a-b").asked.queue_discipline, codel());
}
