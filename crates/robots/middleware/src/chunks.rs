//! A robot that follows a model's actions: it observes, gets a chunk of actions, and follows one at each step of its control.

use std::time::Duration;

use cotorra_graph::{Chunk, Policy, Timestamp};
use cotorra_numbers::Gathered;

/// What a robot followed so far.
#[derive(Debug, Clone, Default)]
pub struct Followed {
    /// Steps of its control.
    pub steps: u64,
    /// Steps without an action to follow.
    pub starved: u64,
    /// Stretches of such steps.
    pub stalls: u64,
    /// Longest of them.
    pub longest_stall: Duration,
    /// Ages of the followed actions, milliseconds: the time since the observation that they answer.
    pub age_ms: Gathered,
}

/// An observation that a robot made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Observed {
    /// Number of the observation, from 0.
    pub sequence: u32,
    /// Time of it.
    pub at: Timestamp,
    /// Number of actions that it had followed by then.
    followed: u64,
}

/// A robot's end of a policy. Call [`ActionChunks::advance`] at each [`ActionChunks::deadline`].
///
/// One observation is under way at a time. Its chunk replaces what is left of the last one, without the actions in whose place
/// the robot followed others meanwhile. Without an action, the robot holds still until one comes.
#[derive(Debug)]
pub struct ActionChunks {
    chunk: Chunk,
    request_ahead: u32,
    timeout: Duration,
    next_step: Timestamp,
    /// Actions that are left.
    left: u64,
    /// The observation that they answer.
    based_on: Timestamp,
    /// Actions that it followed.
    actions: u64,
    under_way: Option<Observed>,
    given_up: Option<Observed>,
    observations: u32,
    stalled_since: Option<Timestamp>,
    so_far: Followed,
}

impl ActionChunks {
    /// Creates the robot's end of a policy whose server answers with such chunks. Its first step is at `begin`.
    pub fn new(chunk: Chunk, policy: &Policy, begin: Timestamp) -> Self {
        Self {
            chunk,
            request_ahead: policy.request_ahead,
            timeout: policy.timeout,
            next_step: begin,
            left: 0,
            based_on: begin,
            actions: 0,
            under_way: None,
            given_up: None,
            observations: 0,
            stalled_since: None,
            so_far: Followed::default(),
        }
    }

    /// Returns the time of the next step.
    pub fn deadline(&self) -> Timestamp {
        self.next_step
    }

    /// Makes the next step, if it is due. Returns the observation to send after it, if there is one.
    pub fn advance(&mut self, now: Timestamp) -> Option<Observed> {
        if now < self.next_step {
            return None;
        }
        let at = self.next_step;
        self.next_step = at + self.chunk.interval;
        self.step(at);
        let timeout = self.timeout;
        self.given_up = self.under_way.take_if(|observed| at.since(observed.at) >= timeout);
        if self.under_way.is_some() || self.left > u64::from(self.request_ahead) {
            return None;
        }
        let observed = Observed { sequence: self.observations, at, followed: self.actions };
        self.observations += 1;
        self.under_way = Some(observed);
        Some(observed)
    }

    /// Returns the observation that the last step gave up.
    pub fn given_up(&mut self) -> Option<Observed> {
        self.given_up.take()
    }

    /// Takes the chunk that answers an observation. Returns the observation, unless it was answered or given up before.
    pub fn receive(&mut self, sequence: u32) -> Option<Observed> {
        let observed = self.under_way.take_if(|observed| observed.sequence == sequence)?;
        let followed_since = self.actions - observed.followed;
        self.left = u64::from(self.chunk.actions).saturating_sub(followed_since);
        self.based_on = observed.at;
        Some(observed)
    }

    /// Returns what the robot followed so far.
    pub fn followed(&self, now: Timestamp) -> Followed {
        let mut followed = self.so_far.clone();
        if let Some(since) = self.stalled_since {
            followed.longest_stall = followed.longest_stall.max(now.since(since));
        }
        followed
    }

    fn step(&mut self, at: Timestamp) {
        let so_far = &mut self.so_far;
        so_far.steps += 1;
        if self.left == 0 {
            so_far.starved += 1;
            so_far.stalls += u64::from(self.stalled_since.is_none());
            self.stalled_since.get_or_insert(at);
            return;
        }
        if let Some(since) = self.stalled_since.take() {
            so_far.longest_stall = so_far.longest_stall.max(at.since(since));
        }
        self.left -= 1;
        self.actions += 1;
        so_far.age_ms.add(at.since(self.based_on).as_secs_f64() * 1e3);
    }
}

#[cfg(test)]
mod tests {
    use cotorra_numbers::Quantiles;
    use proptest::prelude::*;

    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::ZERO + Duration::from_millis(ms)
    }

    /// A chunk has four actions of 20 ms.
    fn chunks(request_ahead: u32) -> ActionChunks {
        let chunk = Chunk { actions: 4, interval: Duration::from_millis(20), bytes: 100 };
        let (server, timeout) = ("model".parse().unwrap(), Duration::from_millis(100));
        let policy = Policy { server, observation_bytes: 1000, request_ahead, timeout };
        ActionChunks::new(chunk, &policy, Timestamp::ZERO)
    }

    /// Runs until that time, with answers so long after their observations.
    fn run(mut chunks: ActionChunks, until_ms: u64, delay_ms: u64) -> Followed {
        let mut answer: Option<(u64, u32)> = None;
        for ms in 0..until_ms {
            if let Some((_, sequence)) = answer.take_if(|(due, _)| *due == ms) {
                chunks.receive(sequence);
            }
            if let Some(observed) = chunks.advance(at(ms)) {
                answer = Some((ms + delay_ms, observed.sequence));
            }
        }
        chunks.followed(at(until_ms))
    }

    fn oldest_ms(followed: &Followed) -> f64 {
        Quantiles::gathered(&followed.age_ms).unwrap().max
    }

    #[test]
    fn a_robot_that_asks_late_stalls_while_it_waits() {
        // Observes at 0, 120, …: the chunk is there at 30, is followed at 40, 60, 80 and 100, and the next step has none.
        let followed = run(chunks(0), 1000, 30);
        assert_eq!((followed.steps, followed.starved, followed.stalls), (50, 11, 10));
        assert_eq!(followed.longest_stall, Duration::from_millis(40));
        assert_eq!(oldest_ms(&followed), 100.0);
    }

    #[test]
    fn a_robot_that_asks_ahead_never_stalls_again() {
        let followed = run(chunks(2), 1000, 30);
        assert_eq!((followed.starved, followed.stalls), (2, 1));
        // A chunk is followed until the next one comes, 30 ms after an observation at its second action.
        assert!(oldest_ms(&followed) <= 80.0);
    }

    #[test]
    fn actions_in_whose_place_others_were_followed_are_skipped() {
        let mut chunks = chunks(3);
        let first = chunks.advance(at(0)).unwrap();
        assert!(chunks.receive(first.sequence).is_some());
        // One action followed, three left: it observes, and follows two more before the answer.
        let second = chunks.advance(at(20)).unwrap();
        assert!(chunks.advance(at(40)).is_none() && chunks.advance(at(60)).is_none());
        assert!(chunks.receive(second.sequence).is_some());
        assert_eq!((chunks.left, chunks.based_on), (2, at(20)));
        assert_eq!(chunks.receive(second.sequence), None);
    }

    #[test]
    fn an_observation_without_an_answer_is_given_up_and_another_one_made() {
        let mut chunks = chunks(0);
        let first = chunks.advance(at(0)).unwrap();
        for ms in [20, 40, 60, 80] {
            assert!(chunks.advance(at(ms)).is_none() && chunks.given_up().is_none());
        }
        let second = chunks.advance(at(100)).unwrap();
        assert_eq!((chunks.given_up(), second.sequence), (Some(first), 1));
        assert_eq!(chunks.receive(first.sequence), None);
        assert_eq!(chunks.followed(at(110)).longest_stall, Duration::from_millis(110));
    }

    proptest! {
        #[test]
        fn steps_are_followed_or_starved(ahead in 0_u32..4, delays in prop::collection::vec(1_u64..150, 1..40)) {
            let mut chunks = chunks(ahead);
            let mut delays = delays.into_iter().cycle();
            let mut answer: Option<(u64, u32)> = None;
            for ms in 0..3000 {
                if let Some((_, sequence)) = answer.take_if(|(due, _)| *due == ms) {
                    chunks.receive(sequence);
                    prop_assert!(chunks.left <= 4);
                }
                if let Some(observed) = chunks.advance(at(ms)) {
                    answer = Some((ms + delays.next().unwrap(), observed.sequence));
                }
            }
            let followed = chunks.followed(at(3000));
            prop_assert_eq!(followed.steps, 150);
            prop_assert_eq!(followed.starved + followed.age_ms.count(), 150);
            prop_assert!(followed.stalls <= followed.starved);
        }
    }
}
