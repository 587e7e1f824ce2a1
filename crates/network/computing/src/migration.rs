//! A move of a VNF with its state: what is copied in which round, and when the VNF stops.

use std::time::Duration;

use cotorra_graph::{PreCopy, StateTransfer, Timestamp, TransferMethod};

/// A move of a VNF with its state, as a state machine.
///
/// [`Self::poll`] returns the bytes of the next copy. [`Self::copied`] takes its end, and [`Self::started`] the start of the
/// instance that takes over. That one serves once the migration [is done](Self::is_done), and the former one
/// [until it stops](Self::has_stopped).
///
/// A pre-copy is that of Clark et al., "Live Migration of Virtual Machines" (NSDI 2005).
#[derive(Debug, Clone)]
pub struct Migration {
    bytes: u64,
    pre_copy: Option<PreCopy>,
    began: Timestamp,
    has_started: bool,
    phase: Phase,
    /// Bytes of a copy to begin.
    next: Option<u64>,
    /// Rounds that ended while the former instance served.
    rounds: u32,
    stopped: Option<Timestamp>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The former instance serves, and a round is copied.
    Round {
        bytes: u64,
        since: Timestamp,
    },
    /// The former instance serves until the new one has started. The last round took so long.
    Converged {
        bytes: u64,
        since: Timestamp,
        took: Duration,
    },
    /// The former instance has stopped, and the rest is copied.
    Rest,
    /// The state has come, and the new instance has not started.
    Arrived,
    Done(Timestamp),
}

/// Figures of a migration up to a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MigrationFigures {
    /// Rounds of copies while the former instance served.
    pub rounds: u32,
    /// Time from the begin until the new instance serves.
    pub duration: Duration,
    /// Time in which neither instance serves.
    pub downtime: Duration,
}

impl Migration {
    /// Begins a migration.
    pub fn new(now: Timestamp, StateTransfer { bytes, method }: StateTransfer) -> Self {
        let mut migration = Self {
            bytes,
            pre_copy: None,
            began: now,
            has_started: false,
            phase: Phase::Rest,
            next: None,
            rounds: 0,
            stopped: None,
        };
        match method {
            TransferMethod::StopAndCopy => migration.stop(now, bytes),
            TransferMethod::PreCopy(pre_copy) => {
                migration.pre_copy = Some(pre_copy);
                migration.round(now, bytes);
            }
        }
        migration
    }

    /// Returns the bytes of the next copy, once. There is one at a time.
    pub fn poll(&mut self) -> Option<u64> {
        self.next.take()
    }

    /// Takes the arrival of the last copy's last byte.
    pub fn copied(&mut self, now: Timestamp) {
        match self.phase {
            Phase::Round { bytes, since } => {
                self.rounds += 1;
                self.decide(now, bytes, since, now.since(since));
            }
            Phase::Rest => {
                self.phase = Phase::Arrived;
                self.finish(now);
            }
            Phase::Converged { .. } | Phase::Arrived | Phase::Done(_) => {}
        }
    }

    /// Takes the start of the new instance.
    pub fn started(&mut self, now: Timestamp) {
        self.has_started = true;
        match self.phase {
            Phase::Converged { bytes, since, took } => self.decide(now, bytes, since, took),
            _ => self.finish(now),
        }
    }

    /// Whether the new instance has started. It may still wait for the state.
    pub fn has_started(&self) -> bool {
        self.has_started
    }

    /// Whether the former instance serves no more.
    pub fn has_stopped(&self) -> bool {
        self.stopped.is_some()
    }

    /// Whether the new instance serves with the state.
    pub fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done(_))
    }

    /// Returns its figures, up to now unless it is done.
    pub fn figures(&self, now: Timestamp) -> MigrationFigures {
        let end = if let Phase::Done(at) = self.phase { at } else { now };
        MigrationFigures {
            rounds: self.rounds,
            duration: end.since(self.began),
            downtime: self.stopped.map_or(Duration::ZERO, |stopped| end.since(stopped)),
        }
    }

    /// Goes on after a round of so many bytes, which began at `since` and took so long.
    fn decide(&mut self, now: Timestamp, bytes: u64, since: Timestamp, took: Duration) {
        let Some(PreCopy { downtime, rounds, .. }) = self.pre_copy else { return };
        let rest = self.changed(now.since(since));
        let takes_no_longer = u128::from(rest) * took.as_nanos() <= u128::from(bytes) * downtime.as_nanos();
        if !takes_no_longer && self.rounds < rounds {
            self.round(now, rest);
        } else if self.has_started {
            self.stop(now, rest);
        } else {
            self.phase = Phase::Converged { bytes, since, took };
        }
    }

    /// Returns the bytes that change in a time.
    fn changed(&self, time: Duration) -> u64 {
        const BITS_AND_NANOS: u128 = 8 * 1_000_000_000;
        let rate = self.pre_copy.map_or(0, |pre_copy| pre_copy.dirty_rate.bits_per_second());
        let changed = (u128::from(rate) * time.as_nanos()).div_ceil(BITS_AND_NANOS);
        changed.min(self.bytes.into()) as u64
    }

    fn round(&mut self, now: Timestamp, bytes: u64) {
        self.phase = Phase::Round { bytes, since: now };
        self.copy(now, bytes);
    }

    /// Stops the former instance, and copies the rest.
    fn stop(&mut self, now: Timestamp, rest: u64) {
        self.stopped = Some(now);
        self.phase = Phase::Rest;
        self.copy(now, rest);
    }

    fn copy(&mut self, now: Timestamp, bytes: u64) {
        match bytes {
            0 => self.copied(now),
            _ => self.next = Some(bytes),
        }
    }

    fn finish(&mut self, now: Timestamp) {
        if self.phase == Phase::Arrived && self.has_started {
            self.phase = Phase::Done(now);
        }
    }
}

#[cfg(test)]
mod tests;
