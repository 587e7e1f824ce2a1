//! CoDel (RFC 8289): drops packets at the head of a queue while the least time that packets wait stays above a target for
//! an interval.

use cotorra_graph::{Codel as Parameters, Timestamp};

use super::{Queued, fifo::Fifo};

/// State of CoDel for one queue, in the terms of RFC 8289, section 5.
#[derive(Debug)]
pub(super) struct Codel {
    parameters: Parameters,
    /// When a packet may be dropped, if the time in the queue stays above the target until then.
    first_above: Option<Timestamp>,
    dropping: bool,
    /// Time of the next drop, or of the one that did not come any more.
    drop_next: Timestamp,
    /// Drops since dropping began; begins at 1.
    count: u32,
    /// `count` when dropping began.
    last_count: u32,
}

/// Intervals after the end of dropping in which it may go on at about the rate that it had (RFC 8289, section 5).
const RECENT_INTERVALS: u32 = 16;

impl Codel {
    pub fn new(parameters: Parameters) -> Self {
        let drop_next = Timestamp::ZERO;
        Self { parameters, first_above: None, dropping: false, drop_next, count: 0, last_count: 0 }
    }

    /// Takes the next packet to send out of the queue (RFC 8289, section 5). Calls `drop` with every packet that is
    /// dropped before it.
    pub fn pop<P: Queued>(
        &mut self,
        now: Timestamp,
        queue: &mut Fifo<P>,
        drop: &mut dyn FnMut(P),
    ) -> Option<P> {
        let Some((mut packet, above)) = self.next(now, queue) else {
            self.dropping = false;
            return None;
        };
        if !self.dropping {
            if !above {
                return Some(packet);
            }
            self.begin(now);
            if self.marks(&mut packet) {
                return Some(packet);
            }
            drop(packet);
            return self.next(now, queue).map(|(packet, _)| packet);
        }
        self.dropping = above;
        while self.dropping && now >= self.drop_next {
            self.count = self.count.saturating_add(1);
            if self.marks(&mut packet) {
                self.drop_next = self.after(self.drop_next);
                return Some(packet);
            }
            drop(packet);
            let Some((next, above)) = self.next(now, queue) else {
                self.dropping = false;
                return None;
            };
            packet = next;
            self.dropping = above;
            if above {
                self.drop_next = self.after(self.drop_next);
            }
        }
        Some(packet)
    }

    /// Takes the packet at the head, and says whether packets waited above the target for an interval.
    fn next<P: Queued>(&mut self, now: Timestamp, queue: &mut Fifo<P>) -> Option<(P, bool)> {
        let Some(packet) = queue.pop() else {
            self.first_above = None;
            return None;
        };
        let waited = now.since(packet.entered());
        if waited < self.parameters.target || queue.bytes() <= P::SPARED {
            self.first_above = None;
            return Some((packet, false));
        }
        let first_above = *self.first_above.get_or_insert(now + self.parameters.interval);
        Some((packet, now >= first_above))
    }

    /// Begins to drop. If it dropped until recently, it goes on at about the rate that controlled the queue then.
    fn begin(&mut self, now: Timestamp) {
        self.dropping = true;
        let delta = self.count - self.last_count;
        let recently = now.since(self.drop_next) < self.parameters.interval * RECENT_INTERVALS;
        self.count = if delta > 1 && recently { delta } else { 1 };
        self.last_count = self.count;
        self.drop_next = self.after(now);
    }

    /// The control law: the time of the drop after one at `time`, interval/√count later.
    fn after(&self, time: Timestamp) -> Timestamp {
        time + self.parameters.interval.div_f64(f64::from(self.count).sqrt())
    }

    fn marks(&self, packet: &mut impl Queued) -> bool {
        self.parameters.ecn && packet.mark()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::queue::testing::{TestPacket, ms, packet};

    /// A queue that is overloaded: every packet waited 20 ms when its turn comes, one each millisecond.
    struct Overload {
        codel: Codel,
        queue: Fifo<TestPacket>,
        next: u32,
        drops: Vec<f64>,
    }

    impl Overload {
        fn new(parameters: Parameters) -> Self {
            Self { codel: Codel::new(parameters), queue: Fifo::default(), next: 0, drops: vec![] }
        }

        /// Takes a packet at each millisecond of the range. They came so many milliseconds before.
        fn run(&mut self, at_ms: std::ops::Range<u32>, waited_ms: f64) -> Vec<TestPacket> {
            self.run_with(at_ms, waited_ms, false)
        }

        fn run_with(
            &mut self,
            at_ms: std::ops::Range<u32>,
            waited_ms: f64,
            is_capable: bool,
        ) -> Vec<TestPacket> {
            let mut sent = Vec::new();
            for at in at_ms.map(f64::from) {
                self.queue.drain().for_each(drop);
                for _ in 0..20 {
                    let came = packet(self.next, ms(at - waited_ms));
                    self.queue.push(TestPacket { is_capable, ..came });
                    self.next += 1;
                }
                let drops = &mut self.drops;
                sent.extend(self.codel.pop(ms(at), &mut self.queue, &mut |_| drops.push(at)));
            }
            sent
        }
    }

    #[test]
    fn packets_are_dropped_after_an_interval_above_the_target() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..200, 5.0);
        assert_eq!(overload.drops, [0.0; 0]);
        overload.run(200..201, 5.0);
        assert_eq!(overload.drops, [200.0]);
    }

    #[test]
    fn nothing_is_dropped_below_the_target() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..1000, 4.99);
        assert_eq!(overload.drops, [0.0; 0]);
    }

    #[test]
    fn a_short_wait_starts_the_interval_anew() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..199, 20.0);
        overload.run(199..200, 1.0);
        overload.run(200..300, 20.0);
        assert_eq!(overload.drops, [0.0; 0]);
        overload.run(300..301, 20.0);
        assert_eq!(overload.drops, [300.0]);
    }

    #[test]
    fn the_last_full_frame_is_never_dropped() {
        let mut codel = Codel::new(Parameters::default());
        let mut queue = Fifo::default();
        for at in (100..1000).map(f64::from) {
            (0..2).for_each(|number| queue.push(packet(number, ms(at - 50.0))));
            for _ in 0..2 {
                codel.pop(ms(at), &mut queue, &mut |packet| panic!("{packet:?} is dropped")).unwrap();
            }
        }
    }

    /// The drop after the n-th one of a phase comes interval/√n later (RFC 8289, section 3).
    #[test]
    fn drops_follow_the_control_law() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..1000, 20.0);
        let mut next = 200.0;
        let mut expected = vec![200.0];
        for count in 1.. {
            next += 100.0 / f64::from(count).sqrt();
            if next > 999.0 {
                break;
            }
            // Packets leave at whole milliseconds.
            expected.push(next.ceil());
        }
        assert!(expected.len() > 10);
        assert_eq!(overload.drops, expected);
    }

    #[test]
    fn dropping_ends_when_packets_wait_less_than_the_target() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..500, 20.0);
        assert!(overload.codel.dropping);
        let drops = overload.drops.len();
        overload.run(500..501, 1.0);
        assert!(!overload.codel.dropping);
        overload.run(501..601, 20.0);
        assert_eq!(overload.drops.len(), drops);
    }

    /// RFC 8289, section 5: a phase soon after another goes on from its rate, a later one begins anew.
    #[test]
    fn a_phase_soon_after_another_goes_on_at_its_rate() {
        for (pause_ms, goes_on) in [(1, true), (2000, false)] {
            let mut overload = Overload::new(Parameters::default());
            overload.run(100..1000, 20.0);
            let count = overload.codel.count;
            assert!(count > 10);
            overload.run(1000..1000 + pause_ms, 1.0);
            overload.run(1000 + pause_ms..1101 + pause_ms, 20.0);
            assert!(overload.codel.dropping);
            let expected = if goes_on { count - 1 } else { 1 };
            assert_eq!([overload.codel.count, overload.codel.last_count], [expected; 2]);
        }
    }

    #[test]
    fn an_empty_queue_ends_dropping() {
        let mut overload = Overload::new(Parameters::default());
        overload.run(100..500, 20.0);
        overload.queue.drain().for_each(drop);
        assert_eq!(overload.codel.pop(ms(500.0), &mut overload.queue, &mut |_| ()), None);
        assert!(!overload.codel.dropping);
        assert_eq!(overload.codel.first_above, None);
    }

    #[test]
    fn capable_packets_are_marked_when_others_would_be_dropped() {
        let [mut marking, mut dropping] =
            [true, false].map(|ecn| Overload::new(Parameters { ecn, ..Parameters::default() }));
        let sent = marking.run_with(100..1000, 20.0, true);
        dropping.run_with(100..1000, 20.0, true);
        assert_eq!(marking.drops, [0.0; 0]);
        assert_eq!(sent.len(), 900);
        let marked = sent.iter().filter(|packet| packet.is_marked);
        let times: Vec<_> = marked.map(|packet| packet.entered.as_nanos() as f64 / 1e6 + 20.0).collect();
        assert_eq!(times, dropping.drops);
        // Without ECN-capable packets, marking drops as well.
        let mut incapable = Overload::new(Parameters { ecn: true, ..Parameters::default() });
        incapable.run(100..1000, 20.0);
        assert_eq!(incapable.drops, dropping.drops);
    }

    #[test]
    fn the_target_and_the_interval_are_the_given_ones() {
        let ms = Duration::from_millis;
        let mut overload = Overload::new(Parameters { target: ms(10), interval: ms(200), ecn: false });
        overload.run(100..400, 9.9);
        overload.run(400..600, 10.0);
        assert_eq!(overload.drops, [0.0; 0]);
        overload.run(600..900, 10.0);
        assert_eq!(overload.drops, [600.0, 800.0]);
    }
}
