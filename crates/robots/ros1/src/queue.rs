//! The frames that wait to be sent to one peer.

use std::{io, sync::Arc};

use cotorra_ros_messages::queue::Waiting;

/// Frames that wait to be sent over one connection. Drops the oldest if there are too many.
#[derive(Debug)]
pub(crate) struct SendQueue {
    /// The frame being sent, and its bytes sent so far. It is never dropped: half a frame would break the stream.
    current: Option<(Arc<Vec<u8>>, usize)>,
    waiting: Waiting<Arc<Vec<u8>>>,
    /// Bytes sent.
    pub bytes: u64,
    /// Frames sent.
    pub frames: u64,
}

impl SendQueue {
    /// A queue that holds `depth` frames, at least one, behind `first`.
    pub fn new(depth: usize, first: Option<Vec<u8>>) -> Self {
        let current = first.map(|first| (Arc::new(first), 0));
        Self { current, waiting: Waiting::new(depth), bytes: 0, frames: 0 }
    }

    /// Adds a frame. Drops the oldest if the queue is full.
    pub fn push(&mut self, frame: Arc<Vec<u8>>) {
        self.waiting.push(frame);
    }

    /// Number of dropped frames.
    pub fn dropped(&self) -> u64 {
        self.waiting.dropped()
    }

    /// Whether every frame was sent.
    pub fn is_empty(&self) -> bool {
        self.current.is_none() && self.waiting.is_empty()
    }

    /// Sends as much as `sink` takes without blocking.
    ///
    /// # Errors
    /// The error of `sink`. The connection cannot be used any more.
    pub fn flush(&mut self, sink: &mut impl io::Write) -> io::Result<()> {
        loop {
            let next = || self.waiting.pop().map(|frame| (frame, 0));
            let Some((frame, sent)) = self.current.take().or_else(next) else { return Ok(()) };
            let written = match sink.write(&frame[sent..]) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => written,
                Err(error) => {
                    self.current = Some((frame, sent));
                    match error.kind() {
                        io::ErrorKind::WouldBlock => return Ok(()),
                        io::ErrorKind::Interrupted => continue,
                        _ => return Err(error),
                    }
                }
            };
            self.bytes += written as u64;
            if sent + written < frame.len() {
                self.current = Some((frame, sent + written));
            } else {
                self.frames += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes a number of bytes, then no more.
    struct Sink(Vec<u8>, usize);

    impl io::Write for Sink {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let count = bytes.len().min(self.1);
            if count == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            self.0.extend_from_slice(&bytes[..count]);
            self.1 -= count;
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn the_oldest_frame_is_dropped_but_never_a_half_sent_one() {
        let mut queue = SendQueue::new(2, Some(b"head".to_vec()));
        let mut sink = Sink(Vec::new(), 6);
        queue.push(Arc::new(b"abc".to_vec()));
        queue.flush(&mut sink).unwrap();
        for frame in ["d", "e", "f"] {
            queue.push(Arc::new(frame.as_bytes().to_vec()));
        }
        assert_eq!((queue.dropped(), queue.is_empty()), (1, false));
        sink.1 = 100;
        queue.flush(&mut sink).unwrap();
        assert_eq!((sink.0.as_slice(), queue.is_empty()), (b"headabcef".as_slice(), true));
    }
}
