//! Packets of captures, as `tcpdump` and Wireshark write them: pcap and pcapng.
//!
//! A capture at one end of a path gives round trips of TCP ([`round_trips_of_capture`]). Captures at both ends give delays and
//! losses of each direction ([`one_way_of_captures`]).

mod both_ends;
mod clocks;
mod tcp;

use cotorra_pcap::{Packet, ReadError, headers};

pub use self::{both_ends::one_way_of_captures, tcp::round_trips_of_capture};
use crate::error::CalibrateError;

/// Largest size of a capture, bytes.
pub const MAX_CAPTURE: usize = 256 << 20;
/// Most packets of a capture.
const MAX_PACKETS: usize = 1_000_000;

/// An IP packet of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Captured<'a> {
    /// Time of the capture's clock, ns since 1970.
    at_ns: i64,
    /// The IP packet, as far as it was captured.
    ip: &'a [u8],
    /// Whether its end was cut off.
    cut: bool,
    /// Size of its Ethernet frame.
    frame_bytes: usize,
}

/// Collects the IP packets of a capture.
#[derive(Default)]
struct Packets<'a> {
    packets: Vec<Captured<'a>>,
    /// Number of packets of any kind.
    seen: usize,
}

impl<'a> Packets<'a> {
    /// Adds a packet, of which the file may have the first bytes only. Skips what is not IP.
    fn add(
        &mut self,
        Packet { link_type, at_ns, bytes, original }: Packet<'a>,
    ) -> Result<(), CalibrateError> {
        self.seen += 1;
        if self.seen > MAX_PACKETS {
            return Err(unreadable(format!(
                "the capture has more than {MAX_PACKETS} packets: capture a shorter time, or one flow only"
            )));
        }
        if let Some(header) = headers::link_header(link_type, bytes)
            && let Some(ip) = bytes.get(header..)
        {
            let original = (original as usize).max(bytes.len());
            let frame_bytes = original - header + headers::ETHERNET;
            self.packets.push(Captured { at_ns, ip, cut: original > bytes.len(), frame_bytes });
        }
        Ok(())
    }
}

/// Reads the IP packets of a capture. A last packet that is not complete is left out, as of a `tcpdump` that was killed.
fn read(bytes: &[u8]) -> Result<Vec<Captured<'_>>, CalibrateError> {
    if bytes.len() > MAX_CAPTURE {
        return Err(unreadable(format!("the capture has more than {} MiB", MAX_CAPTURE >> 20)));
    }
    let mut packets = Packets::default();
    cotorra_pcap::read(bytes, |packet| packets.add(packet))?;
    match packets.packets.is_empty() {
        true => Err(unreadable(format!(
            "none of its {} packets is an IP packet over Ethernet or Linux's `any` interface",
            packets.seen
        ))),
        false => Ok(packets.packets),
    }
}

impl From<ReadError> for CalibrateError {
    fn from(error: ReadError) -> Self {
        unreadable(error.to_string())
    }
}

fn unreadable(reason: impl Into<String>) -> CalibrateError {
    CalibrateError::Unreadable(reason.into())
}

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
