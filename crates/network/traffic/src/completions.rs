//! Completion times of transfers, by their sizes.

use std::time::Duration;

use cotorra_numbers::{Gathered, Quantiles};

use crate::measured::{CompletionTimes, gather};

/// Largest sizes of all classes but the last, bytes: decades, because sizes span many.
const UP_TO: [u64; 4] = [10_000, 100_000, 1_000_000, 10_000_000];

/// Completion times of transfers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Completions {
    all: Class,
    by_size: [Class; UP_TO.len() + 1],
}

/// Transfers of a class of sizes.
#[derive(Debug, Clone, Default)]
struct Class {
    times_ms: Gathered,
    total_ms: f64,
    bytes: u64,
}

impl Class {
    fn add(&mut self, bytes: u64, took: Duration) {
        gather(&mut self.times_ms, took);
        self.total_ms += took.as_secs_f64() * 1e3;
        self.bytes += bytes;
    }

    fn measured(&self, up_to_bytes: Option<u64>) -> Option<CompletionTimes> {
        let transfers = self.times_ms.count();
        Some(CompletionTimes {
            up_to_bytes,
            arrived_transfers: transfers,
            mean_bytes: self.bytes as f64 / transfers as f64,
            mean_completion_ms: self.total_ms / transfers as f64,
            completion_ms: Quantiles::gathered(&self.times_ms)?,
        })
    }
}

impl Completions {
    /// Adds a transfer.
    pub(crate) fn add(&mut self, bytes: u64, took: Duration) {
        let class = UP_TO.partition_point(|&up_to| up_to < bytes);
        self.all.add(bytes, took);
        self.by_size[class].add(bytes, took);
    }

    /// Returns the times of all transfers, and those of each class with any.
    pub(crate) fn measured(&self) -> (Option<CompletionTimes>, Vec<CompletionTimes>) {
        let up_to = UP_TO.into_iter().map(Some).chain([None]);
        let classes = self.by_size.iter().zip(up_to).filter_map(|(class, up_to)| class.measured(up_to));
        (self.all.measured(None), classes.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfers_are_in_the_class_of_their_size() {
        let mut completions = Completions::default();
        assert_eq!(completions.measured(), (None, Vec::new()));
        for (bytes, ms) in [(1, 10), (10_000, 30), (10_001, 50), (20_000_000, 400)] {
            completions.add(bytes, Duration::from_millis(ms));
        }
        let (all, by_size) = completions.measured();
        let all = all.unwrap();
        assert_eq!((all.arrived_transfers, all.mean_completion_ms, all.completion_ms.p50), (4, 122.5, 40.0));
        let classes: Vec<_> =
            by_size.iter().map(|of| (of.up_to_bytes, of.arrived_transfers, of.mean_bytes)).collect();
        assert_eq!(
            classes,
            [(Some(10_000), 2, 5000.5), (Some(100_000), 1, 10_001.0), (None, 1, 20_000_000.0)]
        );
    }
}
