//! Statistics of service times: those of one service, and of several together.

pub use cotorra_numbers::Quantiles;

/// Gathered service times.
#[derive(Debug, Default)]
pub(super) struct Times {
    pub samples: usize,
    /// Number of samples above the target of their service. Unanswered ones count as above it.
    pub above: usize,
    /// Service times of the answered samples, milliseconds.
    pub answered: Vec<f64>,
}

impl Times {
    pub fn add(&mut self, service_time_ms: Option<f64>, target_ms: f64) {
        self.samples += 1;
        self.above += usize::from(service_time_ms.is_none_or(|ms| ms > target_ms));
        self.answered.extend(service_time_ms);
    }

    /// Returns the times of several services together. Each sample keeps the target of its service.
    pub fn merged<'a>(of: impl IntoIterator<Item = &'a Self>) -> Self {
        of.into_iter().fold(Self::default(), |mut all, its| {
            all.samples += its.samples;
            all.above += its.above;
            all.answered.extend(&its.answered);
            all
        })
    }

    pub fn unanswered(&self) -> usize {
        self.samples - self.answered.len()
    }

    /// Returns the share above the target; `None` without samples.
    pub fn above_target(&self) -> Option<f64> {
        (self.samples > 0).then(|| self.above as f64 / self.samples as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unanswered_sample_is_above_any_target_and_one_at_the_target_is_not() {
        let mut times = Times::default();
        assert_eq!(times.above_target(), None);
        for took in [Some(15.0), Some(15.1), None, Some(1.0)] {
            times.add(took, 15.0);
        }
        assert_eq!((times.samples, times.unanswered(), times.above_target()), (4, 1, Some(0.5)));
    }
}
