//! A pool of frame buffers. A dropped or delivered frame leaves its memory to the next one, so that the steady state
//! allocates nothing per packet.

use crate::trace::Trace;

/// Capacity for a frame of an ordinary link, with its header and a VLAN tag.
const SMALL: usize = 2048;
/// Capacity for the largest super-packet: 64 KiB and its Ethernet header.
const LARGE: usize = 66 * 1024;
/// Most buffers of each size in the pool. Further ones go back to the allocator.
const SMALL_KEPT: usize = 16 * 1024;
const LARGE_KEPT: usize = 512;
/// Most ways of dropped frames that are kept until they are taken.
const MOST_DROPPED: usize = 1024;

/// Free buffers.
#[derive(Debug, Default)]
pub(crate) struct Pool {
    small: Vec<Vec<u8>>,
    large: Vec<Vec<u8>>,
    /// Ways of followed frames that were dropped.
    #[allow(clippy::vec_box, reason = "frames have them boxed, and pass them on")]
    dropped: Vec<Box<Trace>>,
}

impl Pool {
    /// Returns an empty buffer with capacity for `length` bytes.
    pub(crate) fn take(&mut self, length: usize) -> Vec<u8> {
        let (kept, capacity) =
            if length <= SMALL { (&mut self.small, SMALL) } else { (&mut self.large, LARGE.max(length)) };
        match kept.pop() {
            Some(buffer) if buffer.capacity() >= length => buffer,
            _ => Vec::with_capacity(capacity),
        }
    }

    /// Keeps the way of a frame that is not delivered.
    pub(crate) fn ended(&mut self, trace: Box<Trace>) {
        if self.dropped.len() < MOST_DROPPED {
            self.dropped.push(trace);
        }
    }

    /// Takes the ways of followed frames that were dropped since the last call, in that order.
    #[allow(clippy::vec_box, reason = "frames have them boxed, and pass them on")]
    pub(crate) fn take_dropped(&mut self) -> Vec<Box<Trace>> {
        std::mem::take(&mut self.dropped)
    }

    /// Takes a buffer back.
    pub(crate) fn put(&mut self, mut buffer: Vec<u8>) {
        let (kept, limit) = match buffer.capacity() {
            0..SMALL => return,
            SMALL..LARGE => (&mut self.small, SMALL_KEPT),
            _ => (&mut self.large, LARGE_KEPT),
        };
        if kept.len() < limit {
            buffer.clear();
            kept.push(buffer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_reused_empty_and_with_their_capacity() {
        let mut pool = Pool::default();
        for length in [60, SMALL, SMALL + 1, LARGE, LARGE + 1] {
            let mut buffer = pool.take(length);
            buffer.resize(length, 7);
            let place = buffer.as_ptr();
            pool.put(buffer);
            let again = pool.take(length);
            assert_eq!(again.as_ptr(), place);
            assert!(again.is_empty() && again.capacity() >= length);
        }
    }
}
