//! The distance of two sets of runs, with its interval over seeds, and whether it is within a bound.

use std::{collections::BTreeMap, time::Duration};

use cotorra_numbers::{Mean, Quantiles};

use crate::{Carried, Measured, Ours, Run, ours::Group};

/// Distances within which two simulators agree: up to these, no decision that stands on the figure changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Of ns-3's figure.
    pub share: f64,
    /// In the figure's unit, whatever its share.
    pub least: f64,
}

/// A figure that is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Figure {
    /// Median of the times, ms.
    Median,
    /// 95th percentile of the times, ms.
    P95,
    /// 99th percentile of the times, ms.
    P99,
    /// Requests above the target or without an answer, %.
    AboveTarget,
    /// Datagrams of a source of traffic that did not arrive, %.
    Lost,
    /// Ethernet frames from a robot at its radio units, or payload of a source of traffic that arrived, Mbit/s.
    Throughput,
}

impl Figure {
    /// Returns its title, with its unit.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Median => "median, ms",
            Self::P95 => "p95, ms",
            Self::P99 => "p99, ms",
            Self::AboveTarget => "above target, %",
            Self::Lost => "lost, %",
            Self::Throughput => "throughput, Mbit/s",
        }
    }

    /// Returns its bound.
    pub const fn bound(self) -> Bound {
        match self {
            Self::Median => Bound { share: 0.10, least: 0.2 },
            Self::P95 => Bound { share: 0.15, least: 0.5 },
            Self::P99 => Bound { share: 0.20, least: 1.0 },
            Self::AboveTarget | Self::Lost => Bound { share: 0.0, least: 2.0 },
            Self::Throughput => Bound { share: 0.05, least: 0.05 },
        }
    }
}

/// Whether both sides agree on a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The mean distance is within the bound.
    Agrees,
    /// It is not, but its interval reaches into the bound: more seeds may decide.
    Undecided,
    /// The whole interval lies beyond the bound.
    Differs,
}

/// A figure of both sides.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The service or the robot.
    pub of: String,
    /// The figure.
    pub figure: Figure,
    /// Mean over seeds here.
    pub ours: f64,
    /// Mean over seeds in ns-3.
    pub theirs: f64,
    /// Mean difference of runs with the same seed, ours less ns-3's.
    pub distance: Mean,
    /// Judged by the bound.
    pub verdict: Verdict,
}

/// All figures of both sides.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// By service and robot, in order.
    pub rows: Vec<Row>,
}

impl Compared {
    /// Whether no figure differs.
    pub fn agrees(&self) -> bool {
        self.rows.iter().all(|row| row.verdict != Verdict::Differs)
    }
}

/// Compares runs of both sides, one pair a seed. `targets` has the target of each service.
pub fn compare(pairs: &[(Ours, Run)], targets: &BTreeMap<String, Duration>) -> Compared {
    let mut rows = Vec::new();
    let Some((first, _)) = pairs.first() else { return Compared { rows } };
    for group in &first.groups {
        let mut figures: BTreeMap<Figure, Vec<(f64, f64)>> = BTreeMap::new();
        for (ours, theirs) in pairs {
            let mut theirs = group.figures(theirs, ours, targets);
            for (figure, value) in group.figures(&ours.run, ours, targets) {
                let both = theirs.remove(&figure).map(|theirs| (theirs, value));
                figures.entry(figure).or_default().extend(both);
            }
        }
        rows.extend(figures.iter().filter_map(|(figure, values)| row(&group.name, *figure, values)));
    }
    Compared { rows }
}

impl Group {
    /// Returns the figures of a run. Requests that do not count in ours do not in the other.
    fn figures(&self, run: &Run, ours: &Ours, targets: &BTreeMap<String, Duration>) -> BTreeMap<Figure, f64> {
        let mut figures = BTreeMap::new();
        let mut gathered = Gathered::default();
        for service in &self.services {
            let target_ms = targets.get(service).map(|target| target.as_secs_f64() * 1e3);
            let skipped = ours.uncounted.get(service);
            let counts = |number: &u32| skipped.is_none_or(|skipped| !skipped.contains(number));
            gathered.add(run.senders.get(service), target_ms, counts);
        }
        figures.extend(gathered.figures());
        if !self.robots.is_empty() {
            let mbps = self.robots.iter().filter_map(|robot| run.mbps.get(robot)).sum();
            figures.insert(Figure::Throughput, mbps);
        }
        let carried: Vec<_> = self.sources.iter().filter_map(|source| run.traffic.get(source)).collect();
        if !carried.is_empty() {
            figures.insert(Figure::Throughput, carried.iter().map(|carried| carried.mbps).sum());
        }
        let mean = |of: &dyn Fn(&Carried) -> Option<f64>| {
            let values: Vec<_> = carried.iter().filter_map(|carried| of(carried)).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let of_delay =
            |quantile: fn(&Quantiles) -> f64| mean(&|carried| carried.delay_ms.as_ref().map(quantile));
        let means = [
            (Figure::Median, of_delay(|delay| delay.p50)),
            (Figure::P95, of_delay(|delay| delay.p95)),
            (Figure::P99, of_delay(|delay| delay.p99)),
            (Figure::Lost, mean(&|carried| carried.lost)),
        ];
        figures.extend(means.into_iter().filter_map(|(figure, mean)| Some((figure, mean?))));
        figures
    }
}

/// The measurements of a group.
#[derive(Debug, Default)]
struct Gathered {
    took_ms: Vec<f64>,
    sent: u32,
    kept: u32,
}

impl Gathered {
    /// Adds the requests of a service that count. Those that a side did not send do not.
    fn add(&mut self, measured: Option<&Measured>, target_ms: Option<f64>, counts: impl Fn(&u32) -> bool) {
        let Some(Measured { took_ms, sent }) = measured else { return };
        self.sent += (0..*sent).filter(|number| counts(number)).count() as u32;
        let counted: Vec<_> =
            took_ms.iter().filter(|(number, _)| counts(number)).map(|(_, ms)| *ms).collect();
        self.kept += counted.iter().filter(|ms| target_ms.is_none_or(|target| **ms <= target)).count() as u32;
        self.took_ms.extend(counted);
    }

    fn figures(&self) -> BTreeMap<Figure, f64> {
        let times = Quantiles::of(self.took_ms.clone());
        let above = || 100.0 * (1.0 - f64::from(self.kept) / f64::from(self.sent));
        let of = |quantile: fn(Quantiles) -> f64| times.map(quantile);
        let figures = [
            (Figure::Median, of(|times| times.p50)),
            (Figure::P95, of(|times| times.p95)),
            (Figure::P99, of(|times| times.p99)),
            (Figure::AboveTarget, (self.sent > 0).then(above)),
        ];
        figures.into_iter().filter_map(|(figure, value)| Some((figure, value?))).collect()
    }
}

fn row(of: &str, figure: Figure, pairs: &[(f64, f64)]) -> Option<Row> {
    let distance = Mean::of_differences(pairs)?;
    let mean = |side: fn(&(f64, f64)) -> f64| pairs.iter().map(side).sum::<f64>() / pairs.len() as f64;
    let (theirs, ours) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let Bound { share, least } = figure.bound();
    let bound = (share * theirs).max(least);
    let (low, high) = distance.interval.map_or((distance.mean, distance.mean), |i| (i.low, i.high));
    let verdict = if distance.mean.abs() <= bound {
        Verdict::Agrees
    } else if low <= bound && high >= -bound {
        Verdict::Undecided
    } else {
        Verdict::Differs
    };
    Some(Row { of: of.to_owned(), figure, ours, theirs, distance, verdict })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_differs_only_if_its_whole_interval_does() {
        let verdict = |pairs: &[(f64, f64)]| row("navigation", Figure::Median, pairs).unwrap().verdict;
        assert_eq!(verdict(&[(10.0, 10.9), (10.0, 10.8), (10.0, 11.0)]), Verdict::Agrees);
        assert_eq!(verdict(&[(10.0, 14.0), (10.0, 10.0), (10.0, 10.0)]), Verdict::Undecided);
        assert_eq!(verdict(&[(10.0, 14.0), (10.0, 14.1), (10.0, 13.9)]), Verdict::Differs);
        // Within 0.2 ms, shares do not matter.
        assert_eq!(verdict(&[(0.5, 0.65), (0.5, 0.66)]), Verdict::Agrees);
    }

    #[test]
    fn requests_without_an_answer_are_above_the_target() {
        let measured = Measured { took_ms: [(0, 5.0), (1, 20.0), (3, 6.0)].into(), sent: 5 };
        let mut gathered = Gathered::default();
        // The last request does not count.
        gathered.add(Some(&measured), Some(15.0), |number| *number < 4);
        let figures = gathered.figures();
        assert_eq!((figures[&Figure::AboveTarget], figures[&Figure::Median]), (50.0, 6.0));
        assert!(Gathered::default().figures().is_empty());
    }
}
