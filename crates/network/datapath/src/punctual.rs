//! When the fabric's thread sleeps and when it spins. A sleeping thread wakes late, by an amount that is the
//! machine's and is much the same each time: so it is measured, the alarm is set earlier by as much, and the rest is
//! spun away. What that takes from others is bounded.

use std::{thread, time::Duration};

use cotorra_graph::Timestamp;

use crate::sys;

/// Whether the fabric's thread spins just before a deadline instead of sleeping up to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BusyPoll {
    /// On a machine with more than two cores as long as need be, else for at most a tenth of the time.
    #[default]
    Auto,
    /// Whatever it takes from others.
    Always,
    /// Never.
    Never,
}

/// Priority of the fabric's thread: above everything that is not real-time, below what the kernel itself runs so.
const PRIORITY: i32 = 10;
/// The least urgent that is real time.
const LOWEST: i32 = 1;
/// No machine should wake later than this by itself; one that does was kept busy by others.
const MOST_LEAD: Duration = Duration::from_micros(100);
/// Lead where a core is spare: about what one takes to wake from its deepest sleep.
const AMPLE_LEAD: Duration = Duration::from_micros(70);
/// By how much an alarm that came on time shortens the lead. One that came late lengthens it by three times as much,
/// so that three in four come on time, and one that came very late counts no more than any other.
const STEP: Duration = Duration::from_nanos(500);
/// One in so many nanoseconds may be spun where no core is spare.
const BUDGET_SHARE: u32 = 10;
/// What may be saved up of it.
const MOST_BUDGET: Duration = Duration::from_millis(5);

/// Decides how long to sleep.
#[derive(Debug)]
pub(crate) struct Punctuality {
    spin: Spin,
    /// How much earlier the alarm has to be set.
    lead: Duration,
    /// For when it is set.
    alarm: Option<Timestamp>,
    budget: Duration,
    /// When it was last asked, and whether it said to spin.
    asked: (Timestamp, bool),
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
        Self { spin, lead: Duration::ZERO, alarm: None, budget: MOST_BUDGET, asked: (Timestamp::ZERO, false) }
    }

    /// How long to sleep at `now` for the sake of a deadline: not at all means to look again at once.
    pub(crate) fn sleep(&mut self, now: Timestamp, deadline: Timestamp) -> Duration {
        let passed = now.since(self.asked.0);
        let spun = if self.asked.1 { passed } else { Duration::ZERO };
        self.budget = (self.budget + passed / BUDGET_SHARE).saturating_sub(spun).min(MOST_BUDGET);
        let lead = match self.spin {
            Spin::Never => Duration::ZERO,
            Spin::Budgeted => self.lead.min(self.budget),
            Spin::Always => self.lead.max(AMPLE_LEAD),
        };
        let sleep = deadline.since(now).saturating_sub(lead);
        self.asked = (now, sleep.is_zero());
        self.alarm = (!sleep.is_zero()).then(|| now + sleep);
        sleep
    }

    /// When that happened which woke the thread at `now`, if it slept since `before`: about as long ago as an alarm is
    /// late.
    pub(crate) fn event_at(&self, before: Timestamp, now: Timestamp) -> Timestamp {
        before.max(now - self.lead)
    }

    /// The thread is awake, by its alarm or by something else.
    pub(crate) fn woke(&mut self, now: Timestamp, by_alarm: bool) {
        let Some(alarm) = self.alarm.take().filter(|_| by_alarm) else { return };
        self.lead = if now.since(alarm) > self.lead {
            (self.lead + STEP * 3).min(MOST_LEAD)
        } else {
            self.lead.saturating_sub(STEP)
        };
    }
}

/// Whether a core may spin without taking it from those whose packets the thread carries.
pub(crate) fn can_spare_a_core() -> bool {
    thread::available_parallelism().is_ok_and(|cores| cores.get() > 2)
}

/// Asks the kernel to run the calling thread as soon as it wakes, and to wake it on time: for the fabric's thread, and
/// for those that note when packets arrive. Such a thread should work for microseconds at a time.
pub fn be_punctual() {
    // Each of these may be forbidden; the run report's lateness shows what it cost, and `doctor` what to do.
    if sys::set_least_timer_slack().is_err() {
        tracing::debug!("timers keep their slack");
    }
    if sys::set_fifo(PRIORITY).is_err() && sys::set_short_slice().is_err() {
        tracing::debug!("the fabric's thread is scheduled like any other");
    }
}

/// Asks the kernel to run the calling thread before all that is not urgent, but after those that are [punctual](be_punctual): for
/// what steers robots, which works for milliseconds at a time, and which a robot stops without.
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
    fn alarms_are_set_earlier_by_as_much_as_they_come_late() {
        let late = Duration::from_micros(40);
        let (mut punctuality, now) = after_alarms_late_by(late, 200, BusyPoll::Auto);
        let sleep = punctuality.sleep(now, now + SECOND);
        assert!((SECOND - sleep).abs_diff(late) <= STEP * 3, "{sleep:?}");
    }

    #[test]
    fn spinning_ends_with_its_budget_and_comes_back_with_it() {
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
    fn who_never_spins_sleeps_up_to_the_deadline() {
        let mut punctuality = Punctuality::new(BusyPoll::Never);
        assert_eq!(punctuality.sleep(Timestamp::ZERO, Timestamp::ZERO + SECOND), SECOND);
    }
}
