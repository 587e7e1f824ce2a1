//! Results of a sweep in the terminal.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use cotorra_experiments::sweep::{Cell, FILES, Interval, Runs, ServiceCell, Verdicts};
use cotorra_graph::{Natural, PluginId};
use cotorra_testbed::DataTable;

use crate::{
    figures::FigureArgs,
    table::Table,
    words::{self, count, of_them},
};

/// Maximum number of combinations that the terminal lists.
const LISTED: usize = 40;

/// Describes the results, and lists the files. A note comes between them.
pub fn describe(runs: &Runs, note: &str, folder: &Path, figure: &FigureArgs) -> String {
    let (done, all) = (runs.done.len(), count(runs.total, "run"));
    let void = runs.void();
    let mut text = format!("{done} of {all}{}\n{}\n", of_them(runs.resumed, void), runs.again);
    let (axes, cells) = (&runs.axes, runs.cells());
    let is_judged = cells.iter().any(|cell| cell.verdicts.judged_runs > 0);
    let mut table = Table::new(&("<".repeat(axes.len()) + &">".repeat(7 + usize::from(is_judged))));
    let heads = ["runs", "median, ms", "p99, ms", "above target, %", "took, s", "blind, m", "at once, m"];
    let heads = heads.into_iter().chain(is_judged.then_some("failed")).map(str::to_owned);
    table.row(axes.iter().map(|axis| axis.path().to_owned()).chain(heads));
    for cell in cells.iter().take(LISTED) {
        let Cell { values, runs, service_time_p50_ms, service_time_p99_ms, above_target, .. } = cell;
        let Cell { duration_ms, blind_m, longest_blind_m, .. } = cell;
        if let Some(void) = &cell.void {
            let cells = ["", "", "", "", ""].map(str::to_owned);
            let row = values.iter().cloned().chain([runs.to_string(), void.to_string()]);
            table.row(row.chain(cells));
            continue;
        }
        let figures = [
            runs.to_string(),
            interval(*service_time_p50_ms, 1.0),
            interval(*service_time_p99_ms, 1.0),
            interval(*above_target, 100.0),
            interval(*duration_ms, 1e-3),
            interval(*blind_m, 1.0),
            interval(*longest_blind_m, 1.0),
        ];
        let Verdicts { judged_runs, failed_runs } = cell.verdicts;
        let failed = is_judged.then(|| match judged_runs {
            0 => "-".to_owned(),
            judged => format!("{failed_runs} of {judged}"),
        });
        table.row(values.iter().cloned().chain(figures).chain(failed));
    }
    text += &table.render("  ");
    if cells.len() > LISTED {
        text += &format!("  and {} more in cells.csv\n", cells.len() - LISTED);
    }
    text += &doubts(runs);
    text += &services(runs, &cells);
    text += &sources(runs, &cells);
    text += &listed(runs.prices(&cells), axes.len() + 1, "bill.csv");
    text += &listed(runs.powers(&cells), axes.len() + 1, "energy.csv");
    text += &differences(runs);
    if void > 0 {
        text += &format!("\n{}\n", words::logs());
    }
    text += note;
    let figures = figure.files("sweep");
    let samples = match runs.with_samples(folder) {
        0 => String::new(),
        kept => format!("\n  samples/ of {}", count(kept, "run")),
    };
    text + &format!("\n{}/\n  {}{figures}{samples}\n", folder.display(), FILES.join("  "))
}

/// Says which plug-ins changed nothing, and whether seeds did.
fn doubts(runs: &Runs) -> String {
    let mut text = String::new();
    let mut ineffective: BTreeMap<&PluginId, usize> = BTreeMap::new();
    for measured in runs.measured() {
        measured.ineffective.iter().for_each(|plugin| *ineffective.entry(plugin).or_default() += 1);
    }
    for (plugin, of) in ineffective {
        let of = count(of, "run");
        text += &format!(
            "  plug-in {plugin}: all its instructions were rejected in {of}, which show what happens without it\n"
        );
    }
    if runs.are_alike() {
        text += "  All runs of a combination are alike: the seed changes nothing, and they count as one.\n";
    }
    text
}

/// Returns the table of each robot and service, if several have samples. Names those that have none in any run.
fn services(runs: &Runs, cells: &[Cell]) -> String {
    let mut text = String::new();
    let all = || cells.iter().flat_map(|cell| &cell.services);
    let name = |its: &ServiceCell| format!("{} of {}", its.service, its.robot);
    let measured: BTreeSet<_> = all().filter(|its| its.runs > 0).map(name).collect();
    if measured.len() > 1 {
        text += &listed(Some(runs.by_service(cells)), runs.axes.len() + 2, "service_cells.csv");
    }
    let without: BTreeSet<_> = all().map(name).filter(|name| !measured.contains(name)).collect();
    if !without.is_empty() {
        let mut names: Vec<_> = without.into_iter().collect();
        names.sort_by_cached_key(|name| Natural::of(name));
        text += &format!("\nwithout samples: {}\n", names.join(", "));
    }
    text
}

/// Returns the table of what arrived of each source of traffic; empty without sources.
fn sources(runs: &Runs, cells: &[Cell]) -> String {
    let mut table = Table::new(&("<".repeat(runs.axes.len() + 1) + ">"));
    let heads = ["traffic", "goodput, Mbit/s"].map(str::to_owned);
    table.row(runs.axes.iter().map(|axis| axis.path().to_owned()).chain(heads));
    let rows = || cells.iter().flat_map(|cell| cell.goodput_bps.iter().map(move |its| (&cell.values, its)));
    for (values, (source, goodput)) in rows().take(LISTED) {
        table.row(values.iter().cloned().chain([source.to_string(), goodput.times(1e-6)]));
    }
    let table = format!("\n{}", table.render("  "));
    match rows().count() {
        0 => String::new(),
        all if all > LISTED => format!("{table}  and {} more in traffic.csv\n", all - LISTED),
        _ => table,
    }
}

/// Returns the first rows of a table, whose columns after the first `left` are numbers, and where the others are; empty without one.
fn listed(table: Option<DataTable>, left: usize, others: &str) -> String {
    let Some(table) = table else { return String::new() };
    let rows = &table.rows()[..table.rows().len().min(LISTED + 1)];
    let text = format!("\n{}", Table::of(rows, left).render("  "));
    match table.rows().len() - rows.len() {
        0 => text,
        more => format!("{text}  and {more} more in {others}\n"),
    }
}

/// Figures whose differences the terminal shows, with their names and factors.
const COMPARED: [(&str, &str, f64); 4] = [
    ("service_time_p50_ms", "median, ms", 1.0),
    ("service_time_p99_ms", "p99, ms", 1.0),
    ("above_target", "above target, points", 100.0),
    ("handovers", "handovers", 1.0),
];

/// Returns how combinations differ from the first one, over the runs that share a seed; empty if there is only one.
fn differences(runs: &Runs) -> String {
    let (axes, all) = (&runs.axes, runs.differences());
    let Some(first) = runs.done.first().filter(|_| !all.is_empty()) else { return String::new() };
    let mut table = Table::new(&("<".repeat(axes.len()) + ">" + &">".repeat(COMPARED.len())));
    let heads = ["pairs"].into_iter().chain(COMPARED.map(|(_, name, _)| name));
    table.row(axes.iter().map(|axis| axis.path().to_owned()).chain(heads.map(str::to_owned)));
    let of_cells: Vec<_> = all.chunk_by(|a, b| a.values == b.values).collect();
    for its in of_cells.iter().take(LISTED) {
        let pairs = its.iter().map(|its| its.pairs).max().unwrap_or(0);
        let figure = |(name, _, factor): (&str, &str, f64)| {
            let found = its.iter().find(|its| its.figure == name);
            found.map_or("-".to_owned(), |its| its.times(factor))
        };
        table.row(its[0].values.iter().cloned().chain([pairs.to_string()]).chain(COMPARED.map(figure)));
    }
    let settings =
        axes.iter().zip(&first.point.values).map(|(axis, value)| format!("{}={value}", axis.path()));
    let mut text = format!(
        "\n  Less {}, over runs with the same seed:\n{}",
        settings.collect::<Vec<_>>().join(" "),
        table.render("  ")
    );
    if of_cells.len() > LISTED {
        text += &format!("  and {} more in differences.csv\n", of_cells.len() - LISTED);
    }
    let too_few = all.iter().any(|its| its.is_shown().is_none());
    text + if too_few {
        "  Fewer than three pairs are too few to tell a difference from chance: --seeds 10.\n"
    } else {
        "  Means with 95 % intervals by Student's t; * differs at 5 %, corrected for all rows (Holm).\n"
    }
}

fn interval(interval: Option<Interval>, factor: f64) -> String {
    interval.map_or("-".to_owned(), |interval| interval.times(factor))
}
