//! Tables of a sweep: tidy ones for programs, and a rounded one for readers.

use cotorra_graph::TrafficId;
use cotorra_testbed::{DataTable, Judged, Void, name_of_total};

use super::{
    Axis, Cell, Difference, Interval, Measured, MeasuredService, Region, Runs, ServiceCell, SpentCell,
    Verdicts,
    column::Column,
    measured::passed,
    runs::Done,
    spent::{Spent, unit_per_hour},
    time_parts::{MeasuredLoss, MeasuredPart},
};
use crate::cell::number;

/// Last column of all tables for programs: the reason for which a run or a cell has no figures.
const VOID: &str = "void";

/// Returns a row for each run.
pub(super) fn runs(runs: &Runs) -> DataTable {
    let heads = names(Measured::default().figures());
    rows(runs, ["seed"], &heads, |measured| {
        vec![measured.figures().into_iter().map(|(_, figure)| number(figure)).collect()]
    })
}

/// Returns a table with the rows of each run; of a void run, with a single one.
fn rows<const N: usize>(
    runs: &Runs,
    heads: [&str; N],
    figures: &[String],
    rows: impl Fn(&Measured) -> Vec<Vec<String>>,
) -> DataTable {
    let mut table = table(&runs.axes, heads, Some(figures.iter().cloned()));
    let width = N - 1 + figures.len();
    for Done { point, outcome, .. } in &runs.done {
        let of_run = outcome.measured().map_or_else(|| vec![vec![String::new(); width]], &rows);
        for cells in of_run {
            let run = of(&point.values).chain([point.seed.to_string()]);
            table.row(run.chain(cells).chain([reason(outcome.void())]));
        }
    }
    table
}

/// Returns a row for each combination.
pub(super) fn cells(axes: &[Axis], cells: &[Cell]) -> DataTable {
    let mut table = table(axes, ["runs"], cells.first().map(|cell| judged(bounds(cell.intervals()))));
    for cell in cells {
        let figures = cell.intervals().into_iter().flat_map(|(_, interval)| numbers(interval));
        // A void combination has no verdicts, either.
        let verdicts = match &cell.void {
            None => cell.verdicts.numbers(),
            Some(_) => [const { String::new() }; 2],
        };
        let row = of(&cell.values).chain([cell.runs.to_string()]).chain(figures).chain(verdicts);
        table.row(row.chain([reason(cell.void.as_ref())]));
    }
    table
}

/// Returns a row for each region of each run.
pub(super) fn regions(runs: &Runs) -> DataTable {
    let heads = ["seed", "robot", "service", "attachment", "server"];
    let figures = ["from_ns", "until_ns", "samples", "service_time_p50_ms"].map(str::to_owned);
    rows(runs, heads, &figures, |measured| {
        let row = |region: &Region| {
            vec![
                region.robot.to_string(),
                region.service.to_string(),
                region.attachment.as_ref().map(ToString::to_string).unwrap_or_default(),
                region.server.to_string(),
                region.from.as_nanos().to_string(),
                region.until.as_nanos().to_string(),
                region.samples.to_string(),
                number(region.service_time_p50_ms),
            ]
        };
        measured.regions.iter().map(row).collect()
    })
}

/// Returns a row for each service of each run.
pub(super) fn services(runs: &Runs) -> DataTable {
    let first = measured(runs).find_map(|measured| measured.services.first());
    let figures = first.map(|its| names(its.figures()).to_vec()).unwrap_or_default();
    rows(runs, ["seed", "robot", "service"], &figures, |measured| {
        let row = |its: &MeasuredService| {
            let MeasuredService { robot, service, .. } = its;
            let figures = its.figures().map(|(_, figure)| number(figure));
            [robot.to_string(), service.to_string()].into_iter().chain(figures).collect()
        };
        measured.services.iter().map(row).collect()
    })
}

/// Returns a row for each KPI of each run; `None` if there are no KPIs beside targets.
pub(super) fn kpis(runs: &Runs) -> Option<DataTable> {
    measured(runs).flat_map(|measured| &measured.services).find(|its| !its.kpis.is_empty())?;
    let figures = ["value", "unit", "passed"].map(str::to_owned);
    Some(rows(runs, ["seed", "robot", "service", "kpi"], &figures, |measured| {
        let all = measured.services.iter().flat_map(|its| its.kpis.iter().map(move |kpi| (its, kpi)));
        let row = |(its, Judged { kpi, value, unit, verdict, .. }): (&MeasuredService, &Judged)| {
            let names = [its.robot.to_string(), its.service.to_string(), kpi.clone()];
            names.into_iter().chain([number(*value), unit.clone(), number(passed(*verdict))]).collect()
        };
        all.map(row).collect()
    }))
}

/// Returns a row for each part of the service times of each run.
pub(super) fn time_parts(runs: &Runs) -> DataTable {
    let first = measured(runs).find_map(|measured| measured.time_parts.first());
    let figures = first.map(|part| names(part.figures()).to_vec()).unwrap_or_default();
    rows(runs, ["seed", "service", "part"], &figures, |measured| {
        let row = |part: &MeasuredPart| {
            let figures = part.figures().map(|(_, figure)| number(figure));
            [part.service.to_string(), part.part.clone()].into_iter().chain(figures).collect()
        };
        measured.time_parts.iter().map(row).collect()
    })
}

/// Returns a row for each source of traffic of each run; `None` without sources.
pub(super) fn traffic(runs: &Runs) -> Option<DataTable> {
    measured(runs).find(|measured| !measured.goodput_bps.is_empty())?;
    Some(rows(runs, ["seed", "source"], &["goodput_bps".to_owned()], |measured| {
        let row = |(source, goodput): &(TrafficId, f64)| vec![source.to_string(), number(Some(*goodput))];
        measured.goodput_bps.iter().map(row).collect()
    }))
}

/// Returns a row for each price of each run; `None` without any.
pub(super) fn bill(runs: &Runs) -> Option<DataTable> {
    let heads = ["currency", "price", "price_per_hour"];
    spent(
        runs,
        &heads,
        |run| &run.bill,
        |its| vec![its.unit.clone(), number(Some(its.amount)), number(Some(its.per_hour))],
    )
}

/// Returns a row for each energy of each run; `None` without any.
pub(super) fn energy(runs: &Runs) -> Option<DataTable> {
    let heads = ["energy_wh", "mean_power_w"];
    spent(runs, &heads, |run| &run.energy, |its| vec![number(Some(its.amount)), number(Some(its.per_hour))])
}

/// Returns a row for each amount that each run spent; `None` without any.
fn spent(
    runs: &Runs,
    heads: &[&str],
    of_run: fn(&Measured) -> &[Spent],
    cells: fn(&Spent) -> Vec<String>,
) -> Option<DataTable> {
    measured(runs).find(|measured| !of_run(measured).is_empty())?;
    let heads: Vec<_> = heads.iter().map(|head| (*head).to_owned()).collect();
    let row = |its: &Spent| [its.of.clone()].into_iter().chain(cells(its)).collect();
    Some(rows(runs, ["seed", "of"], &heads, |measured| of_run(measured).iter().map(row).collect()))
}

/// Returns the results of the runs that have some.
fn measured(runs: &Runs) -> impl Iterator<Item = &Measured> {
    runs.done.iter().filter_map(|done| done.outcome.measured())
}

/// Returns a row for each figure of each combination beside the first.
pub(super) fn differences(axes: &[Axis], differences: &[Difference]) -> DataTable {
    let heads = ["figure", "pairs", "mean", "low", "high", "p"].map(str::to_owned);
    let mut table = DataTable::new(axes.iter().map(|axis| axis.path().to_owned()).chain(heads));
    for Difference { values, figure, pairs, mean, interval, p } in differences {
        let ends = [Some(*mean), interval.map(|its| its.low), interval.map(|its| its.high), *p];
        let fixed = [figure.clone(), pairs.to_string()];
        table.row(of(values).chain(fixed).chain(ends.map(number)));
    }
    table
}

/// Returns a row for each place where samples without an answer ended, of each run.
pub(super) fn unanswered(runs: &Runs) -> DataTable {
    rows(runs, ["seed", "service", "link", "way", "cause"], &["samples".to_owned()], |measured| {
        let row = |loss: &MeasuredLoss| {
            let cells = [loss.service.to_string()].into_iter().chain(loss.place());
            cells.chain([loss.samples.to_string()]).collect()
        };
        measured.losses.iter().map(row).collect()
    })
}

/// Returns a row for each service of each combination.
pub(super) fn service_cells(axes: &[Axis], cells: &[Cell]) -> DataTable {
    let first = cells.iter().find_map(|cell| cell.services.first());
    let heads = ["robot", "service", "runs", "service_time_target_ms"];
    let mut table = table(axes, heads, first.map(|its| judged(bounds(its.intervals()))));
    for cell in cells {
        for its in &cell.services {
            let ServiceCell { robot, service, runs, service_time_target_ms, .. } = its;
            let fixed = [
                robot.to_string(),
                service.to_string(),
                runs.to_string(),
                number(Some(*service_time_target_ms)),
            ];
            let figures = its.intervals().into_iter().flat_map(|(_, interval)| numbers(interval));
            table.row(
                of(&cell.values)
                    .chain(fixed)
                    .chain(figures)
                    .chain(its.verdicts.numbers())
                    .chain([String::new()]),
            );
        }
        if let Some(void) = &cell.void {
            let fixed = ["", "", &cell.runs.to_string(), ""].map(str::to_owned);
            let figures =
                vec![String::new(); first.map_or(0, |its| its.intervals().len() * 3 + Verdicts::NAMES.len())];
            table.row(of(&cell.values).chain(fixed).chain(figures).chain([reason(Some(void))]));
        }
    }
    table
}

impl Runs {
    /// Returns a row for each robot and service of each combination, rounded for readers, with confidence intervals.
    /// Several services also have a row for all together.
    pub fn by_service(&self, cells: &[Cell]) -> DataTable {
        by_service(&self.axes, cells)
    }

    /// Returns a row for each price of each combination, for each hour, rounded for readers, with confidence intervals; `None`
    /// without any.
    pub fn prices(&self, cells: &[Cell]) -> Option<DataTable> {
        per_hour(&self.axes, cells, ["price of", "per hour"], |cell| &cell.bill)
    }

    /// Returns a row for each mean power of each combination, rounded for readers, with confidence intervals; `None` without any.
    pub fn powers(&self, cells: &[Cell]) -> Option<DataTable> {
        per_hour(&self.axes, cells, ["energy of", "mean power"], |cell| &cell.energy)
    }
}

/// Returns a row for each amount that a combination spent in an hour; `None` without any.
fn per_hour(
    axes: &[Axis],
    cells: &[Cell],
    heads: [&str; 2],
    of_cell: fn(&Cell) -> &[SpentCell],
) -> Option<DataTable> {
    cells.iter().find(|cell| !of_cell(cell).is_empty())?;
    let names = axes.iter().map(|axis| axis.path()).chain(heads);
    let mut table = DataTable::new(names).right_after(axes.len() + 1);
    for cell in cells {
        for its in of_cell(cell) {
            let amount = format!("{} {}", its.per_hour.times(1.0), unit_per_hour(&its.unit));
            table.row(of(&cell.values).chain([its.of.clone(), amount]));
        }
    }
    Some(table)
}

/// Returns a row for each service of each combination, and one for all services in the total together if there are several.
/// Figures are rounded, and have half the width of their confidence interval.
pub(super) fn by_service(axes: &[Axis], cells: &[Cell]) -> DataTable {
    let heads = ["runs", "target (ms)", "median (ms)", "p95 (ms)", "p99 (ms)", "kept (%)"];
    let names = axes.iter().map(|axis| axis.path()).chain(["robot", "service"]);
    let mut table = DataTable::new(names.chain(heads)).right_after(axes.len() + 2);
    for cell in cells {
        for its in &cell.services {
            let fixed = [
                its.robot.to_string(),
                its.service.to_string(),
                its.runs.to_string(),
                its.service_time_target_ms.to_string(),
            ];
            let times = [its.service_time_p50_ms, its.service_time_p95_ms, its.service_time_p99_ms];
            table
                .row(of(&cell.values).chain(fixed).chain(times.map(rounded)).chain([kept(its.above_target)]));
        }
        if let Some(void) = &cell.void {
            let figures = ["", "", &cell.runs.to_string(), "", &void.to_string(), "", "", ""];
            table.row(of(&cell.values).chain(figures.map(str::to_owned)));
        }
        if let Some(name) = name_of_total(cell.services.iter().map(|its| its.in_total)) {
            let fixed = [name, "", &cell.runs.to_string(), ""].map(str::to_owned);
            let times = [cell.service_time_p50_ms, cell.service_time_p95_ms, cell.service_time_p99_ms];
            table.row(
                of(&cell.values).chain(fixed).chain(times.map(rounded)).chain([kept(cell.above_target)]),
            );
        }
    }
    table
}

/// Creates a table whose first columns are the axes.
fn table<const N: usize>(
    axes: &[Axis],
    heads: [&str; N],
    figures: Option<impl IntoIterator<Item = String>>,
) -> DataTable {
    let axes = axes.iter().map(|axis| axis.path().to_owned());
    let heads = axes.chain(heads.map(str::to_owned)).chain(figures.into_iter().flatten());
    DataTable::new(heads.chain([VOID.to_owned()]))
}

/// Returns the reason for which a run or a cell is void; nothing if it is not.
fn reason(void: Option<&Void>) -> String {
    void.map(|void| void.reason().to_owned()).unwrap_or_default()
}

fn of(values: &[String]) -> impl Iterator<Item = String> + '_ {
    values.iter().cloned()
}

fn names<const N: usize>(figures: [Column<Option<f64>>; N]) -> [String; N] {
    figures.map(|(name, _)| name)
}

/// Returns the names of the columns of intervals.
fn bounds<const N: usize>(intervals: [Column<Option<Interval>>; N]) -> impl Iterator<Item = String> {
    let names = |(name, _): Column<_>| [name.clone(), name.clone() + "_low", name + "_high"];
    intervals.into_iter().flat_map(names)
}

/// Returns the names of the columns of figures and verdicts.
fn judged(figures: impl Iterator<Item = String>) -> impl Iterator<Item = String> {
    figures.chain(Verdicts::NAMES.map(str::to_owned))
}

/// Returns the mean and the bounds of an interval.
fn numbers(interval: Option<Interval>) -> [String; 3] {
    [interval.map(|i| i.mean), interval.and_then(|i| i.low), interval.and_then(|i| i.high)].map(number)
}

fn rounded(interval: Option<Interval>) -> String {
    interval.map_or("-".to_owned(), |interval| interval.times(1.0))
}

/// Returns the share within the target, in percent.
fn kept(above_target: Option<Interval>) -> String {
    let kept = |above: Interval| Interval {
        n: above.n,
        mean: 1.0 - above.mean,
        low: above.high.map(|high| 1.0 - high),
        high: above.low.map(|low| 1.0 - low),
    };
    above_target.map_or("-".to_owned(), |above| kept(above).times(100.0))
}
