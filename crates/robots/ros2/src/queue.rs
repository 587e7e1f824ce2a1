//! A queue that drops the oldest: what waits to be taken by the program. What is old is worth less than what is new.

use std::{collections::VecDeque, time::Duration};

use parking_lot::{Condvar, Mutex};

/// What waits, at most so many.
#[derive(Debug)]
pub(crate) struct Waiting<T> {
    queue: VecDeque<T>,
    depth: usize,
    /// How many were dropped.
    pub dropped: u64,
}

impl<T> Waiting<T> {
    /// A queue that holds so many, at least one.
    pub fn new(depth: usize) -> Self {
        Self { queue: VecDeque::new(), depth: depth.max(1), dropped: 0 }
    }

    /// Adds one; the oldest gives way if the queue is full.
    pub fn push(&mut self, item: T) {
        if self.queue.len() == self.depth {
            self.queue.pop_front();
            self.dropped += 1;
        }
        self.queue.push_back(item);
    }

    /// The oldest, which stays.
    pub fn front(&self) -> Option<&T> {
        self.queue.front()
    }

    /// Takes the oldest.
    pub fn pop(&mut self) -> Option<T> {
        self.queue.pop_front()
    }
}

/// What waits to be taken by the program.
#[derive(Debug)]
pub(crate) struct Inbox<T> {
    state: Mutex<State<T>>,
    arrived: Condvar,
}

#[derive(Debug)]
struct State<T> {
    waiting: Waiting<T>,
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

impl<T> Inbox<T> {
    /// A queue that holds so many messages, at least one.
    pub fn new(depth: usize) -> Self {
        let state = State { waiting: Waiting::new(depth), closed: false };
        Self { state: Mutex::new(state), arrived: Condvar::new() }
    }

    /// Adds a message; the oldest gives way if the queue is full.
    pub fn push(&self, message: T) {
        self.state.lock().waiting.push(message);
        self.arrived.notify_one();
    }

    /// Nothing comes any more.
    pub fn close(&self) {
        self.state.lock().closed = true;
        self.arrived.notify_all();
    }

    /// The oldest, if there is one.
    pub fn try_pop(&self) -> Option<T> {
        self.state.lock().waiting.pop()
    }

    /// The oldest, once there is one.
    pub fn pop(&self, timeout: Option<Duration>) -> Result<T, RecvError> {
        let mut state = self.state.lock();
        let nothing = |state: &mut State<T>| state.waiting.front().is_none() && !state.closed;
        match timeout {
            None => self.arrived.wait_while(&mut state, nothing),
            Some(timeout) => {
                self.arrived.wait_while_for(&mut state, nothing, timeout);
            }
        }
        let closed = state.closed;
        state.waiting.pop().ok_or(if closed { RecvError::ShutDown } else { RecvError::Timeout })
    }

    /// How many were dropped.
    pub fn dropped(&self) -> u64 {
        self.state.lock().waiting.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inbox_keeps_the_newest_and_gives_them_even_when_closed() {
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
}
