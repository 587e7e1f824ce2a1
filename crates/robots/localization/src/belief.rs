//! A pose with its covariance: moved on by odometry, and compared with the true pose.

use crate::{
    geometry::{Pose2, wrapped},
    motion::Motion,
    parameters::MotionNoise,
};

/// An estimated pose and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// The mean.
    pub pose: Pose2,
    /// The covariance of x, y and heading, row by row; m², m·rad, rad².
    pub covariance: [f64; 9],
}

impl Belief {
    /// Returns the belief after a step of odometry with this noise, without a scan. Apply a long way in several steps,
    /// because the noise of each step is independent.
    pub fn moved_on(&self, step: Pose2, noise: &MotionNoise) -> Self {
        let covariance = Motion::new(step, noise).propagate(self.pose.heading, &self.covariance);
        Self { pose: self.pose * step, covariance }
    }

    /// Returns the normalized estimation error squared, eᵀ·C⁻¹·e (Bar-Shalom, Li and Kirubarajan 2001, section 5.4). It is
    /// 3 on average where the covariance matches the errors. `None` if the covariance has no inverse.
    pub fn nees(&self, truth: Pose2) -> Option<f64> {
        let error =
            [self.pose.x - truth.x, self.pose.y - truth.y, wrapped(self.pose.heading - truth.heading)];
        let root = cholesky(&self.covariance);
        let mut whitened = [0.0; 3];
        for row in 0..3 {
            let inner: f64 = (0..row).map(|k| root[row * 3 + k] * whitened[k]).sum();
            let diagonal = root[row * 3 + row];
            if diagonal <= 0.0 {
                return None;
            }
            whitened[row] = (error[row] - inner) / diagonal;
        }
        Some(whitened.iter().map(|part| part * part).sum())
    }
}

/// Returns the lower Cholesky factor of a covariance. Variances that rounding made negative count as 0.
pub(crate) fn cholesky(c: &[f64; 9]) -> [f64; 9] {
    let mut root = [0.0; 9];
    for row in 0..3 {
        for column in 0..=row {
            let inner: f64 = (0..column).map(|k| root[row * 3 + k] * root[column * 3 + k]).sum();
            let left = c[row * 3 + column] - inner;
            root[row * 3 + column] = if row == column {
                left.max(0.0).sqrt()
            } else if root[column * 3 + column] > 0.0 {
                left / root[column * 3 + column]
            } else {
                0.0
            };
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Parameters;

    #[test]
    fn uncertainty_grows_with_each_step_without_a_scan() {
        let noise = Parameters::turtlebot2().motion;
        let mut belief = Belief { pose: Pose2::new(1.0, 2.0, 0.5), covariance: [0.0; 9] };
        let mut before = 0.0;
        for _ in 0..40 {
            belief = belief.moved_on(Pose2::new(0.25, 0.0, 0.0), &noise);
            let spread = belief.covariance[0] + belief.covariance[4];
            assert!(spread > before);
            before = spread;
        }
        assert!(belief.pose.distance(Pose2::new(1.0, 2.0, 0.5) * Pose2::new(10.0, 0.0, 0.0)) < 1e-9);
        // 10 m: some decimetres.
        assert!((0.1..1.0).contains(&before.sqrt()), "{}", before.sqrt());
    }

    #[test]
    fn nees_is_3_for_an_error_of_one_deviation_in_each_direction() {
        let covariance = [0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0025];
        let belief = Belief { pose: Pose2::default(), covariance };
        let nees = belief.nees(Pose2::new(0.2, -0.1, 0.05)).unwrap();
        assert!((nees - 3.0).abs() < 1e-9, "{nees}");
        assert_eq!(Belief { covariance: [0.0; 9], ..belief }.nees(Pose2::default()), None);
    }
}
