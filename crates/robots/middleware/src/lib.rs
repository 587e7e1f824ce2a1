//! The Robot Middleware block: drives robots, builds κ from their sensors, keeps the robot's end of the navigation and
//! localization services, and applies instructions.
//!
//! It has no sockets and no clock: calls take the time, and datagrams and events are polled. Only links to robots in ROS
//! have sockets, and a TurtleBot 2 at serial ports has these, on threads of their own.
//!
//! [`RobotMiddleware`] is the main type. It moves robots through any [`RobotDriver`]: a [`SimulatedRobot`], a
//! [`TurtlebotDriver`], or a [`RosDriver`] for a [`RosRobot`] behind a [`RosLink`].
#![forbid(unsafe_code)]

mod answer_error;
mod battery;
mod beat;
mod camera;
mod chunks;
mod driver;
mod exchange;
#[cfg(test)]
mod fixtures;
mod goal;
mod heard;
mod imu;
mod kobuki;
mod large;
mod lidar;
mod localization;
mod middleware;
mod nonce;
mod picture;
mod planar;
mod quadrotor;
mod request;
pub mod ros;
mod ros1;
mod ros2;
mod ros_driver;
mod ros_offer;
mod ros_robot;
mod ros_sensors;
mod sensing;
mod service;
mod simulated;
mod turtlebot_driver;
mod watch;
mod world;

pub use answer_error::AnswerError;

pub use camera::View;
pub use chunks::{ActionChunks, Followed, Observed};
pub use driver::{CommandError, RobotDriver};
pub use kobuki::{COMMAND_TIMEOUT, MAX_ANGULAR_SPEED, MAX_SPEED, METRES_PER_TICK, RADIUS, WHEEL_BASE};
pub use large::{Captured, Content, SensedData};
pub use lidar::Scan;
pub use middleware::{MoveError, RobotMiddleware, SensedScan, Walker};
pub use nonce::Nonces;
pub use picture::Picture;
pub use request::{Datagram, Servers};
pub use ros_driver::{Clock, RosDriver, RosLink};
pub use ros_offer::{OfferedRobot, OfferedTime, RosOffer};
pub use ros_robot::RosRobot;
pub use ros1::{Ros1Link, Ros1Offer};
pub use ros2::{Ros2Link, Ros2Offer};
pub use sensing::ReportError;
pub use simulated::{SimulatedRobot, SimulationError};
pub use turtlebot_driver::TurtlebotDriver;
pub use watch::Topic;
pub use world::World;
