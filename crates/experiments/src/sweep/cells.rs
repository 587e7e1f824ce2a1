//! Statistics over the runs of one combination.

use std::collections::BTreeMap;

use cotorra_graph::{NodeId, ServiceId, Statistic, Total, TrafficId};
use cotorra_numbers::{self as numbers, FEWEST, Mean, share_over_runs};
use cotorra_testbed::{Verdict, Void};
use serde::Serialize;

use super::{
    column::{self, Column, service_time, total},
    measured::{Measured, MeasuredService},
    spent::Spent,
};
use crate::outcome::Outcome;

/// A combination of values, and the statistics over its runs. If any of them is void, so is the cell: it has no figures.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Cell {
    /// One value per axis.
    pub values: Vec<String>,
    /// Number of runs.
    pub runs: usize,
    /// The reason for which the first void run is, if there is one.
    pub void: Option<Void>,
    /// The runs' median service times, ms.
    pub service_time_p50_ms: Option<Interval>,
    /// The runs' 95th percentiles of the service time, ms.
    pub service_time_p95_ms: Option<Interval>,
    /// The runs' 99th percentiles of the service time, ms.
    pub service_time_p99_ms: Option<Interval>,
    /// The runs' shares of samples above the target.
    pub above_target: Option<Interval>,
    /// The runs' numbers of handovers.
    pub handovers: Option<Interval>,
    /// The runs' durations, ms.
    pub duration_ms: Option<Interval>,
    /// The runs' distances that robots drove blind, m.
    pub blind_m: Option<Interval>,
    /// The runs' longest blind stretches, m.
    pub longest_blind_m: Option<Interval>,
    /// The runs' verdicts.
    pub verdicts: Verdicts,
    /// Each service, in the file's order.
    pub services: Vec<ServiceCell>,
    /// The runs' goodputs of each source of traffic, bit/s.
    pub goodput_bps: Vec<(TrafficId, Interval)>,
    /// The runs' prices, if the testbed file has a currency.
    pub bill: Vec<SpentCell>,
    /// The runs' energies, if the testbed file has the power of any node.
    pub energy: Vec<SpentCell>,
}

/// Numbers of verdicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Verdicts {
    /// Number of runs with a verdict: 0 if the testbed file demands nothing.
    pub judged_runs: usize,
    /// Number of them that failed.
    pub failed_runs: usize,
}

/// A price or an energy over the runs of a combination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpentCell {
    /// What spent it.
    pub of: String,
    /// The currency, or `Wh`.
    pub unit: String,
    /// The runs' amounts.
    pub amount: Interval,
    /// The runs' amounts for each of their hours.
    pub per_hour: Interval,
}

/// Statistics of a robot's service over the runs of a combination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceCell {
    pub robot: NodeId,
    pub service: ServiceId,
    /// Whether it counts in the figures of all services together.
    pub in_total: bool,
    /// Number of runs with samples of the service.
    pub runs: usize,
    /// Target, ms.
    pub service_time_target_ms: f64,
    /// The runs' median service times, ms.
    pub service_time_p50_ms: Option<Interval>,
    /// The runs' 95th percentiles of the service time, ms.
    pub service_time_p95_ms: Option<Interval>,
    /// The runs' 99th percentiles of the service time, ms.
    pub service_time_p99_ms: Option<Interval>,
    /// The runs' shares of samples above the target.
    pub above_target: Option<Interval>,
    /// The runs' numbers of samples without an answer.
    pub unanswered: Option<Interval>,
    /// The runs' verdicts on the service.
    pub verdicts: Verdicts,
}

/// A mean over runs and its 95 % confidence interval, which is inside the range of the figure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// Number of runs.
    pub n: usize,
    pub mean: f64,
    /// Lower bound; `None` for a single run, which has no confidence interval.
    pub low: Option<f64>,
    /// Upper bound; `None` for a single run.
    pub high: Option<f64>,
}

impl Verdicts {
    pub(crate) fn of(verdicts: impl Iterator<Item = Option<Verdict>>) -> Self {
        verdicts.flatten().fold(Self::default(), |all, verdict| Self {
            judged_runs: all.judged_runs + 1,
            failed_runs: all.failed_runs + usize::from(verdict == Verdict::Fail),
        })
    }

    /// Names of the columns of tables.
    pub(crate) const NAMES: [&str; 2] = ["judged_runs", "failed_runs"];

    pub(crate) fn numbers(self) -> [String; 2] {
        [self.judged_runs, self.failed_runs].map(|runs| runs.to_string())
    }
}

impl Interval {
    /// Returns the interval of values that are 0 or more, by Student's t distribution; `None` without values.
    pub fn of(values: &[f64]) -> Option<Self> {
        let Mean { n, mean, interval, .. } = Mean::of(values)?;
        let interval = interval.map(|its| numbers::Interval { low: its.low.max(0.0), ..its });
        Some(Self { n, mean, low: interval.map(|its| its.low), high: interval.map(|its| its.high) })
    }

    /// Returns the interval of shares of `samples` samples in all, which is inside 0 to 1 ([`share_over_runs`]); `None` without
    /// shares.
    pub fn of_shares(shares: &[f64], samples: usize) -> Option<Self> {
        let Mean { n, mean, .. } = Mean::of(shares)?;
        let interval = share_over_runs(shares, samples as f64);
        Some(Self { n, mean, low: interval.map(|its| its.low), high: interval.map(|its| its.high) })
    }

    /// Returns the interval in another unit, as `11.21 ± 0.02`, or as `0.80 (0.11 to 5.60)` where its ends are not equally far.
    /// Two runs are too few to show one: `11.21 (n = 2)`.
    pub fn times(self, factor: f64) -> String {
        let mean = self.mean * factor;
        let Some((low, high)) = self.low.zip(self.high).map(|(low, high)| (low * factor, high * factor))
        else {
            return format!("{mean:.2}");
        };
        let ends = [mean - low, high - mean].map(|end| format!("{end:.2}"));
        if self.n < FEWEST {
            format!("{mean:.2} (n = {})", self.n)
        } else if ends[0] == ends[1] {
            format!("{mean:.2} ± {}", ends[0])
        } else {
            format!("{mean:.2} ({low:.2} to {high:.2})")
        }
    }
}

impl Cell {
    pub(crate) fn of(values: Vec<String>, outcomes: &[&Outcome<Measured>]) -> Self {
        let mut void = outcomes.iter().filter_map(|outcome| outcome.void());
        if let Some(first) = void.next() {
            let (runs, number) = (outcomes.len(), 1 + void.count());
            return Self { values, runs, void: Some(first.among(number, runs)), ..Self::default() };
        }
        let runs: Vec<_> = outcomes.iter().filter_map(|outcome| outcome.measured()).collect();
        let over = |figure: fn(&Measured) -> Option<f64>| {
            Interval::of(&runs.iter().filter_map(|run| figure(run)).collect::<Vec<_>>())
        };
        Self {
            values,
            runs: runs.len(),
            void: None,
            service_time_p50_ms: over(|run| run.service_time_p50_ms),
            service_time_p95_ms: over(|run| run.service_time_p95_ms),
            service_time_p99_ms: over(|run| run.service_time_p99_ms),
            above_target: above_target(runs.iter().map(|run| (run.above_target, run.samples))),
            handovers: over(|run| Some(run.handovers as f64)),
            duration_ms: over(|run| Some(run.duration_ms)),
            blind_m: over(|run| Some(run.blind_m)),
            longest_blind_m: over(|run| Some(run.longest_blind_m)),
            verdicts: Verdicts::of(runs.iter().map(|run| run.verdict())),
            services: ServiceCell::all(&runs),
            goodput_bps: goodputs(&runs),
            bill: SpentCell::all(&runs, |run| &run.bill),
            energy: SpentCell::all(&runs, |run| &run.energy),
        }
    }

    /// Returns the intervals by the names of the table's columns.
    pub(crate) fn intervals(&self) -> [Column<Option<Interval>>; 8] {
        [
            service_time(Statistic::P50, self.service_time_p50_ms),
            service_time(Statistic::P95, self.service_time_p95_ms),
            service_time(Statistic::P99, self.service_time_p99_ms),
            column::above_target(self.above_target),
            total(Total::Handovers, self.handovers),
            total(Total::Duration, self.duration_ms),
            total(Total::Blind, self.blind_m),
            total(Total::LongestBlind, self.longest_blind_m),
        ]
    }
}

impl ServiceCell {
    /// Returns the services of all these runs, each where it first stands.
    fn all(runs: &[&Measured]) -> Vec<Self> {
        let mut services: Vec<Vec<&MeasuredService>> = Vec::new();
        for its in runs.iter().flat_map(|run| &run.services) {
            let is_same = |others: &&mut Vec<&MeasuredService>| {
                others[0].service == its.service && others[0].robot == its.robot
            };
            match services.iter_mut().find(is_same) {
                Some(others) => others.push(its),
                None => services.push(vec![its]),
            }
        }
        services.iter().map(|runs| Self::of(runs)).collect()
    }

    /// Returns the statistics of one service over its runs, of which there is at least one.
    fn of(runs: &[&MeasuredService]) -> Self {
        let measured = || runs.iter().filter(|its| its.samples > 0);
        let over = |figure: fn(&MeasuredService) -> Option<f64>| {
            Interval::of(&measured().filter_map(|its| figure(its)).collect::<Vec<_>>())
        };
        Self {
            robot: runs[0].robot.clone(),
            service: runs[0].service.clone(),
            in_total: runs[0].in_total,
            runs: measured().count(),
            service_time_target_ms: runs[0].service_time_target_ms,
            service_time_p50_ms: over(|its| its.service_time_p50_ms),
            service_time_p95_ms: over(|its| its.service_time_p95_ms),
            service_time_p99_ms: over(|its| its.service_time_p99_ms),
            above_target: above_target(measured().map(|its| (its.above_target, its.samples))),
            unanswered: over(|its| Some(its.unanswered as f64)),
            verdicts: Verdicts::of(runs.iter().map(|its| its.verdict())),
        }
    }

    /// Returns the intervals by the names of the table's columns.
    pub(crate) fn intervals(&self) -> [Column<Option<Interval>>; 5] {
        [
            service_time(Statistic::P50, self.service_time_p50_ms),
            service_time(Statistic::P95, self.service_time_p95_ms),
            service_time(Statistic::P99, self.service_time_p99_ms),
            column::above_target(self.above_target),
            total(Total::Unanswered, self.unanswered),
        ]
    }
}

impl SpentCell {
    /// Returns what runs spent, in the order in which it first stands.
    fn all(runs: &[&Measured], of_run: fn(&Measured) -> &[Spent]) -> Vec<Self> {
        let mut all: Vec<Vec<&Spent>> = Vec::new();
        for spent in runs.iter().flat_map(|run| of_run(run)) {
            let is_same = |its: &Spent| (&its.of, &its.unit) == (&spent.of, &spent.unit);
            match all.iter_mut().find(|same| is_same(same[0])) {
                Some(same) => same.push(spent),
                None => all.push(vec![spent]),
            }
        }
        let cell = |same: &Vec<&Spent>| {
            let over =
                |of: fn(&Spent) -> f64| Interval::of(&same.iter().map(|its| of(its)).collect::<Vec<_>>());
            let (of, unit) = (same[0].of.clone(), same[0].unit.clone());
            Some(Self { of, unit, amount: over(|its| its.amount)?, per_hour: over(|its| its.per_hour)? })
        };
        all.iter().filter_map(cell).collect()
    }
}

/// Returns the goodputs of each source over runs.
fn goodputs(runs: &[&Measured]) -> Vec<(TrafficId, Interval)> {
    let mut sources: BTreeMap<&TrafficId, Vec<f64>> = BTreeMap::new();
    for (source, goodput) in runs.iter().flat_map(|run| &run.goodput_bps) {
        sources.entry(source).or_default().push(*goodput);
    }
    let interval = |(source, values): (&TrafficId, Vec<f64>)| Some((source.clone(), Interval::of(&values)?));
    sources.into_iter().filter_map(interval).collect()
}

/// Returns the interval of the share above the target, of runs with their numbers of samples.
fn above_target(runs: impl Iterator<Item = (Option<f64>, usize)>) -> Option<Interval> {
    let (shares, samples): (Vec<f64>, Vec<usize>) =
        runs.filter_map(|(share, samples)| Some((share?, samples))).unzip();
    Interval::of_shares(&shares, samples.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_follows_students_t() {
        // t for 4 degrees of freedom is 2.776; the standard error of 1 to 5 is sqrt(2.5 / 5).
        let Interval { n, mean, low, high } = Interval::of(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!((n, mean), (5, 3.0));
        assert!((high.unwrap() - 3.0 - 2.776_445 * 0.5_f64.sqrt()).abs() < 1e-5, "{high:?}");
        assert!((low.unwrap() + high.unwrap() - 6.0).abs() < 1e-12);
        assert_eq!(Interval::of(&[7.0]), Some(Interval { n: 1, mean: 7.0, low: None, high: None }));
        assert_eq!(Interval::of(&[]), None);
    }

    #[test]
    fn a_cell_with_a_void_run_has_no_figures() {
        let void: Outcome<Measured> = serde_json::from_str(r#"{"void":"plug-in x: ended"}"#).unwrap();
        let measured = Outcome::Measured(Measured { above_target: Some(0.5), ..Measured::default() });
        let cell = Cell::of(Vec::new(), &[&measured, &void, &measured]);
        assert_eq!(cell.void.unwrap().to_string(), "void: plug-in x: ended (1 of 3 runs)");
        assert_eq!((cell.runs, cell.above_target, cell.handovers, cell.duration_ms), (3, None, None, None));
        assert!(Cell::of(Vec::new(), &[&measured]).above_target.is_some());
    }

    #[test]
    fn intervals_are_written_with_half_their_width() {
        let interval = Interval { n: 5, mean: 0.125, low: Some(0.12), high: Some(0.13) };
        assert_eq!(interval.times(100.0), "12.50 ± 0.50");
        assert_eq!(Interval { n: 1, low: None, high: None, ..interval }.times(1.0), "0.12");
        assert_eq!(Interval { low: Some(0.0), ..interval }.times(100.0), "12.50 (0.00 to 13.00)");
    }

    #[test]
    fn two_runs_are_too_few_to_show_an_interval() {
        assert_eq!(Interval::of(&[1.0, 2.0]).unwrap().times(1.0), "1.50 (n = 2)");
        assert!(Interval::of(&[1.0, 2.0, 1.5]).unwrap().times(1.0).starts_with("1.50 ± "));
    }

    #[test]
    fn intervals_stay_inside_the_range_of_their_figures() {
        let Interval { mean, low, high, .. } = Interval::of_shares(&[0.0, 0.02, 0.0], 3000).unwrap();
        assert!((mean - 0.02 / 3.0).abs() < 1e-12);
        assert!(low.unwrap() >= 0.0 && mean < high.unwrap() && high.unwrap() < 1.0, "{low:?} {high:?}");
        let all = Interval::of_shares(&[1.0; 5], 5000).unwrap();
        assert!(all.high == Some(1.0) && all.low.unwrap() > 0.99, "{all:?}");
        assert_eq!(Interval::of(&[0.0, 1.0, 5.0]).unwrap().low, Some(0.0), "of a number of handovers");
    }

    #[test]
    fn each_service_has_the_interval_of_its_own_runs() {
        let service = |robot: &str, median: Option<f64>| MeasuredService {
            robot: robot.parse().unwrap(),
            service: format!("navigation-{robot}").parse().unwrap(),
            in_total: true,
            service_time_target_ms: 15.0,
            samples: if median.is_some() { 10 } else { 0 },
            unanswered: 0,
            above_target: median.map(|ms| if ms > 15.0 { 1.0 } else { 0.0 }),
            service_time_p50_ms: median,
            service_time_p95_ms: median,
            service_time_p99_ms: median,
            service_time_max_ms: median,
            keep: (robot == "r1").then_some(0.9),
            kpis: Vec::new(),
        };
        let [first, second] = [(10.0, Some(20.0)), (12.0, None)]
            .map(|(r1, r2)| [service("r1", Some(r1)), service("r2", r2), service("r3", None)]);
        let [first, second] =
            [first, second].map(|services| Measured { services: services.into(), ..Measured::default() });
        let services = ServiceCell::all(&[&first, &second]);
        assert_eq!(
            services.iter().map(|its| (its.robot.as_str(), its.runs)).collect::<Vec<_>>(),
            [("r1", 2), ("r2", 1), ("r3", 0)]
        );
        assert_eq!(services[0].service_time_p50_ms, Interval::of(&[10.0, 12.0]));
        assert_eq!(services[1].above_target, Interval::of_shares(&[1.0], 10));
        assert_eq!((services[2].service_time_p99_ms, services[2].unanswered), (None, None));
        let verdicts: Vec<_> = services.iter().map(|its| its.verdicts.numbers().join("/")).collect();
        assert_eq!(verdicts, ["2/0", "0/0", "0/0"]);
    }

    #[test]
    fn runs_that_kept_too_little_are_counted_and_those_of_old_journals_are_not_judged() {
        let run = |above: Option<f64>, keep| {
            let json = serde_json::json!({
                "robot": "r1", "service": "navigation", "service_time_target_ms": 15.0, "samples": 100, "unanswered": 0,
                "above_target": above, "keep": keep,
            });
            let mut service: MeasuredService = serde_json::from_value(json).unwrap();
            service.samples = above.map_or(0, |_| 100);
            Outcome::Measured(Measured { services: vec![service], ..EMPTY })
        };
        let runs = [
            run(Some(0.1), Some(0.9)),
            run(Some(0.11), Some(0.9)),
            run(None, Some(0.9)),
            run(Some(0.5), None),
        ];
        let cell = Cell::of(Vec::new(), &runs.each_ref());
        assert_eq!(cell.verdicts, Verdicts { judged_runs: 3, failed_runs: 2 });
        assert_eq!(cell.services[0].verdicts, cell.verdicts);
        let old = r#"{"robot":"r1","service":"s","service_time_target_ms":15.0,"samples":1,"unanswered":0,
            "above_target":0.0,"service_time_p50_ms":null,"service_time_p95_ms":null,"service_time_p99_ms":null,
            "service_time_max_ms":null}"#;
        let old: MeasuredService = serde_json::from_str(old).unwrap();
        assert_eq!((old.kept().kept, old.kept().verdict), (Some(1.0), None));
    }

    const EMPTY: Measured = Measured {
        duration_ms: 0.0,
        walked: true,
        samples: 0,
        unanswered: 0,
        above_target: None,
        service_time_p50_ms: None,
        service_time_p95_ms: None,
        service_time_p99_ms: None,
        service_time_max_ms: None,
        handovers: 0,
        handover_gap_p50_ms: None,
        handover_gap_max_ms: None,
        migrations: 0,
        plugin_faults: 0,
        applied: 0,
        refused: 0,
        ineffective: Vec::new(),
        driven_m: 0.0,
        blind_m: 0.0,
        longest_blind_m: 0.0,
        services: Vec::new(),
        time_parts: Vec::new(),
        losses: Vec::new(),
        goodput_bps: Vec::new(),
        bill: Vec::new(),
        energy: Vec::new(),
        regions: Vec::new(),
    };
}
