//! Times that packets took over a path, one way or round trip.

use std::{collections::BTreeSet, time::Duration};

/// Times of packets in the order in which they were sent.
#[derive(Debug, Clone, PartialEq)]
pub struct PacketTimes {
    /// Milliseconds of each packet; `None` if it was lost.
    pub times_ms: Vec<Option<f64>>,
    /// Places in the series of the packets that arrived more than once.
    pub duplicated: BTreeSet<usize>,
    /// Number of packets that arrived behind one that was sent later.
    pub late: usize,
    /// Whether losses and duplicates were measured. If not, there are none in the series.
    pub counts_losses: bool,
    /// Usual time between two packets; `None` if it is unknown.
    pub interval: Option<Duration>,
    /// Size of a packet's Ethernet frame, and of its answer's.
    pub frame_bytes: [usize; 2],
    /// Notes on the measurement, for people.
    pub notes: Vec<String>,
}

impl PacketTimes {
    /// Returns the times of the packets that arrived, in order.
    pub fn arrived(&self) -> Vec<f64> {
        self.times_ms.iter().flatten().copied().collect()
    }

    /// Splits the series in two by time. `share` is that of the first part.
    pub fn split(&self, share: f64) -> [Self; 2] {
        let at = ((self.times_ms.len() as f64 * share).round() as usize).min(self.times_ms.len());
        [0..at, at..self.times_ms.len()].map(|part| Self {
            times_ms: self.times_ms[part.clone()].to_vec(),
            duplicated: self.duplicated.range(part.clone()).map(|place| place - part.start).collect(),
            ..self.clone()
        })
    }
}

/// Times of packets one way, in each direction of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct OneWay {
    /// Forward and backward; `None` for a direction that was not measured.
    pub ways: [Option<PacketTimes>; 2],
    /// The evidence of the times on the mean delay.
    pub means: Means,
    /// Notes on both directions, for people.
    pub notes: Vec<String>,
}

/// The evidence of one-way times on the mean delay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Means {
    /// Clocks were synchronised, and both means are measured.
    Measured,
    /// The difference of the clocks is unknown. The sum of both directions is measured, and each has half of the sum of the
    /// shortest times.
    Halves,
    /// The difference of the clocks is unknown, and packets went one way. Times begin at 0.
    Unknown,
}

/// Returns the middle one of values, the upper one of two; `None` without any. Other than a median, it is always one of them.
pub(crate) fn middle<T: PartialOrd + Copy>(mut values: Vec<T>) -> Option<T> {
    values.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    values.get(values.len() / 2).copied()
}
