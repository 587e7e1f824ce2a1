//! Turns of the lidar, from its samples.

use std::{f64::consts::PI, mem, time::Duration};

use cotorra_graph::Timestamp;

/// One sample of a lidar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Radians clockwise from the lidar's front, in [0, 2π).
    pub angle: f64,
    /// Metres; `None` if none was measured.
    pub range: Option<f32>,
}

/// One turn of a lidar.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Turn {
    /// Time of the first sample.
    pub at: Timestamp,
    /// Time until the first sample of the next turn.
    pub period: Duration,
    /// The samples, in the order in which they were measured.
    pub samples: Vec<Sample>,
}

impl Turn {
    /// Samples of a turn at most: an A2 has 1600 at its fastest samples and slowest turns.
    pub const MOST_SAMPLES: usize = 4096;
    /// Longest time of a turn that makes sense: an A2 takes 0.2 s at its slowest.
    pub const LONGEST_PERIOD: Duration = Duration::from_secs(10);
}

/// Collects samples into turns.
///
/// A turn begins where the angle falls (LR001: "a new scan starts at a measurement point whose raw angle is smaller than
/// the previous one"). The one that was under way when the lidar began to measure is left out.
#[derive(Debug, Clone, Default)]
pub(super) struct Turns {
    under_way: Turn,
    is_whole: bool,
    last: Option<f64>,
    complete: Option<Turn>,
}

impl Turns {
    /// Takes a sample of this time.
    pub fn add(&mut self, at: Timestamp, sample: Sample) {
        let begins = self.last.is_some_and(|last| sample.angle < last - PI);
        self.last = Some(sample.angle);
        if begins {
            let done = mem::take(&mut self.under_way);
            if mem::replace(&mut self.is_whole, true) {
                self.complete = Some(Turn { period: at.since(done.at), ..done });
            }
        }
        if self.under_way.samples.is_empty() {
            self.under_way.at = at;
        }
        if self.is_whole && self.under_way.samples.len() < Turn::MOST_SAMPLES {
            self.under_way.samples.push(sample);
        }
    }

    /// Begins anew: the turn under way is lost.
    pub fn restart(&mut self) {
        *self = Self { complete: self.complete.take(), ..Self::default() };
    }

    /// Returns the last complete turn.
    pub fn complete(&self) -> Option<&Turn> {
        self.complete.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_is_complete_when_the_next_begins_and_the_first_is_left_out() {
        let mut turns = Turns::default();
        let sample = |degrees: f64| Sample { angle: degrees.to_radians(), range: Some(1.0) };
        let at = |ms: u64| Timestamp::from_nanos(ms * 1_000_000);
        for (ms, degrees) in [(0, 90.0), (10, 180.0), (20, 350.0)] {
            turns.add(at(ms), sample(degrees));
        }
        for ms in 30..=129 {
            // Angles jitter a little, which begins no turn.
            let jitter = if ms % 2 == 0 { 1.0 } else { -1.0 };
            turns.add(at(ms), sample(5.0 + 3.5 * (ms - 30) as f64 + jitter));
        }
        assert_eq!(turns.complete(), None);
        turns.add(at(130), sample(2.0));
        let turn = turns.complete().unwrap();
        assert_eq!((turn.at, turn.period, turn.samples.len()), (at(30), Duration::from_millis(100), 100));
        turns.restart();
        assert_eq!(turns.complete().unwrap().samples.len(), 100, "it stays readable");
        turns.add(at(200), sample(300.0));
        turns.add(at(210), sample(10.0));
        assert_eq!(turns.complete().unwrap().at, at(30));
    }

    #[test]
    fn samples_of_a_lidar_that_stands_still_are_bounded() {
        let mut turns = Turns::default();
        for angle in [6.0, 0.1] {
            turns.add(Timestamp::ZERO, Sample { angle, range: None });
        }
        (0..10_000).for_each(|_| turns.add(Timestamp::ZERO, Sample { angle: 0.1, range: None }));
        assert_eq!(turns.under_way.samples.len(), Turn::MOST_SAMPLES);
    }
}
