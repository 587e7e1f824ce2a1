//! The attachment of one station, as a state machine: its radio unit, and the phases of scans and handovers off the
//! channel.

use std::time::Duration;

use cotorra_graph::{HandoverTimes, Timestamp, WirelessNetwork};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::port::RadioUnitIndex;
use crate::random::unit;

/// The purpose of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To update the signals.
    Look,
    /// To attach to the radio unit that the station chooses then, if it is another one.
    Roam,
    /// To attach to a radio unit, as requested during the scan.
    Attach(RadioUnitIndex),
}

/// The activity of a station off its channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Scan(Purpose),
    Authenticate(RadioUnitIndex),
    Reassociate(RadioUnitIndex),
    Handshake(RadioUnitIndex),
}

/// An absence from the channel.
#[derive(Debug, Clone, Copy)]
struct Absence {
    since: Timestamp,
    phase: Phase,
    ends: Timestamp,
}

/// The result of a finished phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// The next phase has begun.
    Underway,
    /// All channels were scanned. The station is back, or goes on to attach.
    Scanned,
    /// The station is attached to another radio unit now.
    Attached(Joined),
}

/// A finished handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Joined {
    pub(super) from: Option<RadioUnitIndex>,
    pub(super) to: RadioUnitIndex,
    pub(super) fast: bool,
    /// Time since the station left its channel.
    pub(super) gap: Duration,
}

/// The current activity, which rejects another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Busy {
    Scanning,
    HandingOver(RadioUnitIndex),
}

/// A station's attachment.
///
/// A handover is authentication and reassociation (IEEE 802.11-2020, 11.3), followed by the key handshakes (12.7.6)
/// unless it is a fast transition (13.5). A fast transition needs a former radio unit (13.4): a station that lost its own
/// does the handshakes again. The station stays attached to its former radio unit until the last phase ends.
#[derive(Debug)]
pub(super) struct Station {
    attached: Option<RadioUnitIndex>,
    absence: Option<Absence>,
    times: HandoverTimes,
    fast_transition: bool,
    rng: Xoshiro256PlusPlus,
}

impl Station {
    /// Creates a station without a radio unit.
    pub(super) fn new(network: &WirelessNetwork, rng: Xoshiro256PlusPlus) -> Self {
        Self {
            attached: None,
            absence: None,
            times: network.handover,
            fast_transition: network.fast_transition,
            rng,
        }
    }

    /// Attaches the station before the run begins.
    pub(super) fn begin_attached(&mut self, to: RadioUnitIndex) {
        self.attached = Some(to);
    }

    /// Returns its radio unit, on or off the channel.
    pub(super) fn attached(&self) -> Option<RadioUnitIndex> {
        self.attached
    }

    /// Returns the radio unit that it can exchange frames with now.
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

    /// Returns when [`Self::expire`] is due.
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

    /// Leaves the channel for another radio unit, after a current scan. Does nothing if the station is attached there, or
    /// about to be.
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

    /// Detaches from its radio unit and returns it. Off the channel, a station does not notice the loss.
    pub(super) fn detach(&mut self) -> Option<RadioUnitIndex> {
        if self.is_away() { None } else { self.attached.take() }
    }

    /// Returns the radio unit that it is being handed over to.
    pub(super) fn underway_to(&self) -> Option<RadioUnitIndex> {
        match self.busy() {
            Some(Busy::HandingOver(to)) => Some(to),
            Some(Busy::Scanning) | None => None,
        }
    }

    /// Ends the current phase. `chosen` is the result of a scan. `is_one_domain` says whether there is a former radio unit,
    /// here or at another core, and whether it is in one mobility domain with the next.
    pub(super) fn expire(&mut self, chosen: Option<RadioUnitIndex>, is_one_domain: bool) -> Step {
        let Some(Absence { since, phase, ends }) = self.absence.take() else { return Step::Underway };
        match phase {
            Phase::Scan(purpose) => {
                let to = match purpose {
                    Purpose::Look => None,
                    Purpose::Attach(to) => Some(to),
                    Purpose::Roam => chosen,
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
            Phase::Reassociate(to) if !self.is_fast(is_one_domain) => {
                self.begin(since, ends, Phase::Handshake(to));
                Step::Underway
            }
            Phase::Reassociate(to) | Phase::Handshake(to) => {
                let fast = self.is_fast(is_one_domain);
                let from = self.attached.replace(to);
                Step::Attached(Joined { from, to, fast, gap: ends.since(since) })
            }
        }
    }

    fn is_fast(&self, is_one_domain: bool) -> bool {
        self.fast_transition && is_one_domain
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

#[cfg(test)]
mod tests {
    use cotorra_graph::{Dbm, GapPolicy, Loss, PathLoss, Shadowing, WifiStandard};

    use super::*;
    use crate::random::stream;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn station(fast_transition: bool, variation: f64) -> Station {
        let network = WirelessNetwork {
            standard: WifiStandard::N,
            delay: ms(1),
            rate: None,
            loss: Loss::None,
            fast_transition,
            mobility_domain: 1,
            path_loss: PathLoss::FreeSpace,
            walls: None,
            access: None,
            interference: Vec::new(),
            shadowing: Shadowing { deviation_db: 0.0, correlation_m: 1.0 },
            noise_floor: Dbm(-95.0),
            hysteresis_db: 0.0,
            time_to_trigger: Duration::ZERO,
            handover: HandoverTimes {
                scan: ms(100),
                authenticate: ms(10),
                reassociate: ms(20),
                handshake: ms(40),
                variation,
            },
            gap: GapPolicy::Hold,
        };
        let mut station = Station::new(&network, stream(1, "r"));
        station.begin_attached(0);
        station
    }

    /// Ends all phases at their deadlines. Returns the total time.
    fn run(
        station: &mut Station,
        from: Timestamp,
        strongest: Option<RadioUnitIndex>,
    ) -> (Vec<Step>, Duration) {
        let (mut steps, mut now) = (Vec::new(), from);
        while let Some(deadline) = station.deadline() {
            now = deadline;
            let is_one_domain = station.attached().is_some();
            steps.push(station.expire(strongest, is_one_domain));
        }
        (steps, now.since(from))
    }

    #[test]
    fn a_fast_handover_is_authentication_and_reassociation() {
        let mut station = station(true, 0.0);
        station.attach(at(5), 1).unwrap();
        assert_eq!((station.attached(), station.on_channel()), (Some(0), None));
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(30) };
        assert_eq!(run(&mut station, at(5), None), (vec![Step::Underway, Step::Attached(joined)], ms(30)));
        assert_eq!(station.on_channel(), Some(1));
    }

    #[test]
    fn a_full_handover_adds_the_handshakes() {
        let mut station = station(false, 0.0);
        station.attach(at(0), 1).unwrap();
        let joined = Joined { from: Some(0), to: 1, fast: false, gap: ms(70) };
        let (steps, took) = run(&mut station, at(0), None);
        assert_eq!((steps.last(), took), (Some(&Step::Attached(joined)), ms(70)));
    }

    #[test]
    fn handshakes_are_repeated_between_mobility_domains() {
        let mut station = station(true, 0.0);
        station.attach(at(0), 1).unwrap();
        assert_eq!(station.underway_to(), Some(1));
        while station.is_away() {
            station.expire(None, false);
        }
        assert_eq!((station.attached(), station.underway_to()), (Some(1), None));
        station.attach(at(100), 0).unwrap();
        let mut last = Step::Underway;
        while station.is_away() {
            last = station.expire(None, false);
        }
        assert_eq!(last, Step::Attached(Joined { from: Some(1), to: 0, fast: false, gap: ms(70) }));
    }

    #[test]
    fn handshakes_are_repeated_after_a_lost_radio_unit() {
        let mut station = station(true, 0.0);
        assert_eq!(station.detach(), Some(0));
        station.scan(at(0), Purpose::Roam).unwrap();
        let joined = Joined { from: None, to: 2, fast: false, gap: ms(170) };
        let (steps, took) = run(&mut station, at(0), Some(2));
        assert_eq!((steps[0], steps.last(), took), (Step::Scanned, Some(&Step::Attached(joined)), ms(170)));
    }

    #[test]
    fn a_scan_returns_to_its_channel() {
        let mut station = station(true, 0.0);
        station.scan(at(0), Purpose::Look).unwrap();
        assert_eq!(station.on_channel(), None);
        assert_eq!(run(&mut station, at(0), Some(1)), (vec![Step::Scanned], ms(100)));
        assert_eq!(station.on_channel(), Some(0));
        // A scan to roam returns as well if no radio unit is better.
        station.scan(at(200), Purpose::Roam).unwrap();
        assert_eq!(run(&mut station, at(200), Some(0)), (vec![Step::Scanned], ms(100)));
    }

    #[test]
    fn a_handover_requested_during_a_scan_follows_it() {
        let mut station = station(true, 0.0);
        station.scan(at(0), Purpose::Look).unwrap();
        station.attach(at(50), 1).unwrap();
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(130) };
        let steps = vec![Step::Scanned, Step::Underway, Step::Attached(joined)];
        assert_eq!(run(&mut station, at(0), None), (steps, ms(130)));
    }

    #[test]
    fn a_busy_station_rejects_other_activities() {
        let mut station = station(true, 0.0);
        station.attach(at(0), 0).unwrap();
        assert!(!station.is_away(), "it is there already");
        station.attach(at(0), 1).unwrap();
        assert_eq!(station.attach(at(1), 1), Ok(()), "it is on its way");
        assert_eq!(station.attach(at(1), 2), Err(Busy::HandingOver(1)));
        assert_eq!(station.scan(at(1), Purpose::Look), Err(Busy::HandingOver(1)));
        run(&mut station, at(0), None);
        station.scan(at(100), Purpose::Look).unwrap();
        assert_eq!(station.scan(at(110), Purpose::Look), Err(Busy::Scanning));
    }

    #[test]
    fn phases_vary_uniformly_within_the_variation() {
        let mut station = station(true, 0.5);
        let scans: Vec<f64> = (0..2000)
            .map(|i| {
                station.scan(at(1000 * i), Purpose::Look).unwrap();
                run(&mut station, at(1000 * i), None).1.as_secs_f64() * 1e3
            })
            .collect();
        assert!(scans.iter().all(|ms| (50.0..=150.0).contains(ms)));
        let mean = scans.iter().sum::<f64>() / scans.len() as f64;
        assert!((mean - 100.0).abs() < 2.0, "{mean}");
        assert!(scans.iter().any(|ms| *ms < 55.0) && scans.iter().any(|ms| *ms > 145.0));
    }
}
