//! The node against Debian's ROS 1: its master, its tools, and its nodes in Python and C++; and against hostile peers,
//! with a real master.
#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod hostile;
mod tools;
