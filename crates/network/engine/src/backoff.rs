//! Delays of restarts.

use std::time::Duration;

/// Delays of restarts of what ends by itself: each twice as long as the one before, unless it ran for long in between.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backoff(Duration);

impl Backoff {
    /// The first delay.
    pub const FIRST: Duration = Duration::from_millis(100);
    /// The longest delay.
    pub const LONGEST: Duration = Duration::from_secs(5);
    /// Running time after which the next delay is the first one again.
    pub const HEALTHY_AFTER: Duration = Duration::from_secs(10);

    /// Notes for how long it ran.
    pub fn ran(&mut self, time: Duration) {
        if time >= Self::HEALTHY_AFTER {
            *self = Self::default();
        }
    }

    /// Returns the delay of the next restart.
    pub fn delay(&mut self) -> Duration {
        let delay = self.0;
        self.0 = (delay * 2).min(Self::LONGEST);
        delay
    }

    /// Whether the next delay is the first one.
    pub fn is_first(&self) -> bool {
        self.0 == Self::FIRST
    }
}

impl Default for Backoff {
    fn default() -> Self {
        Self(Self::FIRST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_until_it_ran_for_long() {
        let mut backoff = Backoff::default();
        let mut delay_after = |ran_ms| {
            backoff.ran(Duration::from_millis(ran_ms));
            backoff.delay().as_millis()
        };
        let short = [0, 0, 0, 1, 100, 5000, 9999].map(&mut delay_after);
        assert_eq!(short, [100, 200, 400, 800, 1600, 3200, 5000]);
        assert_eq!([9999, 10_000, 0].map(delay_after), [5000, 100, 200]);
    }
}
