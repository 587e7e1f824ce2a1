//! The blocks of a pcapng stream, counted and limited. A file ends after a whole block, wherever the stream breaks off.

use crate::{
    order::Order,
    pcapng::{PACKET, PACKET_BYTES},
    write::DROP_COUNT,
};

/// Offset of the number of a packet's bytes.
const LENGTH: usize = 20;

/// Splits a stream into whole blocks.
#[derive(Debug)]
pub struct Blocks {
    most_packets: u64,
    /// Bytes that may still be taken.
    room: u64,
    packets: u64,
    missed: u64,
    is_full: bool,
    /// Taken blocks, and behind them the beginning of the next.
    buffer: Vec<u8>,
    taken: usize,
}

impl Blocks {
    /// Creates an empty stream with limits.
    pub fn new(most_packets: u64, most_bytes: u64) -> Self {
        Self {
            most_packets,
            room: most_bytes,
            packets: 0,
            missed: 0,
            is_full: false,
            buffer: Vec::new(),
            taken: 0,
        }
    }

    /// Adds a part of the stream, and returns the blocks that it completes, up to a limit.
    pub fn take(&mut self, part: &[u8]) -> &[u8] {
        self.buffer.drain(..self.taken);
        self.buffer.extend_from_slice(part);
        self.taken = 0;
        while !self.is_full
            && let rest = &self.buffer[self.taken..]
            && let Some(length) = u32_at(rest, 4)
        {
            let length = length.max(12);
            let Some(room) = self.room.checked_sub(length.into()) else {
                self.is_full = true;
                break;
            };
            let Some(block) = rest.get(..length as usize) else { break };
            self.room = room;
            self.taken += block.len();
            if u32_at(block, 0) == Some(PACKET) {
                self.packets += 1;
                self.missed += missed(block);
            }
            self.is_full = self.packets >= self.most_packets;
        }
        &self.buffer[..self.taken]
    }

    /// Whether a limit is reached.
    pub fn are_full(&self) -> bool {
        self.is_full
    }

    /// Returns the number of packets taken.
    pub fn packets(&self) -> u64 {
        self.packets
    }

    /// Returns the number of packets that the run could not pass on.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

/// Returns the number of packets that were missed before this one.
fn missed(packet: &[u8]) -> u64 {
    let mut at = PACKET_BYTES + (u32_at(packet, LENGTH).unwrap_or_default() as usize).next_multiple_of(4);
    while let Some(head) = u32_at(packet, at) {
        let (code, length) = (head as u16, (head >> 16) as usize);
        let value = packet.get(at + 4..).and_then(|value| value.first_chunk().copied());
        match (code, value) {
            (0, _) => return 0,
            (DROP_COUNT, Some(count)) => return u64::from_le_bytes(count),
            _ => at += 4 + length.next_multiple_of(4),
        }
    }
    0
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Order::Little.u32_at(bytes, at)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(kind: u32, body: &[u8]) -> Vec<u8> {
        let length = (body.len() as u32 + 12).to_le_bytes();
        [&kind.to_le_bytes()[..], &length, body, &length].concat()
    }

    /// A packet of five bytes, with a comment and this number of missed packets before it.
    fn packet(missed: u64) -> Vec<u8> {
        let head = [0, 0, 0, 5, 5_u32].map(u32::to_le_bytes).concat();
        let comment = [1, 0, 3, 0, b'o', b'n', b'e', 0];
        block(
            PACKET,
            &[&head[..], &[7; 5], &[0; 3], &comment, &[4, 0, 8, 0], &missed.to_le_bytes(), &[0; 4]].concat(),
        )
    }

    #[test]
    fn only_whole_blocks_are_taken_however_the_stream_is_cut() {
        let stream = [block(0x0a0d_0d0a, &[0; 16]), packet(0), packet(3), packet(1)].concat();
        let end = stream.len() - 1;
        for size in [1, 7, 100, 1000] {
            let mut blocks = Blocks::new(u64::MAX, u64::MAX);
            let taken: Vec<u8> =
                stream[..end].chunks(size).flat_map(|part| blocks.take(part).to_vec()).collect();
            assert_eq!(taken, stream[..stream.len() - packet(1).len()]);
            assert_eq!((blocks.packets(), blocks.missed(), blocks.are_full()), (2, 3, false));
        }
    }

    #[test]
    fn limits_end_a_capture_after_a_whole_block() {
        let stream = [block(0x0a0d_0d0a, &[0; 16]), packet(0), packet(0), packet(0)].concat();
        let two = stream.len() - packet(0).len();
        for mut blocks in [Blocks::new(2, u64::MAX), Blocks::new(u64::MAX, stream.len() as u64 - 1)] {
            assert_eq!(blocks.take(&stream), &stream[..two]);
            assert!(blocks.are_full());
            assert_eq!(blocks.take(&stream), b"");
        }
    }

    #[test]
    fn damaged_lengths_do_no_harm() {
        for length in [0, 3, 11, u32::MAX] {
            let mut blocks = Blocks::new(u64::MAX, 1 << 20);
            let part = [&PACKET.to_le_bytes()[..], &length.to_le_bytes(), &[0xff; 100]].concat();
            assert!(blocks.take(&part).len() <= part.len());
        }
    }
}
