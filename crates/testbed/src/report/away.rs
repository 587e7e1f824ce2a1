//! Time in which the emulated network stood still in a run's verdict: its thread did not look at its ports.

use std::time::Duration;

use cotorra_datapath::Absence;
use cotorra_graph::millis;
use serde::{Deserialize, Serialize};

use super::measured_frames::MeasuredFrames;

/// Highest trusted share of time in which a frame would have waited for more than a millisecond.
const VALID_SHARE: f64 = 0.01;
/// Longest trusted time at once, ms. It is above the 50 ms for which Linux takes real-time threads off their processor.
pub(super) const VALID_MS: f64 = 100.0;

/// Time in which the emulated network stood still, of a millisecond or more at once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AwaySummary {
    /// In total, ms.
    pub absence_ms: f64,
    /// At once, ms.
    pub absence_max_ms: f64,
    /// Share of the run's time in which an arriving frame would have waited for more than a millisecond.
    pub stalled: f64,
}

impl AwaySummary {
    /// Describes the absences of a run of this duration.
    pub(super) fn new(absence: &Absence, duration: Duration) -> Self {
        let share = absence.late.as_secs_f64() / duration.as_secs_f64().max(f64::MIN_POSITIVE);
        Self {
            absence_ms: millis::of(absence.total),
            absence_max_ms: millis::of(absence.longest),
            stalled: share.min(1.0),
        }
    }

    /// Returns why they make the figures of a run invalid; `None` if they do not. If the kernel carries the frames, it goes on
    /// meanwhile, and only a long absence matters: of probes, of robots and of the conditions' schedule.
    pub(super) fn reason(&self, measured_frames: MeasuredFrames) -> Option<String> {
        let Self { absence_max_ms: longest_ms, stalled, .. } = self;
        if *longest_ms > VALID_MS {
            return Some(format!(
                "cotorra was kept from running for {longest_ms:.0} ms at once, and {VALID_MS:.0} ms are allowed: frames waited, and \
                 robots sent none"
            ));
        }
        let is_late = *stalled > VALID_SHARE && measured_frames != MeasuredFrames::Probes;
        is_late.then(|| {
            let (percent, allowed) = (stalled * 100.0, VALID_SHARE * 100.0);
            format!(
                "in {percent:.1} % of the time a frame would have waited for more than 1 ms, because cotorra was kept from \
                 running; {allowed:.0} % is allowed"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Lateness;

    use super::{super::fidelity::Fidelity, *};

    const MINUTE: Duration = Duration::from_secs(60);

    fn judged(frames: u64, measured: MeasuredFrames, absence: Absence) -> Fidelity {
        let lateness = Lateness { frames, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let away = AwaySummary::new(&absence, MINUTE);
        Fidelity::of(measured, lateness, 0, true).with_away(Some(away), measured)
    }

    fn absent(total_ms: u64, longest_ms: u64) -> Absence {
        let [total, longest] = [total_ms, longest_ms].map(Duration::from_millis);
        Absence { total, longest, late: total }
    }

    #[test]
    fn a_run_that_stood_still_is_not_valid_however_few_frames_were_late() {
        for measured in [MeasuredFrames::All, MeasuredFrames::Emulated, MeasuredFrames::Probes] {
            let stopped = judged(1_000_000, measured, absent(2000, 2000));
            assert!(!stopped.valid && stopped.reason.contains("2000 ms at once"), "{stopped:?}");
        }
    }

    #[test]
    fn a_run_that_stood_still_often_is_not_valid_if_the_fabric_carries_frames() {
        let often = judged(1000, MeasuredFrames::All, absent(900, 20));
        assert!(!often.valid && often.reason.contains("1.5 % of the time"), "{often:?}");
        assert!(judged(1000, MeasuredFrames::Probes, absent(900, 20)).valid);
    }

    #[test]
    fn ordinary_absences_are_allowed_and_told() {
        let ordinary = judged(1000, MeasuredFrames::All, absent(500, 50));
        assert!(ordinary.valid && ordinary.reason.ends_with("absence 50 ms (limit 100)"), "{ordinary:?}");
        assert_eq!(ordinary.away.unwrap().absence_ms, 500.0);
    }

    #[test]
    fn absences_do_not_matter_if_no_frame_crossed_the_network() {
        assert!(judged(0, MeasuredFrames::All, absent(2000, 2000)).valid);
    }
}
