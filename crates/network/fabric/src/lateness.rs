//! Lateness of frames: how much later than its due time each one was handed out. A run reports it to show whether its
//! figures are the network's or the emulator's.

use std::time::Duration;

use cotorra_graph::Lateness;

/// Values below this many nanoseconds share the first octave.
const FINEST_BITS: u32 = 6;
/// Buckets in an octave, as a power of two. The width of a bucket is at most 1/32 of its values.
const STEPS_BITS: u32 = 5;
const STEPS: usize = 1 << STEPS_BITS;
/// Octaves above the first, up to 2^36 ns (more than a minute). The last bucket takes all larger values.
const OCTAVES: usize = 36 - (FINEST_BITS + STEPS_BITS) as usize;
const BUCKETS: usize = STEPS * (OCTAVES + 1);

/// A log-linear histogram of lateness. Its size is fixed, so that recording allocates nothing.
#[derive(Debug, Clone)]
pub struct Histogram {
    buckets: Box<[u64; BUCKETS]>,
    frames: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { buckets: Box::new([0; BUCKETS]), frames: 0, max_ns: 0 }
    }
}

impl Histogram {
    /// Records the lateness of a frame.
    pub fn record(&mut self, late: Duration) {
        let ns = late.as_nanos() as u64;
        self.buckets[bucket(ns)] += 1;
        self.frames += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// Returns count, quantiles and maximum.
    pub fn summary(&self) -> Lateness {
        Lateness {
            frames: self.frames,
            p50_us: self.quantile_us(0.50),
            p99_us: self.quantile_us(0.99),
            max_us: self.max_ns as f64 / 1e3,
        }
    }

    /// Returns the middle of the bucket that holds the quantile, µs.
    fn quantile_us(&self, quantile: f64) -> f64 {
        let rank = (self.frames as f64 * quantile).ceil() as u64;
        let mut seen = 0;
        for (i, count) in self.buckets.iter().enumerate() {
            seen += count;
            if *count > 0 && seen >= rank {
                // Without any lateness, the quantile is exactly 0.
                let middle = if self.max_ns == 0 { 0 } else { (lower(i) + lower(i + 1)) / 2 };
                return middle.min(self.max_ns) as f64 / 1e3;
            }
        }
        0.0
    }
}

/// Returns the bucket of a value.
fn bucket(ns: u64) -> usize {
    let value = ns >> FINEST_BITS;
    let octave = (u64::BITS - value.leading_zeros()).saturating_sub(STEPS_BITS + 1);
    // Above the first octave, the leading bit of `value >> octave` adds one octave to the index.
    (((octave as usize) << STEPS_BITS) + (value >> octave) as usize).min(BUCKETS - 1)
}

/// Returns the smallest value of a bucket.
fn lower(bucket: usize) -> u64 {
    if bucket < 2 * STEPS {
        return (bucket as u64) << FINEST_BITS;
    }
    let octave = (bucket >> STEPS_BITS) - 1;
    ((bucket - (octave << STEPS_BITS)) as u64) << (octave as u32 + FINEST_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket() {
        for shift in 0..36 {
            for ns in [1u64 << shift, (1 << shift) + 1, (3 << shift) / 2, (2 << shift) - 1] {
                let i = bucket(ns);
                assert!(lower(i) <= ns && (ns < lower(i + 1) || i == BUCKETS - 1), "{ns} in {i}");
                let width = (lower(i + 1) - lower(i)) as f64;
                assert!(width <= 64.0 || width / ns as f64 <= 1.0 / 32.0 || i == BUCKETS - 1);
            }
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn quantiles_match_the_recorded_values() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.summary(), Lateness::default());
        (1..=1000).for_each(|us| histogram.record(Duration::from_micros(us)));
        let summary = histogram.summary();
        assert_eq!((summary.frames, summary.max_us), (1000, 1000.0));
        assert!((summary.p50_us / 500.0 - 1.0).abs() < 0.02, "{}", summary.p50_us);
        assert!((summary.p99_us / 990.0 - 1.0).abs() < 0.02, "{}", summary.p99_us);
    }

    #[test]
    fn punctual_frames_have_zero_lateness() {
        let mut histogram = Histogram::default();
        (0..10).for_each(|_| histogram.record(Duration::ZERO));
        assert_eq!(histogram.summary(), Lateness { frames: 10, ..Lateness::default() });
    }
}
