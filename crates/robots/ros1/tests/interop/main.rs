//! The node against Debian's own ROS 1: its master, its tools, its nodes in Python and C++; and against peers that mean
//! no good, with a real master.
#![allow(clippy::unwrap_used, reason = "tests, and what helps them")]

mod hostile;
mod tools;
