//! The node against other implementations of DDS with ROS 2's names, against Zenoh, and against itself.
#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod both_ways;
mod cyclone;
mod fastdds;
mod own;
#[cfg(feature = "zenoh")]
mod zenoh;
