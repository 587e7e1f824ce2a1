//! Port security: what a host's port lets in.

use cotorra_fabric::{Fabric, ForgedFrames, ForgedSources, Frame, PortId};
use cotorra_graph::{Conditions, HostAddress};
use proptest::prelude::*;

use crate::common::{A, B, Network, ms, pair, run};

const ALL: [u8; 6] = [0xff; 6];
const GROUP6: [u8; 6] = [0x33, 0x33, 0, 0, 0, 1];
const UNSPECIFIED: [u8; 16] = [0; 16];

fn own() -> HostAddress {
    HostAddress::of(A.0)
}

/// The other host, as which host A may not pass.
fn other() -> HostAddress {
    HostAddress::of(B.0)
}

/// A host that is not in the graph.
fn stranger() -> HostAddress {
    HostAddress::of(7)
}

fn ethernet(to: [u8; 6], from: [u8; 6], ethertype: u16, payload: &[u8]) -> Vec<u8> {
    [&to[..], &from, &ethertype.to_be_bytes(), payload].concat()
}

/// An ARP packet with this operation in the name of a MAC and an IPv4 address.
fn arp(operation: u8, mac: [u8; 6], ipv4: [u8; 4]) -> Vec<u8> {
    let target = other().ipv4.octets();
    let head = [0, 1, 8, 0, 6, 4, 0, operation];
    ethernet(ALL, own().mac, 0x0806, &[&head[..], &mac, &ipv4, &[0; 6], &target].concat())
}

fn ipv4(from: [u8; 4], protocol: u8, payload: &[u8]) -> Vec<u8> {
    let length = (20 + payload.len() as u16).to_be_bytes();
    let head = [0x45, 0, length[0], length[1], 0, 0, 0, 0, 64, protocol, 0, 0];
    let packet = [&head[..], &from, &other().ipv4.octets(), payload].concat();
    ethernet(other().mac, own().mac, 0x0800, &packet)
}

fn ipv6(from: [u8; 16], protocol: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u16).to_be_bytes();
    let head = [0x60, 0, 0, 0, length[0], length[1], protocol, 255];
    let packet = [&head[..], &from, &other().ipv6.octets(), payload].concat();
    ethernet(GROUP6, own().mac, 0x86dd, &packet)
}

fn link_local(of: HostAddress) -> [u8; 16] {
    let [a, b, c, d, e, f] = of.mac;
    [0xfe, 0x80, 0, 0, 0, 0, 0, 0, a ^ 2, b, c, 0xff, 0xfe, d, e, f]
}

/// A message of neighbour discovery with a target and link-layer addresses as options.
fn discovery(kind: u8, target: Option<[u8; 16]>, options: &[(u8, [u8; 6])]) -> Vec<u8> {
    let mut message = vec![kind, 0, 0, 0, 0, 0, 0, 0];
    message.extend(target.into_iter().flatten());
    options.iter().for_each(|(kind, mac)| message.extend([&[*kind, 1][..], mac].concat()));
    message
}

fn udp(from: u16, to: u16) -> Vec<u8> {
    [&from.to_be_bytes()[..], &to.to_be_bytes(), &[0, 8, 0, 0]].concat()
}

/// Puts tags of VLANs in front of a frame's payload.
fn tagged(tags: &[[u8; 4]], frame: &[u8]) -> Vec<u8> {
    [&frame[..12], &tags.concat(), &frame[12..]].concat()
}

/// Puts headers of extensions in front of an IPv6 payload, the last of which names its protocol.
fn extended(from: [u8; 16], first: u8, headers: &[&[u8]], payload: &[u8]) -> Vec<u8> {
    ipv6(from, first, &[&headers.concat(), payload].concat())
}

/// Sends a frame of host A. Returns the number of deliveries, and what was forged.
fn sent_through(fabric: &mut Fabric, frame: Vec<u8>) -> (usize, Vec<ForgedSources>) {
    fabric.push(ms(0.0), A, Frame::new(frame));
    let delivered = run(fabric, ms(0.0), ms(50.0)).len();
    (delivered, fabric.forged_sources())
}

fn sent(frame: Vec<u8>) -> (usize, Vec<ForgedSources>) {
    sent_through(&mut pair(Conditions::default(), 1), frame)
}

fn honest() -> Vec<Vec<u8>> {
    let (mac, v4, v6, local) = (own().mac, own().ipv4.octets(), own().ipv6.octets(), link_local(own()));
    let solicitation = discovery(135, Some(other().ipv6.octets()), &[(1, mac)]);
    let duplicates = discovery(135, Some(local), &[(14, [0; 6])]);
    let advertisement = discovery(136, Some(v6), &[(2, mac)]);
    let hop_by_hop: &[u8] = &[58, 0, 5, 2, 0, 0, 1, 0];
    let report = [143, 0, 0, 0, 0, 0, 0, 0];
    vec![
        ethernet(other().mac, mac, 0x88b5, &[]),
        arp(1, mac, v4),
        arp(2, mac, v4),
        // A probe.
        arp(1, mac, [0; 4]),
        ipv4(v4, 17, &udp(4000, 4000)),
        ipv4(v4, 6, &[]),
        // Before it has an address.
        ipv4([0; 4], 17, &udp(68, 67)),
        ipv4([0; 4], 2, &[0x22, 0, 0, 0]),
        ipv6(v6, 17, &udp(4000, 4000)),
        ipv6(local, 17, &udp(546, 547)),
        ipv6(v6, 58, &[128, 0, 0, 0]),
        ipv6(v6, 59, &[]),
        ipv6(v6, 58, &solicitation),
        ipv6(local, 58, &solicitation),
        ipv6(UNSPECIFIED, 58, &duplicates),
        ipv6(v6, 58, &advertisement),
        ipv6(local, 58, &discovery(136, Some(local), &[])),
        ipv6(local, 58, &discovery(133, None, &[(1, mac)])),
        ipv6(UNSPECIFIED, 58, &discovery(133, None, &[])),
        extended(local, 0, &[hop_by_hop], &report),
        extended(UNSPECIFIED, 0, &[hop_by_hop], &report),
        // The first fragment of a datagram, and one behind it.
        extended(v6, 44, &[&[17, 0, 0, 1, 0, 0, 0, 1]], &udp(4000, 4000)),
        extended(v6, 44, &[&[58, 0, 0x05, 0xa8, 0, 0, 0, 1]], &[134, 0, 0, 0]),
        tagged(&[[0x81, 0, 0, 7]], &ipv4(v4, 17, &udp(4000, 4000))),
        tagged(&[[0x88, 0xa8, 0, 7], [0x81, 0, 0, 0]], &ipv6(v6, 58, &advertisement)),
    ]
}

/// Reads the counter that a frame belongs to.
type Counter = fn(&ForgedFrames) -> u64;

/// Frames with forged sources, and their counters.
fn forged() -> Vec<(Counter, Vec<u8>)> {
    const ETHERNET: Counter = |frames| frames.ethernet;
    const ARP: Counter = |frames| frames.arp;
    const ND: Counter = |frames| frames.neighbour_discovery;
    const V4: Counter = |frames| frames.ipv4;
    const V6: Counter = |frames| frames.ipv6;
    let (mac, v4, v6, local) = (own().mac, own().ipv4.octets(), own().ipv6.octets(), link_local(own()));
    let (its, its_v4, its_v6) = (other().mac, other().ipv4.octets(), other().ipv6.octets());
    let advertised = discovery(136, Some(its_v6), &[(2, mac)]);
    let router = discovery(134, None, &[(1, mac)]);
    let destination: &[u8] = &[58, 0, 1, 4, 0, 0, 0, 0];
    let mut in_another_name = ipv4(v4, 17, &udp(4000, 4000));
    in_another_name[6..12].copy_from_slice(&its);
    let mut of_nobody = ipv4(v4, 17, &udp(4000, 4000));
    of_nobody[6..12].copy_from_slice(&[0x02, 0x42, 0xac, 0x11, 0, 2]);
    let mut odd_hardware = arp(2, mac, v4);
    odd_hardware[15] = 6;
    let unasked = discovery(135, Some(its_v6), &[]);
    let cut_off = ipv6(v6, 58, &advertised)[..14 + 40 + 23].to_vec();
    let empty_option = [&discovery(136, Some(v6), &[])[..], &[2, 0, 0, 0, 0, 0, 0, 0]].concat();
    vec![
        (ETHERNET, in_another_name),
        (ETHERNET, of_nobody),
        (ETHERNET, ethernet(ALL, its, 0x88b5, &[])),
        (ETHERNET, tagged(&[[0x81, 0, 0, 0]], &ipv4(v4, 17, &[]))[..16].to_vec()),
        // Answers and gratuitous ARP.
        (ARP, arp(2, mac, its_v4)),
        (ARP, arp(1, mac, its_v4)),
        (ARP, arp(2, its, its_v4)),
        (ARP, arp(2, its, v4)),
        (ARP, arp(2, mac, [0; 4])),
        (ARP, odd_hardware),
        (ARP, arp(2, mac, v4)[..41].to_vec()),
        (ARP, tagged(&[[0x81, 0, 0, 0]], &arp(2, mac, its_v4))),
        (ARP, tagged(&[[0x81, 0, 0, 0]; 9], &arp(2, mac, its_v4))),
        (V4, ipv4(its_v4, 17, &udp(4000, 4000))),
        (V4, ipv4(stranger().ipv4.octets(), 6, &[])),
        (V4, ipv4([127, 0, 0, 1], 17, &udp(4000, 4000))),
        (V4, ipv4([0; 4], 17, &udp(4000, 4000))),
        (V4, ipv4([0; 4], 6, &[])),
        (V4, ipv4(v4, 17, &[])[..29].to_vec()),
        (V4, tagged(&[[0x88, 0xa8, 0, 0]], &ipv4(its_v4, 17, &udp(4000, 4000)))),
        (V6, ipv6(its_v6, 17, &udp(4000, 4000))),
        (V6, ipv6(link_local(other()), 17, &udp(4000, 4000))),
        (V6, ipv6(UNSPECIFIED, 17, &udp(4000, 4000))),
        (V6, ipv6(UNSPECIFIED, 58, &[128, 0, 0, 0])),
        (V6, ipv6(v6, 17, &[])[..37].to_vec()),
        // A chain of headers that is cut off.
        (V6, extended(v6, 60, &[&[60, 9, 1, 4, 0, 0, 0, 0]], &[])),
        (ND, ipv6(v6, 58, &advertised)),
        (ND, ipv6(local, 58, &advertised)),
        (ND, ipv6(v6, 58, &discovery(136, Some(v6), &[(2, its)]))),
        (ND, ipv6(v6, 58, &discovery(136, Some(link_local(other())), &[]))),
        (ND, ipv6(UNSPECIFIED, 58, &discovery(136, Some(v6), &[]))),
        (ND, ipv6(v6, 58, &discovery(135, Some(its_v6), &[(1, its)]))),
        (ND, ipv6(UNSPECIFIED, 58, &unasked)),
        (ND, ipv6(local, 58, &router)),
        (ND, ipv6(local, 58, &discovery(133, None, &[(1, its)]))),
        (ND, ipv6(local, 58, &discovery(137, Some(its_v6), &[(2, mac)]))),
        (ND, extended(local, 60, &[destination], &router)),
        (ND, extended(local, 44, &[&[58, 0, 0, 1, 0, 0, 0, 1]], &router)),
        (ND, extended(local, 44, &[&[60, 0, 0, 1, 0, 0, 0, 1], destination], &advertised)),
        (ND, ipv6(v6, 58, &empty_option)),
        (ND, cut_off),
    ]
}

#[test]
fn frames_from_a_hosts_own_addresses_pass() {
    for frame in honest() {
        assert_eq!(sent(frame.clone()), (1, vec![]), "{frame:02x?}");
    }
}

#[test]
fn frames_with_forged_sources_are_dropped_and_counted() {
    for (of_its_kind, frame) in forged() {
        let mut fabric = pair(Conditions::default(), 1);
        let (delivered, forged) = sent_through(&mut fabric, frame.clone());
        let [ForgedSources { node, allowed: false, frames }] = &forged[..] else {
            panic!("{forged:?}: {frame:02x?}")
        };
        let counts = (node.as_str(), of_its_kind(frames), frames.total());
        assert_eq!((delivered, counts), (0, ("a", 1, 1)), "{frame:02x?}");
        let balance = fabric.balance();
        assert_eq!((balance.sent, balance.stranded, fabric.drops().unroutable), (0, 0, 0));
    }
}

#[test]
fn a_host_without_port_security_sends_from_any_address_and_is_named() {
    for (of_its_kind, frame) in forged() {
        let mut fabric = pair(Conditions::default(), 1);
        fabric.disable_port_security(&"a".parse().unwrap());
        let (delivered, forged) = sent_through(&mut fabric, frame.clone());
        let [ForgedSources { allowed: true, frames, .. }] = &forged[..] else { panic!("{forged:?}") };
        assert_eq!((delivered, of_its_kind(frames)), (1, 1), "{frame:02x?}");
    }
}

#[test]
fn a_forged_frame_moves_no_address_to_its_port() {
    let mut fabric = Network::new()
        .servers(&["a", "b", "c"])
        .switches(&["s"])
        .link("a", "s", Conditions::default())
        .link("b", "s", Conditions::default())
        .link("c", "s", Conditions::default())
        .fabric(1);
    let container = [0x02, 0x42, 0xac, 0x11, 0, 2];
    fabric.push(ms(0.0), A, Frame::new(ethernet(ALL, container, 0x88b5, &[])));
    fabric.push(ms(0.0), B, Frame::new(ethernet(container, other().mac, 0x88b5, &[])));
    let mut reached: Vec<_> = run(&mut fabric, ms(0.0), ms(50.0)).iter().map(|d| d.port).collect();
    reached.sort_unstable();
    assert_eq!(reached, [A, PortId(2)], "all, as with an unknown address");
}

proptest! {
    /// Whatever comes, nothing with another MAC address, ARP sender or IP source passes.
    #[test]
    fn no_bytes_pass_that_name_another_sender(
        which in 0..64_usize,
        edits in proptest::collection::vec((6..90_usize, any::<u8>()), 0..4),
        length in 14..120_usize,
    ) {
        let mut all = honest();
        all.extend(forged().into_iter().map(|(_, frame)| frame));
        let mut frame = all[which % all.len()].clone();
        for (at, byte) in edits {
            if let Some(place) = frame.get_mut(at) {
                *place = byte;
            }
        }
        frame.truncate(length);
        if sent(frame.clone()).0 > 0 {
            prop_assert_eq!(&frame[6..12], &own().mac);
            match frame[12..14] {
                [0x08, 0x00] => {
                    prop_assert!([own().ipv4.octets(), [0; 4]].iter().any(|ours| frame[26..30] == *ours));
                }
                [0x08, 0x06] => {
                    prop_assert_eq!(&frame[22..28], &own().mac);
                    prop_assert!([own().ipv4.octets(), [0; 4]].iter().any(|ours| frame[28..32] == *ours));
                }
                [0x86, 0xdd] => {
                    let ours = [own().ipv6.octets(), link_local(own()), UNSPECIFIED];
                    prop_assert!(ours.iter().any(|ours| frame[22..38] == *ours));
                }
                _ => {}
            }
        }
    }
}
