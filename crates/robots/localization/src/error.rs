//! Why localization is impossible.

use crate::geometry::{FARTHEST, Pose2};

/// Why a filter cannot begin, or go on.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LocalizationError {
    /// A robot can be nowhere.
    #[error("the map has no free cell, on which a robot could be")]
    NoFreeSpace,
    /// All scans would look alike.
    #[error("the map has no wall, by which a robot could be found")]
    NoWall,
    /// A pose is not finite, or so far away that computing with it overflows.
    #[error("({:?}, {:?}) m and {:?} rad is no pose: not finite, or beyond {FARTHEST:e} m", .0.x, .0.y, .0.heading)]
    NoPose(Pose2),
    /// A covariance is not finite, or so large that computing with it overflows.
    #[error("a variance of {0} is no use: not finite, or above ({FARTHEST:e} m)²")]
    NoCovariance(f64),
}
