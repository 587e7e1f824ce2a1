//! A TurtleBot 2 without ROS: the serial protocols of its Kobuki base and of its RPLIDAR A2.
//!
//! The protocols are state machines without a clock and without a port: [`kobuki::Base`] and [`rplidar::Lidar`] take bytes
//! with the time, and return bytes to send. A [`Device`] runs one of them on a serial port, on a thread of its own. A
//! [`Turtlebot`] joins both as one robot.
//!
//! It knows nothing of maps, services or ROS, so that a program on the robot can use it alone.
#![forbid(unsafe_code)]

mod device;
pub mod kobuki;
mod port;
pub mod rplidar;
mod turtlebot;

pub use device::{Clock, Device, SILENCE, Session, Transport};
pub use port::{Port, PortError, PortSettings};
pub use turtlebot::{Body, Readings, Turtlebot};
