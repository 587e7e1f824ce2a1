//! Running statistics of service times for the live view. The report computes its own from the events.

use std::collections::BTreeMap;

use cotorra_graph::{ServiceId, ServiceTime};

/// Statistics of the service times so far.
#[derive(Debug, Default)]
pub struct Tally {
    /// Sequence number of the last counted request of each service.
    counted: BTreeMap<ServiceId, u32>,
    /// Times of answered requests in milliseconds, ascending.
    answered_ms: Vec<f64>,
    total: usize,
    above: usize,
}

impl Tally {
    /// Counts a service's last sample, unless it was counted before.
    pub fn count(&mut self, sample: &ServiceTime, target_ms: f64) {
        if self.counted.insert(sample.service.clone(), sample.sequence) == Some(sample.sequence) {
            return;
        }
        self.total += 1;
        let ms = sample.took.map(|took| took.as_secs_f64() * 1e3);
        self.above += usize::from(ms.is_none_or(|ms| ms > target_ms));
        if let Some(ms) = ms {
            self.answered_ms.insert(self.answered_ms.partition_point(|&other| other <= ms), ms);
        }
    }

    /// Returns the median of answered requests.
    pub fn median_ms(&self) -> Option<f64> {
        self.answered_ms.get(self.answered_ms.len() / 2).copied()
    }

    /// Returns the share of requests above their target. Unanswered requests count as above.
    pub fn above(&self) -> Option<f64> {
        (self.total > 0).then(|| self.above as f64 / self.total as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cotorra_graph::Timestamp;
    use std::time::Duration;

    fn sample(sequence: u32, took_ms: Option<u64>) -> ServiceTime {
        ServiceTime {
            service: "navigation".parse().unwrap(),
            robot: "robot".parse().unwrap(),
            sequence,
            emitted: Timestamp::ZERO,
            took: took_ms.map(Duration::from_millis),
            attachment: None,
            server: "cloud".parse().unwrap(),
        }
    }

    #[test]
    fn each_sample_counts_once_and_an_unanswered_one_is_above_any_target() {
        let mut tally = Tally::default();
        assert_eq!((tally.median_ms(), tally.above()), (None, None));
        for (sequence, took) in [(0, Some(30)), (0, Some(30)), (1, Some(10)), (2, None), (3, Some(12))] {
            tally.count(&sample(sequence, took), 15.0);
        }
        assert_eq!(tally.median_ms(), Some(12.0));
        assert_eq!(tally.above(), Some(0.5));
    }
}
