//! Robots in ROS 1, both ways: the link to one that is out there, and the offer of a simulated one.

mod link;
mod offer;

pub use link::Ros1Link;
pub use offer::Ros1Offer;
