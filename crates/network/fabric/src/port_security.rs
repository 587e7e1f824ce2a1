//! Port security: whether a frame names the host at its port as its sender, by each address that others take it for.
//!
//! Checks what switches check as MAC limiting, dynamic ARP inspection, IP source guard and RA guard (RFC 6105).

use cotorra_flows::headers::{ETHERTYPE_IPV4, ETHERTYPE_IPV6, IPV6, PROTOCOL_UDP, u16_at};
use cotorra_graph::HostAddress;

const ETHERTYPE_ARP: u16 = 0x0806;
const VLAN_TAGS: [u16; 2] = [0x8100, 0x88a8];
/// Beginning of an ARP packet about IPv4 over Ethernet (RFC 826), before the operation.
const ARP_IPV4: [u8; 6] = [0, 1, 8, 0, 6, 4];
const ARP_REQUEST: u16 = 1;
const PROTOCOL_IGMP: u8 = 2;
const PROTOCOL_FRAGMENT: u8 = 44;
const PROTOCOL_AUTHENTICATION: u8 = 51;
const PROTOCOL_ICMPV6: u8 = 58;
const DHCP_CLIENT: u16 = 68;
const DHCP_SERVER: u16 = 67;
const UNSPECIFIED: [u8; 16] = [0; 16];

/// The protocol by which a frame names another sender than its host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Forgery {
    Ethernet,
    Arp,
    NeighbourDiscovery,
    Ipv4,
    Ipv6,
}

/// Frames with forged sources, as packets on the wire, by the protocol whose source was not the host's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ForgedFrames {
    /// With another MAC address, or cut off behind a VLAN tag.
    pub ethernet: u64,
    /// ARP with another sender.
    pub arp: u64,
    /// IPv6 neighbour discovery for another host, or as a router.
    pub neighbour_discovery: u64,
    /// With another IPv4 address.
    pub ipv4: u64,
    /// With another IPv6 address.
    pub ipv6: u64,
}

impl ForgedFrames {
    pub(crate) fn count(&mut self, forgery: Forgery, packets: u32) {
        let counter = match forgery {
            Forgery::Ethernet => &mut self.ethernet,
            Forgery::Arp => &mut self.arp,
            Forgery::NeighbourDiscovery => &mut self.neighbour_discovery,
            Forgery::Ipv4 => &mut self.ipv4,
            Forgery::Ipv6 => &mut self.ipv6,
        };
        *counter += u64::from(packets);
    }

    /// Returns the number of all frames.
    pub fn total(&self) -> u64 {
        let Self { ethernet, arp, neighbour_discovery, ipv4, ipv6 } = self;
        ethernet + arp + neighbour_discovery + ipv4 + ipv6
    }
}

/// The addresses that a host may send from, as they are in frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Identity {
    mac: [u8; 6],
    ipv4: [u8; 4],
    ipv6: [u8; 16],
    /// The link-local address that follows from the MAC address (RFC 4291, appendix A).
    link_local: [u8; 16],
}

impl Identity {
    pub(crate) fn of(HostAddress { mac, ipv4, ipv6 }: HostAddress) -> Self {
        let [a, b, c, d, e, f] = mac;
        let link_local = [0xfe, 0x80, 0, 0, 0, 0, 0, 0, a ^ 2, b, c, 0xff, 0xfe, d, e, f];
        Self { mac, ipv4: ipv4.octets(), ipv6: ipv6.octets(), link_local }
    }

    /// Returns how a frame names another sender; `None` if it does not.
    pub(crate) fn forgery(&self, frame: &[u8]) -> Option<Forgery> {
        if frame.get(6..12) != Some(&self.mac) {
            return Some(Forgery::Ethernet);
        }
        let mut at = 12;
        loop {
            let payload = frame.get(at + 2..).unwrap_or_default();
            // A kernel reads what is behind tags of no VLAN (IEEE 802.1Q, priority tags), too.
            let Some(ethertype) = u16_at(frame, at) else { return Some(Forgery::Ethernet) };
            let (is_own, forgery) = match ethertype {
                ETHERTYPE_IPV4 => (self.sent_ipv4(payload), Forgery::Ipv4),
                ETHERTYPE_IPV6 => return self.ipv6_forgery(payload),
                ETHERTYPE_ARP => (self.sent_arp(payload), Forgery::Arp),
                tag if VLAN_TAGS.contains(&tag) => {
                    at += 4;
                    continue;
                }
                _ => return None,
            };
            return (!is_own).then_some(forgery);
        }
    }

    fn sent_arp(&self, packet: &[u8]) -> bool {
        let sender = packet.get(14..18);
        // A probe asks for an address that the host does not have yet (RFC 5227, 2.1.1).
        let is_probe = || sender == Some(&[0; 4]) && u16_at(packet, 6) == Some(ARP_REQUEST);
        packet.len() >= 28
            && packet.starts_with(&ARP_IPV4)
            && packet.get(8..14) == Some(&self.mac)
            && (sender == Some(&self.ipv4) || is_probe())
    }

    fn sent_ipv4(&self, packet: &[u8]) -> bool {
        match packet.get(12..16) {
            Some(source) if source == self.ipv4 => true,
            // A host without an address joins groups (RFC 3376, 4.2.13), and asks for an address (RFC 2131, 4.1).
            Some([0, 0, 0, 0]) => match packet.get(9) {
                Some(&PROTOCOL_IGMP) => true,
                Some(&PROTOCOL_UDP) => {
                    let udp = usize::from(packet[0] & 0x0f) * 4;
                    let is_whole = u16_at(packet, 6).is_some_and(|fragment| fragment & 0x3fff == 0);
                    let ports = [u16_at(packet, udp), u16_at(packet, udp + 2)];
                    is_whole && ports == [Some(DHCP_CLIENT), Some(DHCP_SERVER)]
                }
                _ => false,
            },
            _ => false,
        }
    }

    fn has_ipv6(&self, address: Option<&[u8]>) -> bool {
        address == Some(&self.ipv6) || address == Some(&self.link_local)
    }

    fn ipv6_forgery(&self, packet: &[u8]) -> Option<Forgery> {
        let source = packet.get(8..24);
        let is_unspecified = source == Some(&UNSPECIFIED);
        if !is_unspecified && !self.has_ipv6(source) {
            return Some(Forgery::Ipv6);
        }
        let otherwise = is_unspecified.then_some(Forgery::Ipv6);
        let (mut protocol, mut at) = (*packet.get(6)?, IPV6);
        let mut is_fragment = false;
        // Headers before that of the transport (RFC 8200, 4.1). All are in the first fragment (RFC 7112).
        while let 0 | 43 | 60 | 135 | 139 | 140 | PROTOCOL_FRAGMENT | PROTOCOL_AUTHENTICATION = protocol {
            let Some(&[next, length]) = packet.get(at..at + 2) else { return Some(Forgery::Ipv6) };
            if protocol == PROTOCOL_FRAGMENT {
                let Some(place) = u16_at(packet, at + 2) else { return Some(Forgery::Ipv6) };
                if place & 0xfff8 != 0 {
                    return otherwise;
                }
                is_fragment = true;
            }
            at += match protocol {
                PROTOCOL_FRAGMENT => 8,
                PROTOCOL_AUTHENTICATION => (usize::from(length) + 2) * 4,
                _ => (usize::from(length) + 1) * 8,
            };
            protocol = next;
        }
        if protocol != PROTOCOL_ICMPV6 {
            return otherwise;
        }
        // A kernel reads no further than the packet says it is long.
        let end = match usize::from(u16_at(packet, 4)?) {
            0 => packet.len(),
            length => packet.len().min(IPV6 + length),
        };
        let message = packet.get(at..end).unwrap_or_default();
        let is_neighbour_discovery = message.first().is_some_and(|kind| (133..=137).contains(kind));
        // Neighbour discovery in fragments is ignored (RFC 6980).
        if is_neighbour_discovery && (is_fragment || !self.discovers(message, is_unspecified)) {
            return Some(Forgery::NeighbourDiscovery);
        }
        // Hosts report groups before they have an address, too (RFC 3590).
        let is_report = matches!(message.first(), Some(131 | 132 | 143));
        if is_neighbour_discovery || is_report { None } else { otherwise }
    }

    /// Whether a message of neighbour discovery is one of a host, and about this one (RFC 4861).
    fn discovers(&self, message: &[u8], is_unspecified: bool) -> bool {
        let target = message.get(8..24);
        let options = match message[0] {
            // A router solicitation.
            133 => 8,
            // A neighbour solicitation. From no address, it detects duplicates of the target (RFC 4862, 5.4).
            135 if target.is_some() && (!is_unspecified || self.has_ipv6(target)) => 24,
            // A neighbour advertisement.
            136 if !is_unspecified && self.has_ipv6(target) => 24,
            // Router advertisements and redirects are those of routers, which hosts are not.
            _ => return false,
        };
        let Some(mut options) = message.get(options..) else { return false };
        while let [kind, length, rest @ ..] = options {
            let length = usize::from(*length) * 8;
            // The link-layer address of the sender, or of the target.
            let is_own = !matches!(kind, 1 | 2) || length == 8 && rest.get(..6) == Some(&self.mac);
            if length == 0 || length > options.len() || !is_own {
                return false;
            }
            options = &options[length..];
        }
        options.is_empty()
    }
}
