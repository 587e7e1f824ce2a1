//! Others on the channel: stations of other networks, which contend, and devices that send without listening. Both come
//! and go.

use std::time::Duration;

use cotorra_graph::{Dbm, Interferer, InterfererKind, Position, Timestamp};
use cotorra_numbers::Draws;

use super::{backoff::Backoff, category::Category};

/// Frames of another network that wait at most; more do not come until some are sent.
const MOST_WAITING: u32 = 64;
/// Its airtime of one contention, at most: what waits goes together, as A-MPDU.
const LONGEST: Duration = super::transmission::LONGEST_AGGREGATE;

/// A source of interference.
#[derive(Debug)]
pub(in crate::radio) struct Interference {
    spec: Interferer,
    network: usize,
    channel: usize,
    frequency_mhz: u16,
    /// Whether it is there now, and when that changes.
    present: bool,
    changes: Timestamp,
    source: Source,
    rng: Draws,
}

#[derive(Debug)]
enum Source {
    /// Frames of the same airtime that come at random times: the airtime that waits, and what of it is on the air.
    Network { backoff: Backoff, waiting: Duration, on_air: Duration, next: Timestamp },
    /// The start of the next pulse.
    Device { next: Timestamp },
}

impl Interference {
    /// Creates a source on a channel, which radio units of a network, or of several, share.
    pub(in crate::radio) fn new(
        spec: &Interferer,
        [network, channel]: [usize; 2],
        frequency_mhz: u16,
        sifs: Duration,
        seed: u64,
    ) -> Self {
        let label = format!("interference {}", spec.name);
        let mut rng = Draws::new(seed, &label);
        let source = match spec.kind {
            InterfererKind::Network { .. } => {
                let rng = Draws::new(seed, &format!("backoff {label}"));
                let backoff = Backoff::new(Category::BestEffort.of_station(), sifs, rng);
                Source::Network {
                    backoff,
                    waiting: Duration::ZERO,
                    on_air: Duration::ZERO,
                    next: Timestamp::ZERO,
                }
            }
            InterfererKind::Device { on, off } => {
                Source::Device { next: Timestamp::ZERO + (on + off).mul_f64(rng.unit()) }
            }
        };
        let mut interference = Self {
            present: true,
            changes: Timestamp::MAX,
            spec: spec.clone(),
            network,
            channel,
            frequency_mhz,
            source,
            rng,
        };
        if let Some(presence) = spec.presence {
            let (on, off) = (presence.on.as_secs_f64(), presence.off.as_secs_f64());
            interference.present = interference.rng.unit() < on / (on + off);
            interference.changes = interference.next_change(Timestamp::ZERO);
        }
        if let Source::Network { .. } = interference.source {
            let first = interference.next_frame(Timestamp::ZERO);
            if let Source::Network { next, .. } = &mut interference.source {
                *next = first;
            }
        }
        interference
    }

    pub(super) fn channel(&self) -> usize {
        self.channel
    }

    pub(super) fn network(&self) -> usize {
        self.network
    }

    pub(super) fn frequency_mhz(&self) -> u16 {
        self.frequency_mhz
    }

    pub(super) fn position(&self) -> Position {
        self.spec.position
    }

    pub(super) fn tx_power(&self) -> Dbm {
        self.spec.tx_power
    }

    /// Whether stations recognise its frames, and wait for them even if they are weak.
    pub(super) fn is_wifi(&self) -> bool {
        matches!(self.source, Source::Network { .. })
    }

    /// Returns when it changes or sends next.
    pub(super) fn deadline(&self) -> Timestamp {
        let sends = match &self.source {
            Source::Network { backoff, waiting, next, .. } if !waiting.is_zero() => {
                (*next).min(backoff.access())
            }
            Source::Network { next, .. } | Source::Device { next } => *next,
        };
        sends.min(self.changes)
    }

    /// Advances to `now`. Returns the airtime of what it sends now.
    pub(super) fn sends(&mut self, now: Timestamp) -> Option<Duration> {
        while self.changes <= now {
            self.present = !self.present;
            self.changes = self.next_change(self.changes);
        }
        match (self.spec.kind, &mut self.source) {
            (InterfererKind::Network { airtime, .. }, Source::Network { .. }) => {
                self.frames(now, airtime);
                let Source::Network { backoff, waiting, on_air, .. } = &mut self.source else { return None };
                if waiting.is_zero() || backoff.access() > now {
                    return None;
                }
                *on_air = (*waiting).min(LONGEST.max(airtime));
                Some(*on_air)
            }
            (InterfererKind::Device { on, off }, Source::Device { next }) if *next <= now => {
                *next = *next + on + off;
                self.present.then_some(on)
            }
            _ => None,
        }
    }

    /// Queues the frames that have come by `now`.
    fn frames(&mut self, now: Timestamp, airtime: Duration) {
        loop {
            let Source::Network { backoff, waiting, next, .. } = &mut self.source else { return };
            if *next > now {
                return;
            }
            let came = *next;
            if self.present && *waiting < MOST_WAITING * airtime {
                if waiting.is_zero() {
                    backoff.wake(came);
                }
                *waiting += airtime;
            }
            let following = self.next_frame(came);
            if let Source::Network { next, .. } = &mut self.source {
                *next = following;
            }
        }
    }

    /// Records the end of what was on the air, of which this was disturbed, and goes again.
    pub(super) fn sent(&mut self, disturbed: Duration) {
        if let Source::Network { backoff, waiting, on_air, .. } = &mut self.source {
            let done = on_air.saturating_sub(disturbed);
            *waiting = waiting.saturating_sub(done);
            if done.is_zero() { backoff.double() } else { backoff.reset() }
        }
    }

    /// Senses a transmission.
    pub(super) fn pause(&mut self, now: Timestamp, until: Timestamp) {
        if let Source::Network { backoff, .. } = &mut self.source {
            backoff.pause(now, until);
        }
    }

    /// Returns the time of the next frame: exponential intervals, so that frames fill the load's share of the time.
    fn next_frame(&mut self, now: Timestamp) -> Timestamp {
        let InterfererKind::Network { load, airtime } = self.spec.kind else { return Timestamp::MAX };
        now + exponential(airtime.div_f64(load.get()), &mut self.rng)
    }

    fn next_change(&mut self, now: Timestamp) -> Timestamp {
        let Some(presence) = self.spec.presence else { return Timestamp::MAX };
        let mean = if self.present { presence.on } else { presence.off };
        now + exponential(mean, &mut self.rng)
    }
}

fn exponential(mean: Duration, rng: &mut Draws) -> Duration {
    mean.mul_f64(-(1.0 - rng.unit()).ln()).max(Duration::from_nanos(1))
}
