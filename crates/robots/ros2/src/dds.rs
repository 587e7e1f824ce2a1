//! DDS, by RustDDS: the protocol of all ROS 2 middlewares but `rmw_zenoh`.

mod announce;
mod codec;
mod engine;
mod graph;
mod participant;
mod shared;
mod topics;

pub use participant::Dds;
