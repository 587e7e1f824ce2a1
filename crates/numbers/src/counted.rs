//! Quantiles of many resamples of the same values.

use crate::gathered::between;

/// Values that are counted, so that quantiles of many resamples need no sorting.
#[derive(Debug, Clone)]
pub struct Counted {
    /// Distinct values, rising.
    values: Vec<f64>,
    /// Rank of each value of the series.
    ranks: Vec<usize>,
    counts: Vec<u32>,
}

impl Counted {
    /// Ranks a series, none of whose values is counted yet.
    pub fn new(series: &[f64]) -> Self {
        let mut values = series.to_vec();
        values.sort_unstable_by(f64::total_cmp);
        values.dedup();
        let ranks = series.iter().map(|v| values.partition_point(|below| below < v)).collect();
        Self { counts: vec![0; values.len()], values, ranks }
    }

    /// Counts nothing.
    pub fn clear(&mut self) {
        self.counts.fill(0);
    }

    /// Counts the value at an index of the series once more.
    pub fn add(&mut self, index: usize) {
        self.counts[self.ranks[index]] += 1;
    }

    /// Returns the quantiles at rising shares, by linear interpolation between closest ranks (type 7 of Hyndman and Fan); NaN
    /// if nothing is counted.
    pub fn quantiles<const N: usize>(&self, shares: [f64; N]) -> [f64; N] {
        let last = self.counts.iter().sum::<u32>().saturating_sub(1);
        let mut counted = self.counted().peekable();
        let (mut value, mut up_to) = (f64::NAN, 0);
        shares.map(|share| {
            let rank = share.clamp(0.0, 1.0) * f64::from(last);
            while f64::from(up_to) <= rank.floor() {
                let Some((next, count)) = counted.next() else { break };
                (value, up_to) = (next, up_to + count);
            }
            let is_next = f64::from(up_to) <= rank.ceil();
            let above = counted.peek().filter(|_| is_next).map_or(value, |(next, _)| *next);
            between(value, above, rank.fract())
        })
    }

    /// Returns each counted value and its number, rising.
    pub fn counted(&self) -> impl Iterator<Item = (f64, u32)> {
        self.values.iter().copied().zip(self.counts.iter().copied()).filter(|(_, count)| *count > 0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::quantile::quantile;

    proptest! {
        #[test]
        fn counted_values_have_the_quantiles_of_the_sorted_ones(
            series in vec((0..9_i32).prop_map(f64::from), 1..9), drawn in vec(0..1000_usize, 1..30),
            mut shares in [0.0..=1.0, 0.0..=1.0, 0.0..=1.0],
        ) {
            shares.sort_by(f64::total_cmp);
            let mut counted = Counted::new(&series);
            counted.add(0);
            counted.clear();
            let mut all: Vec<f64> = drawn.iter().map(|place| series[place % series.len()]).collect();
            drawn.iter().for_each(|place| counted.add(place % series.len()));
            all.sort_by(f64::total_cmp);
            prop_assert_eq!(counted.quantiles(shares), shares.map(|share| quantile(&all, share).unwrap()));
        }
    }

    #[test]
    fn nothing_counted_has_no_quantile() {
        assert!(Counted::new(&[1.0]).quantiles([0.5])[0].is_nan());
    }
}
