//! Queue of notifications to one consumer. They are sent in order, one at a time, retried with growing pauses, and
//! finally dropped. A slow or dead consumer costs a bounded amount of memory and affects no other.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;

/// Most notifications that may wait; beyond it the oldest is dropped.
const WAITING: usize = 64;
/// Attempts per notification.
const ATTEMPTS: u32 = 5;
/// Pause before the second attempt. It doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// Longest pause between attempts.
const LONGEST_PAUSE: Duration = Duration::from_secs(8);

/// Outcome of an attempt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// The consumer has it.
    Delivered,
    /// A retry may succeed.
    Failed(String),
    /// A retry is pointless.
    Refused(String),
}

/// The queue.
#[derive(Debug)]
pub struct Outbox {
    waiting: VecDeque<Arc<str>>,
    /// Whether sending is possible: always to a callback, to a WebSocket while it is open.
    open: bool,
    /// The current attempt.
    current: Option<u64>,
    attempts: u32,
    retry_at: Timestamp,
    /// Whether a drop was reported since the last delivery.
    reported: bool,
}

impl Outbox {
    /// Creates an empty queue; `open` says whether sending is possible.
    pub fn new(open: bool) -> Self {
        Self {
            waiting: VecDeque::new(),
            open,
            current: None,
            attempts: 0,
            retry_at: Timestamp::ZERO,
            reported: false,
        }
    }

    /// Adds a notification. Returns a complaint if another was dropped for it.
    pub fn push(&mut self, notification: Arc<str>) -> Option<String> {
        self.waiting.push_back(notification);
        if self.waiting.len() <= WAITING {
            return None;
        }
        // The one being sent cannot be recalled.
        self.waiting.remove(usize::from(self.current.is_some()));
        self.complain(|| format!("{WAITING} notifications wait already: the oldest was dropped"))
    }

    /// Returns the next notification if one is due. `attempt` identifies the attempt.
    pub fn poll(&mut self, now: Timestamp, attempt: u64) -> Option<Arc<str>> {
        if self.deadline().is_none_or(|at| at > now) {
            return None;
        }
        self.current = Some(attempt);
        self.waiting.front().cloned()
    }

    /// Returns when the next notification is due.
    pub fn deadline(&self) -> Option<Timestamp> {
        (self.open && self.current.is_none() && !self.waiting.is_empty()).then_some(self.retry_at)
    }

    /// Ends an attempt. Returns a complaint if its notification was dropped.
    pub fn done(&mut self, now: Timestamp, attempt: u64, outcome: Outcome) -> Option<String> {
        self.current.take_if(|current| *current == attempt)?;
        self.attempts += 1;
        match outcome {
            Outcome::Failed(_) if self.attempts < ATTEMPTS => {
                let pause = FIRST_PAUSE * 2_u32.pow(self.attempts - 1);
                self.retry_at = now + pause.min(LONGEST_PAUSE);
                return None;
            }
            Outcome::Delivered => self.reported = false,
            Outcome::Failed(_) | Outcome::Refused(_) => {}
        }
        let attempts = std::mem::take(&mut self.attempts);
        self.retry_at = Timestamp::ZERO;
        self.waiting.pop_front();
        match outcome {
            Outcome::Delivered => None,
            Outcome::Failed(why) | Outcome::Refused(why) => {
                self.complain(|| format!("a notification was dropped after {attempts} attempts: {why}"))
            }
        }
    }

    /// Sets whether sending is possible. The current attempt will be repeated.
    pub fn set_open(&mut self, open: bool) {
        (self.open, self.current) = (open, None);
    }

    fn complain(&mut self, complaint: impl FnOnce() -> String) -> Option<String> {
        (!std::mem::replace(&mut self.reported, true)).then(complaint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn failed() -> Outcome {
        Outcome::Failed("nobody listens".to_owned())
    }

    #[test]
    fn notifications_are_sent_in_order_one_at_a_time() {
        let mut outbox = Outbox::new(true);
        for text in ["a", "b"] {
            assert_eq!(outbox.push(text.into()), None);
        }
        assert_eq!(outbox.poll(at(0.0), 1).as_deref(), Some("a"));
        assert_eq!(outbox.poll(at(9.0), 2), None, "one is being sent");
        assert_eq!(outbox.done(at(9.0), 7, Outcome::Delivered), None, "from another attempt");
        outbox.done(at(9.0), 1, Outcome::Delivered);
        assert_eq!(outbox.poll(at(9.0), 2).as_deref(), Some("b"));
        outbox.done(at(9.0), 2, Outcome::Delivered);
        assert_eq!((outbox.poll(at(10.0), 3), outbox.deadline()), (None, None));
    }

    #[test]
    fn pauses_grow_and_a_drop_is_reported_once() {
        let mut outbox = Outbox::new(true);
        outbox.push("a".into());
        outbox.push("b".into());
        let (mut now, mut pauses, mut complaints) = (0.0, Vec::new(), Vec::new());
        for attempt in 0..u64::from(ATTEMPTS) * 2 {
            let body = outbox.poll(at(now), attempt).expect("it is due");
            assert_eq!(&*body, if attempt < u64::from(ATTEMPTS) { "a" } else { "b" });
            complaints.extend(outbox.done(at(now), attempt, failed()));
            let due = outbox.deadline().map_or(now, |at| at.as_secs_f64().max(now));
            assert!(due == now || outbox.poll(at(due - 0.001), 99).is_none(), "not before its deadline");
            pauses.push(due - now);
            now = due;
        }
        assert_eq!(pauses[..5], [0.5, 1.0, 2.0, 4.0, 0.0]);
        assert_eq!(complaints, ["a notification was dropped after 5 attempts: nobody listens"]);
        assert_eq!(outbox.deadline(), None);
        // After a delivery the next drop is reported again.
        for (attempt, outcome) in [(20, Outcome::Delivered), (21, Outcome::Refused("404".into()))] {
            outbox.push("c".into());
            outbox.poll(at(now), attempt).unwrap();
            let complaint = outbox.done(at(now), attempt, outcome);
            assert_eq!(complaint.is_some(), attempt == 21);
        }
    }

    #[test]
    fn undelivered_notifications_are_bounded() {
        let mut outbox = Outbox::new(true);
        outbox.push("first".into());
        outbox.poll(at(0.0), 1).unwrap();
        let complaints = (0..1000).filter_map(|n| outbox.push(n.to_string().into())).count();
        assert_eq!((outbox.waiting.len(), complaints), (WAITING, 1));
        outbox.done(at(1.0), 1, Outcome::Delivered);
        let next = outbox.poll(at(1.0), 2);
        assert_eq!(next.as_deref(), Some(&*(1000 - WAITING + 1).to_string()), "the newest are kept");
    }

    #[test]
    fn closed_websockets_keep_undelivered_notifications() {
        let mut outbox = Outbox::new(false);
        outbox.push("a".into());
        assert_eq!(outbox.poll(at(0.0), 1), None);
        outbox.set_open(true);
        outbox.poll(at(0.0), 1).unwrap();
        outbox.set_open(false);
        assert_eq!(outbox.done(at(0.0), 1, failed()), None, "it was closed meanwhile");
        outbox.set_open(true);
        assert_eq!(outbox.poll(at(0.0), 2).as_deref(), Some("a"));
    }
}
