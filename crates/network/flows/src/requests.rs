//! Requests under way, and what became of them.

use std::{collections::VecDeque, time::Duration};

/// Bytes of a request that its answer repeats at the same place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id {
    /// Where they begin in the datagram's payload.
    pub offset: u8,
    /// How many they are; [`Id::MOST`] at most.
    pub length: u8,
}

impl Id {
    /// The most bytes that it can have.
    pub const MOST: u8 = 16;
    /// The farthest place at which it can begin.
    pub const FARTHEST: u8 = 200;
}

/// So many are under way at most; then the oldest is forgotten.
const MOST: usize = 1024;

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Number of the request, from 0.
    pub sequence: u32,
    /// When its first byte entered the network, since the run began.
    pub entered: Duration,
    /// From then to its answer; `None` if none came in time.
    pub took: Option<Duration>,
    /// What [`crate::Meter::entered`] was given with it.
    pub mark: u64,
}

/// How much was seen, and how much of it is in no sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Requests that were seen.
    pub requests: u64,
    /// Requests beside others of the same socket, whose answers cannot be told apart.
    pub unclear: u64,
    /// Requests forgotten because too many were under way.
    pub forgotten: u64,
    /// Requests that the server refused.
    pub refused: u64,
    /// Connections, and writers of ROS 2, that were not followed any more: too many, too much out of order, or another
    /// protocol.
    pub given_up: u64,
}

#[derive(Debug)]
struct Pending<K> {
    sequence: u32,
    key: K,
    entered: Duration,
    mark: u64,
    unclear: bool,
}

/// Requests under way, oldest first, by what tells their answers.
#[derive(Debug)]
pub(crate) struct Requests<K> {
    timeout: Duration,
    pending: VecDeque<Pending<K>>,
    samples: VecDeque<Sample>,
    pub counts: Counts,
}

impl<K: PartialEq> Requests<K> {
    pub fn new(timeout: Duration) -> Self {
        Self { timeout, pending: VecDeque::new(), samples: VecDeque::new(), counts: Counts::default() }
    }

    /// A request entered the network.
    pub fn begin(&mut self, key: K, entered: Duration, mark: u64) {
        if self.pending.len() == MOST {
            self.pending.pop_front();
            self.counts.forgotten += 1;
        }
        let sequence = self.counts.requests as u32;
        self.counts.requests += 1;
        // One whose end tells that it is one may have begun before others.
        let place = self.pending.partition_point(|other| other.entered <= entered);
        self.pending.insert(place, Pending { sequence, key, entered, mark, unclear: false });
    }

    pub fn has(&self, key: &K) -> bool {
        self.pending.iter().any(|pending| pending.key == *key)
    }

    /// The key of the first request for which this holds.
    pub fn find(&mut self, is_it: impl Fn(&K) -> bool) -> Option<&mut K> {
        self.pending.iter_mut().map(|pending| &mut pending.key).find(|key| is_it(key))
    }

    /// Forgets the first request for which this holds: there will be no answer, and the client knows.
    pub fn refuse(&mut self, is_it: impl Fn(&K) -> bool, at: Duration) {
        self.expire(at);
        let place = self.pending.iter().position(|pending| is_it(&pending.key));
        if let Some(place) = place {
            self.pending.remove(place);
            self.counts.refused += 1;
        }
    }

    /// An answer to the request with this key was delivered; an answer to no request is ignored. One that could be to several
    /// makes all of them unclear.
    pub fn answer(&mut self, key: &K, at: Duration) {
        self.answer_to(|its| its == key, at);
    }

    /// The same, to the request for whose key this holds.
    pub fn answer_to(&mut self, is_it: impl Fn(&K) -> bool, at: Duration) {
        self.expire(at);
        let mut its = self.pending.iter_mut().enumerate().filter(|(_, pending)| is_it(&pending.key));
        let Some((place, first)) = its.next() else { return };
        let mut is_clear = !first.unclear;
        for (_, other) in its {
            (is_clear, other.unclear) = (false, true);
        }
        if !is_clear {
            self.pending[place].unclear = true;
            return;
        }
        let Pending { sequence, entered, mark, .. } = self.pending.remove(place).expect("it was found there");
        self.samples.push_back(Sample { sequence, entered, took: Some(at.saturating_sub(entered)), mark });
    }

    /// Gives up requests that were not answered in time.
    pub fn expire(&mut self, now: Duration) {
        while let Some(lost) = self.pending.pop_front_if(|pending| pending.entered + self.timeout <= now) {
            if lost.unclear {
                self.counts.unclear += 1;
                continue;
            }
            let Pending { sequence, entered, mark, .. } = lost;
            self.samples.push_back(Sample { sequence, entered, took: None, mark });
        }
    }

    pub fn deadline(&self) -> Option<Duration> {
        Some(self.pending.front()?.entered + self.timeout)
    }

    pub fn poll(&mut self) -> Option<Sample> {
        self.samples.pop_front()
    }
}
