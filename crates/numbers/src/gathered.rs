//! Quantiles of any number of samples in bounded memory.

use crate::interval::Interval;

/// Most samples that are all kept. With fewer, quantiles are exact.
const EXACT: usize = 1 << 20;
/// Most values of a level after that.
const BLOCK: usize = 1 << 16;

/// Samples that are being gathered for quantiles.
///
/// The first million, i.e. 2²⁰, are all kept, in 8 MiB. Of more, a sorted block gives every second value to the next level,
/// where each value stands for twice as many samples. That moves the rank of any value by less than one of the values
/// ([`Sorted::quantile`] returns what follows from the sum of all that; see Manku, Rajagopalan and Lindsay, "Approximate
/// Medians and other Quantiles in One Pass and with Limited Memory", 1998).
#[derive(Debug, Clone, Default)]
pub struct Gathered {
    /// Values that stand for 2^level samples each.
    levels: Vec<Vec<f64>>,
    /// The values of a level's next block that are passed on.
    odd: Vec<bool>,
    /// Most by which the rank of a value can be wrong.
    error: u64,
    count: u64,
    /// Least and greatest sample.
    ends: Option<Interval>,
}

/// A quantile, and the values between which that of all samples is for certain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Approximate {
    /// Best value.
    pub value: f64,
    /// Its bounds; both are the value if it is exact.
    pub within: Interval,
}

impl Gathered {
    /// Adds a sample.
    pub fn add(&mut self, value: f64) {
        self.add_times(value, 1);
    }

    /// Adds a number of equal samples.
    pub fn add_times(&mut self, value: f64, times: u64) {
        if times == 0 {
            return;
        }
        let ends = self.ends.get_or_insert(Interval { low: value, high: value });
        *ends = Interval { low: ends.low.min(value), high: ends.high.max(value) };
        self.count += times;
        for level in (0..64).filter(|level| times >> level & 1 == 1) {
            self.push(level, value);
        }
    }

    /// Returns the number of samples.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Forgets all samples, and keeps their memory.
    pub fn clear(&mut self) {
        let mut levels = std::mem::take(&mut self.levels);
        levels.iter_mut().for_each(Vec::clear);
        *self = Self { levels, ..Self::default() };
    }

    fn push(&mut self, level: usize, value: f64) {
        self.grow(level);
        self.levels[level].push(value);
        let mut level = level;
        while self.levels[level].len() >= if self.error == 0 { EXACT } else { BLOCK } {
            self.compact(level);
            level += 1;
        }
    }

    fn grow(&mut self, level: usize) {
        let least = level + 1;
        self.levels.resize_with(self.levels.len().max(least), Vec::new);
        self.odd.resize(self.odd.len().max(least), false);
    }

    /// Passes every second value of a level on to the next.
    fn compact(&mut self, level: usize) {
        self.grow(level + 1);
        let (this, next) = self.levels.split_at_mut(level + 1);
        let values = &mut this[level];
        // One is left if their number is odd.
        let rest = if values.len() % 2 == 1 { values.pop() } else { None };
        values.sort_unstable_by(f64::total_cmp);
        next[0].extend(values.iter().skip(usize::from(self.odd[level])).step_by(2));
        values.clear();
        values.extend(rest);
        self.odd[level] = !self.odd[level];
        self.error += 1 << level;
    }

    /// Returns the samples in order; `None` without samples.
    pub fn sorted(&self) -> Option<Sorted> {
        let ends = self.ends?;
        let levels = self.levels.iter().enumerate();
        let mut values: Vec<(f64, u64)> =
            levels.flat_map(|(level, its)| its.iter().map(move |value| (*value, 1 << level))).collect();
        values.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
        let mut up_to = 0;
        values.iter_mut().for_each(|(_, times)| {
            up_to += *times;
            *times = up_to;
        });
        Some(Sorted { values, count: self.count, error: self.error, ends })
    }
}

/// Samples in order.
#[derive(Debug, Clone)]
pub struct Sorted {
    /// Each value with the number of samples up to it.
    values: Vec<(f64, u64)>,
    count: u64,
    error: u64,
    ends: Interval,
}

impl Sorted {
    /// Whether quantiles are approximate, because there were more samples than are kept.
    pub fn is_approximate(&self) -> bool {
        self.error > 0
    }

    /// Returns the quantile at a share, which is clamped to 0 … 1, by linear interpolation between closest ranks (type 7 of
    /// Hyndman and Fan).
    pub fn quantile(&self, share: f64) -> Approximate {
        let last = self.count - 1;
        let rank = share.clamp(0.0, 1.0) * last as f64;
        let (below, above) = (rank.floor() as u64, rank.ceil() as u64);
        let value = match share {
            ..=0.0 => self.ends.low,
            1.0.. => self.ends.high,
            _ => between(self.at(below), self.at(above), rank.fract()),
        };
        let within = if self.error == 0 {
            Interval { low: value, high: value }
        } else {
            let low = below.checked_sub(self.error).map_or(self.ends.low, |rank| self.at(rank));
            let high = above + self.error;
            Interval { low, high: if high > last { self.ends.high } else { self.at(high) } }
        };
        Approximate { value, within }
    }

    /// Returns the value of a rank, from 0.
    fn at(&self, rank: u64) -> f64 {
        let place = self.values.partition_point(|(_, up_to)| *up_to <= rank);
        self.values.get(place).map_or(self.ends.high, |(value, _)| *value)
    }
}

/// Interpolates between two values that follow each other.
pub(crate) fn between(low: f64, high: f64, fraction: f64) -> f64 {
    // Equal values may be infinite. Rounding may otherwise lead past the upper one.
    if low == high { low } else { (low + (high - low) * fraction).min(high) }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::quantile::quantile;

    const SHARES: [f64; 6] = [0.0, 0.01, 0.5, 0.95, 0.99, 1.0];

    proptest! {
        #[test]
        fn gathered_samples_have_the_quantiles_of_all(mut values in vec(-1e6..1e6, 1..300), share in 0.0..=1.0) {
            let mut gathered = Gathered::default();
            values.iter().for_each(|value| gathered.add(*value));
            values.sort_by(f64::total_cmp);
            let Approximate { value, within } = gathered.sorted().unwrap().quantile(share);
            prop_assert_eq!(Some(value), quantile(&values, share));
            prop_assert_eq!(within, Interval { low: value, high: value });
        }

        #[test]
        fn equal_samples_count_as_often_as_they_are(
            values in vec((-1e6..1e6, 0_u64..20), 1..60), share in 0.0..=1.0,
        ) {
            let mut gathered = Gathered::default();
            values.iter().for_each(|(value, times)| gathered.add_times(*value, *times));
            let mut all: Vec<f64> =
                values.iter().flat_map(|(value, times)| std::iter::repeat_n(*value, *times as usize)).collect();
            all.sort_by(f64::total_cmp);
            prop_assert_eq!(gathered.count(), all.len() as u64);
            prop_assert_eq!(gathered.sorted().map(|sorted| sorted.quantile(share).value), quantile(&all, share));
        }
    }

    #[test]
    fn quantiles_of_too_many_samples_are_within_their_bounds() {
        const COUNT: u64 = 5_000_000;
        // Once in disorder and once rising: the samples 0 to COUNT - 1.
        for step in [1_999_993, 1] {
            let mut gathered = Gathered::default();
            (0..COUNT).for_each(|n| gathered.add((n * step % COUNT) as f64));
            assert_eq!(gathered.count(), COUNT);
            let kept: usize = gathered.levels.iter().map(Vec::len).sum();
            assert!(kept < EXACT, "{kept}");
            let sorted = gathered.sorted().unwrap();
            for share in SHARES {
                let Approximate { value, within } = sorted.quantile(share);
                let right = share * (COUNT - 1) as f64;
                assert!(within.low <= right && right <= within.high, "{share}: {within:?}");
                assert!(within.low <= value && value <= within.high, "{share}: {value} {within:?}");
                assert!(within.high - within.low < 0.001 * COUNT as f64, "{share}: {within:?}");
            }
        }
    }

    #[test]
    fn cleared_samples_leave_nothing() {
        let mut gathered = Gathered::default();
        gathered.add_times(3.0, 5);
        gathered.clear();
        assert!(gathered.sorted().is_none());
        gathered.add(4.0);
        assert_eq!(gathered.sorted().unwrap().quantile(0.5).value, 4.0);
    }
}
