//! Bounds how often something happens.

use cotorra_graph::Timestamp;

/// A number of times a second, which may also come all at once. It has no clock.
#[derive(Debug)]
pub struct Allowance {
    per_second: f64,
    left: f64,
    at: Timestamp,
}

impl Allowance {
    /// Makes an allowance that is whole.
    pub fn new(per_second: f64) -> Self {
        Self { per_second, left: per_second, at: Timestamp::ZERO }
    }

    /// Returns whether it may happen once more.
    pub fn take(&mut self, now: Timestamp) -> bool {
        let passed = now.since(self.at).as_secs_f64();
        self.left = (self.left + passed * self.per_second).min(self.per_second);
        self.at = self.at.max(now);
        let is_enough = self.left >= 1.0;
        self.left -= f64::from(u8::from(is_enough));
        is_enough
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_allowance_is_used_up_and_comes_back_with_time() {
        let at = |ms: u64| Timestamp::from_nanos(ms * 1_000_000);
        let mut allowance = Allowance::new(10.0);
        let mut taken = |ms| (0..100).filter(|_| allowance.take(at(ms))).count();
        assert_eq!(
            [taken(5), taken(5), taken(105), taken(55), taken(205), taken(60_000)],
            [10, 0, 1, 0, 1, 10]
        );
    }
}
