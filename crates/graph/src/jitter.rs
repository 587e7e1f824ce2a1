//! Jitter of links: a random part of the delay, and its correlation from one packet to the next, or over time.

use std::{
    f64::consts::{FRAC_1_SQRT_2, PI},
    fmt,
    num::NonZeroU16,
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::units::millis;

/// Random addition to a delay, with mean zero; a total below zero counts as zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Jitter {
    /// Half-width of a uniform, standard deviation of the other distributions.
    #[serde(rename = "deviation_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub deviation: Duration,
    /// Shape of the distribution.
    #[serde(default)]
    pub distribution: JitterDistribution,
    /// Correlation with the jitter of the next packet.
    #[serde(default, skip_serializing_if = "Correlation::is_none")]
    pub correlation: Correlation,
    /// Time over which it changes: the integral of its scores' correlation over time. Without it, each
    /// packet has a jitter of its own.
    #[serde(rename = "over_ms", default, skip_serializing_if = "Option::is_none")]
    pub over: Option<CorrelationTime>,
}

impl Jitter {
    /// Checks that its distribution can have its correlation, and that it has one kind of correlation.
    ///
    /// # Errors
    /// [`InvalidCorrelation`] if the correlation is too far below zero, or if there is one over time, too.
    pub fn check(&self) -> Result<(), InvalidCorrelation> {
        if self.over.is_some() && !self.correlation.is_none() {
            return Err(InvalidCorrelation::Both);
        }
        let least = self.distribution.correlation(-1.0);
        if self.correlation.get() > least { Ok(()) } else { Err(InvalidCorrelation::TooLow { least }) }
    }

    /// Returns the mean of a delay with this jitter, to a microsecond, if it is above the delay by more than 1 %: totals below
    /// zero, which count as zero, are frequent then.
    ///
    /// It is the expected value of max(0, d + J), by integrals of the density of J:
    /// - uniform within ± w, for w > d: (d + w)² / 4w;
    /// - normal, with deviation σ: d Φ(d/σ) + σ φ(d/σ);
    /// - Pareto with shape 3, moved and scaled, for a delay below σ/√3: s / 2c², where s = 2σ/√3 and c = 3/2 - d/s.
    pub fn raised_mean(&self, delay: Duration) -> Option<Duration> {
        let [d, deviation] = [delay, self.deviation].map(|time| time.as_secs_f64());
        if deviation == 0.0 {
            return None;
        }
        let mean = match self.distribution {
            JitterDistribution::Uniform if deviation > d => (d + deviation).powi(2) / (4.0 * deviation),
            JitterDistribution::Normal => {
                let score = d / deviation;
                let below = libm::erfc(-score * FRAC_1_SQRT_2) / 2.0;
                d * below + deviation * (-score * score / 2.0).exp() / (2.0 * PI).sqrt()
            }
            JitterDistribution::Pareto if deviation > d * 3f64.sqrt() => {
                let scale = 2.0 * deviation / 3f64.sqrt();
                let cut = 1.5 - d / scale;
                scale / (2.0 * cut * cut)
            }
            JitterDistribution::Uniform | JitterDistribution::Pareto => d,
        };
        (mean > d * 1.01).then(|| Duration::from_micros((mean * 1e6).round() as u64))
    }

    /// Whether a packet's jitter depends on those before it.
    pub fn is_correlated(&self) -> bool {
        self.over.is_some() || !self.correlation.is_none()
    }

    /// Returns the correlation of the normal scores behind this jitter.
    pub fn score_correlation(&self) -> f64 {
        self.distribution.score_correlation(self.correlation)
    }
}

/// Error of a correlation that a jitter cannot have.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum InvalidCorrelation {
    /// A distribution with a long tail on one side only is never the mirror image of itself.
    #[error("the jitter's distribution allows no correlation of {:.1} % or below", least * 100.0)]
    TooLow {
        /// The bound.
        least: f64,
    },
    /// Jitter changes over time or from packet to packet.
    #[error("the jitter has a correlation from packet to packet and one over time: leave one out")]
    Both,
}

/// Correlation of a packet's jitter with that of the next packet: above -1 and below 1.
///
/// Jitter is then a Gaussian copula (Cario and Nelson, Modeling and generating random vectors with arbitrary marginal
/// distributions and correlation matrix, 1997): each packet has a normal score, scores are an autoregression of first order,
/// and a jitter is the quantile of its distribution at the score's probability. The distribution of single jitters is exactly
/// the one asked for.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, utoipa::ToSchema,
)]
#[schema(value_type = f64)]
#[serde(try_from = "f64", into = "f64")]
// In millionths, so that conditions stay small.
pub struct Correlation(i32);

impl Correlation {
    /// Each jitter is independent of those before.
    pub const NONE: Self = Self(0);

    /// Rounds to a millionth. `None` if that is -1 or below, or 1 or above, and for NaN.
    pub fn new(correlation: f64) -> Option<Self> {
        let millionths = (correlation * 1e6).round();
        (millionths.abs() < 1e6).then_some(Self(millionths as i32))
    }

    /// The number between -1 and 1.
    pub fn get(self) -> f64 {
        f64::from(self.0) / 1e6
    }

    /// Whether it is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }
}

impl From<Correlation> for f64 {
    fn from(correlation: Correlation) -> Self {
        correlation.get()
    }
}

impl TryFrom<f64> for Correlation {
    type Error = &'static str;
    fn try_from(correlation: f64) -> Result<Self, Self::Error> {
        Self::new(correlation).ok_or("a correlation is above -1 and below 1")
    }
}

impl fmt::Display for Correlation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} %", f64::from(self.0) / 1e4)
    }
}

/// Time over which a jitter changes: 1 ms to 65 s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(value_type = f64)]
#[serde(try_from = "f64", into = "f64")]
// In milliseconds, so that conditions stay small.
pub struct CorrelationTime(NonZeroU16);

impl CorrelationTime {
    /// Rounds to a millisecond. `None` if that is out of range.
    pub fn new(time: Duration) -> Option<Self> {
        let ms = u16::try_from((time + Duration::from_micros(500)).as_millis()).ok()?;
        NonZeroU16::new(ms).map(Self)
    }

    /// Returns the time.
    pub fn get(self) -> Duration {
        Duration::from_millis(u64::from(self.0.get()))
    }
}

impl From<CorrelationTime> for f64 {
    fn from(time: CorrelationTime) -> Self {
        millis::of(time.get())
    }
}

impl TryFrom<f64> for CorrelationTime {
    type Error = &'static str;
    fn try_from(ms: f64) -> Result<Self, Self::Error> {
        let time = millis::duration(ms).ok().and_then(Self::new);
        time.ok_or("a jitter changes over a time from 1 ms to 65 s")
    }
}

/// Shape of a jitter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JitterDistribution {
    /// Every value within ± deviation is as likely.
    Uniform,
    /// Gaussian.
    #[default]
    Normal,
    /// Pareto with shape 3, moved and scaled to mean zero and the given standard deviation: a long upper tail.
    Pareto,
}

/// Shares of the powers 1, 2, … of the normal scores' correlation in the correlation of Pareto jitters: (E X·Heₖ(Z))²/(k!·Var X)
/// for X = Φ(-Z)^(-1/3), by the expansion of the bivariate normal density in Hermite polynomials (Mehler 1866).
const PARETO_POWERS: [f64; 16] = [
    0.460_163, 0.290_058, 0.132_382, 0.059_997, 0.029_411, 0.014_418, 0.006_921, 0.003_375, 0.001_668,
    0.000_817, 0.000_400, 0.000_198, 0.000_098, 0.000_048, 0.000_024, 0.000_022,
];

impl JitterDistribution {
    /// Returns the correlation of two jitters whose normal scores have this correlation, from -1 to 1.
    pub fn correlation(self, of_scores: f64) -> f64 {
        match self {
            Self::Normal => of_scores,
            // Pearson 1907: of the ranks of a bivariate normal distribution.
            Self::Uniform => 6.0 / PI * (of_scores / 2.0).asin(),
            Self::Pareto => PARETO_POWERS.iter().rev().fold(0.0, |sum, share| (sum + share) * of_scores),
        }
    }

    /// Returns the correlation of the normal scores of two jitters with this correlation: the inverse of
    /// [`correlation`](Self::correlation). A correlation that the distribution cannot have gives -1.
    pub fn score_correlation(self, correlation: Correlation) -> f64 {
        let correlation = correlation.get();
        match self {
            Self::Normal => correlation,
            Self::Uniform => 2.0 * (PI / 6.0 * correlation).sin(),
            Self::Pareto => {
                let (mut low, mut high) = (-1.0, 1.0);
                // By halves, down to the precision of an f64.
                for _ in 0..54 {
                    let middle = (low + high) / 2.0;
                    if self.correlation(middle) < correlation { low = middle } else { high = middle }
                }
                low
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [JitterDistribution; 3] =
        [JitterDistribution::Uniform, JitterDistribution::Normal, JitterDistribution::Pareto];

    fn correlation(correlation: f64) -> Correlation {
        Correlation::new(correlation).unwrap()
    }

    #[test]
    fn correlations_of_jitters_and_of_scores_are_inverse() {
        for distribution in ALL {
            assert_eq!(distribution.correlation(0.0), 0.0);
            assert!((distribution.correlation(1.0) - 1.0).abs() < 1e-9, "{distribution:?}");
            for percent in -25..100 {
                let asked = correlation(f64::from(percent) / 100.0);
                let of_scores = distribution.score_correlation(asked);
                assert!(of_scores.abs() < 1.0);
                let got = distribution.correlation(of_scores);
                assert!((got - asked.get()).abs() < 1e-12, "{distribution:?}: {got} for {asked}");
            }
        }
    }

    #[test]
    fn pareto_correlations_match_known_values() {
        let pareto = |of_scores: f64| JitterDistribution::Pareto.correlation(of_scores);
        // Of opposite scores: (B(2/3, 2/3) - (3/2)²)/(3/4), with the beta function B.
        assert!((pareto(-1.0) + 0.262_146).abs() < 1e-4, "{}", pareto(-1.0));
        // By a double integral (Simpson's rule) over both scores' densities.
        for (of_scores, expected) in PARETO_INTEGRALS {
            assert!((pareto(of_scores) - expected).abs() < 1e-4, "{of_scores}: {}", pareto(of_scores));
        }
    }

    const PARETO_INTEGRALS: [(f64, f64); 4] =
        [(-0.5, -0.171_102), (0.3, 0.168_298), (0.6, 0.420_123), (0.9, 0.815_913)];

    #[test]
    fn a_correlation_is_between_minus_one_and_one() {
        for wrong in [-1.0, 1.0, 0.999_999_9, 1.5, f64::NAN, f64::INFINITY] {
            assert_eq!(Correlation::new(wrong), None);
        }
        let jitter = |distribution, percent: f64| Jitter {
            distribution,
            correlation: correlation(percent / 100.0),
            ..Jitter::default()
        };
        for distribution in [JitterDistribution::Uniform, JitterDistribution::Normal] {
            assert_eq!(jitter(distribution, -99.0).check(), Ok(()));
        }
        assert_eq!(jitter(JitterDistribution::Pareto, -26.0).check(), Ok(()));
        let error = jitter(JitterDistribution::Pareto, -27.0).check().unwrap_err();
        assert_eq!(error.to_string(), "the jitter's distribution allows no correlation of -26.2 % or below");
    }

    #[test]
    fn jitter_above_the_delay_raises_its_mean() {
        let [of_10, ms] = [Duration::from_millis(10), Duration::from_millis(1)];
        // Worked out apart from the formulas, by sums over 10⁶ equally probable quantiles.
        for (distribution, deviation, expected_us) in [
            (JitterDistribution::Uniform, 10, 10_000),
            (JitterDistribution::Uniform, 20, 11_250),
            (JitterDistribution::Uniform, 40, 15_625),
            (JitterDistribution::Normal, 5, 10_042),
            (JitterDistribution::Normal, 10, 10_833),
            (JitterDistribution::Normal, 20, 13_956),
            (JitterDistribution::Pareto, 17, 10_000),
            (JitterDistribution::Pareto, 20, 10_142),
            (JitterDistribution::Pareto, 40, 14_018),
        ] {
            let jitter = Jitter { deviation: ms * deviation, distribution, ..Jitter::default() };
            let mean = jitter.raised_mean(of_10).map(|mean| mean.as_micros());
            let is_right = mean.map_or(expected_us <= 10_100, |mean| mean.abs_diff(expected_us) <= 1);
            assert!(is_right, "{distribution:?}, {deviation} ms: {mean:?} µs");
        }
        assert_eq!(Jitter::default().raised_mean(of_10), None);
    }

    #[test]
    fn jitter_without_correlation_is_written_as_before() {
        let json = r#"{"deviation_ms":2.0,"distribution":"normal"}"#;
        let jitter: Jitter = serde_json::from_str(json).unwrap();
        assert!(jitter.correlation.is_none());
        assert_eq!(serde_json::to_string(&jitter).unwrap(), json);
        let correlated = Jitter { correlation: correlation(0.4), ..jitter };
        let text = serde_json::to_string(&correlated).unwrap();
        assert_eq!(text, r#"{"deviation_ms":2.0,"distribution":"normal","correlation":0.4}"#);
        assert_eq!(serde_json::from_str::<Jitter>(&text).unwrap(), correlated);
        let wrong = r#"{"deviation_ms":2.0,"correlation":1.0}"#;
        assert!(serde_json::from_str::<Jitter>(wrong).is_err());
    }

    #[test]
    fn jitter_is_correlated_by_packets_or_over_time() {
        let time = |us| CorrelationTime::new(Duration::from_micros(us));
        let over = |ms: u64| Jitter { over: time(1000 * ms), ..Jitter::default() };
        assert_eq!(over(50).check(), Ok(()));
        assert_eq!([0, 499, 66_000_000].map(time), [None; 3]);
        assert_eq!(time(1499).unwrap().get(), Duration::from_millis(1));
        let both = Jitter { correlation: correlation(0.1), ..over(50) };
        assert_eq!(both.check(), Err(InvalidCorrelation::Both));
        assert_eq!(
            [over(50), both, Jitter::default()].map(|jitter| jitter.is_correlated()),
            [true, true, false]
        );
        let text = serde_json::to_string(&over(50)).unwrap();
        assert_eq!(text, r#"{"deviation_ms":0.0,"distribution":"normal","over_ms":50.0}"#);
        assert_eq!(serde_json::from_str::<Jitter>(&text).unwrap(), over(50));
        assert!(serde_json::from_str::<Jitter>(&text.replace("50.0", "0.0")).is_err());
    }

    #[test]
    fn a_correlation_is_shown_in_percent() {
        assert_eq!(correlation(0.35).to_string(), "35 %");
        assert_eq!(correlation(-0.123_456_7).to_string(), "-12.3457 %");
    }
}
