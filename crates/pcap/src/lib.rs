//! Captures of packets, as `tcpdump` and Wireshark write them: [`read`] takes pcap and pcapng, [`mod@write`] makes pcapng, and
//! [`Blocks`] splits a stream of pcapng. [`headers`] reads those of IP and TCP; what else is in the packets is for others.
#![forbid(unsafe_code)]

mod blocks;
pub mod headers;
mod order;
mod packet;
mod pcap;
mod pcapng;
pub mod write;

pub use blocks::Blocks;
pub use order::Order;
pub use packet::{Packet, ReadError};

/// The link type of Ethernet.
pub const ETHERNET: u16 = 1;

/// Reads the packets of a capture. A last packet that is not complete is left out, as of a `tcpdump` that was killed.
///
/// # Errors
/// [`ReadError`], or the first error of `take`.
pub fn read<'a, E: From<ReadError>>(
    bytes: &'a [u8],
    take: impl FnMut(Packet<'a>) -> Result<(), E>,
) -> Result<(), E> {
    if pcapng::is_pcapng(bytes) { pcapng::read(bytes, take) } else { pcap::read(bytes, take) }
}

#[cfg(test)]
mod tests;
