//! The distance of two sets of runs, with its interval over seeds, and whether it is within a bound.

use std::{collections::BTreeMap, time::Duration};

use cotorra_numbers::{Mean, quantile};

use crate::{Measured, Ours, Run, ours::Group};

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
    /// Ethernet frames from a robot at its radio units, Mbit/s.
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
            Self::Throughput => "throughput, Mbit/s",
        }
    }

    /// Returns its bound.
    pub const fn bound(self) -> Bound {
        match self {
            Self::Median => Bound { share: 0.10, least: 0.2 },
            Self::P95 => Bound { share: 0.15, least: 0.5 },
            Self::P99 => Bound { share: 0.20, least: 1.0 },
            Self::AboveTarget => Bound { share: 0.0, least: 2.0 },
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
    for Group { name, services, robots } in &first.groups {
        let gathered: Vec<_> = pairs
            .iter()
            .map(|(ours, theirs)| {
                let [mut our, mut their] = [Gathered::default(), Gathered::default()];
                for service in services {
                    let target_ms = targets.get(service).map(|target| target.as_secs_f64() * 1e3);
                    let skipped = ours.uncounted.get(service);
                    let counts = |number: &u32| skipped.is_none_or(|skipped| !skipped.contains(number));
                    our.add(ours.run.senders.get(service), target_ms, counts);
                    their.add(theirs.senders.get(service), target_ms, counts);
                }
                [their, our]
            })
            .collect();
        for figure in [Figure::Median, Figure::P95, Figure::P99, Figure::AboveTarget] {
            let values =
                gathered.iter().filter_map(|[theirs, ours]| Some((theirs.of(figure)?, ours.of(figure)?)));
            rows.extend(row(name, figure, &values.collect::<Vec<_>>()));
        }
        let mbps = |run: &Run| robots.iter().filter_map(|robot| run.mbps.get(robot)).sum::<f64>();
        let values: Vec<_> = pairs.iter().map(|(ours, theirs)| (mbps(theirs), mbps(&ours.run))).collect();
        if !robots.is_empty() {
            rows.extend(row(name, Figure::Throughput, &values));
        }
    }
    Compared { rows }
}

/// The measurements of a group.
#[derive(Debug, Default)]
struct Gathered {
    /// Rising only when figures are taken.
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

    fn of(&self, figure: Figure) -> Option<f64> {
        let mut times = self.took_ms.clone();
        times.sort_by(f64::total_cmp);
        match figure {
            Figure::Median => quantile(&times, 0.5),
            Figure::P95 => quantile(&times, 0.95),
            Figure::P99 => quantile(&times, 0.99),
            Figure::AboveTarget => {
                (self.sent > 0).then(|| 100.0 * (1.0 - f64::from(self.kept) / f64::from(self.sent)))
            }
            Figure::Throughput => None,
        }
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
        assert_eq!(gathered.of(Figure::AboveTarget), Some(50.0));
        assert_eq!(gathered.of(Figure::Median), Some(6.0));
        assert_eq!(Gathered::default().of(Figure::AboveTarget), None);
    }
}
