//! RPLIDAR A2, the lidar of a TurtleBot 2.
//!
//! Requests and answers are those of Slamtec's interface protocol (LR001, "Interface Protocol and Application Notes,
//! applied to RPLIDAR A1 & A2") and of `rplidar_sdk`.

mod answers;
mod capsule;
mod lidar;
mod request;
mod turns;

pub use answers::{Answer, Answers, Health};
pub use capsule::Capsule;
pub use lidar::{Lidar, LidarSettings};
pub use request::Request;
pub use turns::{Sample, Turn};
