//! Statistics of the values of a figure.

use cotorra_graph::Statistic;
use cotorra_numbers::Gathered;

/// The values of a figure so far.
#[derive(Debug, Default)]
pub(super) struct Stream {
    values: Gathered,
    sum: f64,
    unanswered: u64,
}

impl Stream {
    pub(super) fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.values.add(value);
            self.sum += value;
        }
    }

    /// Adds a sample without an answer, which is greater than any value.
    pub(super) fn add_unanswered(&mut self) {
        self.unanswered += 1;
    }

    /// Returns the number of samples without an answer, and that of all samples.
    pub(super) fn unanswered(&self) -> (u64, u64) {
        (self.unanswered, self.unanswered + self.values.count())
    }

    /// Returns a statistic; `None` without values, and if samples without an answer make it greater than any value. Of more
    /// than a million values, quantiles are approximate.
    pub(super) fn of(&self, statistic: Statistic) -> Option<f64> {
        let sorted = self.values.sorted()?;
        let (unanswered, all) = self.unanswered();
        let last = self.values.count() - 1;
        let at = |share: f64| match share * (all - 1) as f64 {
            rank if rank > last as f64 => None,
            _ if last == 0 => Some(sorted.quantile(0.0).value),
            rank => Some(sorted.quantile(rank / last as f64).value),
        };
        match statistic {
            Statistic::Mean if unanswered > 0 => None,
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

    #[test]
    fn a_sample_without_an_answer_is_greater_than_any_value() {
        let mut stream = Stream::default();
        (0..=18).for_each(|value| stream.add(f64::from(value)));
        assert_eq!(stream.of(Statistic::Max), Some(18.0));
        stream.add_unanswered();
        assert_eq!(stream.unanswered(), (1, 20));
        // By the definition of the quantile, over 0, 1, … 18 and infinity.
        let all = Statistic::ALL.map(|statistic| stream.of(statistic));
        assert_eq!(all, [None, Some(0.0), Some(9.5), None, None, None]);
        let mut one = Stream::default();
        one.add(4.0);
        one.add_unanswered();
        assert_eq!((one.of(Statistic::Min), one.of(Statistic::P50)), (Some(4.0), None));
    }
}
