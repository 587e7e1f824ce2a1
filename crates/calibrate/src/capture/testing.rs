//! Captures for tests.

/// An Ethernet frame and when it was captured, ns.
pub(super) type Frame = (i64, Vec<u8>);

fn ethernet_ip(protocol: u8, [from, to]: [u8; 2], identification: u16, transport: &[u8]) -> Vec<u8> {
    let mut frame = vec![2; 12];
    frame.extend([8, 0, 0x45, 0]);
    frame.extend((20 + transport.len() as u16).to_be_bytes());
    frame.extend(identification.to_be_bytes());
    frame.extend([0, 0, 64, protocol, 0, 0, 10, 0, 0, from, 10, 0, 0, to]);
    frame.extend(transport);
    frame
}

/// A UDP packet between two hosts of 10.0.0.0/24, with a number in its payload.
pub(super) fn udp(hosts: [u8; 2], number: u32, payload: usize) -> Vec<u8> {
    let mut datagram = [7000_u16, 7001, 8 + payload as u16, 0].map(u16::to_be_bytes).concat();
    datagram.extend(number.to_be_bytes());
    datagram.resize(8 + payload, 0);
    ethernet_ip(17, hosts, 0, &datagram)
}

/// A TCP segment.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tcp {
    pub hosts: [u8; 2],
    pub sequence: u32,
    pub acknowledged: u32,
    pub payload: usize,
    pub syn: bool,
    pub stamps: Option<[u32; 2]>,
}

impl Tcp {
    pub fn frame(self) -> Vec<u8> {
        let ports = self.hosts.map(|host| 5000 + u16::from(host));
        let mut tcp = ports.map(u16::to_be_bytes).concat();
        tcp.extend(self.sequence.to_be_bytes());
        tcp.extend(self.acknowledged.to_be_bytes());
        let words = if self.stamps.is_some() { 8 } else { 5 };
        tcp.extend([words << 4, if self.syn { 0x12 } else { 0x10 }, 0xff, 0xff, 0, 0, 0, 0]);
        if let Some(stamps) = self.stamps {
            tcp.extend([1, 1, 8, 10]);
            tcp.extend(stamps.map(u32::to_be_bytes).concat());
        }
        tcp.resize(tcp.len() + self.payload, 0x55);
        ethernet_ip(6, self.hosts, self.sequence as u16, &tcp)
    }
}

/// A pcap file with nanoseconds that keeps the first `snap` bytes of each frame.
pub(super) fn pcap_cut(frames: &[Frame], snap: usize) -> Vec<u8> {
    let mut file = [0xa1b2_3c4d, 0x0004_0002, 0, 0, snap as u32, 1].map(u32::to_le_bytes).concat();
    for (at_ns, frame) in frames {
        let kept = &frame[..frame.len().min(snap)];
        let (seconds, ns) = (at_ns.div_euclid(1_000_000_000), at_ns.rem_euclid(1_000_000_000));
        let header = [seconds as u32, ns as u32, kept.len() as u32, frame.len() as u32];
        file.extend(header.map(u32::to_le_bytes).concat());
        file.extend(kept);
    }
    file
}

/// A pcap file with nanoseconds.
pub(super) fn pcap(frames: &[Frame]) -> Vec<u8> {
    pcap_cut(frames, 65_535)
}

/// A pcap file of a machine with the other order of bytes, with microseconds.
pub(super) fn big_endian_pcap(frames: &[Frame]) -> Vec<u8> {
    let mut file = [0xa1b2_c3d4, 0x0002_0004, 0, 0, 65_535, 1_u32].map(u32::to_be_bytes).concat();
    for (at_ns, frame) in frames {
        let length = frame.len() as u32;
        let header = [(at_ns / 1_000_000_000) as u32, (at_ns % 1_000_000_000 / 1000) as u32, length, length];
        file.extend(header.map(u32::to_be_bytes).concat());
        file.extend(frame);
    }
    file
}

/// A block of pcapng.
pub(super) fn block(kind: u32, body: &[u8]) -> Vec<u8> {
    let mut body = body.to_vec();
    body.resize(body.len().next_multiple_of(4), 0);
    let length = (body.len() as u32 + 12).to_le_bytes();
    [&kind.to_le_bytes()[..], &length, &body, &length].concat()
}

/// A pcapng file whose interface has options; times are given in its units.
pub(super) fn pcapng(options: &[u8], frames: &[(u64, Vec<u8>)]) -> Vec<u8> {
    let section = [&0x1a2b_3c4d_u32.to_le_bytes()[..], &[1, 0, 0, 0], &[0xff; 8]].concat();
    let interface = [&[1, 0, 0, 0, 0, 0, 0, 0][..], options].concat();
    let mut file = [block(0x0a0d_0d0a, &section), block(1, &interface)].concat();
    for (time, frame) in frames {
        let length = frame.len() as u32;
        let head = [0, (time >> 32) as u32, *time as u32, length, length].map(u32::to_le_bytes).concat();
        file.extend(block(6, &[&head[..], frame].concat()));
    }
    file
}
