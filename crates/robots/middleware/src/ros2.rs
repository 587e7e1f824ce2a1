//! ROS 2: the link to a robot, and the offer of a simulated robot.

mod link;
mod offer;

pub use link::Ros2Link;
pub use offer::Ros2Offer;
