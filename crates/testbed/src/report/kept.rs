//! Verdicts on services: whether the share of samples within the target is the one that the testbed file demands.

use std::fmt;

use cotorra_numbers::wilson;
use serde::{Deserialize, Serialize};

/// Whether a service kept its target as often as demanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "UPPERCASE")]
pub enum Verdict {
    Pass,
    Fail,
}

/// The share of a service's samples within its target, and the verdict on it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Kept {
    /// Share of samples within the target; `None` without samples. Unanswered ones are not within it.
    pub kept: Option<f64>,
    /// Lower bound of the 95 % confidence interval of that share.
    pub kept_low: Option<f64>,
    /// Upper bound.
    pub kept_high: Option<f64>,
    /// Share that the testbed file demands; `None` if any will do.
    pub keep: Option<f64>,
    /// The verdict, by the measured share alone; `None` if any share will do. Without samples, nothing was kept.
    #[serde(skip)]
    pub verdict: Option<Verdict>,
    /// Whether the interval excludes the demanded share, so that there are enough samples for the verdict. `None` without a
    /// verdict.
    pub sure: Option<bool>,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pass => "PASS",
            Self::Fail => "FAIL",
        })
    }
}

impl Verdict {
    /// Returns the verdict on several services together: that on the worst one. `None` if nothing is demanded of any.
    pub fn of_all(verdicts: impl IntoIterator<Item = Option<Self>>) -> Option<Self> {
        let verdicts: Vec<_> = verdicts.into_iter().flatten().collect();
        if verdicts.contains(&Self::Fail) { Some(Self::Fail) } else { verdicts.first().copied() }
    }
}

impl Kept {
    /// Judges so many samples within the target, of so many, by a demanded share.
    pub fn of(within: usize, samples: usize, keep: Option<f64>) -> Self {
        let kept = (samples > 0).then(|| within as f64 / samples as f64);
        let interval = wilson(within as u64, samples as u64);
        let is_kept = |keep: f64| kept.is_some_and(|kept| kept >= keep);
        let is_sure = |keep: f64| interval.is_some_and(|interval| !interval.holds(keep));
        Self {
            kept,
            kept_low: interval.map(|interval| interval.low),
            kept_high: interval.map(|interval| interval.high),
            keep,
            verdict: keep.map(|keep| if is_kept(keep) { Verdict::Pass } else { Verdict::Fail }),
            sure: keep.map(is_sure),
        }
    }

    /// Judges a share above the target.
    pub fn beside(above_target: Option<f64>, samples: usize, keep: Option<f64>) -> Self {
        let above = (above_target.unwrap_or(0.0) * samples as f64).round() as usize;
        Self::of(samples.saturating_sub(above), samples, keep)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_demanded_share_passes_or_fails_by_the_measured_one_and_few_samples_are_not_sure() {
        let of = |within, samples, keep| {
            let Kept { verdict, sure, .. } = Kept::of(within, samples, Some(keep));
            (verdict.unwrap(), sure.unwrap())
        };
        assert_eq!(of(949, 1000, 0.99), (Verdict::Fail, true));
        assert_eq!(of(999, 1000, 0.99), (Verdict::Pass, true));
        assert_eq!(of(19, 20, 0.99), (Verdict::Fail, false));
        assert_eq!(of(20, 20, 0.99), (Verdict::Pass, false));
        assert_eq!(of(99, 100, 0.99), (Verdict::Pass, false), "the demanded share is enough");
        assert_eq!(of(0, 0, 0.99), (Verdict::Fail, false), "nothing was kept");
        assert_eq!(of(1000, 1000, 1.0), (Verdict::Pass, false), "no number of samples shows all");
    }

    #[test]
    fn without_a_demanded_share_there_is_no_verdict() {
        let Kept { kept, verdict, sure, .. } = Kept::of(3, 4, None);
        assert_eq!((kept, verdict, sure), (Some(0.75), None, None));
    }

    #[test]
    fn one_failure_is_that_of_all() {
        use Verdict::{Fail, Pass};
        assert_eq!(Verdict::of_all([None, Some(Pass), Some(Fail)]), Some(Fail));
        assert_eq!(Verdict::of_all([Some(Pass), None]), Some(Pass));
        assert_eq!(Verdict::of_all([None, None]), None);
    }

    #[test]
    fn a_share_above_the_target_judges_the_same_samples() {
        assert_eq!(Kept::beside(Some(1.0 / 3.0), 3, Some(0.5)), Kept::of(2, 3, Some(0.5)));
        assert_eq!(Kept::beside(None, 0, Some(0.5)), Kept::of(0, 0, Some(0.5)));
    }
}
