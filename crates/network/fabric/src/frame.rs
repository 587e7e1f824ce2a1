//! Ethernet frames with the work that a sender left to the network card: checksums to complete and super-packets to cut.
//! Both are put off until a link needs them, because that is what makes the data path fast.

use std::ops::Range;

use cotorra_flows::{
    Frame as Seen, checksum,
    headers::{
        self, ETHERNET, IPV6, IpVersion, PROTOCOL_TCP, PROTOCOL_UDP, UDP, UDP_CHECKSUM, find_ip,
        pseudo_header_sum, u16_at,
    },
};
use cotorra_graph::LostCause;

use crate::{
    pool::Pool,
    trace::{DirectedLink, Trace},
};

/// A checksum to complete (virtio 1.2, 5.1.6.2). The ones' complement sum of everything from `start` on belongs at
/// `start + offset`, which holds the sum of the pseudo header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Checksum {
    /// First covered byte, from the beginning of the frame.
    pub start: u16,
    /// Place of the checksum, from `start`.
    pub offset: u16,
}

/// The protocol of a super-packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentationKind {
    /// TCP over IPv4 (TSO).
    Tcp4,
    /// TCP over IPv6 (TSO).
    Tcp6,
    /// UDP over either (USO).
    Udp,
}

/// The sizes by which a super-packet is cut into packets as they are on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segmentation {
    /// Protocol of the payload.
    pub kind: SegmentationKind,
    /// Payload bytes of a packet (the MSS); the last may have fewer.
    pub size: u16,
    /// Length of all headers, from Ethernet to transport. A sender's value is a hint; frames out of the fabric have the
    /// right one.
    pub header_len: u16,
}

/// Work that the sender left undone, as in a `virtio_net_hdr`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Offload {
    /// A checksum to complete.
    pub checksum: Option<Checksum>,
    /// A super-packet to cut.
    pub segmentation: Option<Segmentation>,
}

impl Offload {
    /// No work left.
    pub const NONE: Self = Self { checksum: None, segmentation: None };
}

/// An inconsistency between a frame and its offload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// A frame shorter than an Ethernet header.
    #[error("a frame has an Ethernet header of 14 bytes; this one is shorter")]
    Short,
    /// A checksum behind the frame's end.
    #[error("the checksum's place lies behind the frame's end")]
    ChecksumBeyondEnd,
    /// A checksum that is not the transport's.
    #[error("the checksum to complete is not that of the super-packet's transport header")]
    ChecksumElsewhere,
    /// A packet size of 0.
    #[error("a super-packet is cut into packets of 1 byte or more, not 0")]
    NoSize,
    /// Headers of another kind, or cut off.
    #[error("the super-packet's headers are not those of its kind, or are cut off")]
    Headers,
}

/// An Ethernet frame, destination address first and without FCS, and its offload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    bytes: Vec<u8>,
    offload: Offload,
    /// The way so far, of a frame that is followed.
    trace: Option<Box<Trace>>,
}

/// Offsets of a super-packet's headers.
struct Layout {
    ip: usize,
    version: IpVersion,
    transport: usize,
    payload: usize,
}

/// Offset of the checksum in the TCP header.
const TCP_CHECKSUM: usize = 16;
const TCP_FLAGS: usize = 13;
const FIN_AND_PSH: u8 = 0x09;
const CWR: u8 = 0x80;

impl Frame {
    /// Creates a frame without an offload.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self::with_offload(bytes, Offload::NONE)
    }

    /// Creates a frame with an offload.
    pub fn with_offload(bytes: Vec<u8>, offload: Offload) -> Self {
        Self { bytes, offload, trace: None }
    }

    /// Copies the frame into a buffer of the pool.
    pub(crate) fn copy(&self, pool: &mut Pool) -> Self {
        let mut buffer = pool.take(self.bytes.len());
        buffer.extend_from_slice(&self.bytes);
        Self { bytes: buffer, offload: self.offload, trace: self.trace.clone() }
    }

    /// Follows the frame from now on.
    pub(crate) fn follow(&mut self, trace: Trace) {
        self.trace = Some(Box::new(trace));
    }

    /// Returns the way so far, of a frame that is followed.
    pub(crate) fn trace(&mut self) -> Option<&mut Trace> {
        self.trace.as_deref_mut()
    }

    /// Records where and why the frame is lost or damaged, if it is followed. The first place counts.
    pub(crate) fn end(&mut self, link: Option<DirectedLink>, cause: LostCause) {
        if let Some(trace) = &mut self.trace {
            trace.ended.get_or_insert((link, cause));
        }
    }

    /// Ends following the frame, and returns its way.
    pub(crate) fn take_trace(&mut self) -> Option<Box<Trace>> {
        self.trace.take()
    }

    /// Returns the frame as meters of flows see it.
    pub(crate) fn seen(&self) -> Seen<'_> {
        Seen {
            bytes: &self.bytes,
            checksum_left: self.offload.checksum.is_some(),
            segment: self.offload.segmentation.map(|segmentation| segmentation.size),
        }
    }

    /// Returns the frame's bytes, destination address first.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the frame's bytes for a change that keeps its length and its transport checksum.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// Returns the length in bytes. On the wire it can be more; see [`Frame::wire_bytes`].
    #[expect(clippy::len_without_is_empty, reason = "an Ethernet frame has a header, it is never empty")]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Returns the work left to do.
    pub fn offload(&self) -> Offload {
        self.offload
    }

    /// Returns the buffer for reuse.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Returns the number of packets on the wire.
    pub fn wire_packets(&self) -> u32 {
        match self.offload.segmentation {
            None => 1,
            Some(s) => {
                let payload = self.bytes.len().saturating_sub(usize::from(s.header_len));
                payload.div_ceil(usize::from(s.size.max(1))).max(1) as u32
            }
        }
    }

    /// Returns the bytes on the wire, without preamble, FCS and gap. Each packet of a super-packet counts with its own
    /// headers.
    pub fn wire_bytes(&self) -> u64 {
        let headers = self
            .offload
            .segmentation
            .map_or(0, |s| u64::from(self.wire_packets() - 1) * u64::from(s.header_len));
        self.bytes.len() as u64 + headers
    }

    /// Returns the destination address.
    pub(crate) fn destination(&self) -> Option<[u8; 6]> {
        self.bytes.first_chunk().copied()
    }

    /// Returns the source address.
    pub(crate) fn source(&self) -> Option<[u8; 6]> {
        self.bytes.get(6..12)?.first_chunk().copied()
    }

    /// Checks the offload and corrects the length of its headers, so that later steps can rely on both.
    ///
    /// # Errors
    /// [`Malformed`] for an inconsistent offload.
    pub fn check(&mut self) -> Result<(), Malformed> {
        if self.bytes.len() < ETHERNET {
            return Err(Malformed::Short);
        }
        if let Some(checksum) = self.offload.checksum {
            self.checksum_place(checksum).ok_or(Malformed::ChecksumBeyondEnd)?;
        }
        let Some(segmentation) = self.offload.segmentation else { return Ok(()) };
        let layout = self.layout(segmentation)?;
        let single = self.bytes.len() - layout.payload <= usize::from(segmentation.size);
        self.offload.segmentation =
            (!single).then_some(Segmentation { header_len: layout.payload as u16, ..segmentation });
        Ok(())
    }

    /// Completes the checksum, if the sender left it undone.
    ///
    /// # Errors
    /// [`Malformed::ChecksumBeyondEnd`]. The frame is unchanged then.
    pub fn complete_checksum(&mut self) -> Result<(), Malformed> {
        let Some(checksum) = self.offload.checksum else { return Ok(()) };
        let place = self.checksum_place(checksum).ok_or(Malformed::ChecksumBeyondEnd)?;
        let sum = checksum::sum(&self.bytes[usize::from(checksum.start)..]);
        self.bytes[place].copy_from_slice(&checksum::complement(sum).to_be_bytes());
        self.offload.checksum = None;
        Ok(())
    }

    /// Cuts a super-packet into the packets that it is on the wire and appends them to `out`. Any other frame is appended
    /// unchanged. Each packet has a completed checksum if the super-packet had one, and one to complete otherwise.
    ///
    /// Cuts as a network card does: TCP sequence numbers and IPv4 identifications count up, FIN and PSH go with the last
    /// packet, CWR with the first (RFC 3168, 6.1.2).
    ///
    /// # Errors
    /// [`Malformed`]. `out` is unchanged then.
    pub fn segment(self, out: &mut Vec<Self>) -> Result<(), Malformed> {
        self.segment_with(&mut Pool::default(), |packet| out.push(packet))
    }

    /// [`Frame::segment`] with buffers from a pool, which takes this frame's buffer.
    pub(crate) fn segment_with(
        mut self,
        pool: &mut Pool,
        mut each: impl FnMut(Self),
    ) -> Result<(), Malformed> {
        self.check()?;
        let Some(segmentation) = self.offload.segmentation else {
            each(self);
            return Ok(());
        };
        let layout = self.layout(segmentation)?;
        let offload = Offload { segmentation: None, ..self.offload };
        let (headers, payload) = self.bytes.split_at(layout.payload);
        let size = usize::from(segmentation.size);
        let last = payload.len().div_ceil(size) - 1;
        for (i, part) in payload.chunks(size).enumerate() {
            let mut bytes = pool.take(headers.len() + part.len());
            bytes.extend_from_slice(headers);
            bytes.extend_from_slice(part);
            layout.renumber(&mut bytes, segmentation.kind, i, size, i == last);
            let mut packet = Self { bytes, offload, trace: self.trace.clone() };
            if offload.checksum.is_none() {
                let offset = checksum_offset(segmentation.kind) as u16;
                packet.offload.checksum = Some(Checksum { start: layout.transport as u16, offset });
                packet.complete_checksum()?;
            }
            each(packet);
        }
        pool.put(self.into_bytes());
        Ok(())
    }

    /// Flips one bit behind the Ethernet header: the `choice`-th, modulo their number. Completes the checksum first, so
    /// that the receiver can detect the damage. Returns `false` if there is nothing to flip.
    pub(crate) fn flip_bit(&mut self, choice: u64) -> bool {
        let bits = self.bytes.len().saturating_sub(ETHERNET) as u64 * 8;
        if bits == 0 || self.complete_checksum().is_err() {
            return false;
        }
        let bit = choice % bits;
        self.bytes[ETHERNET + (bit / 8) as usize] ^= 1 << (bit % 8);
        true
    }

    fn checksum_place(&self, checksum: Checksum) -> Option<Range<usize>> {
        let at = usize::from(checksum.start) + usize::from(checksum.offset);
        (at + 2 <= self.bytes.len()).then_some(at..at + 2)
    }

    fn layout(&self, segmentation: Segmentation) -> Result<Layout, Malformed> {
        if segmentation.size == 0 {
            return Err(Malformed::NoSize);
        }
        let layout = Layout::of(&self.bytes, segmentation.kind).ok_or(Malformed::Headers)?;
        let here =
            Checksum { start: layout.transport as u16, offset: checksum_offset(segmentation.kind) as u16 };
        if self.offload.checksum.is_some_and(|c| c != here) {
            return Err(Malformed::ChecksumElsewhere);
        }
        Ok(layout)
    }
}

fn checksum_offset(kind: SegmentationKind) -> usize {
    match kind {
        SegmentationKind::Tcp4 | SegmentationKind::Tcp6 => TCP_CHECKSUM,
        SegmentationKind::Udp => UDP_CHECKSUM,
    }
}

impl Layout {
    /// Finds the headers of a super-packet; `None` if they do not match its kind.
    fn of(bytes: &[u8], kind: SegmentationKind) -> Option<Self> {
        let (ip, version) = find_ip(bytes)?;
        let (protocol, transport) = match version {
            IpVersion::V4 => Self::ipv4(bytes, ip)?,
            IpVersion::V6 => Self::ipv6(bytes, ip)?,
        };
        let payload = match (kind, version, protocol) {
            (SegmentationKind::Tcp4, IpVersion::V4, PROTOCOL_TCP)
            | (SegmentationKind::Tcp6, IpVersion::V6, PROTOCOL_TCP) => {
                let length = usize::from(bytes.get(transport + 12)? >> 4) * 4;
                (length >= headers::TCP).then_some(transport + length)?
            }
            (SegmentationKind::Udp, _, PROTOCOL_UDP) => transport + UDP,
            _ => return None,
        };
        (payload < bytes.len()).then_some(Self { ip, version, transport, payload })
    }

    fn ipv4(bytes: &[u8], ip: usize) -> Option<(u8, usize)> {
        let first = *bytes.get(ip)?;
        let length = usize::from(first & 0x0f) * 4;
        let whole = usize::from(u16_at(bytes, ip + 2)?) == bytes.len() - ip;
        // "More fragments" and the offset: a fragment has no transport header to copy.
        let fragment = u16_at(bytes, ip + 6)? & 0x3fff != 0;
        (first >> 4 == 4 && length >= headers::IPV4 && whole && !fragment)
            .then_some((*bytes.get(ip + 9)?, ip + length))
    }

    fn ipv6(bytes: &[u8], ip: usize) -> Option<(u8, usize)> {
        let whole = usize::from(u16_at(bytes, ip + 4)?) + IPV6 == bytes.len() - ip;
        if bytes.get(ip)? >> 4 != 6 || !whole {
            return None;
        }
        let (mut protocol, mut at) = (*bytes.get(ip + 6)?, ip + IPV6);
        // Hop-by-hop options, routing, destination options (RFC 8200, 4.1). Super-packets have no others.
        while matches!(protocol, 0 | 43 | 60) {
            protocol = *bytes.get(at)?;
            at += (usize::from(*bytes.get(at + 1)?) + 1) * 8;
        }
        Some((protocol, at))
    }

    /// Turns the copied headers into those of the `i`-th packet.
    fn renumber(&self, bytes: &mut [u8], kind: SegmentationKind, i: usize, size: usize, last: bool) {
        let ip_length = bytes.len() - self.ip;
        let transport_length = bytes.len() - self.transport;
        let put = |bytes: &mut [u8], at: usize, value: u16| {
            bytes[at..at + 2].copy_from_slice(&value.to_be_bytes());
        };
        match self.version {
            IpVersion::V4 => {
                put(bytes, self.ip + 2, ip_length as u16);
                let id = u16::from_be_bytes([bytes[self.ip + 4], bytes[self.ip + 5]]);
                put(bytes, self.ip + 4, id.wrapping_add(i as u16));
                put(bytes, self.ip + 10, 0);
                let header = self.ip..self.ip + usize::from(bytes[self.ip] & 0x0f) * 4;
                let sum = !checksum::fold(checksum::sum(&bytes[header]));
                put(bytes, self.ip + 10, sum);
            }
            IpVersion::V6 => put(bytes, self.ip + 4, (ip_length - IPV6) as u16),
        }
        let protocol = if kind == SegmentationKind::Udp {
            put(bytes, self.transport + 4, transport_length as u16);
            PROTOCOL_UDP
        } else {
            let at = self.transport + 4;
            let before = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
            let sequence = u32::from_be_bytes(before).wrapping_add((i * size) as u32);
            bytes[at..at + 4].copy_from_slice(&sequence.to_be_bytes());
            if !last {
                bytes[self.transport + TCP_FLAGS] &= !FIN_AND_PSH;
            }
            if i > 0 {
                bytes[self.transport + TCP_FLAGS] &= !CWR;
            }
            PROTOCOL_TCP
        };
        // The checksum's place holds the sum of the pseudo header, to which the rest is added.
        let addresses = match self.version {
            IpVersion::V4 => self.ip + 12..self.ip + 20,
            IpVersion::V6 => self.ip + 8..self.ip + 40,
        };
        let pseudo = pseudo_header_sum(&bytes[addresses], protocol, transport_length);
        put(bytes, self.transport + checksum_offset(kind), checksum::fold(pseudo));
    }
}

impl Pool {
    /// Takes the buffer of a dropped frame, and keeps its way if it was followed.
    pub(crate) fn discard(&mut self, mut frame: Frame) {
        if let Some(trace) = frame.take_trace() {
            self.ended(trace);
        }
        self.put(frame.into_bytes());
    }
}
