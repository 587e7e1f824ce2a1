#![doc = include_str!("../README.md")]

mod carried;
pub mod checksum;
mod datagram;
mod fragments;
pub mod headers;
mod http;
mod meter;
mod packet;
mod requests;
mod ros1;
mod ros2;
mod rtps;
mod stream;
mod tcp;
#[cfg(test)]
mod testing;
mod udp;

pub use carried::{Carried, Place};
pub use datagram::Datagram;
pub use meter::{Meter, Protocol};
pub use packet::Frame;
pub use requests::{Counts, Id, Sample};
