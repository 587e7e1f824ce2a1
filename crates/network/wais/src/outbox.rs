//! Notifications on their way to one consumer, in order: one at a time, tried again with longer and longer pauses, and
//! dropped in the end. A consumer that is slow or dead costs a bounded amount of memory, and nobody else anything.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;

/// Notifications that wait at the most; then the oldest is dropped.
pub(crate) const WAITING: usize = 64;
/// A notification is tried so often …
pub(crate) const ATTEMPTS: u32 = 5;
/// … the second time after so long, and then twice as long each time …
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// … but never longer than this.
const LONGEST_PAUSE: Duration = Duration::from_secs(8);

/// What came of an attempt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// The consumer took it.
    Delivered,
    /// It may go better next time.
    Failed(String),
    /// It will not.
    Refused(String),
}

#[derive(Debug)]
pub(crate) struct Outbox {
    waiting: VecDeque<Arc<str>>,
    /// Whether anything can be sent: always to a callback, to a WebSocket while it is open.
    open: bool,
    /// The attempt that is under way.
    under_way: Option<u64>,
    attempts: u32,
    retry_at: Timestamp,
    /// A drop is told once, until something is delivered.
    told: bool,
}

impl Outbox {
    pub(crate) fn new(open: bool) -> Self {
        Self {
            waiting: VecDeque::new(),
            open,
            under_way: None,
            attempts: 0,
            retry_at: Timestamp::ZERO,
            told: false,
        }
    }

    /// Adds a notification; gives the complaint if that drops another.
    pub(crate) fn push(&mut self, notification: Arc<str>) -> Option<String> {
        self.waiting.push_back(notification);
        if self.waiting.len() <= WAITING {
            return None;
        }
        // The one under way cannot be called back.
        self.waiting.remove(usize::from(self.under_way.is_some()));
        self.complain(|| format!("{WAITING} notifications wait already: the oldest was dropped"))
    }

    /// The next to be sent, if it is time; `attempt` names it.
    pub(crate) fn poll(&mut self, now: Timestamp, attempt: u64) -> Option<Arc<str>> {
        if self.deadline().is_none_or(|at| at > now) {
            return None;
        }
        self.under_way = Some(attempt);
        self.waiting.front().cloned()
    }

    /// When there is something to be sent.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        (self.open && self.under_way.is_none() && !self.waiting.is_empty()).then_some(self.retry_at)
    }

    /// An attempt is over; gives the complaint if its notification was dropped.
    pub(crate) fn done(&mut self, now: Timestamp, attempt: u64, outcome: Outcome) -> Option<String> {
        self.under_way.take_if(|under_way| *under_way == attempt)?;
        self.attempts += 1;
        match outcome {
            Outcome::Failed(_) if self.attempts < ATTEMPTS => {
                let pause = FIRST_PAUSE * 2_u32.pow(self.attempts - 1);
                self.retry_at = now + pause.min(LONGEST_PAUSE);
                return None;
            }
            Outcome::Delivered => self.told = false,
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

    /// Something can be sent from now on, or cannot any more; what was under way is tried again.
    pub(crate) fn set_open(&mut self, open: bool) {
        (self.open, self.under_way) = (open, None);
    }

    fn complain(&mut self, complaint: impl FnOnce() -> String) -> Option<String> {
        (!std::mem::replace(&mut self.told, true)).then(complaint)
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
    fn one_goes_at_a_time_and_in_order() {
        let mut outbox = Outbox::new(true);
        for text in ["a", "b"] {
            assert_eq!(outbox.push(text.into()), None);
        }
        assert_eq!(outbox.poll(at(0.0), 1).as_deref(), Some("a"));
        assert_eq!(outbox.poll(at(9.0), 2), None, "one is under way");
        assert_eq!(outbox.done(at(9.0), 7, Outcome::Delivered), None, "of another attempt");
        outbox.done(at(9.0), 1, Outcome::Delivered);
        assert_eq!(outbox.poll(at(9.0), 2).as_deref(), Some("b"));
        outbox.done(at(9.0), 2, Outcome::Delivered);
        assert_eq!((outbox.poll(at(10.0), 3), outbox.deadline()), (None, None));
    }

    #[test]
    fn pauses_grow_and_in_the_end_it_is_dropped_and_told_once() {
        let mut outbox = Outbox::new(true);
        outbox.push("a".into());
        outbox.push("b".into());
        let (mut now, mut pauses, mut complaints) = (0.0, Vec::new(), Vec::new());
        for attempt in 0..u64::from(ATTEMPTS) * 2 {
            let body = outbox.poll(at(now), attempt).expect("it is due");
            assert_eq!(&*body, if attempt < u64::from(ATTEMPTS) { "a" } else { "b" });
            complaints.extend(outbox.done(at(now), attempt, failed()));
            let due = outbox.deadline().map_or(now, |at| at.as_secs_f64().max(now));
            assert!(due == now || outbox.poll(at(due - 0.001), 99).is_none(), "not before its time");
            pauses.push(due - now);
            now = due;
        }
        assert_eq!(pauses[..5], [0.5, 1.0, 2.0, 4.0, 0.0]);
        assert_eq!(complaints, ["a notification was dropped after 5 attempts: nobody listens"]);
        assert_eq!(outbox.deadline(), None);
        // After a delivery a drop is news again.
        for (attempt, outcome) in [(20, Outcome::Delivered), (21, Outcome::Refused("404".into()))] {
            outbox.push("c".into());
            outbox.poll(at(now), attempt).unwrap();
            let complaint = outbox.done(at(now), attempt, outcome);
            assert_eq!(complaint.is_some(), attempt == 21);
        }
    }

    #[test]
    fn what_nobody_takes_is_bounded() {
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
    fn a_closed_websocket_keeps_what_it_did_not_take() {
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
