//! Service times as they come, for the live view; the report counts them all again from the events.

use std::collections::BTreeMap;

use cotorra_graph::{NodeId, ServiceTime};

/// Service times so far.
#[derive(Debug, Default)]
pub struct Tally {
    /// The last packet that was counted, robot by robot.
    counted: BTreeMap<NodeId, u32>,
    /// Answered ones in milliseconds, ascending.
    answered_ms: Vec<f64>,
    total: usize,
}

impl Tally {
    /// Counts a robot's last service time, once.
    pub fn count(&mut self, sample: &ServiceTime) {
        if self.counted.insert(sample.robot.clone(), sample.sequence) == Some(sample.sequence) {
            return;
        }
        self.total += 1;
        if let Some(took) = sample.took {
            let ms = took.as_secs_f64() * 1e3;
            self.answered_ms.insert(self.answered_ms.partition_point(|&other| other <= ms), ms);
        }
    }

    /// The median of the answered ones.
    pub fn median_ms(&self) -> Option<f64> {
        self.answered_ms.get(self.answered_ms.len() / 2).copied()
    }

    /// The share of all that took longer than the target, unanswered ones among them.
    pub fn above(&self, target_ms: f64) -> Option<f64> {
        let within = self.answered_ms.partition_point(|&ms| ms <= target_ms);
        (self.total > 0).then(|| (self.total - within) as f64 / self.total as f64)
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
        assert_eq!((tally.median_ms(), tally.above(15.0)), (None, None));
        for (sequence, took) in [(0, Some(30)), (0, Some(30)), (1, Some(10)), (2, None), (3, Some(12))] {
            tally.count(&sample(sequence, took));
        }
        assert_eq!(tally.median_ms(), Some(12.0));
        assert_eq!(tally.above(15.0), Some(0.5));
    }
}
