//! Limits the rate of changes to resources: a token bucket on the run's time.

use std::time::Duration;

use cotorra_graph::Timestamp;

/// Changes at once.
const BURST: f64 = 500.0;
/// Changes per second in the long run.
const RATE: f64 = 200.0;

/// Changes are too frequent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("resources change at most {RATE} times a second: try again later")]
pub struct TooOften(pub Duration);

/// A limit on changes. Each caller has its own.
#[derive(Debug)]
pub struct Limiter {
    tokens: f64,
    since: Timestamp,
}

impl Default for Limiter {
    fn default() -> Self {
        Self { tokens: BURST, since: Timestamp::ZERO }
    }
}

impl Limiter {
    /// Admits a change.
    ///
    /// # Errors
    /// [`TooOften`], with the time until the next one is admitted.
    pub fn admit(&mut self, now: Timestamp) -> Result<(), TooOften> {
        self.tokens = (self.tokens + now.since(self.since).as_secs_f64() * RATE).min(BURST);
        self.since = self.since.max(now);
        if self.tokens < 1.0 {
            return Err(TooOften(Duration::from_secs_f64((1.0 - self.tokens) / RATE)));
        }
        self.tokens -= 1.0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bursts_pass_then_the_rate_applies() {
        let mut limiter = Limiter::default();
        let admitted = |limiter: &mut Limiter, at: f64| {
            (0..1000).filter(|_| limiter.admit(Timestamp::from_secs_f64(at)).is_ok()).count()
        };
        assert_eq!(admitted(&mut limiter, 0.0), 500);
        assert_eq!(admitted(&mut limiter, 0.5), 100);
        assert_eq!(admitted(&mut limiter, 0.1), 0, "time does not go back");
        let TooOften(wait) = limiter.admit(Timestamp::from_secs_f64(0.5)).unwrap_err();
        assert!(limiter.admit(Timestamp::from_secs_f64(0.5) + wait).is_ok());
        assert_eq!(admitted(&mut limiter, 100.0), 500);
    }
}
