//! Statistics of the values of a figure.

use cotorra_graph::Statistic;
use cotorra_numbers::Gathered;

/// The values of a figure so far.
#[derive(Debug, Default)]
pub(super) struct Stream {
    values: Gathered,
    sum: f64,
}

impl Stream {
    pub(super) fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.values.add(value);
            self.sum += value;
        }
    }

    /// Returns a statistic; `None` without values. Of more than a million values, quantiles are approximate.
    pub(super) fn of(&self, statistic: Statistic) -> Option<f64> {
        let sorted = self.values.sorted()?;
        let at = |share| Some(sorted.quantile(share).value);
        match statistic {
            Statistic::Mean => Some(self.sum / self.values.count() as f64),
            Statistic::Min => at(0.0),
            Statistic::P50 => at(0.5),
            Statistic::P95 => at(0.95),
            Statistic::P99 => at(0.99),
            Statistic::Max => at(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_those_of_all_values_and_none_without() {
        let mut stream = Stream::default();
        assert_eq!(stream.of(Statistic::Mean), None);
        [3.0, f64::NAN, 1.0, 8.0].into_iter().for_each(|value| stream.add(value));
        let all = Statistic::ALL.map(|statistic| stream.of(statistic).unwrap());
        assert_eq!((all[0], all[1], all[2], all[5]), (4.0, 1.0, 3.0, 8.0));
        assert!(all[3] < all[4] && all[4] < all[5], "{all:?}");
    }
}
