//! A mean, a deviation and a distribution, matched to a series of times, with resamples.

use cotorra_graph::JitterDistribution;
use cotorra_numbers::{Counted, Draws, Resampler};

use crate::{
    estimate::Estimate,
    jitter::{LEVELS, Located, levels, match_quantiles, standard_quantiles},
};

/// Resamples of a bootstrap.
pub(crate) const RESAMPLES: usize = 500;

/// A distribution of times.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Matched {
    /// Distribution whose quantiles are nearest to those of the times.
    pub distribution: JitterDistribution,
    /// Its mean and deviation.
    pub found: Located,
    /// Distance of each distribution to the quantiles of the times: root of the mean square.
    pub distances: Vec<(JitterDistribution, f64)>,
    /// Number of different times.
    pub distinct: usize,
    /// Mean length of a block of the bootstrap.
    pub block_length: f64,
    /// Means and deviations of resamples.
    pub resampled: Vec<Located>,
}

impl Matched {
    /// Matches the nearest of some distributions to times, of which there is at least one. Resamples have the distribution that
    /// is the nearest to all times.
    pub fn nearest(among: &[JitterDistribution], times: &[f64], draws: &mut Draws) -> Self {
        let mut ranked = Counted::new(times);
        (0..times.len()).for_each(|i| ranked.add(i));
        let distinct = ranked.counted().count();
        let observed = ranked.quantiles(levels());
        let matched: Vec<_> =
            among.iter().map(|its| (*its, match_quantiles(&standard_quantiles(*its), &observed))).collect();
        let nearest = matched.iter().min_by(|(_, a), (_, b)| a.distance.total_cmp(&b.distance));
        let (distribution, found) = *nearest.unwrap_or(&matched[0]);
        let standard = standard_quantiles(distribution);
        let resampler = Resampler::new(times);
        let resample = |_| {
            ranked.clear();
            resampler.resample(draws, |i| ranked.add(i));
            match_quantiles(&standard, &ranked.quantiles::<LEVELS>(levels()))
        };
        let resampled = (0..RESAMPLES).map(resample).collect();
        Self {
            distribution,
            found,
            distances: matched.iter().map(|(its, found)| (*its, found.distance)).collect(),
            distinct,
            block_length: resampler.length(),
            resampled,
        }
    }

    /// Returns the mean with its interval.
    pub fn mean(&self) -> Estimate {
        self.estimate(|located| located.mean)
    }

    /// Returns the deviation with its interval.
    pub fn deviation(&self) -> Estimate {
        self.estimate(|located| located.deviation)
    }

    /// Returns a figure of these times and others, with its interval. Resamples of both are independent.
    pub fn compared(&self, others: &Self, figure: impl Fn(&Located, &Located) -> f64) -> Estimate {
        let pairs = self.resampled.iter().zip(&others.resampled);
        let mut resampled: Vec<_> = pairs.map(|(these, others)| figure(these, others)).collect();
        Estimate::around(figure(&self.found, &others.found), &mut resampled)
    }

    fn estimate(&self, of: fn(&Located) -> f64) -> Estimate {
        Estimate::around(of(&self.found), &mut self.resampled.iter().map(of).collect::<Vec<_>>())
    }
}
