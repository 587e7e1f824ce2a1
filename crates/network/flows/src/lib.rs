//! Measures the service time of a flow from the frames at one host's port: from the moment in which a request enters the
//! network there to the moment in which its answer is delivered there. Programs are not changed for it, and need not know.
//!
//! A [`Meter`] takes frames with the time and gives [`Sample`]s. It opens no socket, reads no clock and waits for nothing.
//! What it remembers has bounds: of requests, connections, fragments and bytes. What exceeds them is left out of the samples
//! and counted ([`Counts`]); no sample is a guess.

mod fragments;
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

pub use meter::{Meter, Protocol};
pub use packet::Frame;
pub use requests::{Counts, Id, Sample};
