//! Decides when the fabric's thread sleeps and when it spins. A sleeping thread wakes late, by an amount that depends
//! on the machine and varies little. That amount is measured, the alarm is set earlier by it, and the rest is spent
//! spinning. The share of spinning is limited.

use std::{thread, time::Duration};

use cotorra_graph::Timestamp;

use crate::sys;

/// Policy of spinning just before a deadline instead of sleeping until it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BusyPoll {
    /// On a machine with more than two cores as long as needed, else for at most a tenth of the time.
    #[default]
    Auto,
    /// As long as needed, whatever it takes from other threads.
    Always,
    Never,
}

/// Priority of the fabric's thread: above everything that is not real-time, below the kernel's own real-time threads.
const PRIORITY: i32 = 10;
/// Lowest real-time priority.
const LOWEST: i32 = 1;
/// Upper limit on the lead. A machine that wakes later than this was kept busy by others.
const MOST_LEAD: Duration = Duration::from_micros(100);
/// Lead on a machine with a spare core: about the time in which one wakes from its deepest sleep.
const AMPLE_LEAD: Duration = Duration::from_micros(70);
/// Decrease of the lead after an alarm on time. A late alarm increases it three times as much, so that three in four
/// are on time. A very late alarm counts no more than any other.
const STEP: Duration = Duration::from_nanos(500);
/// Inverse share of time that may be spent spinning without a spare core.
const BUDGET_SHARE: u32 = 10;
/// Most spinning time that may be saved up.
const MOST_BUDGET: Duration = Duration::from_millis(5);

/// Computes how long to sleep.
#[derive(Debug)]
pub(crate) struct Punctuality {
    spin: Spin,
    /// Lead by which the alarm is set earlier.
    lead: Duration,
    /// Time that the alarm is set for.
    alarm: Option<Timestamp>,
    budget: Duration,
    /// Time and result of the last call: whether it was to spin.
    last: (Timestamp, bool),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Spin {
    Never,
    Budgeted,
    Always,
}

impl Punctuality {
    pub(crate) fn new(busy_poll: BusyPoll) -> Self {
        let spin = match busy_poll {
            BusyPoll::Never => Spin::Never,
            BusyPoll::Auto if !can_spare_a_core() => Spin::Budgeted,
            BusyPoll::Auto | BusyPoll::Always => Spin::Always,
        };
        Self { spin, lead: Duration::ZERO, alarm: None, budget: MOST_BUDGET, last: (Timestamp::ZERO, false) }
    }

    /// Returns how long to sleep at `now` before a deadline. Zero means to poll again at once.
    pub(crate) fn sleep(&mut self, now: Timestamp, deadline: Timestamp) -> Duration {
        let passed = now.since(self.last.0);
        let spun = if self.last.1 { passed } else { Duration::ZERO };
        self.budget = (self.budget + passed / BUDGET_SHARE).saturating_sub(spun).min(MOST_BUDGET);
        let lead = match self.spin {
            Spin::Never => Duration::ZERO,
            Spin::Budgeted => self.lead.min(self.budget),
            Spin::Always => self.lead.max(AMPLE_LEAD),
        };
        let sleep = deadline.since(now).saturating_sub(lead);
        self.last = (now, sleep.is_zero());
        self.alarm = (!sleep.is_zero()).then(|| now + sleep);
        sleep
    }

    /// Estimates when the event happened that woke the thread at `now`, if it slept since `before`. A wake-up is
    /// about as late as an alarm.
    pub(crate) fn event_at(&self, before: Timestamp, now: Timestamp) -> Timestamp {
        before.max(now - self.lead)
    }

    /// Records that the thread woke, by its alarm or by an event.
    pub(crate) fn woke(&mut self, now: Timestamp, by_alarm: bool) {
        let Some(alarm) = self.alarm.take().filter(|_| by_alarm) else { return };
        self.lead = if now.since(alarm) > self.lead {
            (self.lead + STEP * 3).min(MOST_LEAD)
        } else {
            self.lead.saturating_sub(STEP)
        };
    }
}

/// Whether a core may spin without taking it from the programs whose packets the thread carries.
pub(crate) fn can_spare_a_core() -> bool {
    thread::available_parallelism().is_ok_and(|cores| cores.get() > 2)
}

/// Asks the kernel to run the calling thread as soon as it wakes, and to wake it on time. Meant for the fabric's
/// thread and for those that stamp arriving packets. Such a thread should work for microseconds at a time.
pub fn be_punctual() {
    // Each of these may be forbidden. The run report's lateness shows the effect, and `doctor` the remedy.
    if sys::set_least_timer_slack().is_err() {
        tracing::debug!("timer slack cannot be reduced");
    }
    if sys::set_fifo(PRIORITY).is_err() && sys::set_short_slice().is_err() {
        tracing::debug!("the fabric's thread is scheduled like any other");
    }
}

/// Asks the kernel to run the calling thread before ordinary threads, but after [punctual](be_punctual) ones. Meant
/// for threads that steer robots: they work for milliseconds at a time, and a robot stops without them.
pub fn be_timely() {
    if sys::set_fifo(LOWEST).is_err() && sys::set_short_slice().is_err() {
        tracing::debug!("the calling thread is scheduled like any other");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn after_alarms_late_by(late: Duration, count: usize, busy_poll: BusyPoll) -> (Punctuality, Timestamp) {
        let mut punctuality = Punctuality { spin: Spin::Budgeted, ..Punctuality::new(busy_poll) };
        let mut now = Timestamp::ZERO;
        for _ in 0..count {
            now = now + punctuality.sleep(now, now + SECOND) + late;
            punctuality.woke(now, true);
        }
        (punctuality, now)
    }

    #[test]
    fn alarms_are_set_earlier_by_their_lateness() {
        let late = Duration::from_micros(40);
        let (mut punctuality, now) = after_alarms_late_by(late, 200, BusyPoll::Auto);
        let sleep = punctuality.sleep(now, now + SECOND);
        assert!((SECOND - sleep).abs_diff(late) <= STEP * 3, "{sleep:?}");
    }

    #[test]
    fn spinning_is_limited_by_its_budget() {
        let (mut punctuality, mut now) = after_alarms_late_by(Duration::from_micros(40), 200, BusyPoll::Auto);
        let tick = Duration::from_micros(1);
        let begin = now;
        while punctuality.sleep(now, now + tick).is_zero() {
            now = now + tick;
        }
        let spun = now.since(begin);
        assert!(spun >= MOST_BUDGET && spun <= MOST_BUDGET * 2, "{spun:?}");
        now = now + punctuality.sleep(now, now + SECOND);
        assert!(punctuality.sleep(now, now + tick).is_zero());
    }

    #[test]
    fn threads_that_never_spin_sleep_until_the_deadline() {
        let mut punctuality = Punctuality::new(BusyPoll::Never);
        assert_eq!(punctuality.sleep(Timestamp::ZERO, Timestamp::ZERO + SECOND), SECOND);
    }
}
