//! Curves: a figure over time in a bounded number of points. Each point summarises its samples, and says whether some were
//! lost.

use cotorra_graph::{Figure, Timestamp};
use cotorra_numbers as numbers;
use serde::{Deserialize, Serialize};

use crate::{
    rolled::{Reading, Summary},
    run::Gap,
};

/// Requested shape of a curve.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveRequest {
    /// Most points; clamped to 1 … [`Self::MAX_POINTS`].
    pub points: usize,
    /// Quantiles of each point, as shares that are clamped to 0 … 1. Those after the first [`Self::MAX_QUANTILES`] are
    /// ignored.
    pub quantiles: Vec<f64>,
}

impl CurveRequest {
    /// Most points of any curve.
    pub const MAX_POINTS: usize = 10_000;
    /// Most quantiles of any point.
    pub const MAX_QUANTILES: usize = 16;
}

impl Default for CurveRequest {
    /// 1000 points with their medians.
    fn default() -> Self {
        Self { points: 1000, quantiles: vec![0.5] }
    }
}

/// A figure over time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Curve {
    /// Figure that the curve shows.
    #[schema(value_type = String)]
    pub figure: Figure,
    /// Unit of the figure; empty for a bare number.
    pub unit: String,
    /// The quantiles that points have, as shares from 0 to 1.
    pub quantiles: Vec<f64>,
    /// Points in the order of time. A time without samples and without losses has none.
    pub points: Vec<Point>,
}

/// The samples of a stretch of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Point {
    /// Start, nanoseconds since the run began.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// End, excluded.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// Whether events were lost in this time, or around it.
    pub gap: bool,
    /// Summary of the samples; `None` for a gap without samples.
    #[serde(flatten)]
    pub values: Option<Values>,
}

/// A summary of samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Values {
    /// Number of samples.
    pub count: u64,
    /// Number of samples that were rolled up. They count fully in all figures but the quantiles, for which only the least, the
    /// greatest and the mean of the samples of each step are left.
    #[serde(default)]
    pub rolled_up: u64,
    /// Least sample.
    pub min: f64,
    /// Greatest sample.
    pub max: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Latest sample.
    pub last: f64,
    /// Requested quantiles, by linear interpolation between closest ranks (type 7 of Hyndman and Fan, 1996).
    pub quantiles: Vec<f64>,
    /// If the quantiles are approximate, because samples were rolled up, or because there are more than a million: the least
    /// and the greatest value that each has for certain. Empty if they are exact.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub quantiles_within: Vec<[f64; 2]>,
}

/// Samples that are being gathered.
#[derive(Debug, Clone)]
pub(crate) struct Gathered {
    count: u64,
    rolled_up: u64,
    min: f64,
    max: f64,
    sum: f64,
    last: f64,
    samples: numbers::Gathered,
    /// The samples at their least and at their greatest, as far as summaries have them; `None` if nothing was rolled up.
    bounds: Option<Box<[numbers::Gathered; 2]>>,
}

impl Default for Gathered {
    fn default() -> Self {
        let (min, max) = (f64::INFINITY, f64::NEG_INFINITY);
        let samples = numbers::Gathered::default();
        Self { count: 0, rolled_up: 0, min, max, sum: 0.0, last: f64::NAN, samples, bounds: None }
    }
}

impl Gathered {
    pub fn read(&mut self, reading: Reading) {
        match reading {
            Reading::Sample(value) => self.add(value),
            Reading::RolledUp(summary) => self.add_all(summary),
        }
    }

    pub fn add(&mut self, value: f64) {
        self.samples.add(value);
        if let Some(bounds) = &mut self.bounds {
            bounds.iter_mut().for_each(|all| all.add(value));
        }
        self.count += 1;
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.sum += value;
        self.last = value;
    }

    fn add_all(&mut self, Summary { count, min, max, sum, last }: Summary) {
        let bounds = self.bounds.get_or_insert_with(|| {
            let before = &self.samples;
            Box::new([before.clone(), before.clone()])
        });
        let [least, greatest] = &mut **bounds;
        least.add_times(min, 1);
        greatest.add_times(max, 1);
        self.samples.add(min);
        // One sample is the least, one is the greatest, and the others have this mean.
        if let Some(others) = count.checked_sub(2) {
            let mean = ((sum - min - max) / others.max(1) as f64).max(min).min(max);
            self.samples.add_times(mean, others);
            self.samples.add(max);
            least.add_times(min, others);
            greatest.add_times(max, others);
            least.add(max);
            greatest.add(min);
        }
        self.count += count;
        self.rolled_up += count;
        self.min = self.min.min(min);
        self.max = self.max.max(max);
        self.sum += sum;
        self.last = last;
    }

    /// Returns the summary, `None` without samples, and starts over with the same memory.
    pub fn finish(&mut self, quantiles: &[f64]) -> Option<Values> {
        let values = self.samples.sorted().map(|sorted| {
            let found: Vec<_> = quantiles.iter().map(|share| sorted.quantile(*share)).collect();
            let within = |of: &numbers::Sorted| {
                quantiles.iter().map(|share| of.quantile(*share).within).collect::<Vec<_>>()
            };
            let bounds =
                match self.bounds.as_deref().map(|bounds| bounds.each_ref().map(numbers::Gathered::sorted)) {
                    Some([Some(least), Some(greatest)]) => Some((within(&least), within(&greatest))),
                    _ => sorted.is_approximate().then(|| (within(&sorted), within(&sorted))),
                };
            let within = bounds.into_iter().flat_map(|(low, high)| low.into_iter().zip(high));
            Values {
                count: self.count,
                rolled_up: self.rolled_up,
                min: self.min,
                max: self.max,
                mean: self.sum / self.count as f64,
                last: self.last,
                quantiles: found.iter().map(|found| found.value).collect(),
                quantiles_within: within.map(|(low, high)| [low.low, high.high]).collect(),
            }
        });
        let mut samples = std::mem::take(&mut self.samples);
        samples.clear();
        *self = Self { samples, ..Self::default() };
        values
    }
}

/// Draws a curve over a span that holds all samples.
pub(crate) struct Drawing {
    from: i64,
    width: i64,
    quantiles: Vec<f64>,
    gaps: Vec<Gap>,
    points: Vec<Point>,
    /// Number of the point that is being filled.
    current: i64,
    gathered: Gathered,
}

impl Drawing {
    /// Starts a curve from `from` to `until`, both included. `gaps` are all that overlap with that.
    pub fn new(from: i64, until: i64, request: &CurveRequest, gaps: Vec<Gap>) -> Self {
        let points = request.points.clamp(1, CurveRequest::MAX_POINTS) as i64;
        let shares = request.quantiles.iter().take(CurveRequest::MAX_QUANTILES);
        Self {
            from,
            // Nanoseconds of a point, rounded up.
            width: (until - from) / points + 1,
            quantiles: shares.map(|share| share.clamp(0.0, 1.0)).collect(),
            gaps,
            points: Vec::new(),
            current: 0,
            gathered: Gathered::default(),
        }
    }

    /// Adds a reading that is no earlier than those before.
    pub fn read(&mut self, t: i64, reading: Reading) {
        let place = (t - self.from) / self.width;
        if place != self.current {
            self.close();
            self.current = place;
        }
        self.gathered.read(reading);
    }

    fn close(&mut self) {
        let values = self.gathered.finish(&self.quantiles);
        if values.is_some() {
            let point = self.point(self.current, values);
            self.points.push(point);
        }
    }

    fn point(&self, place: i64, values: Option<Values>) -> Point {
        let from = self.from + place * self.width;
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());
        Point { from: time(from), until: time(from.saturating_add(self.width)), gap: false, values }
    }

    /// Returns the curve, with its gaps marked.
    pub fn finish(mut self, figure: Figure, until: i64) -> Curve {
        self.close();
        let mut points = std::mem::take(&mut self.points);
        for gap in &self.gaps {
            let clamp =
                |t: Timestamp| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX).clamp(self.from, until);
            let place = |t: Timestamp| (clamp(t) - self.from) / self.width;
            for place in place(gap.from)..=place(gap.until) {
                let point = self.point(place, None);
                match points.binary_search_by_key(&point.from, |point| point.from) {
                    Ok(found) => points[found].gap = true,
                    Err(free) => points.insert(free, Point { gap: true, ..point }),
                }
            }
        }
        let unit = figure.unit().to_owned();
        Curve { figure, unit, quantiles: self.quantiles, points }
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::LatenessQuantity;

    const FIGURE: Figure = Figure::Lateness(LatenessQuantity::P99);

    fn draw(samples: &[(i64, f64)], gaps: Vec<Gap>, points: usize) -> Curve {
        let (from, until) = (samples[0].0, samples[samples.len() - 1].0);
        let request = CurveRequest { points, quantiles: vec![0.0, 0.5, 1.0] };
        let mut drawing = Drawing::new(from, until, &request, gaps);
        samples.iter().for_each(|(t, value)| drawing.read(*t, Reading::Sample(*value)));
        drawing.finish(FIGURE, until)
    }

    proptest! {
        /// Every sample is in one point, and each point summarises its samples.
        #[test]
        fn points_are_their_samples(
            mut samples in vec((0..i64::MAX, -1e6..1e6), 1..200),
            points in 0..50_usize,
            gap in (any::<u64>(), any::<u64>()),
        ) {
            samples.sort_by_key(|(t, _)| *t);
            let time = Timestamp::from_nanos;
            let gap = Gap { from: time(gap.0.min(gap.1)), until: time(gap.0.max(gap.1)), events: 1 };
            let curve = draw(&samples, vec![gap], points);
            prop_assert!(curve.points.len() <= points.max(1));
            prop_assert!(curve.points.is_sorted_by(|a, b| a.until <= b.from));
            let mut rest = &samples[..];
            for point in &curve.points {
                let inside = |t: i64| point.from <= time(t as u64) && time(t as u64) < point.until;
                let Some(values) = &point.values else {
                    prop_assert!(point.gap && !rest.first().is_some_and(|(t, _)| inside(*t)));
                    continue;
                };
                let (mine, others) = rest.split_at(values.count as usize);
                prop_assert!(mine.iter().all(|(t, _)| inside(*t)));
                rest = others;
                let mut sorted: Vec<f64> = mine.iter().map(|(_, value)| *value).collect();
                sorted.sort_by(f64::total_cmp);
                let (min, max) = (sorted[0], sorted[sorted.len() - 1]);
                prop_assert_eq!((values.min, values.max, values.last), (min, max, mine[mine.len() - 1].1));
                let median = numbers::median(sorted).unwrap();
                prop_assert_eq!(&values.quantiles, &[min, median, max]);
                prop_assert!(values.quantiles_within.is_empty());
                prop_assert!(min - 1e-6 <= values.mean && values.mean <= max + 1e-6);
            }
            prop_assert!(rest.is_empty());
        }
    }

    #[test]
    fn points_show_their_gaps() {
        let samples: Vec<(i64, f64)> = [0, 1, 2, 30, 31, 99].map(|t| (t, t as f64)).to_vec();
        let time = Timestamp::from_nanos;
        let gaps = vec![Gap { from: time(35), until: time(52), events: 3 }];
        let curve = draw(&samples, gaps, 10);
        let points: Vec<_> = curve
            .points
            .iter()
            .map(|point| (point.from.as_nanos(), point.gap, point.values.as_ref().map_or(0, |v| v.count)))
            .collect();
        assert_eq!(points, [(0, false, 3), (30, true, 2), (40, true, 0), (50, true, 0), (90, false, 1)]);
    }

    #[test]
    fn rolled_up_samples_have_quantiles_within_bounds_and_say_so() {
        let samples: Vec<f64> = (0..1000).map(|n| f64::from(n * 7919 % 1000)).collect();
        let exact = {
            let mut all = Gathered::default();
            samples.iter().for_each(|value| all.add(*value));
            all.finish(&[0.5, 0.99]).unwrap()
        };
        assert_eq!((&exact.quantiles[..], exact.quantiles_within.len()), (&[499.5, 989.01][..], 0));
        let mut rolled = Gathered::default();
        for step in samples[..900].chunks(30) {
            rolled.read(Reading::RolledUp(Summary {
                count: 30,
                min: step.iter().copied().fold(f64::INFINITY, f64::min),
                max: step.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                sum: step.iter().sum(),
                last: step[29],
            }));
        }
        samples[900..].iter().for_each(|value| rolled.read(Reading::Sample(*value)));
        let rolled = rolled.finish(&[0.5, 0.99]).unwrap();
        assert_eq!((rolled.count, rolled.rolled_up, rolled.mean), (1000, 900, exact.mean));
        for place in 0..2 {
            let [low, high] = rolled.quantiles_within[place];
            assert!(low <= exact.quantiles[place] && exact.quantiles[place] <= high, "{rolled:?}");
            assert!(low <= rolled.quantiles[place] && rolled.quantiles[place] <= high, "{rolled:?}");
        }
        // Each middle sample of a step is near its mean.
        assert!((rolled.quantiles[0] - 499.5).abs() < 100.0, "{rolled:?}");
    }

    #[test]
    fn summaries_of_one_or_two_samples_are_exact() {
        let mut rolled = Gathered::default();
        let one = Summary { count: 1, min: 3.0, max: 3.0, sum: 3.0, last: 3.0 };
        let two = Summary { count: 2, min: 1.0, max: 2.0, sum: 3.0, last: 2.0 };
        rolled.read(Reading::RolledUp(one));
        rolled.read(Reading::RolledUp(two));
        let rolled = rolled.finish(&[0.25, 0.5]).unwrap();
        assert_eq!(rolled.quantiles, [1.5, 2.0]);
        assert_eq!(rolled.quantiles_within, [[1.5, 1.5], [2.0, 2.0]]);
    }
}
