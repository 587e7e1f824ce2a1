//! Running statistics of service times for the live view. The report computes its own from the events.

use std::collections::BTreeMap;

use cotorra_graph::{ServiceId, ServiceTime};
use cotorra_numbers::quantile;

/// Statistics of the service times so far.
#[derive(Debug, Default)]
pub struct Tally {
    services: BTreeMap<ServiceId, Counted>,
    /// Times of answered requests of services in the total, in milliseconds, ascending.
    answered_ms: Vec<f64>,
}

/// Requests of a service.
#[derive(Debug, Default, Clone, Copy)]
struct Counted {
    /// Sequence number of the last one.
    last: Option<u32>,
    in_total: bool,
    total: usize,
    above: usize,
}

impl Tally {
    /// Counts a service's last sample, unless it was counted before.
    /// `in_total` is whether the service counts in the statistics of the whole run.
    pub fn count(&mut self, sample: &ServiceTime, target_ms: f64, in_total: bool) {
        let its = self.services.entry(sample.service.clone()).or_default();
        if its.last.replace(sample.sequence) == Some(sample.sequence) {
            return;
        }
        its.in_total = in_total;
        its.total += 1;
        let ms = sample.took.map(|took| took.as_secs_f64() * 1e3);
        its.above += usize::from(ms.is_none_or(|ms| ms > target_ms));
        if let Some(ms) = ms.filter(|_| in_total) {
            self.answered_ms.insert(self.answered_ms.partition_point(|&other| other <= ms), ms);
        }
    }

    /// Returns the median of answered requests.
    pub fn median_ms(&self) -> Option<f64> {
        quantile(&self.answered_ms, 0.5)
    }

    /// Returns the share of requests above their target, and the number of requests. Unanswered requests count as above.
    pub fn above(&self) -> Option<(f64, usize)> {
        let in_total = || self.services.values().filter(|its| its.in_total);
        let sum = |of: fn(&Counted) -> usize| in_total().map(of).sum::<usize>();
        share(sum(|its| its.above), sum(|its| its.total))
    }

    /// Returns the share of a service's requests within its target, and the number of requests.
    pub fn kept(&self, service: &ServiceId) -> Option<(f64, usize)> {
        let its = self.services.get(service)?;
        share(its.total - its.above, its.total)
    }
}

fn share(part: usize, of: usize) -> Option<(f64, usize)> {
    (of > 0).then(|| (part as f64 / of as f64, of))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cotorra_graph::Timestamp;
    use cotorra_graph_testing as base;
    use std::time::Duration;

    fn sample(sequence: u32, took_ms: Option<u64>) -> ServiceTime {
        ServiceTime {
            sequence,
            ..base::service_time("cloud", Timestamp::ZERO, took_ms.map(Duration::from_millis))
        }
    }

    #[test]
    fn each_sample_counts_once_and_an_unanswered_one_is_above_any_target() {
        let mut tally = Tally::default();
        assert_eq!((tally.median_ms(), tally.above()), (None, None));
        for (sequence, took) in [(0, Some(30)), (0, Some(30)), (1, Some(10)), (2, None), (3, Some(12))] {
            tally.count(&sample(sequence, took), 15.0, true);
        }
        assert_eq!(tally.median_ms(), Some(12.0));
        assert_eq!(tally.above(), Some((0.5, 4)));
    }

    #[test]
    fn each_service_has_its_own_share() {
        let mut tally = Tally::default();
        for (service, sequence, took) in
            [("a", 0, Some(10)), ("b", 0, Some(20)), ("a", 1, None), ("a", 1, None), ("apart", 0, Some(90))]
        {
            let in_total = service != "apart";
            let service = service.parse().unwrap();
            tally.count(&ServiceTime { service, ..sample(sequence, took) }, 15.0, in_total);
        }
        let kept = |service: &str| tally.kept(&service.parse().unwrap());
        assert_eq!(
            ["a", "b", "apart", "c"].map(kept),
            [Some((0.5, 2)), Some((0.0, 1)), Some((0.0, 1)), None]
        );
        assert_eq!(tally.above(), Some((2.0 / 3.0, 3)));
        assert_eq!(tally.median_ms(), Some(15.0), "of 10 and 20 ms");
    }
}
