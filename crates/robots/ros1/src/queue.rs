//! Queues that drop the oldest: of what waits to be sent to one peer, and of what waits to be taken by the program.
//! What is old is worth less than what is new, and no peer makes another wait.

use std::{collections::VecDeque, io, sync::Arc, time::Duration};

use parking_lot::{Condvar, Mutex};

/// What waits to be sent over one connection.
#[derive(Debug)]
pub(crate) struct SendQueue {
    /// What is being sent, and how much of it was. It is never dropped: half a frame would spoil the stream.
    current: Option<(Arc<Vec<u8>>, usize)>,
    waiting: VecDeque<Arc<Vec<u8>>>,
    depth: usize,
    /// How many frames were dropped.
    pub dropped: u64,
    /// How many bytes were sent.
    pub bytes: u64,
    /// How many frames were sent.
    pub frames: u64,
}

impl SendQueue {
    /// A queue that holds so many frames, at least one, behind `first`.
    pub fn new(depth: usize, first: Option<Vec<u8>>) -> Self {
        let current = first.map(|first| (Arc::new(first), 0));
        Self { current, waiting: VecDeque::new(), depth: depth.max(1), dropped: 0, bytes: 0, frames: 0 }
    }

    /// Adds a frame; the oldest gives way if the queue is full.
    pub fn push(&mut self, frame: Arc<Vec<u8>>) {
        if self.waiting.len() == self.depth {
            self.waiting.pop_front();
            self.dropped += 1;
        }
        self.waiting.push_back(frame);
    }

    /// Whether all was sent.
    pub fn is_empty(&self) -> bool {
        self.current.is_none() && self.waiting.is_empty()
    }

    /// Sends as much as `sink` takes without blocking.
    ///
    /// # Errors
    /// What `sink` fails with; the connection is of no use from then on.
    pub fn flush(&mut self, sink: &mut impl io::Write) -> io::Result<()> {
        loop {
            let next = || self.waiting.pop_front().map(|frame| (frame, 0));
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

/// What waits to be taken by the program.
#[derive(Debug)]
pub(crate) struct Inbox {
    state: Mutex<InboxState>,
    arrived: Condvar,
    depth: usize,
}

#[derive(Debug, Default)]
struct InboxState {
    waiting: VecDeque<Vec<u8>>,
    dropped: u64,
    closed: bool,
}

/// Nothing came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// For as long as was said.
    #[error("no message came in time")]
    Timeout,
    /// And nothing will: the node was shut down.
    #[error("the node was shut down")]
    ShutDown,
}

impl Inbox {
    /// A queue that holds so many messages, at least one.
    pub fn new(depth: usize) -> Self {
        Self { state: Mutex::default(), arrived: Condvar::new(), depth: depth.max(1) }
    }

    /// Adds a message; the oldest gives way if the queue is full.
    pub fn push(&self, message: &[u8]) {
        let mut state = self.state.lock();
        // The memory of what gives way serves for what comes.
        let full = state.waiting.len() == self.depth;
        let mut buffer = if full { state.waiting.pop_front().unwrap_or_default() } else { Vec::new() };
        state.dropped += u64::from(full);
        buffer.clear();
        buffer.extend_from_slice(message);
        state.waiting.push_back(buffer);
        drop(state);
        self.arrived.notify_one();
    }

    /// Nothing comes any more.
    pub fn close(&self) {
        self.state.lock().closed = true;
        self.arrived.notify_all();
    }

    /// The oldest, if there is one.
    pub fn try_pop(&self) -> Option<Vec<u8>> {
        self.state.lock().waiting.pop_front()
    }

    /// The oldest, once there is one.
    pub fn pop(&self, timeout: Option<Duration>) -> Result<Vec<u8>, RecvError> {
        let mut state = self.state.lock();
        let nothing = |state: &mut InboxState| state.waiting.is_empty() && !state.closed;
        match timeout {
            None => self.arrived.wait_while(&mut state, nothing),
            Some(timeout) => {
                self.arrived.wait_while_for(&mut state, nothing, timeout);
            }
        }
        let closed = state.closed;
        state.waiting.pop_front().ok_or(if closed { RecvError::ShutDown } else { RecvError::Timeout })
    }

    /// How many were dropped.
    pub fn dropped(&self) -> u64 {
        self.state.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes so many bytes, then no more.
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
    fn the_oldest_gives_way_and_what_is_half_sent_does_not() {
        let mut queue = SendQueue::new(2, Some(b"head".to_vec()));
        let mut sink = Sink(Vec::new(), 6);
        queue.push(Arc::new(b"abc".to_vec()));
        queue.flush(&mut sink).unwrap();
        for frame in ["d", "e", "f"] {
            queue.push(Arc::new(frame.as_bytes().to_vec()));
        }
        assert_eq!((queue.dropped, queue.is_empty()), (1, false));
        sink.1 = 100;
        queue.flush(&mut sink).unwrap();
        assert_eq!((sink.0.as_slice(), queue.is_empty()), (b"headabcef".as_slice(), true));
    }

    #[test]
    fn an_inbox_keeps_the_newest_and_gives_them_even_when_closed() {
        let inbox = Inbox::new(2);
        for message in [b"a", b"b", b"c"] {
            inbox.push(message);
        }
        assert_eq!((inbox.dropped(), inbox.try_pop()), (1, Some(b"b".to_vec())));
        inbox.close();
        assert_eq!(inbox.pop(None), Ok(b"c".to_vec()));
        assert_eq!(inbox.pop(None), Err(RecvError::ShutDown));
        assert_eq!(Inbox::new(1).pop(Some(Duration::ZERO)), Err(RecvError::Timeout));
    }
}
