//! Frames of one category from one sender to one receiver: those that wait, and those that were sent and are not settled.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{QueueLimit, Timestamp};

use crate::{
    frame::Frame,
    radio::medium::{Queue, Waiting},
};

/// A frame that was sent at least once.
#[derive(Debug)]
struct Sent {
    waiting: Waiting,
    attempts: u32,
    /// Start and airtime of its first attempt.
    began: Timestamp,
    first: Duration,
    state: State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    ToRetry,
    OnAir,
    Received,
    GivenUp,
}

/// A frame whose fate is settled, in the order of sending.
#[derive(Debug)]
pub(in crate::radio) struct Settled {
    pub(super) waiting: Waiting,
    pub(super) began: Timestamp,
    pub(super) first: Duration,
    pub(super) received: bool,
}

/// The outcome of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Outcome {
    pub(super) sent: u32,
    pub(super) received: u32,
    pub(super) given_up: u32,
}

/// Frames that are sent together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Batch {
    /// Frames at most, and from the first unsettled one on: the window of a block acknowledgement (9.3.1.8.2).
    pub(super) frames: usize,
    /// Sum of the costs at most. The first frame goes whatever its cost.
    pub(super) cost: u64,
}

/// The frames of one category from one sender to one receiver. With batches of one frame it is a sender that waits for each
/// acknowledgement; with larger ones it is both ends of a block acknowledgement agreement (10.25), so that the receiver gets
/// frames in order.
#[derive(Debug, Default)]
pub(super) struct Stream {
    queue: Queue,
    window: VecDeque<Sent>,
    /// Number of changes of its receiver.
    epoch: u32,
}

impl Stream {
    /// Queues a frame.
    ///
    /// # Errors
    /// The frame, if the queue is full.
    pub(super) fn push(&mut self, waiting: Waiting, limit: QueueLimit) -> Result<(), Frame> {
        if self.queue.fits(&waiting.frame, limit) {
            self.queue.push(waiting);
            Ok(())
        } else {
            Err(waiting.frame)
        }
    }

    /// Whether a frame is to be sent.
    pub(super) fn is_ready(&self) -> bool {
        let retries = self.window.iter().any(|sent| sent.state == State::ToRetry);
        retries || !self.queue.is_empty()
    }

    /// Returns how often its receiver has changed.
    pub(super) fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the number of unsettled frames.
    pub(super) fn len(&self) -> usize {
        self.queue.len() + self.window.len()
    }

    /// Returns the unsettled frames.
    pub(super) fn frames(&self) -> impl Iterator<Item = &Waiting> {
        self.window.iter().map(|sent| &sent.waiting).chain(self.queue.iter())
    }

    /// Returns the length in bytes of the next frame to send.
    pub(super) fn next_bytes(&self) -> Option<usize> {
        let retried = self.window.iter().find(|sent| sent.state == State::ToRetry);
        let next = retried.map(|sent| &sent.waiting).or_else(|| self.queue.front())?;
        Some(next.frame.bytes().len())
    }

    /// Puts the next frames on the air, earlier ones first. `cost` is the cost of a frame of a length. Returns their lengths.
    pub(super) fn send(&mut self, batch: Batch, cost: impl Fn(usize) -> u64) -> Vec<usize> {
        let mut lengths = Vec::new();
        let mut left = batch.cost;
        let mut takes = |waiting: &Waiting| {
            let bytes = waiting.frame.bytes().len();
            let spent = cost(bytes);
            let fits = lengths.len() < batch.frames && (lengths.is_empty() || spent <= left);
            if fits {
                left = left.saturating_sub(spent);
                lengths.push(bytes);
            }
            fits
        };
        for sent in self.window.iter_mut().filter(|sent| sent.state == State::ToRetry) {
            if !takes(&sent.waiting) {
                return lengths;
            }
            sent.state = State::OnAir;
        }
        while self.window.len() < batch.frames && self.queue.front().is_some_and(&mut takes) {
            let Some(waiting) = self.queue.pop() else { break };
            let state = State::OnAir;
            let (began, first) = (Timestamp::ZERO, Duration::ZERO);
            self.window.push_back(Sent { waiting, attempts: 0, began, first, state });
        }
        lengths
    }

    /// Ends the attempt on the air, which took from `start` to `end`. `receives` decides for each frame in turn, by its length.
    /// A frame is given up after `most` attempts.
    pub(super) fn conclude(
        &mut self,
        [start, end]: [Timestamp; 2],
        most: u32,
        mut receives: impl FnMut(usize) -> bool,
    ) -> Outcome {
        let mut outcome = Outcome { sent: 0, received: 0, given_up: 0 };
        for sent in self.window.iter_mut().filter(|sent| sent.state == State::OnAir) {
            if sent.attempts == 0 {
                (sent.began, sent.first) = (start, end.since(start));
            }
            sent.attempts += 1;
            outcome.sent += 1;
            sent.state = if receives(sent.waiting.frame.bytes().len()) {
                outcome.received += 1;
                State::Received
            } else if sent.attempts >= most {
                outcome.given_up += 1;
                State::GivenUp
            } else {
                State::ToRetry
            };
        }
        outcome
    }

    /// Takes the next frame whose fate, and that of all before it, is settled.
    pub(super) fn settle(&mut self) -> Option<Settled> {
        let received = match self.window.front()?.state {
            State::Received => true,
            State::GivenUp => false,
            State::ToRetry | State::OnAir => return None,
        };
        let Sent { waiting, began, first, .. } = self.window.pop_front()?;
        Some(Settled { waiting, began, first, received })
    }

    /// Ends the agreement with a receiver that is gone. Returns the frames that it received; the others wait for the next one.
    pub(super) fn part(&mut self) -> Vec<Settled> {
        self.epoch += 1;
        let mut received = Vec::new();
        while let Some(Sent { waiting, began, first, state, .. }) = self.window.pop_back() {
            match state {
                State::Received => received.push(Settled { waiting, began, first, received: true }),
                State::GivenUp => received.push(Settled { waiting, began, first, received: false }),
                State::ToRetry | State::OnAir => self.queue.push_front(waiting),
            }
        }
        received.reverse();
        received
    }

    /// Takes the frames that wait.
    pub(super) fn clear(&mut self) -> VecDeque<Waiting> {
        self.queue.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    const LIMIT: QueueLimit = QueueLimit::Packets(1000);
    const ALL: Batch = Batch { frames: 64, cost: u64::MAX };

    /// A frame whose first byte is its number.
    fn waiting(number: u8) -> Waiting {
        Waiting {
            frame: Frame::new(vec![number; 100]),
            since: Timestamp::ZERO,
            source: None,
            is_probe: false,
        }
    }

    fn stream(frames: u8) -> Stream {
        let mut stream = Stream::default();
        (0..frames).for_each(|number| stream.push(waiting(number), LIMIT).unwrap());
        stream
    }

    fn at(us: u64) -> Timestamp {
        Timestamp::from_nanos(us * 1000)
    }

    /// Sends a batch, of which the frames in these places arrive, and returns what settles: numbers and whether received.
    fn attempt(stream: &mut Stream, batch: Batch, arrive: &[usize]) -> Vec<(u8, bool)> {
        stream.send(batch, |_| 1);
        let mut place = 0;
        stream.conclude([at(0), at(10)], 7, |_| {
            place += 1;
            arrive.contains(&(place - 1))
        });
        settled(stream)
    }

    fn settled(stream: &mut Stream) -> Vec<(u8, bool)> {
        std::iter::from_fn(|| stream.settle()).map(|s| (s.waiting.frame.bytes()[0], s.received)).collect()
    }

    #[test]
    fn a_lost_frame_holds_back_those_behind_it() {
        let mut stream = stream(4);
        assert_eq!(attempt(&mut stream, Batch { frames: 3, ..ALL }, &[0, 2]), [(0, true)]);
        // The lost one goes first, together with the one that waited.
        assert_eq!(attempt(&mut stream, ALL, &[0, 1]), [(1, true), (2, true), (3, true)]);
        assert!(!stream.is_ready());
    }

    #[test]
    fn a_frame_is_given_up_after_seven_attempts() {
        let mut stream = stream(2);
        for _ in 0..6 {
            assert_eq!(attempt(&mut stream, Batch { frames: 1, ..ALL }, &[]), []);
        }
        assert_eq!(attempt(&mut stream, Batch { frames: 1, ..ALL }, &[]), [(0, false)]);
        assert_eq!(attempt(&mut stream, Batch { frames: 1, ..ALL }, &[0]), [(1, true)]);
    }

    #[test]
    fn a_batch_is_bounded_by_frames_cost_and_window() {
        assert_eq!(stream(200).send(ALL, |_| 1).len(), 64);
        assert_eq!(stream(200).send(Batch { cost: 250, ..ALL }, |bytes| bytes as u64).len(), 2);
        assert_eq!(stream(200).send(Batch { cost: 0, ..ALL }, |bytes| bytes as u64).len(), 1);
        let mut stream = stream(200);
        attempt(&mut stream, ALL, &[1, 2, 3]);
        // The window begins at frame 0, which is not settled: only frames 0 and 4 to 63 may go.
        assert_eq!(stream.send(ALL, |_| 1).len(), 61);
    }

    #[test]
    fn frames_wait_for_the_next_receiver_in_order() {
        let mut stream = stream(4);
        stream.send(Batch { frames: 3, ..ALL }, |_| 1);
        let mut place = 0;
        stream.conclude([at(0), at(10)], 7, |_| {
            place += 1;
            place == 2
        });
        let numbers: Vec<_> = stream.part().iter().map(|settled| settled.waiting.frame.bytes()[0]).collect();
        assert_eq!(numbers, [1]);
        let numbers: Vec<_> = stream.clear().iter().map(|waiting| waiting.frame.bytes()[0]).collect();
        assert_eq!(numbers, [0, 2, 3]);
    }

    proptest! {
        #[test]
        fn every_frame_is_settled_once_and_in_order(
            frames in 0_u8..100, batch in 1_usize..70, losses in prop::collection::vec(any::<bool>(), 1..200),
        ) {
            let mut stream = stream(frames);
            let mut losses = losses.into_iter().cycle();
            let mut all = Vec::new();
            for _ in 0..1000 {
                stream.send(Batch { frames: batch, ..ALL }, |_| 1);
                stream.conclude([at(0), at(10)], 7, |_| !losses.next().unwrap());
                all.extend(settled(&mut stream).into_iter().map(|(number, _)| number));
            }
            prop_assert_eq!(all, (0..frames).collect::<Vec<_>>());
            prop_assert_eq!(stream.len(), 0);
        }
    }
}
