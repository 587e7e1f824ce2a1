//! The attachment of one station: which radio unit it is with, and what it does when it is off the channel. A state
//! machine that is told the time and says when it wants to hear it again.

use std::time::Duration;

use cotorra_graph::{HandoverTimes, Timestamp, WirelessNetwork};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::RadioUnitIndex;
use crate::random::unit;

/// What a scan is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To know the signals.
    Look,
    /// To join the strongest radio unit, if it is another one.
    Roam,
    /// A handover that was asked for while the scan ran.
    Attach(RadioUnitIndex),
}

/// What a station does off its channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Scan(Purpose),
    Authenticate(RadioUnitIndex),
    Reassociate(RadioUnitIndex),
    Handshake(RadioUnitIndex),
}

/// A time off the channel.
#[derive(Debug, Clone, Copy)]
struct Absence {
    since: Timestamp,
    phase: Phase,
    ends: Timestamp,
}

/// What the end of a phase brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// The next phase has begun.
    Underway,
    /// All channels were scanned; the station is back, or goes on to attach.
    Scanned,
    /// The station is with another radio unit now.
    Attached(Joined),
}

/// A finished handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Joined {
    pub(super) from: Option<RadioUnitIndex>,
    pub(super) to: RadioUnitIndex,
    pub(super) fast: bool,
    /// Since the station left its channel.
    pub(super) gap: Duration,
}

/// A station does one thing at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Busy {
    Scanning,
    HandingOver(RadioUnitIndex),
}

/// A station's attachment.
///
/// A handover is authentication and reassociation (IEEE 802.11-2020, 11.3), followed by the key handshakes (12.7.6)
/// unless it is a fast transition (13.5). Fast transition needs a radio unit to come from (13.4): who lost theirs does
/// the handshakes again. The station is with its former radio unit until the last phase ends.
#[derive(Debug)]
pub(super) struct Station {
    attached: Option<RadioUnitIndex>,
    absence: Option<Absence>,
    times: HandoverTimes,
    fast_transition: bool,
    rng: Xoshiro256PlusPlus,
}

impl Station {
    /// A station with no radio unit.
    pub(super) fn new(network: &WirelessNetwork, rng: Xoshiro256PlusPlus) -> Self {
        Self {
            attached: None,
            absence: None,
            times: network.handover,
            fast_transition: network.fast_transition,
            rng,
        }
    }

    /// It has been with a radio unit since before the run.
    pub(super) fn begin_attached(&mut self, to: RadioUnitIndex) {
        self.attached = Some(to);
    }

    /// The radio unit that it is with, be it on the channel or off.
    pub(super) fn attached(&self) -> Option<RadioUnitIndex> {
        self.attached
    }

    /// The radio unit that it can exchange frames with now.
    pub(super) fn on_channel(&self) -> Option<RadioUnitIndex> {
        if self.absence.is_none() { self.attached } else { None }
    }

    /// Whether it scans or hands over.
    pub(super) fn is_away(&self) -> bool {
        self.absence.is_some()
    }

    /// Whether it scans.
    pub(super) fn is_scanning(&self) -> bool {
        self.absence.is_some_and(|a| matches!(a.phase, Phase::Scan(_)))
    }

    /// When [`Self::expire`] is due.
    pub(super) fn deadline(&self) -> Option<Timestamp> {
        self.absence.map(|a| a.ends)
    }

    fn busy(&self) -> Option<Busy> {
        self.absence.map(|a| match a.phase {
            Phase::Scan(Purpose::Look | Purpose::Roam) => Busy::Scanning,
            Phase::Scan(Purpose::Attach(to))
            | Phase::Authenticate(to)
            | Phase::Reassociate(to)
            | Phase::Handshake(to) => Busy::HandingOver(to),
        })
    }

    /// Leaves the channel to scan.
    pub(super) fn scan(&mut self, now: Timestamp, purpose: Purpose) -> Result<(), Busy> {
        if let Some(busy) = self.busy() {
            return Err(busy);
        }
        self.begin(now, now, Phase::Scan(purpose));
        Ok(())
    }

    /// Leaves the channel for another radio unit; at the end of the scan if one is under way. Nothing happens where
    /// the station is with that radio unit already, or on its way there.
    pub(super) fn attach(&mut self, now: Timestamp, to: RadioUnitIndex) -> Result<(), Busy> {
        match self.busy() {
            Some(Busy::HandingOver(underway)) if underway == to => Ok(()),
            Some(busy @ Busy::HandingOver(_)) => Err(busy),
            Some(Busy::Scanning) => {
                let absence = self.absence.as_mut().expect("a station that scans is absent");
                let purpose = if self.attached == Some(to) { Purpose::Look } else { Purpose::Attach(to) };
                absence.phase = Phase::Scan(purpose);
                Ok(())
            }
            None if self.attached == Some(to) => Ok(()),
            None => {
                self.begin(now, now, Phase::Authenticate(to));
                Ok(())
            }
        }
    }

    /// Loses its radio unit, and says which; only on the channel does it notice.
    pub(super) fn detach(&mut self) -> Option<RadioUnitIndex> {
        if self.is_away() { None } else { self.attached.take() }
    }

    /// The phase under way has come to its end. `strongest` is what a scan found.
    pub(super) fn expire(&mut self, strongest: Option<RadioUnitIndex>) -> Step {
        let Some(Absence { since, phase, ends }) = self.absence.take() else { return Step::Underway };
        match phase {
            Phase::Scan(purpose) => {
                let to = match purpose {
                    Purpose::Look => None,
                    Purpose::Attach(to) => Some(to),
                    Purpose::Roam => strongest,
                };
                if let Some(to) = to.filter(|to| self.attached != Some(*to)) {
                    self.begin(since, ends, Phase::Authenticate(to));
                }
                Step::Scanned
            }
            Phase::Authenticate(to) => {
                self.begin(since, ends, Phase::Reassociate(to));
                Step::Underway
            }
            Phase::Reassociate(to) if !self.is_fast() => {
                self.begin(since, ends, Phase::Handshake(to));
                Step::Underway
            }
            Phase::Reassociate(to) | Phase::Handshake(to) => {
                let fast = self.is_fast();
                let from = self.attached.replace(to);
                Step::Attached(Joined { from, to, fast, gap: ends.since(since) })
            }
        }
    }

    fn is_fast(&self) -> bool {
        self.fast_transition && self.attached.is_some()
    }

    fn begin(&mut self, since: Timestamp, now: Timestamp, phase: Phase) {
        let mean = match phase {
            Phase::Scan(_) => self.times.scan,
            Phase::Authenticate(_) => self.times.authenticate,
            Phase::Reassociate(_) => self.times.reassociate,
            Phase::Handshake(_) => self.times.handshake,
        };
        let ends = now + self.vary(mean);
        self.absence = Some(Absence { since, phase, ends });
    }

    fn vary(&mut self, mean: Duration) -> Duration {
        let u = 2.0 * unit(&mut self.rng) - 1.0;
        if self.times.variation == 0.0 {
            mean
        } else {
            mean.mul_f64((1.0 + u * self.times.variation).max(0.0))
        }
    }
}
