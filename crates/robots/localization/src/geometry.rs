//! Poses in the plane, which form a group: odometry gives a step from pose to pose, and composition applies it to any pose.

use std::{
    f64::consts::{PI, TAU},
    ops::Mul,
};

/// A position and a heading, or the step from one pose to another.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose2 {
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Radians, counter-clockwise, in (-π, π].
    pub heading: f64,
}

/// Largest valid coordinate, metres. Products of larger ones overflow sooner or later.
pub const FARTHEST: f64 = 1e7;

impl Pose2 {
    /// Creates a pose, and wraps its heading into (-π, π].
    pub fn new(x: f64, y: f64, heading: f64) -> Self {
        Self { x, y, heading: wrapped(heading) }
    }

    /// Whether the heading is finite and no coordinate is beyond [`FARTHEST`].
    pub fn is_valid(self) -> bool {
        // NaN fails the comparisons.
        self.x.abs() <= FARTHEST && self.y.abs() <= FARTHEST && self.heading.is_finite()
    }

    /// Returns the inverse step: `p * p.inverse()` is the origin.
    pub fn inverse(self) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self::new(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.heading)
    }

    /// Returns the step from this pose to another: `a * a.step_to(b)` is `b`.
    pub fn step_to(self, there: Self) -> Self {
        self.inverse() * there
    }

    /// Returns the distance between two positions, metres.
    pub fn distance(self, there: Self) -> f64 {
        (there.x - self.x).hypot(there.y - self.y)
    }
}

/// Applies a step that is given in the frame of the pose.
impl Mul for Pose2 {
    type Output = Self;

    fn mul(self, step: Self) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self::new(
            self.x + cos * step.x - sin * step.y,
            self.y + sin * step.x + cos * step.y,
            self.heading + step.heading,
        )
    }
}

/// Wraps an angle into (-π, π].
pub(crate) fn wrapped(angle: f64) -> f64 {
    // Most angles are in range already; the remainder would change their last bits.
    if angle > -PI && angle <= PI {
        return angle;
    }
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-100.0..100.0, -100.0..100.0, -10.0..10.0).prop_map(|(x, y, heading)| Pose2::new(x, y, heading))
    }

    fn same(a: Pose2, b: Pose2) -> bool {
        a.distance(b) < 1e-9 && wrapped(a.heading - b.heading).abs() < 1e-9
    }

    proptest! {
        #[test]
        fn steps_and_their_inverses_cancel(a in pose(), b in pose()) {
            prop_assert!(same(a * a.step_to(b), b));
            prop_assert!(same(a * a.inverse(), Pose2::default()));
            prop_assert!(same((a * b) * b.inverse(), a));
        }

        #[test]
        fn headings_stay_within_half_a_turn(angle in -1e3..1e3) {
            let heading = wrapped(angle);
            prop_assert!(heading > -PI && heading <= PI);
            prop_assert!((heading.cos() - f64::cos(angle)).abs() < 1e-9);
        }
    }
}
