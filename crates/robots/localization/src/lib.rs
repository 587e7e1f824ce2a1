#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod belief;
mod bins;
pub mod carmen;
mod cluster;
mod disagreement;
mod doubt;
mod error;
mod fast;
mod field;
mod geometry;
mod localizer;
mod motion;
mod parameters;
mod particles;
mod place;
mod poses;
mod relocate;
mod scan;
mod track;
pub mod trajectory;
mod weights;

pub use belief::Belief;
pub use error::LocalizationError;
pub use field::LikelihoodField;
pub use geometry::{FARTHEST, Pose2};
pub use localizer::{Estimate, Localizer};
pub use parameters::{BeamModel, MotionNoise, Parameters, Weighing};
pub use poses::{believed, parameters, planar, to_pose};
pub use scan::Scan;
