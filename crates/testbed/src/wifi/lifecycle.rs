//! The life of a program: started, and started again with growing delays if it ends by itself.

use cotorra_engine::Backoff;
use cotorra_graph::Timestamp;

/// The life of a program.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Lifecycle {
    state: State,
    backoff: Backoff,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    /// It is not wanted.
    #[default]
    Off,
    /// It is being started.
    Starting,
    /// It answers.
    Running { since: Timestamp },
    /// It ended by itself, and is started again.
    Waiting { until: Timestamp },
}

impl Lifecycle {
    /// Wants the program to run. Returns whether it is to be started now.
    pub(super) fn begin(&mut self) -> bool {
        let begins = !self.is_wanted();
        if begins {
            *self = Self { state: State::Starting, backoff: Backoff::default() };
        }
        begins
    }

    /// Wants the program no more. Returns whether it is to be stopped now.
    pub(super) fn end(&mut self) -> bool {
        let ends = matches!(self.state, State::Starting | State::Running { .. });
        self.state = State::Off;
        ends
    }

    /// Records that the program answers. Returns whether that is wanted.
    pub(super) fn started(&mut self, now: Timestamp) -> bool {
        let is_wanted = self.state == State::Starting;
        if is_wanted {
            self.state = State::Running { since: now };
        }
        is_wanted
    }

    /// Records that the program ended, or could not be started. Returns when it is started again; `None` if it is not wanted.
    pub(super) fn ended(&mut self, now: Timestamp) -> Option<Timestamp> {
        match self.state {
            State::Off | State::Waiting { .. } => return None,
            State::Starting => {}
            State::Running { since } => self.backoff.ran(now.since(since)),
        }
        let until = now + self.backoff.delay();
        self.state = State::Waiting { until };
        Some(until)
    }

    /// Returns whether the program is to be started again now.
    pub(super) fn advance(&mut self, now: Timestamp) -> bool {
        let is_due = self.deadline().is_some_and(|until| until <= now);
        if is_due {
            self.state = State::Starting;
        }
        is_due
    }

    /// Returns when [`Self::advance`] is due.
    pub(super) fn deadline(&self) -> Option<Timestamp> {
        if let State::Waiting { until } = self.state { Some(until) } else { None }
    }

    /// Whether the program is wanted.
    pub(super) fn is_wanted(&self) -> bool {
        self.state != State::Off
    }

    /// Whether the program answers.
    pub(super) fn is_running(&self) -> bool {
        matches!(self.state, State::Running { .. })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::ZERO + Duration::from_millis(ms)
    }

    #[test]
    fn a_program_that_ends_by_itself_is_started_again() {
        let mut life = Lifecycle::default();
        assert!(life.begin());
        assert!(!life.begin());
        assert!(life.started(at(50)));
        assert!(life.is_running());
        assert_eq!(life.ended(at(100)), Some(at(200)));
        assert_eq!(life.ended(at(110)), None);
        assert_eq!(life.deadline(), Some(at(200)));
        assert!(!life.advance(at(199)));
        assert!(life.advance(at(200)));
        assert!(!life.advance(at(201)));
        // It cannot be started: the delay doubles.
        assert_eq!(life.ended(at(300)), Some(at(500)));
        assert!(life.advance(at(500)));
        assert!(life.started(at(500)));
        // It ran for long: the first delay again.
        assert_eq!(life.ended(at(20_000)), Some(at(20_100)));
    }

    #[test]
    fn a_program_that_was_stopped_is_not_started_again() {
        let mut life = Lifecycle::default();
        assert!(!life.end());
        life.begin();
        assert!(life.end());
        assert!(!life.started(at(10)), "it answers too late");
        assert_eq!(life.ended(at(20)), None);
        life.begin();
        life.ended(at(30));
        assert!(!life.end(), "nothing runs while it waits");
        assert_eq!(life.deadline(), None);
        assert!(life.begin());
    }
}
