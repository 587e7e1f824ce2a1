//! Kobuki, the base of a TurtleBot 2.
//!
//! Frames, commands and feedback are those of the protocol specification in `kobuki_core` (`en_appendix_protocol.dox`),
//! and conversions those of its driver.

mod base;
mod command;
mod feedback;
mod frames;
mod odometry;

pub use base::{Base, COMMAND_TIMEOUT};
pub use command::{Command, Gains, MAX_ANGULAR_SPEED, WHEEL_BASE, limited};
pub use feedback::{Basic, Feedback, Gyro, Inertia, Version};
pub use frames::Frames;
pub use odometry::{METRES_PER_TICK, Odometry};
