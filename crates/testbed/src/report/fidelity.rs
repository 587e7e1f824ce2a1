//! Judges whether a run's emulation did what the testbed file demands.

use cotorra_graph::Lateness;
use serde::{Deserialize, Serialize};

use super::{
    away::{AwaySummary, VALID_MS},
    measured_frames::{MeasuredFrames, VALID_P50_US, VALID_P99_US},
    vnf_waits::VnfWaits,
};

/// Highest trusted share of frames lost unintentionally.
const VALID_DROPPED: f64 = 1e-4;
/// Share of a target that the lateness may reach without a word about it.
const UNNOTICED: f64 = 0.1;
/// Lowest number of probes that says something about one in a hundred.
const VALID_PROBES: u64 = 100;

/// Verdict on the emulation: whether it did what the testbed file demands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Fidelity {
    /// Whether the figures can be trusted.
    pub valid: bool,
    /// Whether the emulation is exact by construction: virtual time waits for nothing.
    #[serde(default)]
    pub exact: bool,
    /// Lateness of frames, µs: when they were delivered, or how long they waited in a port, whichever is larger.
    pub lateness_us: LatenessSummary,
    /// Number of frames in the verdict: all, or only probes if the kernel's NetEm carried the frames.
    pub frames: u64,
    /// Frames lost unintentionally: an interface was down, or its queue was full.
    pub frames_dropped: u64,
    /// Time in which the emulated network stood still; `None` in virtual time.
    #[serde(default)]
    pub away: Option<AwaySummary>,
    /// Waits of VNFs for a processor of this machine, by VNF. Empty in virtual time.
    #[serde(default)]
    pub vnf_waits: Vec<VnfWaits>,
    /// Reason for the verdict, with the limits.
    pub reason: String,
}

/// Quantiles of the lateness, µs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LatenessSummary {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Fidelity {
    /// Judges the frames of a run. Without any, it is valid only if `is_idle`, i.e. nothing that it measures needs one.
    pub(super) fn of(
        measured_frames: MeasuredFrames,
        lateness: Lateness,
        frames_dropped: u64,
        is_idle: bool,
    ) -> Self {
        let Lateness { frames, p50_us, p99_us, max_us } = lateness;
        let (which, what) = match measured_frames {
            MeasuredFrames::Exact | MeasuredFrames::All | MeasuredFrames::Emulated => ("", "the frames"),
            MeasuredFrames::Probes => {
                ("the kernel's NetEm carried the frames, and only probes tell how late; ", "the probes")
            }
        };
        let (valid, reason) = if measured_frames == MeasuredFrames::Probes && frames < VALID_PROBES {
            (
                false,
                format!(
                    "{which}{frames} of them did, and {VALID_PROBES} are needed (those of links with jitter or reordering \
                     cannot tell)"
                ),
            )
        } else if frames == 0 && measured_frames == MeasuredFrames::Emulated {
            (false, "the kernel's NetEm carried the frames, and tells nobody how late they were".to_owned())
        } else if frames == 0 && !is_idle {
            (false, "no frame crossed the emulated network".to_owned())
        } else if frames_dropped as f64 > frames as f64 * VALID_DROPPED {
            (false, format!("{frames_dropped} frames were lost at interfaces though nobody asked for it"))
        } else if frames == 0 {
            (true, "no service is measured, and no frame crossed the emulated network".to_owned())
        } else if p99_us > VALID_P99_US {
            (
                false,
                format!(
                    "{which}1 % of {what} came later than {p99_us:.0} µs; {VALID_P99_US:.0} µs are allowed"
                ),
            )
        } else if p50_us > VALID_P50_US {
            (
                false,
                format!(
                    "{which}half of {what} came later than {p50_us:.0} µs; {VALID_P50_US:.0} µs are allowed"
                ),
            )
        } else if measured_frames == MeasuredFrames::Exact {
            (true, "in virtual time, every frame arrives when it is due".to_owned())
        } else {
            let reason = format!(
                "{which}lateness p50 {p50_us:.0} µs (limit {VALID_P50_US:.0}), p99 {p99_us:.0} µs (limit {VALID_P99_US:.0})"
            );
            (true, reason)
        };
        let lateness_us = LatenessSummary { p50: p50_us, p99: p99_us, max: max_us };
        let exact = valid && measured_frames == MeasuredFrames::Exact;
        Self { valid, exact, lateness_us, frames, frames_dropped, away: None, vnf_waits: Vec::new(), reason }
    }

    /// Extends the verdict to the waits of datagrams in robots' sockets, which are part of the service times.
    pub(super) fn with_receptions(self, receptions: Lateness) -> Self {
        let Lateness { p50_us, p99_us, .. } = receptions;
        let (share, late, limit) = if p99_us > VALID_P99_US {
            ("1 %", p99_us, VALID_P99_US)
        } else if p50_us > VALID_P50_US {
            ("half", p50_us, VALID_P50_US)
        } else {
            return self;
        };
        let reason = format!(
            "{share} of the answers waited in their robot's socket for more than {late:.0} µs; {limit:.0} µs are allowed"
        );
        if self.valid { Self { valid: false, reason, ..self } } else { self }
    }

    /// Adds to the reason of a valid verdict how late frames were beside the tightest of these targets, ms, if that is much.
    pub(super) fn beside_targets(mut self, targets_ms: impl Iterator<Item = f64>) -> Self {
        if let Some(tightest) = targets_ms.reduce(f64::min) {
            let share = self.lateness_us.p99 / 1e3 / tightest;
            if self.valid && share > UNNOTICED {
                self.reason +=
                    &format!("; beside the tightest target, {tightest} ms, p99 is {:.0} %", share * 100.0);
            }
        }
        self
    }

    /// Returns the verdict in a word or a few.
    pub fn word(&self) -> &'static str {
        match self {
            Self { valid: false, .. } => "NOT VALID",
            Self { exact: true, .. } => "exact by construction",
            Self { .. } => "valid",
        }
    }

    /// Extends the verdict to packets that no port saw, because the kernel knew no address to send them to.
    pub(super) fn with_neighbours(self, overflows: u64) -> Self {
        if !self.valid || overflows == 0 {
            return self;
        }
        let reason = format!(
            "the kernel's table of neighbours, which all namespaces of this machine share, was full, and it dropped packets \
             {overflows} times; raise net.ipv4.neigh.default.gc_thresh3 and that of ipv6"
        );
        Self { valid: false, reason, ..self }
    }

    /// Extends the verdict to the time in which the emulated network stood still; `None` in virtual time. It does not matter if
    /// no frame crossed the network at all.
    pub(super) fn with_away(self, away: Option<AwaySummary>, measured_frames: MeasuredFrames) -> Self {
        let judged = away.filter(|_| self.valid && self.frames > 0);
        match judged.map(|its| (its, its.reason(measured_frames))) {
            None => Self { away, ..self },
            Some((_, Some(reason))) => Self { valid: false, reason, away, ..self },
            Some((its, None)) => {
                let reason =
                    format!("{}, absence {:.0} ms (limit {VALID_MS:.0})", self.reason, its.absence_max_ms);
                Self { reason, away, ..self }
            }
        }
    }

    /// Extends the verdict to waits of VNFs, which no testbed file asks for.
    pub(super) fn with_vnf_waits(self, vnf_waits: Vec<VnfWaits>) -> Self {
        let starved = vnf_waits.iter().find(|its| its.is_starved);
        let unknown = vnf_waits.iter().filter(|its| its.waited_ms.is_none());
        let unknown: Vec<_> = unknown.map(|its| format!("`{}`", its.vnf)).collect();
        let (valid, reason) = match starved {
            _ if !self.valid => (false, self.reason),
            Some(starved) => (false, format!("VNF `{}` {}", starved.vnf, starved.sentence())),
            None if unknown.is_empty() => (true, self.reason),
            None => {
                let unknown = unknown.join(", ");
                (true, format!("{}; how long VNF {unknown} waited for a processor is unknown", self.reason))
            }
        };
        Self { valid, reason, vnf_waits, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_table_of_neighbours_makes_the_verdict_invalid() {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let valid = || Fidelity::of(MeasuredFrames::All, good, 0, false);
        assert_eq!(valid().with_neighbours(0), valid());
        let full = valid().with_neighbours(3);
        assert!(!full.valid && full.reason.contains("3 times"), "{full:?}");
        let worse = Fidelity { valid: false, reason: "worse".to_owned(), ..valid() };
        assert_eq!(worse.clone().with_neighbours(3), worse);
    }

    #[test]
    fn a_run_without_frames_or_with_late_ones_is_not_valid() {
        let fidelity = |lateness, dropped| Fidelity::of(MeasuredFrames::All, lateness, dropped, false);
        assert!(!fidelity(Lateness::default(), 0).valid);
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        assert!(fidelity(good, 0).valid);
        assert!(!fidelity(good, 1).valid);
        let late = fidelity(Lateness { p99_us: 1500.0, ..good }, 0);
        assert!(!late.valid && late.reason.contains("1500"), "{late:?}");
        let real = Fidelity::of(MeasuredFrames::Emulated, Lateness::default(), 0, false);
        assert!(!real.valid && real.reason.contains("NetEm"), "{real:?}");
        // The fabric's own frames are known, beside real links.
        assert!(Fidelity::of(MeasuredFrames::Emulated, good, 0, false).valid);
    }

    #[test]
    fn lateness_that_is_much_beside_the_tightest_target_is_told() {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let beside = |targets: &[f64]| {
            let fidelity = Fidelity::of(MeasuredFrames::All, good, 0, false);
            fidelity.beside_targets(targets.iter().copied()).reason
        };
        assert!(beside(&[15.0, 2.0]).ends_with("; beside the tightest target, 2 ms, p99 is 15 %"));
        assert_eq!(beside(&[15.0, 4.0]), beside(&[]));
    }

    #[test]
    fn a_testbed_without_services_needs_no_frames() {
        let fidelity = |lateness, dropped| Fidelity::of(MeasuredFrames::All, lateness, dropped, true);
        let idle = fidelity(Lateness::default(), 0);
        assert!(idle.valid && idle.reason.contains("no service"), "{idle:?}");
        assert!(!fidelity(Lateness::default(), 1).valid);
        assert!(!fidelity(Lateness { frames: 10, p50_us: 20.0, p99_us: 1500.0, max_us: 5000.0 }, 0).valid);
    }

    #[test]
    fn answers_that_wait_in_a_robots_socket_are_late() {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let judged =
            |receptions| Fidelity::of(MeasuredFrames::All, good, 0, false).with_receptions(receptions);
        assert!(judged(good).valid && judged(Lateness::default()).valid);
        let rare = judged(Lateness { p99_us: 1001.0, ..good });
        assert!(!rare.valid && rare.reason.contains("1 % of the answers"), "{rare:?}");
        let half = judged(Lateness { p50_us: 251.0, ..good });
        assert!(!half.valid && half.reason.contains("half of the answers"), "{half:?}");
    }

    #[test]
    fn virtual_time_is_exact_by_construction() {
        let punctual = Lateness { frames: 10, ..Lateness::default() };
        let exact = Fidelity::of(MeasuredFrames::Exact, punctual, 0, false);
        assert_eq!((exact.word(), exact.valid, exact.exact), ("exact by construction", true, true));
        let none = Fidelity::of(MeasuredFrames::Exact, Lateness::default(), 0, false);
        assert_eq!((none.word(), none.exact), ("NOT VALID", false));
        assert_eq!(Fidelity::of(MeasuredFrames::All, punctual, 0, false).word(), "valid");
    }

    #[test]
    fn with_the_kernel_carrying_frames_enough_probes_decide() {
        let fidelity = |frames, p99_us| {
            Fidelity::of(
                MeasuredFrames::Probes,
                Lateness { frames, p50_us: 20.0, p99_us, max_us: 5000.0 },
                0,
                false,
            )
        };
        for few in [0, VALID_PROBES - 1] {
            let few = fidelity(few, 300.0);
            assert!(!few.valid && few.reason.contains("NetEm") && few.reason.contains("100"), "{few:?}");
        }
        let good = fidelity(VALID_PROBES, 300.0);
        assert!(good.valid && good.reason.contains("only probes"), "{good:?}");
        let late = fidelity(VALID_PROBES, 1500.0);
        assert!(!late.valid && late.reason.contains("1 % of the probes"), "{late:?}");
    }
}
