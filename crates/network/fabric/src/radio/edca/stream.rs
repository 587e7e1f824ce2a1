//! Frames of one category from one sender to one receiver: those that wait, and those that were sent and are not settled.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Conditions, Timestamp};
use cotorra_numbers::Draws;

use crate::{
    queue,
    radio::medium::{Queue, QueueSettings, Waiting},
};

/// Airtime that a receiver without any gets in each round, µs (Linux's `IEEE80211_DEFAULT_AIRTIME_WEIGHT`).
const ROUND_US: u64 = 256;

/// Rounds after which a frame under a block acknowledgement agreement is given up: once, and the retries of Linux's ath9k
/// (`ATH_MAX_SW_RETRIES`). The standard goes on for the frame's lifetime (10.25.2).
const ROUNDS: u32 = 31;

/// A frame that was sent at least once.
#[derive(Debug)]
struct Sent {
    waiting: Waiting,
    /// Attempts or rounds, see [`Limit`].
    tries: u32,
    /// Start and airtime of its first attempt; `None` until that ends.
    first: Option<(Timestamp, Duration)>,
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

impl Sent {
    fn settled(self, received: bool) -> Option<Settled> {
        let (began, first) = self.first?;
        Some(Settled { waiting: self.waiting, began, first, received })
    }
}

/// The outcome of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Outcome {
    pub(super) sent: u32,
    pub(super) received: u32,
    pub(super) given_up: u32,
}

/// When a frame that was not received is given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Limit {
    /// After this many attempts: without an agreement.
    Attempts(u32),
    /// After [`ROUNDS`] rounds: under a block acknowledgement agreement. A round ends with a block acknowledgement, or with an
    /// attempt that is the `last` one in a row that nobody answers.
    Rounds { last: bool },
}

/// Frames that are sent together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Batch {
    /// Frames at most, and from the first unsettled one on: the window of a block acknowledgement (9.3.1.8.2).
    pub(super) frames: usize,
    /// Sum of the costs at most. The first frame goes whatever its cost.
    pub(super) cost: u64,
}

impl Batch {
    /// Takes the room of a frame. Returns `false` if there is none.
    fn takes(&mut self, cost: u64, is_first: bool) -> bool {
        let fits = self.frames > 0 && (is_first || cost <= self.cost);
        if fits {
            self.frames -= 1;
            self.cost = self.cost.saturating_sub(cost);
        }
        fits
    }
}

/// The frames of one category from one sender to one receiver. With batches of one frame it is a sender that waits for each
/// acknowledgement; with larger ones it is both ends of a block acknowledgement agreement (10.25), so that the receiver gets
/// frames in order.
#[derive(Debug, Default)]
pub(super) struct Stream {
    queue: Queue,
    /// Frames of a queue with flows, which come after those of `queue`.
    flows: Option<Box<queue::Queue<Waiting>>>,
    window: VecDeque<Sent>,
    /// Number of changes of its receiver.
    epoch: u32,
    /// Airtime that it used, on the scale of its radio unit's rounds, µs. Only with flows.
    used_us: u64,
    /// Airtime of its attempts since its last turn.
    spent: Duration,
}

impl Stream {
    /// Queues a frame. Returns the frames that are dropped. A queue with flows takes its random numbers from `rng`.
    pub(super) fn push(
        &mut self,
        now: Timestamp,
        waiting: Waiting,
        settings: QueueSettings,
        rng: impl FnOnce() -> Draws,
    ) -> Vec<Waiting> {
        let QueueSettings { limit, discipline } = settings;
        if discipline.is_drop_tail() {
            if let Some(mut flows) = self.flows.take() {
                flows.drain().into_iter().for_each(|waiting| self.queue.push(waiting));
            }
            if !self.queue.fits(&waiting.frame, limit) {
                return vec![waiting];
            }
            self.queue.push(waiting);
            return Vec::new();
        }
        let conditions = Conditions { queue: limit, queue_discipline: discipline, ..Conditions::default() };
        let flows = self.flows.get_or_insert_with(|| Box::new(queue::Queue::new(now, &conditions, rng())));
        flows.change(now, &conditions);
        let mut dropped = Vec::new();
        flows.push(now, waiting, &mut |waiting| dropped.push(waiting));
        dropped
    }

    /// Makes the next frame of the flows the next one to send, if none is yet. Calls `drop` with those that are dropped.
    fn fill(&mut self, now: Timestamp, drop: &mut dyn FnMut(Waiting)) {
        if self.queue.is_empty()
            && let Some(next) = self.flows.as_mut().and_then(|flows| flows.pop(now, drop))
        {
            self.queue.push(next);
        }
    }

    /// Whether a frame is to be sent.
    pub(super) fn is_ready(&self) -> bool {
        let retries = self.window.iter().any(|sent| sent.state == State::ToRetry);
        retries || self.queued() > 0
    }

    /// Returns the number of frames that were not sent yet.
    fn queued(&self) -> usize {
        self.queue.len() + self.flows.as_ref().map_or(0, |flows| flows.packets() as usize)
    }

    /// Returns how often its receiver has changed.
    pub(super) fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the number of unsettled frames.
    pub(super) fn len(&self) -> usize {
        self.queued() + self.window.len()
    }

    /// Returns the unsettled frames.
    pub(super) fn frames(&self) -> impl Iterator<Item = &Waiting> {
        let flows = self.flows.iter().flat_map(|flows| flows.iter());
        self.window.iter().map(|sent| &sent.waiting).chain(self.queue.iter()).chain(flows)
    }

    /// Returns the length in bytes of the next frame to send. Calls `drop` with those that are dropped before it.
    pub(super) fn next_bytes(&mut self, now: Timestamp, drop: &mut dyn FnMut(Waiting)) -> Option<usize> {
        if let Some(retried) = self.window.iter().find(|sent| sent.state == State::ToRetry) {
            return Some(retried.waiting.frame.bytes().len());
        }
        self.fill(now, drop);
        self.queue.front().map(|next| next.frame.bytes().len())
    }

    /// Puts the next frames on the air, earlier ones first. `cost` is the cost of a frame of a length. Calls `drop` with frames
    /// that are dropped. Returns the lengths of those that are sent.
    pub(super) fn send(
        &mut self,
        now: Timestamp,
        mut batch: Batch,
        cost: impl Fn(usize) -> u64,
        drop: &mut dyn FnMut(Waiting),
    ) -> Vec<usize> {
        let (mut lengths, window) = (Vec::new(), batch.frames);
        for sent in self.window.iter_mut().filter(|sent| sent.state == State::ToRetry) {
            let bytes = sent.waiting.frame.bytes().len();
            if !batch.takes(cost(bytes), lengths.is_empty()) {
                return lengths;
            }
            lengths.push(bytes);
            sent.state = State::OnAir;
        }
        while batch.frames > 0 && self.window.len() < window {
            self.fill(now, drop);
            let Some(bytes) = self.queue.front().map(|next| next.frame.bytes().len()) else { break };
            if !batch.takes(cost(bytes), lengths.is_empty()) {
                break;
            }
            lengths.push(bytes);
            let Some(waiting) = self.queue.pop() else { break };
            self.window.push_back(Sent { waiting, tries: 0, first: None, state: State::OnAir });
        }
        lengths
    }

    /// Ends the attempt on the air, which took from `start` to `end`. `receives` decides for each frame in turn, by its length.
    pub(super) fn conclude(
        &mut self,
        [start, end]: [Timestamp; 2],
        limit: Limit,
        mut receives: impl FnMut(usize) -> bool,
    ) -> Outcome {
        let mut outcome = Outcome { sent: 0, received: 0, given_up: 0 };
        for sent in self.window.iter_mut().filter(|sent| sent.state == State::OnAir) {
            sent.first.get_or_insert((start, end.since(start)));
            outcome.sent += 1;
            if receives(sent.waiting.frame.bytes().len()) {
                outcome.received += 1;
                sent.state = State::Received;
            }
        }
        let (counts, most) = match limit {
            Limit::Attempts(most) => (true, most),
            Limit::Rounds { last } => (last || outcome.received > 0, ROUNDS),
        };
        for sent in self.window.iter_mut().filter(|sent| sent.state == State::OnAir) {
            sent.tries += u32::from(counts);
            sent.state = if sent.tries >= most { State::GivenUp } else { State::ToRetry };
            outcome.given_up += u32::from(sent.state == State::GivenUp);
        }
        outcome
    }

    /// Whether its flows share the airtime of their radio unit by use, not by turns.
    pub(super) fn is_fair(&self) -> bool {
        self.flows.is_some()
    }

    /// Returns the rounds until it has airtime again, after the rounds that gave `given_us` to each; 0 without flows.
    pub(super) fn rounds(&self, given_us: u64) -> u64 {
        if self.is_fair() { self.used_us.saturating_sub(given_us).div_ceil(ROUND_US) } else { 0 }
    }

    /// Begins to share the airtime of a radio unit whose rounds gave `given_us` to each.
    pub(super) fn share(&mut self, given_us: u64) {
        (self.used_us, self.spent) = (given_us, Duration::ZERO);
    }

    /// Records the airtime of an attempt.
    pub(super) fn spend(&mut self, airtime: Duration) {
        self.spent += airtime;
    }

    /// Pays for its attempts, at the end of its turn, after the rounds that it needed for it. Returns whether others go first now.
    pub(super) fn pay(&mut self, given_us: &mut u64) -> bool {
        let spent = std::mem::take(&mut self.spent);
        if !self.is_fair() {
            return true;
        }
        *given_us += self.rounds(*given_us) * ROUND_US;
        // One that has airtime gets none in a round, so that less than a round's is left.
        let left = (*given_us - self.used_us) % ROUND_US;
        self.used_us = *given_us - left + spent.as_micros() as u64;
        self.used_us > *given_us
    }

    /// Takes the next frame whose fate, and that of all before it, is settled.
    pub(super) fn settle(&mut self) -> Option<Settled> {
        let received = match self.window.front()?.state {
            State::Received => true,
            State::GivenUp => false,
            State::ToRetry | State::OnAir => return None,
        };
        self.window.pop_front()?.settled(received)
    }

    /// Ends the agreement with a receiver that is gone. Returns the frames that it received; the others wait for the next one.
    pub(super) fn part(&mut self) -> Vec<Settled> {
        self.epoch += 1;
        let mut received = Vec::new();
        while let Some(sent) = self.window.pop_back() {
            match sent.state {
                State::Received => received.extend(sent.settled(true)),
                State::GivenUp => received.extend(sent.settled(false)),
                State::ToRetry | State::OnAir => self.queue.push_front(sent.waiting),
            }
        }
        received.reverse();
        received
    }

    /// Takes the frames that wait.
    pub(super) fn clear(&mut self) -> VecDeque<Waiting> {
        let mut waiting = self.queue.take();
        if let Some(flows) = &mut self.flows {
            waiting.extend(flows.drain());
        }
        waiting
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use cotorra_graph::{FqCodel, QueueDiscipline, QueueLimit};
    use proptest::prelude::*;

    use crate::frame::Frame;

    const ALL: Batch = Batch { frames: 64, cost: u64::MAX };
    const SEVEN: Limit = Limit::Attempts(7);

    /// A frame of a flow, which tells its number.
    fn frame(flow: u8, number: u8) -> Frame {
        Frame::new([&[flow; 14][..], &[number; 986]].concat())
    }

    fn waiting(number: u8) -> Waiting {
        Waiting { frame: frame(0, number), since: Timestamp::ZERO, source: None, is_probe: false }
    }

    fn stream(frames: u8) -> Stream {
        queued(frames, QueueSettings::default())
    }

    fn queued(frames: u8, settings: QueueSettings) -> Stream {
        let mut stream = Stream::default();
        (0..frames).for_each(|number| assert!(push(&mut stream, waiting(number), settings).is_empty()));
        stream
    }

    fn push(stream: &mut Stream, waiting: Waiting, settings: QueueSettings) -> Vec<Waiting> {
        stream.push(Timestamp::ZERO, waiting, settings, || Draws::new(1, "queue"))
    }

    /// Sends the next frames, none of which is dropped.
    fn send(stream: &mut Stream, batch: Batch, cost: impl Fn(usize) -> u64) -> Vec<usize> {
        stream.send(Timestamp::ZERO, batch, cost, &mut |waiting| panic!("{waiting:?} is dropped"))
    }

    fn at(us: u64) -> Timestamp {
        Timestamp::from_nanos(us * 1000)
    }

    /// Sends a batch, of which the frames in these places arrive, and returns what settles: numbers and whether received.
    fn attempt(stream: &mut Stream, batch: Batch, arrive: &[usize]) -> Vec<(u8, bool)> {
        send(stream, batch, |_| 1);
        let mut place = 0;
        stream.conclude([at(0), at(10)], SEVEN, |_| {
            place += 1;
            arrive.contains(&(place - 1))
        });
        settled(stream)
    }

    fn settled(stream: &mut Stream) -> Vec<(u8, bool)> {
        std::iter::from_fn(|| stream.settle()).map(|s| (s.waiting.frame.bytes()[14], s.received)).collect()
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
    fn a_frame_under_an_agreement_is_given_up_after_31_rounds() {
        let mut stream = stream(2);
        let mut attempt = |last, arrives: bool| {
            send(&mut stream, ALL, |_| 1);
            let mut second = false;
            stream.conclude([at(0), at(10)], Limit::Rounds { last }, |_| {
                std::mem::replace(&mut second, arrives)
            });
            settled(&mut stream)
        };
        // A block acknowledgement without the first frame ends its first round.
        assert_eq!(attempt(false, true), []);
        for _ in 1..30 {
            // Of attempts that nobody answers, only the last one in a row ends a round.
            for last in [false, false, true] {
                assert_eq!(attempt(last, false), []);
            }
        }
        assert_eq!(attempt(false, false), []);
        assert_eq!(attempt(true, false), [(0, false), (1, true)]);
    }

    #[test]
    fn a_batch_is_bounded_by_frames_cost_and_window() {
        assert_eq!(send(&mut stream(200), ALL, |_| 1).len(), 64);
        assert_eq!(send(&mut stream(200), Batch { cost: 2500, ..ALL }, |bytes| bytes as u64).len(), 2);
        assert_eq!(send(&mut stream(200), Batch { cost: 0, ..ALL }, |bytes| bytes as u64).len(), 1);
        let mut stream = stream(200);
        attempt(&mut stream, ALL, &[1, 2, 3]);
        // The window begins at frame 0, which is not settled: only frames 0 and 4 to 63 may go.
        assert_eq!(send(&mut stream, ALL, |_| 1).len(), 61);
    }

    #[test]
    fn frames_wait_for_the_next_receiver_in_order() {
        let mut stream = stream(4);
        send(&mut stream, Batch { frames: 3, ..ALL }, |_| 1);
        let mut place = 0;
        stream.conclude([at(0), at(10)], SEVEN, |_| {
            place += 1;
            place == 2
        });
        let numbers: Vec<_> = stream.part().iter().map(|settled| settled.waiting.frame.bytes()[14]).collect();
        assert_eq!(numbers, [1]);
        let numbers: Vec<_> = stream.clear().iter().map(|waiting| waiting.frame.bytes()[14]).collect();
        assert_eq!(numbers, [0, 2, 3]);
    }

    const FAIR: QueueSettings = QueueSettings {
        limit: QueueLimit::Packets(10),
        discipline: QueueDiscipline::FqCodel(FqCodel::MAC80211),
    };

    #[test]
    fn a_sparse_flow_goes_before_what_waits() {
        let mut stream = queued(10, FAIR);
        assert_eq!(attempt(&mut stream, Batch { frames: 2, ..ALL }, &[0, 1]), [(0, true), (1, true)]);
        let sparse = Waiting { frame: frame(1, 77), ..waiting(0) };
        assert!(push(&mut stream, sparse, FAIR).is_empty());
        assert_eq!(attempt(&mut stream, Batch { frames: 2, ..ALL }, &[0, 1]), [(77, true), (2, true)]);
    }

    #[test]
    fn a_full_queue_drops_from_its_longest_flow() {
        let mut stream = queued(10, FAIR);
        let sparse = Waiting { frame: frame(1, 77), ..waiting(0) };
        let dropped = push(&mut stream, sparse, FAIR);
        assert_eq!(dropped.iter().map(|waiting| waiting.frame.bytes()[14]).collect::<Vec<_>>(), [0]);
        assert_eq!(stream.len(), 10);
    }

    #[test]
    fn a_change_to_drop_tail_keeps_the_frames() {
        let mut stream = queued(3, FAIR);
        assert!(push(&mut stream, waiting(3), QueueSettings::default()).is_empty());
        let numbers: Vec<_> = stream.clear().iter().map(|waiting| waiting.frame.bytes()[14]).collect();
        assert_eq!(numbers, [0, 1, 2, 3]);
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
                send(&mut stream, Batch { frames: batch, ..ALL }, |_| 1);
                stream.conclude([at(0), at(10)], SEVEN, |_| !losses.next().unwrap());
                all.extend(settled(&mut stream).into_iter().map(|(number, _)| number));
            }
            prop_assert_eq!(all, (0..frames).collect::<Vec<_>>());
            prop_assert_eq!(stream.len(), 0);
        }
    }
}
