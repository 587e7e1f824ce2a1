//! DDS, by RustDDS: what carries messages for all of ROS 2's middlewares but `rmw_zenoh`.

mod announce;
mod codec;
mod engine;
mod graph;
mod participant;
mod topics;

pub use participant::Dds;
