//! Zenoh, as ROS 2's `rmw_zenoh` uses it: a session that finds its peers through a router, topics as key expressions, nodes
//! and endpoints as liveliness tokens, and messages with `rmw_zenoh`'s attachments.
//!
//! Source: `rmw_zenoh`'s design document, and the wire format of its versions since ROS 2 Jazzy's 0.2.4.

mod names;
mod session;
mod shared;
mod topics;

pub use session::Zenoh;
