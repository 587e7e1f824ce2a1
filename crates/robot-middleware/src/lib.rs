//! The Robot Middleware block: drives robots, collects what they sense into κ, keeps the robot's end of the
//! navigation service, and passes instructions on. It knows no sockets and no clock: plain calls with the time as an
//! argument, and events to poll.
//!
//! [`RobotMiddleware`] is the way in. It drives any [`RobotDriver`]; [`SimulatedRobot`] is the one that needs nothing.
#![forbid(unsafe_code)]

mod driver;
#[cfg(test)]
mod fixtures;
mod kobuki;
mod lidar;
mod middleware;
mod random;
pub mod ros;
mod service;
mod simulated;
mod world;

pub use driver::{CommandRefused, RobotDriver};
pub use kobuki::{COMMAND_TIMEOUT, MAX_ANGULAR_SPEED, MAX_SPEED, METRES_PER_TICK, RADIUS, WHEEL_BASE};
pub use lidar::Scan;
pub use middleware::{MoveRefused, RobotMiddleware, Route};
pub use service::{Answer, ServiceEndpoint};
pub use simulated::{SimulatedRobot, SimulationError};
pub use world::World;
