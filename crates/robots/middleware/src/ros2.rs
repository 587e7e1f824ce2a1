//! Robots in ROS 2, both ways: the link to one that is out there, and the offer of a simulated one.

mod link;
mod offer;

pub use link::Ros2Link;
pub use offer::Ros2Offer;
