//! Properties of Ethernet frames that queues need: their flow, and marks of congestion in their IP headers.

use cotorra_flows::{
    checksum::fold,
    headers::{IPV6, IpVersion, PROTOCOL_TCP, PROTOCOL_UDP, find_ip, u16_at},
};
use cotorra_graph::Timestamp;

use super::{ClassKey, Queued};
use crate::{
    pipe::{Packet, Purpose},
    routes::Target,
};

/// The two ECN bits of a packet that met congestion (RFC 3168, section 5).
const CE: u8 = 0b11;

impl Queued for Packet {
    fn entered(&self) -> Timestamp {
        self.entered
    }

    fn packets(&self) -> u32 {
        self.frame.wire_packets()
    }

    fn bytes(&self) -> u64 {
        self.frame.wire_bytes()
    }

    fn flow(&self) -> u64 {
        flow(self.frame.bytes())
    }

    fn class(&self) -> Option<ClassKey> {
        match &self.purpose {
            Purpose::Target(Target::Port { along: Some(path), .. }) => Some(path.ends),
            _ => None,
        }
    }

    fn mark(&mut self) -> bool {
        mark(self.frame.bytes_mut())
    }
}

/// Returns a hash of the flow of a frame: its IP addresses, protocol and ports, as far as it has them, or else the Ethernet
/// addresses and the EtherType. Fragments of one packet are of one flow.
pub(crate) fn flow(bytes: &[u8]) -> u64 {
    ip_flow(bytes).unwrap_or_else(|| hash(&[bytes.get(..14).unwrap_or(bytes)]))
}

fn ip_flow(bytes: &[u8]) -> Option<u64> {
    let (ip, version) = find_ip(bytes)?;
    let (protocol, addresses, transport) = match version {
        IpVersion::V4 => {
            let is_fragment = u16_at(bytes, ip + 6)? & 0x3fff != 0;
            let transport = ip + usize::from(bytes.get(ip)? & 0x0f) * 4;
            (*bytes.get(ip + 9)?, bytes.get(ip + 12..ip + 20)?, (!is_fragment).then_some(transport))
        }
        IpVersion::V6 => (*bytes.get(ip + 6)?, bytes.get(ip + 8..ip + IPV6)?, Some(ip + IPV6)),
    };
    let has_ports = matches!(protocol, PROTOCOL_TCP | PROTOCOL_UDP);
    let ports = transport.filter(|_| has_ports).and_then(|at| bytes.get(at..at + 4));
    Some(hash(&[addresses, &[protocol], ports.unwrap_or_default()]))
}

/// FNV-1a.
fn hash(parts: &[&[u8]]) -> u64 {
    let bytes = parts.iter().copied().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Sets CE in the IP header of a frame. Returns `false`, and changes nothing, if the frame is not ECN-capable.
pub(crate) fn mark(bytes: &mut [u8]) -> bool {
    try_mark(bytes).is_some()
}

fn try_mark(bytes: &mut [u8]) -> Option<()> {
    let (ip, version) = find_ip(bytes)?;
    match version {
        IpVersion::V4 => {
            let before = u16_at(bytes, ip)?;
            is_capable(before as u8)?;
            let checksum = u16_at(bytes, ip + 10)?;
            let after = before | u16::from(CE);
            // RFC 1624, equation 3.
            let updated = !fold(u64::from(!checksum) + u64::from(!before) + u64::from(after));
            bytes[ip..ip + 2].copy_from_slice(&after.to_be_bytes());
            bytes[ip + 10..ip + 12].copy_from_slice(&updated.to_be_bytes());
        }
        IpVersion::V6 => {
            // The traffic class lies across two bytes. The frame must have all of its header.
            bytes.get(ip + IPV6 - 1)?;
            is_capable(bytes[ip + 1] >> 4)?;
            bytes[ip + 1] |= CE << 4;
        }
    }
    Some(())
}

/// Returns whether the lower two bits are those of an ECN-capable packet, marked or not.
fn is_capable(bits: u8) -> Option<()> {
    (bits & CE != 0).then_some(())
}

#[cfg(test)]
mod tests {
    use cotorra_flows::checksum::sum;

    use super::*;

    /// An Ethernet frame with an IPv4 packet of UDP between two ports.
    fn ipv4(ecn: u8, ports: [u16; 2], fragment: u16) -> Vec<u8> {
        let mut header = [0; 20];
        (header[0], header[1], header[9]) = (0x45, 0xb8 | ecn, PROTOCOL_UDP);
        header[2..4].copy_from_slice(&28_u16.to_be_bytes());
        header[6..8].copy_from_slice(&fragment.to_be_bytes());
        header[12..20].copy_from_slice(&[10, 0, 0, 1, 10, 0, 0, 2]);
        let checksum = !fold(sum(&header));
        header[10..12].copy_from_slice(&checksum.to_be_bytes());
        let ports = ports.map(u16::to_be_bytes).concat();
        [&[0; 12][..], &[0x08, 0x00], &header, &ports, &[0; 4]].concat()
    }

    fn ipv6(ecn: u8, ports: [u16; 2]) -> Vec<u8> {
        let mut header = [0; IPV6];
        (header[0], header[1], header[6]) = (0x6b, 0x8f | ecn << 4, PROTOCOL_UDP);
        let ports = ports.map(u16::to_be_bytes).concat();
        [&[0; 12][..], &[0x86, 0xdd], &header, &ports, &[0; 4]].concat()
    }

    #[test]
    fn capable_packets_are_marked_with_a_valid_checksum() {
        for ecn in [0b01, 0b10, 0b11] {
            let mut frame = ipv4(ecn, [1, 2], 0);
            assert!(mark(&mut frame));
            assert_eq!(frame[15], 0xb8 | CE, "the DSCP stays");
            assert_eq!(fold(sum(&frame[14..34])), 0xffff);
            let mut frame = ipv6(ecn, [1, 2]);
            assert!(mark(&mut frame));
            assert_eq!(frame[14..16], [0x6b, 0xbf]);
        }
    }

    #[test]
    fn other_packets_stay_as_they_are() {
        let mut cut = ipv4(0b10, [1, 2], 0);
        cut.truncate(20);
        for frame in [ipv4(0, [1, 2], 0), ipv6(0, [1, 2]), cut, vec![0; 60], vec![]] {
            let mut marked = frame.clone();
            assert!(!mark(&mut marked));
            assert_eq!(marked, frame);
        }
    }

    #[test]
    fn a_tagged_packet_is_marked_behind_its_tag() {
        let mut frame = ipv4(0b10, [1, 2], 0);
        frame.splice(12..12, [0x81, 0x00, 0x00, 0x05]);
        assert!(mark(&mut frame));
        assert_eq!(frame[19], 0xb8 | CE);
    }

    #[test]
    fn flows_differ_in_addresses_ports_and_protocol() {
        let base = ipv4(0, [1, 2], 0);
        let [mut address, mut protocol, mut same] = [base.clone(), base.clone(), base.clone()];
        address[14 + 19] = 9;
        protocol[14 + 9] = PROTOCOL_TCP;
        same[14 + 5] = 77;
        let others = [address, protocol, ipv4(0, [1, 3], 0), ipv4(0, [2, 1], 0), ipv6(0, [1, 2])];
        assert!(others.iter().all(|other| flow(other) != flow(&base)));
        assert_eq!(flow(&same), flow(&base));
        assert_ne!(flow(&ipv6(0, [1, 2])), flow(&ipv6(0, [1, 3])));
    }

    #[test]
    fn fragments_are_of_one_flow() {
        // The first fragment has ports, the second one has data in their place.
        assert_eq!(flow(&ipv4(0, [1, 2], 0x2000)), flow(&ipv4(0, [7, 8], 0x0001)));
    }

    #[test]
    fn frames_without_ip_have_a_flow() {
        assert_eq!(flow(&[1; 60]), flow(&[1; 70]));
        assert_ne!(flow(&[1; 60]), flow(&[2; 60]));
        flow(&[]);
    }
}
