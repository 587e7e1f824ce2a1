//! Packets as a pcapng file (draft-ietf-opsawg-pcapng). Each direction of a link is an interface. Times are those of the
//! run, in nanoseconds since it began.

use cotorra_fabric::{Frame, Passage};
use cotorra_graph::{Direction, LinkId, Timestamp};

const SECTION_HEADER: u32 = 0x0a0d_0d0a;
const INTERFACE: u32 = 1;
const PACKET: u32 = 6;
const BYTE_ORDER_MAGIC: u32 = 0x1a2b_3c4d;
const LINKTYPE_ETHERNET: u16 = 1;

/// Codes of options.
const COMMENT: u16 = 1;
const USER_APPLICATION: u16 = 4;
const INTERFACE_NAME: u16 = 2;
const TIME_RESOLUTION: u16 = 9;
const DROP_COUNT: u16 = 4;

/// A packet that crossed a link, apart from the fabric.
#[derive(Debug)]
pub(crate) struct Captured {
    link: LinkId,
    direction: Direction,
    entered: Timestamp,
    due: Timestamp,
    delivered: Timestamp,
    lost: u64,
    overflowed: u64,
    frame: Frame,
    /// Packets that the capture missed before it.
    missed: u64,
}

impl Captured {
    pub(crate) fn new(passage: &Passage<'_>, missed: u64) -> Self {
        let Passage { link, direction, entered, due, delivered, lost, overflowed, frame } = *passage;
        let (link, frame) = (link.clone(), frame.clone());
        Self { link, direction, entered, due, delivered, lost, overflowed, frame, missed }
    }

    /// Returns the length of its bytes.
    pub(crate) fn len(&self) -> usize {
        self.frame.len()
    }
}

/// Writes packets as blocks.
#[derive(Debug)]
pub(crate) struct Writer {
    /// Most bytes of a packet that are kept.
    snap: u32,
    interfaces: Vec<Interface>,
    /// Buffer for the packets that a super-packet is cut into.
    cut: Vec<Frame>,
}

#[derive(Debug)]
struct Interface {
    link: LinkId,
    direction: Direction,
    /// Counters at its last packet.
    lost: u64,
    overflowed: u64,
}

impl Writer {
    /// Begins a file: writes its first block.
    pub(crate) fn new(snap: u32, out: &mut Vec<u8>) -> Self {
        block(out, SECTION_HEADER, |out| {
            out.extend(BYTE_ORDER_MAGIC.to_le_bytes());
            // Version 1.0, and a section of unknown length.
            out.extend([1, 0, 0, 0]);
            out.extend(u64::MAX.to_le_bytes());
            option(out, USER_APPLICATION, concat!("cotorra ", env!("CARGO_PKG_VERSION")).as_bytes());
            end_options(out);
        });
        Self { snap, interfaces: Vec::new(), cut: Vec::new() }
    }

    /// Writes a packet. A super-packet becomes the packets that it is on the wire.
    pub(crate) fn write(&mut self, captured: Captured, out: &mut Vec<u8>) {
        let Captured { link, direction, entered, due, delivered, lost, overflowed, frame, mut missed } =
            captured;
        let number = self.interface(link, direction, [lost, overflowed], out);
        let interface = &mut self.interfaces[number];
        let mut fewer = [lost - interface.lost, overflowed - interface.overflowed];
        (interface.lost, interface.overflowed) = (lost, overflowed);
        let mut cut = std::mem::take(&mut self.cut);
        // The fabric has checked its offload.
        let _ = frame.segment(&mut cut);
        for mut packet in cut.drain(..) {
            let _ = packet.complete_checksum();
            let comment = comment([entered, due, delivered], std::mem::take(&mut fewer));
            let kept = &packet.bytes()[..packet.len().min(self.snap as usize)];
            block(out, PACKET, |out| {
                out.extend((number as u32).to_le_bytes());
                let at = due.as_nanos();
                out.extend(((at >> 32) as u32).to_le_bytes());
                out.extend((at as u32).to_le_bytes());
                out.extend((kept.len() as u32).to_le_bytes());
                out.extend((packet.len() as u32).to_le_bytes());
                out.extend(kept);
                pad(out, kept.len());
                option(out, COMMENT, comment.as_bytes());
                option(out, DROP_COUNT, &std::mem::take(&mut missed).to_le_bytes());
                end_options(out);
            });
        }
        self.cut = cut;
    }

    /// Returns the number of a direction's interface. Describes it before its first packet.
    fn interface(
        &mut self,
        link: LinkId,
        direction: Direction,
        [lost, overflowed]: [u64; 2],
        out: &mut Vec<u8>,
    ) -> usize {
        let is_it = |known: &Interface| known.direction == direction && known.link == link;
        if let Some(number) = self.interfaces.iter().position(is_it) {
            return number;
        }
        let way = match direction {
            Direction::Forward => "forward",
            Direction::Backward => "backward",
        };
        block(out, INTERFACE, |out| {
            out.extend(LINKTYPE_ETHERNET.to_le_bytes());
            out.extend([0; 2]);
            out.extend(self.snap.to_le_bytes());
            option(out, INTERFACE_NAME, format!("{link} {way}").as_bytes());
            // Nanoseconds: 10 to the power of minus 9.
            option(out, TIME_RESOLUTION, &[9]);
            end_options(out);
        });
        self.interfaces.push(Interface { link, direction, lost, overflowed });
        self.interfaces.len() - 1
    }
}

/// Describes how a packet fared: its times, and the packets that the link lost and dropped since the one before.
fn comment([entered, due, delivered]: [Timestamp; 3], [lost, overflowed]: [u64; 2]) -> String {
    let seconds =
        |at: Timestamp| format!("{}.{:09} s", at.as_nanos() / 1_000_000_000, at.as_nanos() % 1_000_000_000);
    let [entered, due, delivered] = [entered, due, delivered].map(seconds);
    let mut text = format!("entered {entered}, due {due}, delivered {delivered}");
    for (packets, what) in [(lost, "lost"), (overflowed, "overflowed")] {
        if packets > 0 {
            text += &format!(", {packets} {what} before it");
        }
    }
    text
}

/// Writes a block with its length at both ends.
fn block(out: &mut Vec<u8>, kind: u32, body: impl FnOnce(&mut Vec<u8>)) {
    let begin = out.len();
    out.extend(kind.to_le_bytes());
    out.extend([0; 4]);
    body(out);
    let length = ((out.len() - begin + 4) as u32).to_le_bytes();
    out.extend(length);
    out[begin + 4..begin + 8].copy_from_slice(&length);
}

fn option(out: &mut Vec<u8>, code: u16, value: &[u8]) {
    out.extend(code.to_le_bytes());
    out.extend((value.len() as u16).to_le_bytes());
    out.extend(value);
    pad(out, value.len());
}

fn end_options(out: &mut Vec<u8>) {
    out.extend([0; 4]);
}

/// Pads a field of this length to 32 bits.
fn pad(out: &mut Vec<u8>, length: usize) {
    out.resize(out.len() + length.next_multiple_of(4) - length, 0);
}
