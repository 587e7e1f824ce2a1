//! Differences between contenders, i.e. combinations, over the runs that share a seed.

use std::collections::BTreeMap;

use cotorra_graph::{Bound, Statistic, Total, Unit};
use cotorra_numbers::{self as numbers, FEWEST, Mean, holm};
use serde::Serialize;

use super::{
    column::{Column, above_target, service_time, total},
    measured::Measured,
    runs::Runs,
};

/// A figure of a combination, less that of the first combination with the same seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// One value per axis.
    pub values: Vec<String>,
    /// Name of the figure, as in the table of combinations; of a KPI, the service and the bound.
    pub figure: String,
    /// Number of pairs of runs with the same seed that both have the figure.
    pub pairs: usize,
    /// Mean difference.
    pub mean: f64,
    /// Interval of 95 % by Student's t distribution; `None` for a single pair.
    pub interval: Option<numbers::Interval>,
    /// Probability of a mean at least as far from 0 if there is no difference, corrected for the number of combinations (Holm).
    /// `None` with fewer than three pairs, which are too few.
    pub p: Option<f64>,
}

impl Difference {
    /// Whether there is a difference, at 5 % over all combinations; `None` if there are too few pairs.
    pub fn is_shown(&self) -> Option<bool> {
        self.p.map(|p| p < 0.05)
    }

    /// Returns the difference in another unit, as `+1.20 (+0.80 to +1.60) *`. The star marks one that is shown. Two pairs are
    /// too few to show an interval: `+1.20 (n = 2)`.
    pub fn times(&self, factor: f64) -> String {
        let mean = format!("{:+.2}", self.mean * factor);
        match self.interval {
            Some(_) if self.pairs < FEWEST => format!("{mean} (n = {})", self.pairs),
            Some(numbers::Interval { low, high }) => {
                let star = if self.is_shown() == Some(true) { " *" } else { "" };
                format!("{mean} ({:+.2} to {:+.2}){star}", low * factor, high * factor)
            }
            None => mean,
        }
    }
}

/// Returns the figures of a run that are compared, beside its KPIs, and whether each is a share.
fn compared() -> [Column<bool>; 8] {
    [
        service_time(Statistic::P50, false),
        service_time(Statistic::P95, false),
        service_time(Statistic::P99, false),
        above_target(true),
        total(Total::Handovers, false),
        total(Total::Migrations, false),
        total(Total::Duration, false),
        total(Total::Blind, false),
    ]
}

/// The values of a combination, and the figures of its runs by seed.
type Contender<'a> = (&'a [String], BTreeMap<u64, Vec<Compared>>);

/// A compared figure of a run, with the most that two of them can differ.
struct Compared {
    figure: String,
    most: f64,
    value: Option<f64>,
}

impl Compared {
    /// Returns the compared figures of a run.
    fn all(run: &Measured) -> Vec<Self> {
        let of = |figure: String, is_share: bool, value: Option<f64>| Self {
            figure,
            most: if is_share { 1.0 } else { f64::INFINITY },
            value,
        };
        let figures = run.figures();
        let named = |name: &str| figures.iter().find(|(its, _)| *its == name).and_then(|(_, value)| *value);
        let figures = compared().map(|(name, is_share)| of(name.clone(), is_share, named(&name)));
        let kpis = run.services.iter().flat_map(|its| its.kpis.iter().map(move |kpi| (its, kpi)));
        let bounds = kpis.filter_map(|(its, judged)| {
            let bound = judged.kpi.parse::<Bound>().ok()?;
            let is_share = bound.figure().unit == Unit::Share;
            Some(of(format!("{}: {bound}", its.service), is_share, judged.value))
        });
        let bill = run.bill.iter().map(|its| of(format!("price of {}", its.of), false, Some(its.amount)));
        let energy =
            run.energy.iter().map(|its| of(format!("energy of {}", its.of), false, Some(its.amount)));
        figures.into_iter().chain(bounds).chain(bill).chain(energy).collect()
    }
}

impl Runs {
    /// Returns how each combination differs from the first one that has runs, figure by figure. Combinations without a seed
    /// in common with it have no differences, and neither have those with a void run.
    pub fn differences(&self) -> Vec<Difference> {
        let mut contenders: Vec<Contender<'_>> = Vec::new();
        for cell in self.combinations() {
            let its = self.done.iter().filter(|done| done.point.values == *cell);
            let measured = its.map(|done| Some((done.point.seed, Compared::all(done.outcome.measured()?))));
            contenders.push((cell, measured.collect::<Option<_>>().unwrap_or_default()));
        }
        let Some(((_, first), others)) = contenders.split_first() else { return Vec::new() };
        let mut all = Vec::new();
        for Compared { figure, most, .. } in first.values().next().into_iter().flatten() {
            let read = |its: &Vec<Compared>| its.iter().find(|its| its.figure == *figure)?.value;
            let difference = |(values, runs): &Contender<'_>| {
                let pair = |(seed, run): (&u64, &Vec<Compared>)| Some((read(first.get(seed)?)?, read(run)?));
                let pairs: Vec<_> = runs.iter().filter_map(pair).collect();
                let Mean { n, mean, interval, p } = Mean::of_differences(&pairs)?;
                let interval = interval
                    .map(|its| numbers::Interval { low: its.low.max(-*most), high: its.high.min(*most) });
                Some(Difference {
                    values: values.to_vec(),
                    figure: figure.clone(),
                    pairs: n,
                    mean,
                    interval,
                    p,
                })
            };
            let mut its: Vec<_> = others.iter().filter_map(difference).collect();
            let told: Vec<_> = its.iter().filter_map(|difference| difference.p).collect();
            let corrected = holm(&told);
            its.iter_mut().filter_map(|its| its.p.as_mut()).zip(corrected).for_each(|(p, holm)| *p = holm);
            all.extend(its);
        }
        // By combination, in the order of the figures.
        all.sort_by_key(|its| others.iter().position(|(values, _)| *values == its.values));
        all
    }

    /// Returns the combinations that have runs, in their order.
    fn combinations(&self) -> Vec<&[String]> {
        let mut all: Vec<&[String]> = Vec::new();
        for done in &self.done {
            if all.last() != Some(&&done.point.values[..]) {
                all.push(&done.point.values);
            }
        }
        all
    }
}
