//! Measures one direction of a link, wired or wireless: packets and bytes since the run began; delay, throughput and the
//! longest queue over the last second.

use std::time::Duration;

use cotorra_graph::{LinkCounters, Timestamp};

/// Slices of the last second.
const SLICES: usize = 20;
const SLICE_NS: u64 = 1_000_000_000 / SLICES as u64;

/// Counts what crosses one direction of a link.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter {
    /// Packets and bytes since the run began.
    pub(crate) counters: LinkCounters,
    slices: [Slice; SLICES],
}

/// Counters of one slice of time.
#[derive(Debug, Clone, Copy, Default)]
struct Slice {
    /// Number of the slice since the run began.
    number: u64,
    packets: u64,
    bytes: u64,
    delay_ns: u64,
    /// The most packets that waited at a time.
    queued: u64,
}

impl Meter {
    /// Records packets that crossed the link.
    pub(crate) fn crossed(&mut self, entered: Timestamp, left: Timestamp, packets: u32, bytes: u64) {
        let packets = u64::from(packets);
        self.counters.packets += packets;
        self.counters.bytes += bytes;
        let slice = self.slice(left);
        slice.packets += packets;
        slice.bytes += bytes;
        slice.delay_ns += left.as_nanos().saturating_sub(entered.as_nanos()) * packets;
    }

    /// Records that so many packets waited in the queue until `now`.
    pub(crate) fn queued(&mut self, now: Timestamp, packets: u64) {
        let slice = self.slice(now);
        slice.queued = slice.queued.max(packets);
    }

    /// Returns d, the mean time that packets took over the last second; `None` if none crossed.
    pub(crate) fn delay(&self, now: Timestamp) -> Option<Duration> {
        let (packets, delay_ns) =
            self.last_second(now).fold((0, 0u64), |(p, d), s| (p + s.packets, d.saturating_add(s.delay_ns)));
        delay_ns.checked_div(packets).map(Duration::from_nanos)
    }

    /// Returns λ, the throughput over the last second, bit/s.
    pub(crate) fn throughput_bps(&self, now: Timestamp) -> f64 {
        let bytes: u64 = self.last_second(now).map(|s| s.bytes).sum();
        // The current slice is not over, and a run may be younger than a second.
        let covered = now.as_nanos().min((SLICES as u64 - 1) * SLICE_NS + now.as_nanos() % SLICE_NS);
        bytes as f64 * 8e9 / covered.max(SLICE_NS) as f64
    }

    /// Returns the most packets that waited at a time over the last second. `waiting` of them wait now.
    pub(crate) fn most_queued(&self, now: Timestamp, waiting: u64) -> u64 {
        self.last_second(now).fold(waiting, |most, s| most.max(s.queued))
    }

    /// Returns the slice of a time, emptied if it was that of an earlier second.
    fn slice(&mut self, at: Timestamp) -> &mut Slice {
        let number = at.as_nanos() / SLICE_NS;
        let slice = &mut self.slices[(number % SLICES as u64) as usize];
        if slice.number != number {
            *slice = Slice { number, ..Slice::default() };
        }
        slice
    }

    fn last_second(&self, now: Timestamp) -> impl Iterator<Item = &Slice> {
        let number = now.as_nanos() / SLICE_NS;
        self.slices.iter().filter(move |s| s.number <= number && number - s.number < SLICES as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn delay_and_throughput_cover_the_last_second_and_counters_the_run() {
        let mut meter = Meter::default();
        assert_eq!((meter.delay(at(0)), meter.throughput_bps(at(0))), (None, 0.0));
        // 1 Mbit/s for three seconds, 7 ms per packet.
        for i in 0..3000 {
            meter.crossed(at(i), at(i + 7), 1, 125);
        }
        let now = at(3007);
        assert_eq!(meter.delay(now), Some(Duration::from_millis(7)));
        assert!((meter.throughput_bps(now) / 1e6 - 1.0).abs() < 0.01, "{}", meter.throughput_bps(now));
        assert_eq!((meter.counters.packets, meter.counters.bytes), (3000, 375_000));
        assert_eq!((meter.delay(at(4100)), meter.throughput_bps(at(4100))), (None, 0.0));
    }

    #[test]
    fn the_longest_queue_is_that_of_the_last_second_or_of_now() {
        let mut meter = Meter::default();
        assert_eq!(meter.most_queued(at(0), 0), 0);
        [(100, 5), (120, 3), (600, 4)].into_iter().for_each(|(ms, packets)| meter.queued(at(ms), packets));
        assert_eq!((meter.most_queued(at(700), 2), meter.most_queued(at(700), 6)), (5, 6));
        assert_eq!(meter.most_queued(at(1200), 0), 4);
        // The slice of another second is not taken for this one.
        meter.queued(at(1100), 1);
        assert_eq!(meter.most_queued(at(1700), 0), 1);
        // A queue that stands still.
        assert_eq!(meter.most_queued(at(9000), 2), 2);
        assert_eq!((meter.delay(at(600)), meter.counters.packets), (None, 0));
    }

    #[test]
    fn throughput_is_right_in_the_first_second() {
        let mut meter = Meter::default();
        (0..100).for_each(|i| meter.crossed(at(i), at(i), 1, 125));
        assert!((meter.throughput_bps(at(100)) / 1e6 - 1.0).abs() < 0.02);
    }
}
