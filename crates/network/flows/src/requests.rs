//! Pending requests and their samples.

use std::{collections::VecDeque, time::Duration};

/// Bytes of a request that its answer repeats at the same offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id {
    /// Offset in the payload.
    pub offset: u8,
    /// Number of bytes, at most [`Id::MOST`].
    pub length: u8,
}

impl Id {
    /// Largest length.
    pub const MOST: u8 = 16;
    /// Largest offset.
    pub const FARTHEST: u8 = 200;
}

/// Most pending requests. Beyond that, the oldest is forgotten.
const MOST: usize = 1024;

/// The outcome of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Number of the request, from 0.
    pub sequence: u32,
    /// Time at which its first byte entered the network, since the run began.
    pub entered: Duration,
    /// Time from then to its answer; `None` without an answer in time.
    pub took: Option<Duration>,
    /// Mark given to [`crate::Meter::entered`].
    pub mark: u64,
}

/// Counters of requests, and of those without a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// All requests.
    pub requests: u64,
    /// Requests whose answers could belong to other requests of the same socket.
    pub unclear: u64,
    /// Requests forgotten because too many were pending.
    pub forgotten: u64,
    /// Requests that the server rejected.
    pub rejected: u64,
    /// Connections, and writers of ROS 2, that were not followed to their end: too many, too much out of order, or another
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

/// Pending requests, oldest first. `K` identifies the answer.
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

    /// Adds a request that entered the network.
    pub fn begin(&mut self, key: K, entered: Duration, mark: u64) {
        if self.pending.len() == MOST {
            self.pending.pop_front();
            self.counts.forgotten += 1;
        }
        let sequence = self.counts.requests as u32;
        self.counts.requests += 1;
        // A request that is recognized at its end may have begun before others.
        let place = self.pending.partition_point(|other| other.entered <= entered);
        self.pending.insert(place, Pending { sequence, key, entered, mark, unclear: false });
    }

    pub fn has(&self, key: &K) -> bool {
        self.pending.iter().any(|pending| pending.key == *key)
    }

    /// Returns the key of the first request that matches.
    pub fn find(&mut self, is_it: impl Fn(&K) -> bool) -> Option<&mut K> {
        self.pending.iter_mut().map(|pending| &mut pending.key).find(|key| is_it(key))
    }

    /// Removes the first request that matches, because the server rejected it.
    pub fn reject(&mut self, is_it: impl Fn(&K) -> bool, at: Duration) {
        self.expire(at);
        let place = self.pending.iter().position(|pending| is_it(&pending.key));
        if let Some(place) = place {
            self.pending.remove(place);
            self.counts.rejected += 1;
        }
    }

    /// Records the answer to the request with this key. Ignores an answer without a request. An answer that could belong to
    /// several requests makes all of them unclear.
    pub fn answer(&mut self, key: &K, at: Duration) {
        self.answer_to(|its| its == key, at);
    }

    /// [`Self::answer`] for the request whose key matches.
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
        let Pending { sequence, entered, mark, .. } =
            self.pending.remove(place).expect("a request is at this place");
        self.samples.push_back(Sample { sequence, entered, took: Some(at.saturating_sub(entered)), mark });
    }

    /// Expires requests without an answer in time.
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

    /// Returns the marks of all pending requests, oldest first.
    pub fn marks(&self) -> Vec<u64> {
        self.pending.iter().map(|pending| pending.mark).collect()
    }

    pub fn deadline(&self) -> Option<Duration> {
        Some(self.pending.front()?.entered + self.timeout)
    }

    pub fn poll(&mut self) -> Option<Sample> {
        self.samples.pop_front()
    }
}
