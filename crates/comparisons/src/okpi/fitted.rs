//! A testbed that is fitted to the first half of a measured walk, and its prediction of the second half, beside those of the
//! unfitted testbed and of two baselines.

use cotorra_calibrate::{Region, SimulatedSample, WalkData, WalkFit, WalkSample, fit_walk};
use cotorra_testbed::{DataTable, Report, service_time_ms};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::{
    Contender, Walks,
    bootstrap::intervals,
    compared,
    figures::{ABOVE_MS, Distribution, Intervals, ms, percent, with_interval},
    samples,
    times::{Timed, halves},
};

/// Least share of a walk with other decisions that is noted. Less is a change at another sample.
const NOTED_SHARE: f64 = 0.01;

/// A contender's fitted testbed, and the walk on it.
#[derive(Debug, Clone, Copy)]
pub struct FittedWalk<'a> {
    pub contender: Contender,
    /// The fit to the first half of the measured walk.
    pub fit: &'a WalkFit,
    /// The walk on the fitted testbed, with the same seed.
    pub report: &'a Report,
}

/// A predictor of the second half of a measured walk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Predictor {
    /// The walk on the fitted testbed.
    Fitted,
    /// The walk on the testbed as it was.
    Unfitted,
    /// Baseline: a constant delay with normal jitter and independent loss, by the mean, the standard deviation and the share
    /// without an answer of the first half.
    Normal,
    /// Baseline: the first half, played again.
    Replay,
}

impl Predictor {
    /// Returns its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fitted => "fitted testbed",
            Self::Unfitted => "testbed as it was",
            Self::Normal => "constant delay, normal jitter",
            Self::Replay => "replay of the first half",
        }
    }
}

/// A prediction of the second half.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Prediction {
    pub by: Predictor,
    #[serde(flatten)]
    pub figures: Distribution,
}

/// A fit to the first half of the measured walk, and its test on the second.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WalkTest {
    /// Name of the contender whose testbed was fitted.
    pub contender: &'static str,
    pub fit: WalkFit,
    /// Share of the fitted walk, at the times of the second half, with another radio unit or server than in the unfitted walk.
    pub decided_otherwise: f64,
    /// Figures of the measured second half.
    pub measured: Distribution,
    pub intervals: Option<Intervals>,
    /// The fitted testbed first.
    pub predictions: Vec<Prediction>,
}

/// Fits a contender's testbed to the first half of the measured walk; `None` without one, or if it is another contender's.
pub fn fit(walks: &Walks<'_>, contender: &Contender) -> Option<WalkFit> {
    let measured = walks.measured.filter(|its| its.is_beside(contender))?;
    let robot = &compared(walks.testbed)?.robot;
    let simulated = simulated(walks, walks.of(contender));
    let [first, _] = halves(measured.samples());
    let measured: Vec<_> = first.iter().map(|timed| WalkSample { at_s: timed.at_s, ms: timed.ms }).collect();
    let data = WalkData { testbed: walks.testbed, robot, simulated: &simulated, measured: &measured };
    Some(fit_walk(&data, walks.seed))
}

/// Returns the tests of all fits.
pub(super) fn tests(walks: &Walks<'_>) -> Vec<WalkTest> {
    walks.fitted.iter().filter_map(|fitted| test(walks, fitted)).collect()
}

fn test(walks: &Walks<'_>, fitted: &FittedWalk<'_>) -> Option<WalkTest> {
    let [first, second] = halves(walks.measured?.samples());
    let [unfitted, by_fit] = [walks.of(&fitted.contender), fitted.report].map(|report| {
        let mut walk = simulated(walks, report);
        walk.retain(|its| is_during(second, its.sample.at_s));
        walk
    });
    let of_walk = |walk: &[SimulatedSample]| {
        let timed = walk.iter().map(|its| Timed { at_s: its.sample.at_s, ms: its.sample.ms });
        Distribution::of(&timed.collect::<Vec<_>>())
    };
    // Without settings, it is the testbed as it was.
    let is_fitted = !fitted.fit.settings.is_empty();
    let figures = [
        (Predictor::Fitted, is_fitted.then(|| of_walk(&by_fit)).flatten()),
        (Predictor::Unfitted, of_walk(&unfitted)),
        (Predictor::Normal, normal(first)),
        (Predictor::Replay, Distribution::of(first)),
    ];
    let predictions =
        figures.into_iter().filter_map(|(by, figures)| Some(Prediction { by, figures: figures? }));
    Some(WalkTest {
        contender: fitted.contender.name,
        fit: fitted.fit.clone(),
        decided_otherwise: decided_otherwise(&unfitted, &by_fit),
        measured: Distribution::of(second)?,
        intervals: intervals(second, walks.seed),
        predictions: predictions.collect(),
    })
}

/// Whether a time is within those of some samples, which are sorted by time.
pub(super) fn is_during(samples: &[Timed], at_s: f64) -> bool {
    let ends = samples.first().zip(samples.last());
    ends.is_some_and(|(first, last)| (first.at_s..=last.at_s).contains(&at_s))
}

/// Returns the samples of a simulated walk with their regions, by time.
fn simulated(walks: &Walks<'_>, report: &Report) -> Vec<SimulatedSample> {
    let with_region = samples(walks.testbed, report).map(|sample| SimulatedSample {
        sample: WalkSample { at_s: sample.emitted.as_secs_f64(), ms: service_time_ms(&sample) },
        region: sample.attachment.map(|radio_unit| Region { radio_unit, server: sample.server }),
    });
    with_region.collect()
}

/// Returns the share of a walk that is in another region than a reference at the same time.
fn decided_otherwise(reference: &[SimulatedSample], walk: &[SimulatedSample]) -> f64 {
    let at = |at_s: f64| {
        let next = reference.partition_point(|its| its.sample.at_s <= at_s);
        reference[..next].last().or(reference.first()).and_then(|its| its.region.as_ref())
    };
    let other = walk.iter().filter(|its| its.region.as_ref() != at(its.sample.at_s)).count();
    other as f64 / walk.len().max(1) as f64
}

/// Returns the figures of a constant delay with normal jitter, like some samples; `None` without answers.
pub(super) fn normal(like: &[Timed]) -> Option<Distribution> {
    let answered: Vec<f64> = like.iter().filter_map(|timed| timed.ms).collect();
    if answered.is_empty() {
        return None;
    }
    let n = answered.len() as f64;
    let mean = answered.iter().sum::<f64>() / n;
    let deviation = (answered.iter().map(|ms| (ms - mean).powi(2)).sum::<f64>() / n).sqrt();
    let quantile = |level: f64| (mean + deviation * Normal::standard().inverse_cdf(level)).max(0.0);
    let lost = 1.0 - n / like.len() as f64;
    let above = |limit_ms: f64| {
        let within = if deviation > 0.0 {
            Normal::standard().cdf((limit_ms - mean) / deviation)
        } else {
            f64::from(u8::from(mean <= limit_ms))
        };
        lost + (1.0 - lost) * (1.0 - within)
    };
    let [above_15_ms, above_40_ms] = ABOVE_MS.map(above);
    Some(Distribution {
        samples: like.len(),
        p50_ms: mean,
        p95_ms: quantile(0.95),
        p99_ms: quantile(0.99),
        above_15_ms,
        above_40_ms,
    })
}

/// Returns the tables for readers: the fitted values, and the predictions beside the measured half.
pub(super) fn tables(tests: &[WalkTest]) -> Vec<DataTable> {
    if tests.is_empty() {
        return Vec::new();
    }
    let mut values = DataTable::new(["walk", "fitted to the first half", "value", "from"]).right_after(2);
    for WalkTest { contender, fit, .. } in tests {
        let mut row = |what: String, value: String, from: String| {
            values.row([(*contender).to_owned(), what, value, from])
        };
        for of in &fit.regions {
            let samples = || format!("{} samples", of.samples);
            row(format!("{}: added round trip, ms", of.region), format!("{:.2}", of.added_ms), samples());
            let jitter = format!("{}: jitter ({}), ms", of.region, of.distribution_name());
            row(jitter, format!("{:.2}", of.jitter_ms), samples());
        }
        if let Some(scan) = &fit.scan {
            let from = format!("{} scans", scan.scans);
            let what =
                if scan.visits.is_some() { "duration of a visit, ms" } else { "duration of a scan, ms" };
            row(what.to_owned(), format!("{:.1}", scan.scan_ms), from.clone());
            if let Some(visits) = scan.visits {
                row("visits of a scan".to_owned(), format!("{visits:.1}"), from);
            }
            let share = |value: f64| value * 100.0;
            let (value, low, high) = (share(scan.share.value), share(scan.share.low), share(scan.share.high));
            row(
                "samples in scans (no setting)".to_owned(),
                format!("{value:.2} % ({low:.2} % to {high:.2} %)"),
                format!("simulated: {:.2} %", share(scan.simulated_share)),
            );
        }
    }
    let heads = ["walk", "second half", "p95, ms", "p99, ms", "above 15 ms", "above 40 ms"];
    let mut predicted = DataTable::new(heads).right_after(2);
    for test in tests {
        let all = test.predictions.iter().map(|its| (its.by.name(), &its.figures, None));
        for (name, figures, ends) in
            [("measured", &test.measured, test.intervals.as_ref())].into_iter().chain(all)
        {
            let Distribution { p95_ms, p99_ms, above_15_ms, above_40_ms, .. } = *figures;
            predicted.row([
                test.contender.to_owned(),
                name.to_owned(),
                with_interval(&ms, p95_ms, ends.map(|its| its.p95_ms)),
                with_interval(&ms, p99_ms, ends.map(|its| its.p99_ms)),
                with_interval(&percent, above_15_ms, ends.map(|its| its.above_15_ms)),
                with_interval(&percent, above_40_ms, ends.map(|its| its.above_40_ms)),
            ]);
        }
    }
    let fitted = tests.iter().any(|test| !test.fit.settings.is_empty());
    if fitted { vec![values, predicted] } else { vec![predicted] }
}

/// Returns what was not fitted and why, and the fitted values as settings, in Markdown.
pub(super) fn remarks(tests: &[WalkTest]) -> String {
    let mut text = String::new();
    for WalkTest { contender, fit, decided_otherwise, .. } in tests {
        let mut notes = fit.notes.clone();
        if *decided_otherwise >= NOTED_SHARE {
            notes.push(format!(
                "on the fitted testbed, it used another radio unit or server for {} of the second half",
                percent(*decided_otherwise)
            ));
        }
        if !notes.is_empty() {
            let notes: String = notes.iter().map(|note| format!("- {note}\n")).collect();
            text += &format!("\nNotes on the fit of {contender}:\n\n{notes}");
        }
        if !fit.settings.is_empty() {
            let set =
                |its: &cotorra_calibrate::FittedSetting| format!("--set '{}={}'\n", its.path, its.value);
            let settings: String = fit.settings.iter().map(set).collect();
            text += &format!(
                "\nSettings of the testbed that was fitted for {contender}:\n\n```\n{settings}```\n"
            );
        }
    }
    text
}
