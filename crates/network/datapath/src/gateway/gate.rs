//! Decides which frames pass a gateway, and counts them. Frames from outside are hostile input, and frames of hosts must not
//! disturb the real network.

use std::{
    collections::{BTreeSet, HashSet},
    net::Ipv4Addr,
    time::Duration,
};

use cotorra_fabric::{Frame, Histogram};
use cotorra_graph::{Gateway, HostAddress, Lateness, Timestamp};

use crate::{allowance::Allowance, hosts::MTU};

/// The I/G bit of an address, which marks a group (IEEE 802).
pub(super) const GROUP: u8 = 0x01;
/// EtherTypes that pass.
pub(super) const IPV4: u16 = 0x0800;
pub(super) const ARP: u16 = 0x0806;

const ETHERNET: usize = 14;
/// Beginning of an ARP packet about IPv4 over Ethernet (RFC 826).
const ARP_IPV4: [u8; 6] = [0, 1, 8, 0, 6, 4];
/// Most frames a second to groups, in each direction. Each goes to all hosts.
const MOST_GROUP_FRAMES: f64 = 1000.0;
/// Most MAC addresses behind a gateway: those of its machines, and of cards that take their place.
const MOST_ADDRESSES: usize = 4 * Gateway::MAX_MACHINES;

/// Counters of a gateway's frames.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Passed {
    /// Frames from outside that went on to the emulated network.
    pub received: u64,
    /// Frames from the emulated network that went out.
    pub sent: u64,
    /// Frames from outside that break a rule: wrong addresses, too long, or too many to groups.
    pub rejected: u64,
    /// Frames that were to pass and were lost, because the interface was down or a queue was full.
    pub dropped: u64,
    /// Time from a frame's arrival in the kernel until the emulated network had it.
    pub received_lateness: Lateness,
    /// Time in which the kernel took a frame to the interface.
    pub sent_lateness: Lateness,
}

/// The rules and counters of a gateway. It has no clock.
#[derive(Debug)]
pub(crate) struct Gate {
    hosts: usize,
    machines: BTreeSet<Ipv4Addr>,
    /// MAC addresses of machines.
    learnt: HashSet<[u8; 6]>,
    groups: Groups,
    inward: Allowance,
    outward: Allowance,
    passed: Passed,
    received: Histogram,
    sent: Histogram,
}

/// Destination of frames of hosts to groups.
#[derive(Debug)]
enum Groups {
    /// The group: all machines on the interface's network receive them.
    Group,
    /// The only machine, at the MAC address that it used last. No other machine receives them, not even another real server
    /// behind the interface, which has copies of its own.
    Machine(Option<[u8; 6]>),
}

/// Addresses in a frame that may pass.
struct Addresses {
    destination: [u8; 6],
    source: [u8; 6],
    /// The sender's IPv4 address.
    sender: Ipv4Addr,
    /// The address that an ARP packet is about.
    target: Option<Ipv4Addr>,
}

impl Addresses {
    /// Reads the addresses of a frame of IPv4, or of ARP that names its own sender.
    fn of(frame: &[u8]) -> Option<Self> {
        fn array<const N: usize>(frame: &[u8], at: usize) -> Option<[u8; N]> {
            frame.get(at..at + N)?.try_into().ok()
        }
        let (destination, source) = (array(frame, 0)?, array(frame, 6)?);
        let (sender, target) = match u16::from_be_bytes(array(frame, 12)?) {
            IPV4 if frame.get(ETHERNET)? >> 4 == 4 => (array::<4>(frame, ETHERNET + 12)?, None),
            ARP if array(frame, ETHERNET)? == ARP_IPV4 && array(frame, ETHERNET + 8)? == source => {
                (array(frame, ETHERNET + 14)?, Some(array::<4>(frame, ETHERNET + 24)?))
            }
            _ => return None,
        };
        Some(Self { destination, source, sender: sender.into(), target: target.map(Ipv4Addr::from) })
    }

    fn is_to_group(&self) -> bool {
        self.destination[0] & GROUP != 0
    }
}

/// Whether a frame is no longer on the wire than hosts can receive.
fn fits(frame: &Frame) -> bool {
    match frame.offload().segmentation {
        Some(cut) => u32::from(cut.size) <= MTU,
        None => frame.bytes().len() <= ETHERNET + MTU as usize,
    }
}

impl Gate {
    pub(super) fn new(hosts: usize, machines: impl IntoIterator<Item = Ipv4Addr>) -> Self {
        Self {
            hosts,
            machines: machines.into_iter().collect(),
            learnt: HashSet::new(),
            groups: Groups::Group,
            inward: Allowance::new(MOST_GROUP_FRAMES),
            outward: Allowance::new(MOST_GROUP_FRAMES),
            passed: Passed::default(),
            received: Histogram::default(),
            sent: Histogram::default(),
        }
    }

    /// Makes the gate of a real server.
    pub(super) fn of_server(hosts: usize, address: Ipv4Addr) -> Self {
        Self { groups: Groups::Machine(None), ..Self::new(hosts, [address]) }
    }

    /// Decides whether a frame from outside goes on to the emulated network. `age` is the time since the kernel received
    /// it.
    pub(crate) fn admits(&mut self, now: Timestamp, age: Duration, frame: &Frame) -> bool {
        let admits = fits(frame) && self.is_from_machine(now, frame.bytes());
        if admits {
            self.passed.received += 1;
            self.received.record(age);
        } else {
            self.reject();
        }
        admits
    }

    /// Counts a frame from outside that breaks a rule.
    pub(crate) fn reject(&mut self) {
        self.passed.rejected += 1;
    }

    fn is_from_machine(&mut self, now: Timestamp, frame: &[u8]) -> bool {
        let Some(addresses) = Addresses::of(frame) else { return false };
        let Addresses { destination, source, sender, target } = &addresses;
        if !self.machines.contains(sender)
            || source[0] & GROUP != 0
            || HostAddress::place_of(*source).is_some()
            || target.is_some_and(|target| !HostAddress::is_near(target))
        {
            return false;
        }
        let is_wanted = if addresses.is_to_group() {
            self.inward.take(now)
        } else {
            HostAddress::place_of(*destination).is_some_and(|place| place < self.hosts)
        };
        let is_learnt = is_wanted
            && (self.learnt.contains(source)
                || self.learnt.len() < MOST_ADDRESSES && self.learnt.insert(*source));
        if let (true, Groups::Machine(last)) = (is_learnt, &mut self.groups) {
            *last = Some(*source);
        }
        is_learnt
    }

    /// Returns the MAC address to which a frame of the emulated network goes out. Only frames to a machine or to a group, from
    /// a host's own addresses, do.
    pub(crate) fn way_out(&mut self, now: Timestamp, frame: &[u8]) -> Option<[u8; 6]> {
        let addresses = Addresses::of(frame)?;
        let Addresses { destination, source, sender, target } = addresses;
        let host = HostAddress::place_of(source).filter(|place| *place < self.hosts)?;
        if HostAddress::of(host).ipv4 != sender {
            return None;
        }
        if !addresses.is_to_group() {
            return self.learnt.contains(&destination).then_some(destination);
        }
        let to = match (target, &self.groups) {
            // Who has the address? Only an answer has its MAC address.
            (Some(target), _) => self.machines.contains(&target).then_some(destination)?,
            (None, Groups::Group) => destination,
            (None, Groups::Machine(last)) => (*last)?,
        };
        self.outward.take(now).then_some(to)
    }

    /// Counts a frame that went out, which took the kernel so long.
    pub(crate) fn went_out(&mut self, took: Duration) {
        self.passed.sent += 1;
        self.sent.record(took);
    }

    /// Counts frames that were to pass and were lost.
    pub(crate) fn lost(&mut self, frames: u64) {
        self.passed.dropped += frames;
    }

    pub(crate) fn passed(&self) -> Passed {
        Passed {
            received_lateness: self.received.summary(),
            sent_lateness: self.sent.summary(),
            ..self.passed
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_fabric::{Offload, Segmentation, SegmentationKind};

    use super::{super::filter, *};

    const MACHINE: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 7);
    const ITS_MAC: [u8; 6] = [0x52, 0x54, 0, 1, 2, 3];
    const ALL: [u8; 6] = [0xff; 6];
    const NOW: Timestamp = Timestamp::ZERO;

    fn gate() -> Gate {
        Gate::new(2, [MACHINE])
    }

    fn host(place: usize) -> HostAddress {
        HostAddress::of(place)
    }

    fn ip(destination: [u8; 6], source: [u8; 6], [from, to]: [Ipv4Addr; 2]) -> Vec<u8> {
        let mut frame = [destination, source].concat();
        frame.extend([8, 0, 0x45, 0, 0, 20, 0, 0, 0, 0, 64, 17, 0, 0]);
        frame.extend(from.octets());
        frame.extend(to.octets());
        frame
    }

    fn arp(destination: [u8; 6], source: [u8; 6], [sender, target]: [Ipv4Addr; 2]) -> Vec<u8> {
        let mut frame = [destination, source].concat();
        frame.extend([8, 6, 0, 1, 8, 0, 6, 4, 0, 1]);
        frame.extend(source);
        frame.extend(sender.octets());
        frame.extend([0; 6]);
        frame.extend(target.octets());
        frame
    }

    /// Whether a frame comes through the filter and the gate.
    fn comes_in(gate: &mut Gate, frame: &[u8]) -> bool {
        let admits = gate.admits(NOW, Duration::ZERO, &Frame::new(frame.to_vec()));
        let accepts = filter::tests::accepts(&filter::filter(&[MACHINE]), frame, false);
        assert!(accepts || !admits, "the filter drops what the gate admits");
        accepts && admits
    }

    #[test]
    fn machines_reach_hosts_and_groups() {
        let mut gate = gate();
        assert!(comes_in(&mut gate, &arp(ALL, ITS_MAC, [MACHINE, host(1).ipv4])));
        assert!(comes_in(&mut gate, &arp(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4])));
        assert!(comes_in(&mut gate, &ip(host(1).mac, ITS_MAC, [MACHINE, host(1).ipv4])));
        let discovery = ([1, 0, 0x5e, 0x7f, 0, 1], Ipv4Addr::new(239, 255, 0, 1));
        assert!(comes_in(&mut gate, &ip(discovery.0, ITS_MAC, [MACHINE, discovery.1])));
        assert_eq!((gate.passed().received, gate.passed().rejected), (4, 0));
    }

    #[test]
    fn frames_from_outside_with_wrong_addresses_are_rejected() {
        let mut gate = gate();
        let stranger = Ipv4Addr::new(192, 168, 1, 8);
        let mut spoofed_arp = arp(ALL, ITS_MAC, [MACHINE, host(0).ipv4]);
        spoofed_arp[22..28].copy_from_slice(&host(1).mac);
        let mut version = ip(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4]);
        version[14] = 0x65;
        for frame in [
            ip(host(0).mac, ITS_MAC, [stranger, host(0).ipv4]),
            ip(host(0).mac, ITS_MAC, [host(1).ipv4, host(0).ipv4]),
            ip(host(0).mac, host(1).mac, [MACHINE, host(0).ipv4]),
            ip(host(0).mac, ALL, [MACHINE, host(0).ipv4]),
            ip(host(2).mac, ITS_MAC, [MACHINE, host(2).ipv4]),
            ip([2, 0, 0, 0, 0, 1], ITS_MAC, [MACHINE, host(0).ipv4]),
            arp(ALL, ITS_MAC, [MACHINE, Ipv4Addr::new(192, 168, 1, 1)]),
            arp(ALL, ITS_MAC, [host(1).ipv4, host(0).ipv4]),
            spoofed_arp,
            version,
        ] {
            assert!(!comes_in(&mut gate, &frame), "{frame:x?}");
        }
        let whole = ip(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4]);
        for length in 0..whole.len() {
            assert!(!comes_in(&mut gate, &whole[..length]) || length >= 30, "cut off after {length} bytes");
        }
        let other = [&whole[..12], &[0x86, 0xdd], &whole[14..]].concat();
        assert!(!comes_in(&mut gate, &other), "IPv6");
    }

    #[test]
    fn frames_longer_than_hosts_receive_are_rejected() {
        let mut gate = gate();
        let mut frame = ip(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4]);
        frame.resize(1514, 0);
        assert!(comes_in(&mut gate, &frame));
        frame.resize(1515, 0);
        assert!(!comes_in(&mut gate, &frame));
        let mut cut_to = |size| {
            let segmentation = Segmentation { kind: SegmentationKind::Tcp4, size, header_len: 54 };
            let offload = Offload { checksum: None, segmentation: Some(segmentation) };
            gate.admits(NOW, Duration::ZERO, &Frame::with_offload(frame.clone(), offload))
        };
        assert!(cut_to(1460) && !cut_to(8960));
    }

    #[test]
    fn storms_of_broadcasts_are_limited_and_packets_to_hosts_pass() {
        let mut gate = gate();
        let broadcast = Frame::new(arp(ALL, ITS_MAC, [MACHINE, host(1).ipv4]));
        let passed = (0..5000).filter(|_| gate.admits(NOW, Duration::ZERO, &broadcast)).count();
        assert_eq!((passed, gate.passed().rejected), (1000, 4000));
        assert!(comes_in(&mut gate, &ip(host(1).mac, ITS_MAC, [MACHINE, host(1).ipv4])));
        let later = NOW + Duration::from_millis(100);
        let passed = (0..5000).filter(|_| gate.admits(later, Duration::ZERO, &broadcast)).count();
        assert_eq!(passed, 100);
    }

    #[test]
    fn a_machine_cannot_take_more_addresses_than_there_is_room_for() {
        let mut gate = gate();
        let from = |n: u16| {
            let [high, low] = n.to_be_bytes();
            ip(host(0).mac, [0x52, 0, 0, 0, high, low], [MACHINE, host(0).ipv4])
        };
        let passed = (0..10_000).filter(|n| comes_in(&mut gate, &from(*n))).count();
        assert_eq!(passed, MOST_ADDRESSES);
        assert!(comes_in(&mut gate, &from(0)), "known ones still pass");
    }

    #[test]
    fn only_frames_from_hosts_own_addresses_to_machines_and_groups_go_out() {
        let mut gate = gate();
        let mut goes_out = |frame: Vec<u8>| gate.way_out(NOW, &frame).is_some();
        assert!(!goes_out(ip(ITS_MAC, host(0).mac, [host(0).ipv4, MACHINE])), "nobody is known there");
        assert!(goes_out(arp(ALL, host(0).mac, [host(0).ipv4, MACHINE])));
        assert!(!goes_out(arp(ALL, host(0).mac, [host(0).ipv4, host(1).ipv4])), "hosts among themselves");
        let group = Ipv4Addr::new(239, 255, 0, 1);
        assert!(goes_out(ip([1, 0, 0x5e, 0x7f, 0, 1], host(0).mac, [host(0).ipv4, group])));
        assert!(comes_in(&mut gate, &arp(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4])));
        let mut goes_out = |frame: Vec<u8>| gate.way_out(NOW, &frame).is_some();
        assert!(goes_out(ip(ITS_MAC, host(0).mac, [host(0).ipv4, MACHINE])));
        assert!(!goes_out(ip(ITS_MAC, host(0).mac, [host(1).ipv4, MACHINE])), "another host's IP address");
        assert!(!goes_out(ip(ITS_MAC, host(2).mac, [host(2).ipv4, MACHINE])), "no host at all");
        assert!(!goes_out(ip(ITS_MAC, [2, 0, 0, 0, 0, 1], [host(0).ipv4, MACHINE])), "another MAC address");
        assert!(!goes_out(arp(ALL, host(0).mac, [MACHINE, MACHINE])), "in a machine's name");
    }

    #[test]
    fn frames_to_groups_reach_only_the_machine_that_a_real_server_is() {
        let mut gate = Gate::of_server(2, MACHINE);
        let group = ([1, 0, 0x5e, 0x7f, 0, 1], Ipv4Addr::new(239, 255, 0, 1));
        let to_group = ip(group.0, host(0).mac, [host(0).ipv4, group.1]);
        let to_all = ip(ALL, host(1).mac, [host(1).ipv4, Ipv4Addr::BROADCAST]);
        assert_eq!(gate.way_out(NOW, &to_group), None, "its MAC address is not known yet");
        let question = arp(ALL, host(0).mac, [host(0).ipv4, MACHINE]);
        assert_eq!(gate.way_out(NOW, &question), Some(ALL));
        let other = arp(ALL, host(0).mac, [host(0).ipv4, Ipv4Addr::new(192, 168, 1, 8)]);
        assert_eq!(gate.way_out(NOW, &other), None, "another real server's address");
        assert!(comes_in(&mut gate, &arp(host(0).mac, ITS_MAC, [MACHINE, host(0).ipv4])));
        for frame in [&to_group, &to_all] {
            assert_eq!(gate.way_out(NOW, frame), Some(ITS_MAC));
        }
        // The machine got another card.
        let new = [0x52, 0x54, 0, 9, 9, 9];
        assert!(comes_in(&mut gate, &ip(host(1).mac, new, [MACHINE, host(1).ipv4])));
        assert_eq!(gate.way_out(NOW, &to_group), Some(new));
        let answers = gate.way_out(NOW, &ip(ITS_MAC, host(0).mac, [host(0).ipv4, MACHINE]));
        assert_eq!(answers, Some(ITS_MAC), "known addresses stay known");
        let passed = (0..5000).filter(|_| gate.way_out(NOW, &to_all).is_some()).count();
        assert!(passed < 1000, "storms are limited: {passed}");
    }
}
