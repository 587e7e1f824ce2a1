//! Zenoh, as ROS 2's `rmw_zenoh` uses it: a session that finds its peers by a router, topics as key expressions, what
//! there is as liveliness tokens, and messages with what `rmw_zenoh` attaches to them.
//!
//! Source: `rmw_zenoh`'s design document, and what its versions since ROS 2 Jazzy's 0.2.4 put on the wire.

mod names;
mod session;
mod topics;

pub use session::Zenoh;
