//! The crate's error type.

use crate::geometry::{FARTHEST, Pose2};

/// An error of a filter's inputs.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LocalizationError {
    /// The map has no free cell.
    #[error("the map has no free cell for a robot to stand on")]
    NoFreeSpace,
    /// The map has no wall: all scans would look alike.
    #[error("the map has no wall to locate a robot by")]
    NoWall,
    /// A pose is not finite, or so far away that computing with it overflows.
    #[error("({:?}, {:?}) m and {:?} rad is not a valid pose: it is not finite, or beyond {FARTHEST:e} m", .0.x, .0.y, .0.heading)]
    NoPose(Pose2),
    /// A covariance is not finite, or so large that computing with it overflows.
    #[error("a variance of {0} is not valid: it is not finite, or above ({FARTHEST:e} m)²")]
    NoCovariance(f64),
}
