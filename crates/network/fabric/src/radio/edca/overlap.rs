//! Frames that overlap. Each span of time of a frame has the noise of those that are on the air in it, so that an A-MPDU loses
//! the frames that were disturbed and keeps the others.

use cotorra_graph::{Dbm, Timestamp};

use super::Emitter;
use crate::radio::{Path, Radio, phy::Reception};

/// Power above all others together from which a receiver drops a frame that it receives for one that begins later
/// (Santhapuri et al., Message in message, HotNets 2008; Lee et al., An experimental study on the capture effect in 802.11a
/// networks, WiNTECH 2007).
const RESTART_DB: f64 = 10.0;

/// Time in which another one sends, too.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlap {
    pub(super) emitter: Emitter,
    /// Start and end of what both have in common.
    pub(super) span: [Timestamp; 2],
    /// Start of the other's frame.
    pub(super) began: Timestamp,
}

/// A frame, with those that overlap with it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlapped<'a> {
    pub(super) emitter: Emitter,
    /// Start and end of its data.
    pub(super) span: [Timestamp; 2],
    pub(super) overlaps: &'a [Overlap],
}

/// A span of a frame, and its quality there; `None` if the receiver does not listen to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part<Q> {
    pub(super) span: [Timestamp; 2],
    pub(super) quality: Option<Q>,
}

impl<Q> Part<Q> {
    fn map<R>(self, map: impl Fn(Q) -> R) -> Part<R> {
        Part { span: self.span, quality: self.quality.map(map) }
    }
}

/// Returns the probability that what was sent in a span is lost. `of` is the same if all of it had one quality. The parts of a
/// frame are independent, and each has the bits of its share of the time.
pub(super) fn error_rate<Q>(parts: &[Part<Q>], [from, to]: [Timestamp; 2], of: impl Fn(&Q) -> f64) -> f64 {
    let mut received = 1.0;
    for Part { span: [start, end], quality } in parts {
        let share = (*end).min(to).since((*start).max(from)).as_secs_f64() / to.since(from).as_secs_f64();
        match quality {
            _ if share == 0.0 => {}
            Some(quality) if share == 1.0 => return of(quality),
            Some(quality) => received *= (1.0 - of(quality)).powf(share),
            None => return 1.0,
        }
    }
    1.0 - received
}

impl Radio {
    /// Returns the parts of a frame that overlaps with others, with the signal-to-noise ratio at a receiver in each, dB. `signal`
    /// is its power there.
    pub(super) fn ratios(&self, sent: Overlapped<'_>, receiver: Emitter, signal: Dbm) -> Vec<Part<f64>> {
        let spec = &self.networks[self.network_of(receiver)].spec;
        let mut cuts = sent.span.to_vec();
        cuts.extend(sent.overlaps.iter().flat_map(|overlap| overlap.span));
        cuts.sort_unstable();
        cuts.dedup();
        let power = |overlap: &Overlap| self.power(overlap.emitter, receiver);
        let mut listens = !sent.overlaps.iter().any(|other| self.is_locked(sent, receiver, signal, other));
        let spans = cuts.windows(2).map(|ends| [ends[0], ends[1]]);
        spans
            .map(|span| {
                let here = |overlap: &&Overlap| overlap.span[0] <= span[0] && span[1] <= overlap.span[1];
                let others = || sent.overlaps.iter().filter(here);
                // A receiver that sends, or has turned to a frame that is far stronger, does not come back to this one.
                listens &= others().all(|other| {
                    let turns = other.began > sent.span[0]
                        && self.is_wifi(other.emitter)
                        && power(other).0 >= signal.0 + RESTART_DB;
                    other.emitter != receiver && !turns
                });
                let disturbing: f64 = others().map(|other| power(other).milliwatts()).sum();
                let noise_db = 10.0 * (spec.noise().milliwatts() + disturbing).log10();
                Part { span, quality: listens.then_some(signal.0 - noise_db) }
            })
            .collect()
    }

    /// Whether a receiver stays with another frame, which it had begun to receive before.
    fn is_locked(&self, sent: Overlapped<'_>, receiver: Emitter, signal: Dbm, other: &Overlap) -> bool {
        let power = self.power(other.emitter, receiver);
        other.began < sent.span[0]
            && self.is_wifi(other.emitter)
            && power >= self.networks[self.network_of(receiver)].sensitivity
            && signal.0 < power.0 + RESTART_DB
    }

    /// Returns the parts of a frame on a path, with what the receiver makes of each. The header of a frame that is disturbed
    /// may be lost, and the frame with it: then there is none.
    pub(super) fn parts_of(&mut self, sent: Overlapped<'_>, path: Path) -> Vec<Part<Reception>> {
        let Overlapped { span, .. } = sent;
        if sent.overlaps.is_empty() {
            return vec![Part { span, quality: Some(self.reception(span[0], path)) }];
        }
        let place = self.robots[path.robot].position;
        let moment = self.link(path.robot, path.unit).moment(span[0], place);
        let fading_db = self.fading_db(path, moment);
        let signal = self.signals(path.robot, path.unit)[path.direction as usize];
        let phy = self.phy_of(sent.emitter);
        let ratios = self.ratios(sent, path.receiver(), Dbm(signal.0 + fading_db));
        let parts: Vec<_> =
            ratios.into_iter().map(|part| part.map(|snr_db| Reception::new(phy, snr_db))).collect();
        let header = [span[0], (span[0] + phy.preamble()).min(span[1])];
        let lost = error_rate(&parts, header, Reception::header_error_rate);
        if self.lane(path).receives(lost) { parts } else { Vec::from([Part { span, quality: None }]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(us: u64) -> Timestamp {
        Timestamp::from_nanos(us * 1000)
    }

    #[test]
    fn each_part_of_a_frame_has_its_own_errors() {
        let part = |span: [u64; 2], quality| Part { span: span.map(at), quality };
        let parts = [part([0, 100], Some(0.0)), part([100, 300], Some(0.5)), part([300, 400], None)];
        let rate = |from, to| error_rate(&parts, [at(from), at(to)], |lost| *lost);
        assert_eq!(rate(0, 100), 0.0);
        assert_eq!(rate(120, 200), 0.5);
        assert_eq!(rate(250, 310), 1.0);
        // A quarter of it has the errors of the second part.
        assert!((rate(70, 110) - (1.0 - 0.5_f64.powf(0.25))).abs() < 1e-12);
    }
}
