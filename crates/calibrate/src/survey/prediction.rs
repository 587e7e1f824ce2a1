//! Checks how well a fitted radio predicts the signals of another part of a survey, beside two baselines.

use cotorra_graph::Testbed;
use cotorra_numbers::{Draws, Resampler, block_length};
use serde::Serialize;

use super::{
    Reading, SurveyFit,
    kriging::{Normal, Off},
    likelihood::{COEFFICIENTS, Sample},
    radio_unit, sample,
};
use crate::{
    error::CalibrateError,
    estimate::{Estimate, quantile},
    matched::RESAMPLES,
};

/// Fewest readings of a test.
const LEAST_TEST: usize = 20;
/// Share of the readings that a prediction's interval should hold.
const WITHIN: f64 = 0.9;
/// Normal deviate at the ends of that interval.
const WITHIN_DEVIATE: f64 = 1.644_854;
/// Number of predictors that are fits, which come first.
const FITS: usize = 2;
/// Drawn signals of a predicted distribution, at least.
const DRAWN: usize = 2000;
/// Most drawn signals of one reading.
const MOST_DRAWN: usize = 20;

/// Splits readings in two by time. `share` is that of the first part. Readings of one time stay together.
pub fn split_survey(readings: &[Reading], share: f64) -> [Vec<Reading>; 2] {
    let mut first = readings.to_vec();
    first.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let mut at = ((first.len() as f64 * share).round() as usize).min(first.len());
    while at > 0 && at < first.len() && first[at].time_s == first[at - 1].time_s {
        at += 1;
    }
    let second = first.split_off(at);
    [first, second]
}

/// A predictor of signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SignalPredictor {
    /// The fitted path loss and walls, with shadowing and noise around them.
    Fitted,
    /// The same, and the shadowing that readings nearby had (kriging).
    Nearby,
    /// Baseline: the mean signal of the radio unit in the part that was fitted, wherever it was heard.
    Mean,
    /// Baseline: the testbed before the calibration, with its path loss, walls and shadowing.
    Before,
}

impl SignalPredictor {
    /// All predictors, the fitted radio first.
    pub const ALL: [Self; 4] = [Self::Fitted, Self::Nearby, Self::Mean, Self::Before];

    /// Returns its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fitted => "fitted radio",
            Self::Nearby => "fitted radio, with readings nearby",
            Self::Mean => "mean of each radio unit",
            Self::Before => "testbed before",
        }
    }
}

/// A prediction of the test part of a survey, with bootstrap intervals. Errors are measured less predicted signals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SignalPrediction {
    /// The predictor.
    pub by: SignalPredictor,
    /// 5 % quantile of the errors, dB.
    pub p5_db: Estimate,
    /// Median of the errors, dB.
    pub p50_db: Estimate,
    /// Whether the median agrees with 0: its interval holds that, over resamples of the test part and draws of the fit.
    pub median_agrees: bool,
    /// 95 % quantile of the errors, dB.
    pub p95_db: Estimate,
    /// Root of the mean squared error, dB.
    pub root_mean_square_db: Estimate,
    /// Share of the readings within the interval that is predicted to hold 90 % of them.
    pub within: Estimate,
    /// Whether that share agrees with 90 %, likewise.
    pub within_agrees: bool,
    /// Distance of the predicted distribution of signals to the measured one: 1-Wasserstein, dB.
    pub wasserstein_db: Estimate,
}

/// A comparison of predictions with the test part of a survey.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurveyComparison {
    /// Number of readings of the part that was fitted.
    pub fitted_readings: usize,
    /// Number of readings of the test part.
    pub test_readings: usize,
    /// Mean length of a block of the bootstrap, in times of readings.
    pub block_length: f64,
    /// The fitted radio, and the others.
    pub predictions: Vec<SignalPrediction>,
}

/// A reading of the test part: the signal, and its prediction by each predictor.
struct Tested {
    time_s: f64,
    signal: f64,
    predicted: [Normal; 4],
    /// Factors of the coefficients in each prediction.
    factors: [[f64; COEFFICIENTS]; 4],
    /// Signals drawn from each prediction.
    drawn: [Vec<f64>; 4],
}

/// Compares the fitted radio of a network with readings that were not fitted. The seed decides draws and resamples.
///
/// # Errors
/// [`CalibrateError::TooLittle`] if there are too few of them, and [`CalibrateError::Unsuited`] if a radio unit is not in the
/// testbed or has no position.
pub fn compare_survey(
    testbed: &Testbed,
    network: &str,
    fit: &SurveyFit,
    fitted: &[Reading],
    test: &[Reading],
    seed: u64,
) -> Result<SurveyComparison, CalibrateError> {
    if test.len() < LEAST_TEST {
        return Err(CalibrateError::too_little(format!(
            "network `{network}` has {} readings in the part to test: it needs {LEAST_TEST} or more, later than the others by \
             their `time_s`",
            test.len()
        )));
    }
    let draws = &mut Draws::new(seed, &format!("calibrate survey test {network}"));
    let tested = predicted(testbed, network, fit, fitted, test, draws)?;
    let moments: Vec<&[Tested]> = tested.chunk_by(|a, b| a.time_s == b.time_s).collect();
    let length = moments_per_block(test, &tested, moments.len());
    let resampler = Resampler::of_length(moments.len(), length);
    let everything: Vec<&Tested> = tested.iter().collect();
    let resamples: Vec<(Vec<&Tested>, Off)> = (0..RESAMPLES)
        .map(|_| {
            let mut drawn = Vec::with_capacity(tested.len());
            resampler.resample(draws, |moment| drawn.extend(moments[moment]));
            (drawn, fit.middle.draw_off(draws))
        })
        .collect();
    let prediction = |(k, by): (usize, SignalPredictor)| {
        let value = Figures::of(&everything, k);
        let resampled: Vec<Figures> =
            resamples.iter().map(|(resample, _)| Figures::of(resample, k)).collect();
        let agrees = |value: f64, of: fn(&[&Tested], usize, Off) -> f64| {
            let mut values: Vec<f64> =
                resamples.iter().map(|(resample, off)| of(resample, k, *off)).collect();
            Estimate::around(value, &mut values)
        };
        let estimate = |i: usize| {
            let mut values: Vec<f64> = resampled.iter().map(|figures| figures.0[i]).collect();
            Estimate::around(value.0[i], &mut values)
        };
        let mut within = estimate(4);
        within.widen(tested.len());
        let mut within_agrees = agrees(value.0[4], within_if_off);
        within_agrees.widen(tested.len());
        SignalPrediction {
            by,
            p5_db: estimate(0),
            p50_db: estimate(1),
            median_agrees: agrees(value.0[1], median_if_off).covers(0.0),
            p95_db: estimate(2),
            root_mean_square_db: estimate(3),
            within,
            within_agrees: within_agrees.covers(WITHIN),
            wasserstein_db: estimate(5),
        }
    };
    Ok(SurveyComparison {
        fitted_readings: fitted.len(),
        test_readings: test.len(),
        block_length: length,
        predictions: SignalPredictor::ALL.into_iter().enumerate().map(prediction).collect(),
    })
}

/// Figures of a prediction: three quantiles of the errors, their root mean square, the share within the interval, and the
/// distance of distributions.
struct Figures([f64; 6]);

impl Figures {
    fn of(tested: &[&Tested], k: usize) -> Self {
        let n = tested.len() as f64;
        let mut errors: Vec<f64> = tested.iter().map(|t| t.signal - t.predicted[k].mean).collect();
        let within = |t: &&&Tested| {
            (t.signal - t.predicted[k].mean).abs() <= WITHIN_DEVIATE * t.predicted[k].deviation
        };
        let within = tested.iter().filter(within).count() as f64 / n;
        let square = errors.iter().map(|error| error * error).sum::<f64>() / n;
        errors.sort_unstable_by(f64::total_cmp);
        let [p5, p50, p95] = [0.05, 0.5, 0.95].map(|level| quantile(&errors, level));
        Self([p5, p50, p95, square.sqrt(), within, distance(tested, k)])
    }
}

/// Returns the error of a reading if the fit is off.
fn error_if_off(tested: &Tested, k: usize, off: Off) -> f64 {
    let shift: f64 = tested.factors[k].iter().zip(off.coefficients).map(|(factor, off)| factor * off).sum();
    tested.signal - tested.predicted[k].mean - shift
}

/// Returns the median of the errors if the fit is off.
fn median_if_off(tested: &[&Tested], k: usize, off: Off) -> f64 {
    let mut errors: Vec<f64> = tested.iter().map(|t| error_if_off(t, k, off)).collect();
    errors.sort_unstable_by(f64::total_cmp);
    quantile(&errors, 0.5)
}

/// Returns the share of readings within their predicted intervals if the fit is off. That of a baseline never is.
fn within_if_off(tested: &[&Tested], k: usize, off: Off) -> f64 {
    let factor = if k < FITS { off.deviation } else { 1.0 };
    let within =
        |t: &&&Tested| error_if_off(t, k, off).abs() <= WITHIN_DEVIATE * factor * t.predicted[k].deviation;
    tested.iter().filter(within).count() as f64 / tested.len() as f64
}

/// Returns the 1-Wasserstein distance between the measured signals and those drawn from their predictions: the mean distance
/// between their quantiles.
fn distance(tested: &[&Tested], k: usize) -> f64 {
    let mut measured: Vec<f64> = tested.iter().map(|t| t.signal).collect();
    let mut drawn: Vec<f64> = tested.iter().flat_map(|t| &t.drawn[k]).copied().collect();
    measured.sort_unstable_by(f64::total_cmp);
    drawn.sort_unstable_by(f64::total_cmp);
    let each = drawn.len() / measured.len();
    let apart = |(measured, drawn): (&f64, &[f64])| drawn.iter().map(|d| (d - measured).abs()).sum::<f64>();
    measured.iter().zip(drawn.chunks(each)).map(apart).sum::<f64>() / drawn.len() as f64
}

/// Returns the mean length of a block, in moments: that over which the errors of a radio unit depend on each other.
fn moments_per_block(test: &[Reading], tested: &[Tested], moments: usize) -> f64 {
    let mut units: Vec<&str> = test.iter().map(|reading| reading.radio_unit.as_str()).collect();
    units.sort_unstable();
    units.dedup();
    let length = |unit: &&str| {
        let of_unit = test.iter().zip(tested).filter(|(reading, _)| reading.radio_unit == *unit);
        let errors: Vec<f64> = of_unit.map(|(_, t)| t.signal - t.predicted[0].mean).collect();
        block_length(&errors) * moments as f64 / errors.len() as f64
    };
    units.iter().map(length).fold(1.0, f64::max).min(moments as f64)
}

/// Predicts the readings of the test part, in their order.
fn predicted(
    testbed: &Testbed,
    network: &str,
    fit: &SurveyFit,
    fitted: &[Reading],
    test: &[Reading],
    draws: &mut Draws,
) -> Result<Vec<Tested>, CalibrateError> {
    let wireless = &testbed.graph.wireless[network];
    let as_sample = |reading: &Reading| {
        let (unit, at) = radio_unit(testbed, &reading.radio_unit)?;
        Ok::<_, CalibrateError>(sample(wireless, unit, at, testbed.map.as_ref(), reading))
    };
    let of_unit =
        |unit: &str| fitted.iter().filter(move |reading| reading.radio_unit == unit).collect::<Vec<_>>();
    let drawn = (DRAWN / test.len()).clamp(1, MOST_DRAWN);
    let mut units = std::collections::BTreeMap::new();
    let mut tested = Vec::with_capacity(test.len());
    for reading in test {
        let name = reading.radio_unit.as_str();
        if !units.contains_key(name) {
            let readings = of_unit(name);
            let samples: Vec<Sample> =
                readings.iter().map(|reading| as_sample(reading)).collect::<Result<_, _>>()?;
            // A radio unit that the fitted part did not hear has the mean of all.
            let mean = match readings.is_empty() {
                true => Normal::of(fitted.iter().map(|reading| reading.signal.0)),
                false => Normal::of(readings.iter().map(|reading| reading.signal.0)),
            };
            units.insert(name, (samples, mean));
        }
        let (samples, mean) = &units[name];
        let own = as_sample(reading)?;
        // The model is one of values, which differ from signals by what is known of the radio unit.
        let known = reading.signal.0 - own.value;
        let signal = |value: Normal| Normal { mean: value.mean + known, ..value };
        let (unit, at) = radio_unit(testbed, name)?;
        let before = wireless.mean_signal(unit, at.distance(reading.place)).0
            - wireless.wall_loss_db(at, reading.place);
        let (nearby, left) = fit.middle.predict_nearby(&own, samples);
        let factors = [own.factors, left, [0.0; COEFFICIENTS], [0.0; COEFFICIENTS]];
        let predicted = [
            signal(fit.middle.predict(&own)),
            signal(nearby),
            *mean,
            Normal { mean: before, deviation: wireless.shadowing.deviation_db },
        ];
        let mut draw =
            |normal: Normal| (0..drawn).map(|_| normal.mean + normal.deviation * draws.normal()).collect();
        let drawn = predicted.map(&mut draw);
        tested.push(Tested { time_s: reading.time_s, signal: reading.signal.0, predicted, factors, drawn });
    }
    Ok(tested)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Dbm, Position};

    use super::*;

    fn reading(time_s: f64) -> Reading {
        Reading { time_s, place: Position::new(1.0, 2.0), radio_unit: "R".to_owned(), signal: Dbm(-50.0) }
    }

    #[test]
    fn a_survey_is_split_by_time_and_moments_stay_whole() {
        let readings: Vec<_> = [4.0, 1.0, 2.0, 2.0, 2.0, 3.0].map(reading).into();
        let times = |share| {
            split_survey(&readings, share).map(|part| part.iter().map(|r| r.time_s).collect::<Vec<_>>())
        };
        assert_eq!(times(0.5), [vec![1.0, 2.0, 2.0, 2.0], vec![3.0, 4.0]]);
        assert_eq!(times(0.17), [vec![1.0], vec![2.0, 2.0, 2.0, 3.0, 4.0]]);
    }

    #[test]
    fn distances_of_signals_match_those_by_hand() {
        let tested = |signal: f64, drawn: [f64; 2]| Tested {
            time_s: 0.0,
            signal,
            predicted: [Normal { mean: signal - 1.0, deviation: 0.5 }; 4],
            factors: [[-1.0, 0.0, 0.0]; 4],
            drawn: std::array::from_fn(|_| drawn.to_vec()),
        };
        let both = [tested(-50.0, [-53.0, -49.0]), tested(-60.0, [-60.0, -61.0])];
        let both: Vec<&Tested> = both.iter().collect();
        // -60 against -61 and -60, and -50 against -53 and -49.
        assert_eq!(distance(&both, 0), (1.0 + 3.0 + 1.0) / 4.0);
        let off = Off { coefficients: [2.0, 7.0, 7.0], deviation: 3.6 };
        assert_eq!((median_if_off(&both, 0, off), within_if_off(&both, 0, off)), (3.0, 0.0));
        assert_eq!(within_if_off(&both, 0, Off { deviation: 3.7, ..off }), 1.0);
        assert_eq!(Figures::of(&both, 0).0[..5], [1.0, 1.0, 1.0, 1.0, 0.0]);
    }
}
