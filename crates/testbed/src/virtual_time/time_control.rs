//! Control of a run's time where it is not real time: in virtual time that somebody watches, and in a replay. Time passes at
//! a speed, and can be stopped and taken on in steps.

use std::time::Duration;

use cotorra_graph::Timestamp;

use crate::clock::Clock;

/// Speed of a run's time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// Seconds of the run per second; positive and finite.
    Times(f64),
    /// As fast as possible.
    Max,
}

impl Speed {
    /// Returns the speed of so many seconds of the run per second; `None` below 0.001 and above 1000000.
    pub fn times(times: f64) -> Option<Self> {
        (1e-3..=1e6).contains(&times).then_some(Self::Times(times))
    }
}

/// A change of how time passes. What is `None` stays as it is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct TimeChange {
    pub(crate) paused: Option<bool>,
    pub(crate) speed: Option<Speed>,
    /// Stops time, and takes it on by so much.
    pub(crate) step: Option<Duration>,
}

/// Course of time.
#[derive(Debug, PartialEq)]
pub(crate) struct TimeState {
    /// The run's time.
    pub(crate) now: Timestamp,
    /// Whether time is stopped.
    pub(crate) paused: bool,
    /// Speed while it is not stopped.
    pub(crate) speed: Speed,
}

/// Says when the run's time may go on.
pub(crate) struct TimeControl {
    speed: Speed,
    paused: bool,
    /// Real time and the run's, from which the speed counts. While time is stopped, the run's time does not exceed it.
    since: (Timestamp, Timestamp),
    wall: Clock,
}

impl TimeControl {
    /// Lets time pass at a speed from `now` on.
    pub(crate) fn new(speed: Speed, now: Timestamp, wall: Clock) -> Self {
        Self { speed, paused: false, since: (wall(), now), wall }
    }

    /// Applies a change at the time `now` of the run, and returns how time passes from then on.
    pub(crate) fn change(&mut self, change: TimeChange, now: Timestamp) -> TimeState {
        if change == TimeChange::default() {
            return self.state(now);
        }
        let was_paused = self.paused;
        self.speed = change.speed.unwrap_or(self.speed);
        self.paused = change.step.is_some() || change.paused.unwrap_or(self.paused);
        // Steps while time is stopped are from the end of the one before, even if nothing happens there.
        let from = if was_paused { self.since.1.max(now) } else { now };
        self.since = ((self.wall)(), from + change.step.unwrap_or_default());
        self.state(now)
    }

    fn state(&self, now: Timestamp) -> TimeState {
        TimeState { now, paused: self.paused, speed: self.speed }
    }

    /// Whether time must not pass as fast as possible.
    pub(crate) fn is_limited(&self) -> bool {
        self.paused || self.speed != Speed::Max
    }

    /// Returns how long the run has to wait before its time may be `next`: zero if not at all, and `None` while time is
    /// stopped.
    pub(crate) fn wait(&self, next: Timestamp) -> Option<Duration> {
        let (began, from) = self.since;
        let ahead = next.since(from);
        match self.speed {
            _ if ahead.is_zero() => Some(Duration::ZERO),
            _ if self.paused => None,
            Speed::Max => Some(Duration::ZERO),
            Speed::Times(times) => {
                let due = Duration::try_from_secs_f64(ahead.as_secs_f64() / times).unwrap_or(Duration::MAX);
                Some(due.saturating_sub((self.wall)().since(began)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    };

    use super::*;

    /// A clock that a test sets, in milliseconds.
    #[derive(Default, Clone)]
    struct Wall(Arc<AtomicU64>);

    impl Wall {
        fn clock(&self) -> Clock {
            let millis = Arc::clone(&self.0);
            Arc::new(move || at(millis.load(Ordering::Relaxed)))
        }

        fn set(&self, millis: u64) {
            self.0.store(millis, Ordering::Relaxed);
        }
    }

    fn at(millis: u64) -> Timestamp {
        Timestamp::ZERO + ms(millis)
    }

    fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    fn paused(paused: bool) -> TimeChange {
        TimeChange { paused: Some(paused), ..TimeChange::default() }
    }

    #[test]
    fn time_passes_at_the_speed_from_the_change_on() {
        let wall = Wall::default();
        let mut time = TimeControl::new(Speed::Times(2.0), at(1000), wall.clock());
        assert_eq!(time.wait(at(3000)), Some(ms(1000)));
        wall.set(600);
        assert_eq!(time.wait(at(3000)), Some(ms(400)));
        assert_eq!(time.wait(at(2000)), Some(ms(0)));
        time.change(TimeChange { speed: Some(Speed::Times(0.5)), ..TimeChange::default() }, at(2200));
        assert_eq!(time.wait(at(2300)), Some(ms(200)));
        time.change(TimeChange { speed: Some(Speed::Max), ..TimeChange::default() }, at(2200));
        assert_eq!(time.wait(Timestamp::MAX), Some(ms(0)));
    }

    #[test]
    fn a_pause_costs_no_time_of_the_run() {
        let wall = Wall::default();
        let mut time = TimeControl::new(Speed::Times(1.0), at(0), wall.clock());
        wall.set(500);
        time.change(paused(true), at(500));
        wall.set(9000);
        assert_eq!((time.wait(at(501)), time.wait(at(500))), (None, Some(ms(0))));
        time.change(paused(false), at(500));
        assert_eq!(time.wait(at(700)), Some(ms(200)));
    }

    #[test]
    fn steps_add_up_even_if_nothing_happens_in_them() {
        let wall = Wall::default();
        let mut time = TimeControl::new(Speed::Max, at(0), wall.clock());
        let step = TimeChange { step: Some(ms(100)), ..TimeChange::default() };
        assert!(time.change(step, at(40)).paused);
        assert_eq!((time.wait(at(140)), time.wait(at(141))), (Some(ms(0)), None));
        // Nothing has happened since 40 ms.
        time.change(step, at(40));
        assert_eq!((time.wait(at(240)), time.wait(at(241))), (Some(ms(0)), None));
    }

    #[test]
    fn a_speed_that_needs_longer_than_there_is_time_waits_without_end() {
        let time = TimeControl::new(Speed::Times(1e-300), at(0), Wall::default().clock());
        assert_eq!(time.wait(at(1)), Some(Duration::MAX));
    }
}
