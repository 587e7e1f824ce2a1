//! ROS 1: the link to a robot, and the offer of a simulated robot.

mod link;
mod offer;

pub use link::Ros1Link;
pub use offer::Ros1Offer;
