//! Random choices from one seed.

use std::{ops::RangeInclusive, time::Duration};

use cotorra_numbers::seed;

/// A stream of random choices: the same seed and label give the same ones on every machine.
#[derive(Debug, Clone)]
pub(crate) struct Draw {
    seed: u64,
    drawn: u64,
}

impl Draw {
    pub(crate) fn new(seed: u64, label: &str) -> Self {
        Self { seed: seed::split(seed, label), drawn: 0 }
    }

    fn next(&mut self) -> u64 {
        self.drawn += 1;
        // A Weyl sequence, so that no two draws mix the same number.
        seed::split(self.seed.wrapping_add(self.drawn.wrapping_mul(0x9e37_79b9_7f4a_7c15)), "draw")
    }

    /// Returns a number in 0..1, with 53 random bits.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Returns a whole number of a range.
    pub(crate) fn whole(&mut self, range: RangeInclusive<usize>) -> usize {
        let (from, to) = range.into_inner();
        from + (self.unit() * (to - from + 1) as f64) as usize
    }

    /// Returns a number between two, rounded to three decimal places, as testbed files have it.
    pub(crate) fn number(&mut self, from: f64, to: f64) -> f64 {
        ((from + self.unit() * (to - from)) * 1e3).round() / 1e3
    }

    pub(crate) fn duration(&mut self, from: f64, to: f64) -> Duration {
        Duration::from_secs_f64(self.number(from, to))
    }

    /// Returns one of the elements; there must be at least one.
    pub(crate) fn one<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.whole(0..=of.len() - 1)]
    }
}
