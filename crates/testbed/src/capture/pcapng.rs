//! Packets as a pcapng file (draft-ietf-opsawg-pcapng). Each direction of a link is an interface. Times are those of the
//! run, in nanoseconds since it began.

use cotorra_fabric::{Frame, Passage};
use cotorra_graph::{Direction, LinkId, Timestamp};
use cotorra_pcap::{
    ETHERNET,
    write::{self, Record},
};

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
        write::section(out, concat!("cotorra ", env!("CARGO_PKG_VERSION")));
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
            let record = Record {
                interface: number as u32,
                at_ns: due.as_nanos(),
                bytes: kept,
                original: packet.len() as u32,
                comment: &comment,
                missed: std::mem::take(&mut missed),
            };
            write::packet(out, &record);
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
        write::interface(out, ETHERNET, self.snap, &format!("{link} {way}"));
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
