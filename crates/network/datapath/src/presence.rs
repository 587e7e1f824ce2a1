//! Accounts for the time in which the fabric's thread looked at no port although it had not chosen to sleep: it waited for a
//! processor, or the process or the whole machine was stopped. Frames wait in their ports meanwhile, and a TAP does not tell
//! since when.

use std::{fs::File, os::unix::fs::FileExt, time::Duration};

use cotorra_fabric::Histogram;
use cotorra_graph::{Lateness, Timestamp};

/// Longest sleep between two looks. Nothing but a late alarm shows that the process was stopped, or the machine.
pub(crate) const LONGEST_SLEEP: Duration = Duration::from_millis(10);
/// Waits from here on are counted as absence.
const ABSENT: Duration = Duration::from_millis(1);
/// Waits within shorter sleeps are not looked up. They are within the verdict's limit of the median.
const SHORT: Duration = Duration::from_micros(250);
/// Interval of publication.
const PUBLISHED: Duration = Duration::from_millis(100);

/// Time in which the fabric's thread was away from its ports, of absences of a millisecond or more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Absence {
    /// Sum of all absences.
    pub total: Duration,
    /// The longest absence.
    pub longest: Duration,
    /// Time at which an arriving frame would have waited for more than a millisecond.
    pub late: Duration,
}

impl Absence {
    fn record(&mut self, away: Duration) {
        if away < ABSENT {
            return;
        }
        self.total += away;
        self.longest = self.longest.max(away);
        self.late += away - ABSENT;
    }
}

/// Waits of frames in the ports, and absences of the fabric's thread.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PortWaits {
    /// Time that frames waited in their ports before the fabric had them. If the port reports no time of arrival, this is
    /// the longest possible wait.
    pub frames: Lateness,
    pub absence: Absence,
}

/// Observes the looks of a thread at its ports. It has no clock. Call [`Self::sleeps`] and [`Self::woke`] in turn.
#[derive(Debug)]
pub(crate) struct Presence {
    /// End of the last wait.
    woke: Timestamp,
    /// Beginning of the present wait, and its alarm.
    sleeps: Timestamp,
    alarm: Timestamp,
    /// Time for which the thread waited for a processor so far, when it was last read.
    queued: (Timestamp, Option<Duration>),
    /// The longest possible wait of a frame that the last look found.
    wait: Duration,
    /// That of frames which an interrupted look did not find.
    unfound: Duration,
    frames: Histogram,
    absence: Absence,
    /// When the figures were last taken, and their absence.
    published: (Timestamp, Absence),
}

impl Presence {
    pub(crate) fn new(now: Timestamp) -> Self {
        Self {
            woke: now,
            sleeps: now,
            alarm: now,
            queued: (now, None),
            wait: Duration::ZERO,
            unfound: Duration::ZERO,
            frames: Histogram::default(),
            absence: Absence::default(),
            published: (now, Absence::default()),
        }
    }

    /// Records that the thread is about to wait for `sleep` at most. `queued` reads for how long it has waited for a processor
    /// so far; `None` if that is unknown.
    pub(crate) fn sleeps(
        &mut self,
        now: Timestamp,
        sleep: Duration,
        queued: impl FnOnce() -> Option<Duration>,
    ) {
        // At high rates, one reading in a while is enough.
        let is_stale = self.queued.1.is_none() || now.since(self.queued.0) > SHORT;
        if sleep > SHORT && is_stale {
            self.queued = (now, queued());
        }
        (self.sleeps, self.alarm) = (now, now + sleep);
    }

    /// Records that the wait has ended. An interrupted one may have been a stop of the process since it began.
    pub(crate) fn woke(
        &mut self,
        now: Timestamp,
        was_interrupted: bool,
        queued: impl FnOnce() -> Option<Duration>,
    ) {
        let slept = now.since(self.sleeps);
        let mut late = if was_interrupted { slept } else { now.since(self.alarm) };
        if slept > SHORT {
            let before = std::mem::replace(&mut self.queued, (now, queued()));
            let waited = self.queued.1.zip(before.1).map(|(now, before)| now.saturating_sub(before));
            late = late.max(waited.unwrap_or_default().min(slept));
        }
        let worked =
            Some(self.sleeps.since(self.woke)).filter(|worked| *worked >= ABSENT).unwrap_or_default();
        self.absence.record(worked);
        self.absence.record(late);
        self.wait = worked.max(late).max(self.unfound);
        // An interrupted wait finds nothing: the next look has its frames.
        self.unfound = if was_interrupted { self.wait } else { Duration::ZERO };
        self.woke = now;
    }

    /// Returns the longest possible wait of a frame that the last look found, at a port that does not report its time of
    /// arrival.
    pub(crate) fn wait(&self) -> Duration {
        self.wait
    }

    /// Records a frame that waited for so long in its port.
    pub(crate) fn found(&mut self, wait: Duration) {
        self.frames.record(wait);
    }

    /// Returns the figures if they are to be published at `now`.
    pub(crate) fn publish(&mut self, now: Timestamp) -> Option<PortWaits> {
        let (at, absence) = self.published;
        if absence == self.absence && now.since(at) < PUBLISHED {
            return None;
        }
        self.published = (now, self.absence);
        Some(self.waits())
    }

    pub(crate) fn waits(&self) -> PortWaits {
        PortWaits { frames: self.frames.summary(), absence: self.absence }
    }
}

/// The time for which a thread was ready to run and waited for a processor.
pub(crate) struct RunQueue(Option<File>);

impl RunQueue {
    /// Opens that of the calling thread, if this kernel counts it.
    pub(crate) fn of_this_thread() -> Self {
        let its = Self(File::open("/proc/thread-self/schedstat").ok());
        if its.waited().is_some() {
            return its;
        }
        tracing::info!("this kernel does not tell how long the fabric's thread waits for a processor");
        Self(None)
    }

    /// Returns the time so far.
    pub(crate) fn waited(&self) -> Option<Duration> {
        let mut text = [0; 64];
        let length = self.0.as_ref()?.read_at(&mut text, 0).ok()?;
        let mut fields = std::str::from_utf8(&text[..length]).ok()?.split_ascii_whitespace();
        let waited = fields.nth(1)?.parse().ok()?;
        // A thread that runs has run, unless the kernel does not count.
        let runs: u64 = fields.next()?.parse().ok()?;
        (runs > 0).then(|| Duration::from_nanos(waited))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    fn at(us: u64) -> Timestamp {
        Timestamp::from_nanos(us * 1000)
    }

    /// Waits from `from` for `sleep`, until `until`. The thread waits for a processor for `queued` of that.
    fn look(presence: &mut Presence, from: u64, sleep: Duration, until: u64, queued: Option<u64>) {
        presence.sleeps(at(from), sleep, || queued.map(|_| Duration::ZERO));
        presence.woke(at(until), false, || queued.map(us));
    }

    #[test]
    fn a_stop_is_an_absence_and_a_possible_wait_of_the_frames_behind_it() {
        let mut presence = Presence::new(at(0));
        look(&mut presence, 0, ms(10), 2_000_000, Some(0));
        (0..20).for_each(|_| presence.found(presence.wait()));
        let PortWaits { frames, absence } = presence.waits();
        assert_eq!((frames.frames, frames.max_us), (20, 1_990_000.0));
        assert_eq!(absence, Absence { total: ms(1990), longest: ms(1990), late: ms(1989) });
    }

    #[test]
    fn an_interrupted_wait_may_have_been_a_stop_since_it_began() {
        let mut presence = Presence::new(at(0));
        presence.sleeps(at(0), ms(10), || None);
        presence.woke(at(8000), true, || None);
        assert_eq!(presence.waits().absence.longest, ms(8));
        // Only the next look finds the frames that waited.
        look(&mut presence, 8000, ms(10), 8010, None);
        assert_eq!((presence.wait(), presence.waits().absence.total), (ms(8), ms(8)));
        look(&mut presence, 8020, ms(10), 8030, None);
        assert_eq!(presence.wait(), Duration::ZERO);
    }

    #[test]
    fn frames_wait_while_the_thread_that_they_woke_waits_for_a_processor() {
        let mut presence = Presence::new(at(0));
        look(&mut presence, 0, ms(10), 5000, Some(4200));
        presence.found(presence.wait());
        assert_eq!(presence.waits().frames.max_us, 4200.0);
        assert_eq!(presence.waits().absence.late, us(3200));
        // The wait is no longer than the sleep, whatever was not looked up before.
        look(&mut presence, 5000, ms(10), 5400, Some(9000));
        assert_eq!(presence.wait, us(400));
    }

    #[test]
    fn sleep_that_the_thread_chose_is_no_absence() {
        let mut presence = Presence::new(at(0));
        for look_at in (0..100).map(|n| n * 10_050) {
            look(&mut presence, look_at, ms(10), look_at + 10_050, Some(30));
            presence.found(presence.wait());
        }
        let PortWaits { frames, absence } = presence.waits();
        assert_eq!((frames.max_us, absence), (50.0, Absence::default()));
    }

    #[test]
    fn work_of_less_than_a_millisecond_between_two_looks_is_the_fabrics_own() {
        let mut presence = Presence::new(at(0));
        look(&mut presence, 900, ms(1), 901, None);
        presence.found(presence.wait());
        assert_eq!(presence.waits().frames.max_us, 0.0);
        look(&mut presence, 20_901, ms(1), 20_902, None);
        presence.found(presence.wait());
        assert_eq!((presence.waits().frames.max_us, presence.waits().absence.longest), (20_000.0, ms(20)));
    }

    #[test]
    fn waits_for_a_processor_are_read_at_a_bounded_rate() {
        let mut presence = Presence::new(at(0));
        let reads = std::cell::Cell::new(0);
        let read = || {
            reads.set(reads.get() + 1);
            Some(Duration::ZERO)
        };
        for now in (0..10_000).step_by(10) {
            presence.sleeps(at(now), ms(10), read);
            presence.woke(at(now + 5), false, read);
        }
        assert!(reads.get() <= 10_000 / 250, "{}", reads.get());
    }

    #[test]
    fn figures_are_published_after_an_absence_and_now_and_then() {
        let mut presence = Presence::new(at(0));
        look(&mut presence, 0, ms(100), 50_000, None);
        assert_eq!(presence.publish(at(50_000)), None);
        look(&mut presence, 50_000, ms(100), 100_000, None);
        assert!(presence.publish(at(100_000)).is_some());
        look(&mut presence, 100_000, ms(1), 103_000, None);
        assert_eq!(presence.publish(at(103_000)).unwrap().absence.longest, ms(2));
        assert_eq!(presence.publish(at(104_000)), None);
    }

    #[test]
    fn the_kernel_tells_how_long_a_thread_waits_or_nothing() {
        let queue = RunQueue::of_this_thread();
        let before = queue.waited();
        assert!(queue.waited() >= before);
    }
}
