//! Queues that drop the oldest entry when they are full: news is worth more than history, and no peer makes another wait.
//!
//! Nodes of ROS 1 and ROS 2 use them; programs see [`RecvError`] alone.

use std::{collections::VecDeque, time::Duration};

use parking_lot::{Condvar, Mutex};

/// A queue of limited length.
#[derive(Debug)]
pub struct Waiting<T> {
    queue: VecDeque<T>,
    depth: usize,
    dropped: u64,
}

impl<T> Waiting<T> {
    /// A queue that holds `depth` entries, at least one.
    pub fn new(depth: usize) -> Self {
        Self { queue: VecDeque::new(), depth: depth.max(1), dropped: 0 }
    }

    /// Adds an entry. Drops the oldest if the queue is full.
    pub fn push(&mut self, entry: T) {
        self.make_room();
        self.queue.push_back(entry);
    }

    /// Removes the oldest entry if the queue is full, and returns it.
    fn make_room(&mut self) -> Option<T> {
        if self.queue.len() < self.depth {
            return None;
        }
        self.dropped += 1;
        self.queue.pop_front()
    }

    /// Returns the oldest entry, which stays.
    pub fn front(&self) -> Option<&T> {
        self.queue.front()
    }

    /// Takes the oldest entry.
    pub fn pop(&mut self) -> Option<T> {
        self.queue.pop_front()
    }

    /// Whether no entry waits.
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Number of dropped entries.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// Received messages that the program has not taken yet.
#[derive(Debug)]
pub struct Inbox<T> {
    state: Mutex<State<T>>,
    arrived: Condvar,
}

#[derive(Debug)]
struct State<T> {
    waiting: Waiting<T>,
    closed: bool,
}

/// Reason why no message was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// None came in time.
    #[error("no message came in time")]
    Timeout,
    /// The node was shut down, and all its messages are taken.
    #[error("the node was shut down")]
    ShutDown,
}

impl<T> Inbox<T> {
    /// A queue that holds `depth` messages, at least one.
    pub fn new(depth: usize) -> Self {
        let state = State { waiting: Waiting::new(depth), closed: false };
        Self { state: Mutex::new(state), arrived: Condvar::new() }
    }

    /// Adds a message. Drops the oldest if the queue is full.
    pub fn push(&self, message: T) {
        self.push_with(|_| message);
    }

    /// Adds the message that `make` returns. If the queue is full, `make` gets the oldest to reuse its memory.
    pub fn push_with(&self, make: impl FnOnce(Option<T>) -> T) {
        let mut state = self.state.lock();
        let oldest = state.waiting.make_room();
        state.waiting.push(make(oldest));
        drop(state);
        self.arrived.notify_one();
    }

    /// Ends the queue: no message follows.
    pub fn close(&self) {
        self.state.lock().closed = true;
        self.arrived.notify_all();
    }

    /// Takes the oldest message, if there is one.
    pub fn try_pop(&self) -> Option<T> {
        self.state.lock().waiting.pop()
    }

    /// Waits for a message and takes it; without a timeout, for as long as it takes.
    ///
    /// # Errors
    /// [`RecvError`] if none comes in time, or the queue was closed and is empty.
    pub fn pop(&self, timeout: Option<Duration>) -> Result<T, RecvError> {
        let mut state = self.state.lock();
        let nothing = |state: &mut State<T>| state.waiting.is_empty() && !state.closed;
        match timeout {
            None => self.arrived.wait_while(&mut state, nothing),
            Some(timeout) => {
                self.arrived.wait_while_for(&mut state, nothing, timeout);
            }
        }
        let closed = state.closed;
        state.waiting.pop().ok_or(if closed { RecvError::ShutDown } else { RecvError::Timeout })
    }

    /// Number of dropped messages.
    pub fn dropped(&self) -> u64 {
        self.state.lock().waiting.dropped()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inbox_keeps_the_newest_and_returns_them_even_when_closed() {
        let inbox = Inbox::new(2);
        for message in ['a', 'b', 'c'] {
            inbox.push(message);
        }
        assert_eq!((inbox.dropped(), inbox.try_pop()), (1, Some('b')));
        inbox.close();
        assert_eq!(inbox.pop(None), Ok('c'));
        assert_eq!(inbox.pop(None), Err(RecvError::ShutDown));
        assert_eq!(Inbox::<()>::new(1).pop(Some(Duration::ZERO)), Err(RecvError::Timeout));
    }

    #[test]
    fn a_full_inbox_reuses_the_memory_of_the_oldest() {
        let inbox = Inbox::new(2);
        for message in [b"a", b"b", b"c"] {
            inbox.push_with(|oldest: Option<Vec<u8>>| {
                assert_eq!(oldest, (message == b"c").then(|| b"a".to_vec()));
                message.to_vec()
            });
        }
        assert_eq!((inbox.dropped(), inbox.try_pop()), (1, Some(b"b".to_vec())));
        inbox.close();
        assert_eq!(inbox.pop(None), Ok(b"c".to_vec()));
        assert_eq!(inbox.pop(None), Err(RecvError::ShutDown));
    }
}
