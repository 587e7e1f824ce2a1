//! The COTORRA letter's second validation (arXiv 2101.07676): a robot leaves the coverage of its domain. The domain's
//! orchestrator negotiates another domain's virtual access point over a ledger with blocks before that.

pub mod dishonest;
mod drawn;
mod federated;
mod ledger_backend;

use std::{fmt::Write as _, path::Path, time::Duration};

use cotorra_figure::Format;
use cotorra_graph::{DomainId, Testbed};
use cotorra_testbed::{DataTable, FolderError, Quantiles, orchestrators, write_file};
use serde::Serialize;

use self::federated::BLOCKS_BETWEEN;
pub use self::{
    federated::{Federated, NoFederation, STEPS},
    ledger_backend::LedgerBackend,
};
use crate::walk_time;
pub use cotorra_federation::{Access, Account, LedgerError, Network, PASSWORD};

/// Files that [`Comparison::write`] makes.
pub const FILES: [&str; 5] =
    ["federation.svg", "federation.md", "federation.json", "steps.csv", "federation.tex"];

/// Block period of the published ledger, seconds.
const PUBLISHED_PERIOD_S: f64 = 5.0;
/// Published total time with that ledger: mean and standard deviation, seconds.
const PUBLISHED_S: [f64; 2] = [18.05, 1.25];
/// The letter's total time, seconds.
const LETTER_S: f64 = 19.0;

/// The runs of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The network between the nodes, as in `in virtual time`.
    pub how: String,
    /// The ledger, as in `an anvil node: one node without consensus`.
    pub ledger: String,
    /// In the order in which they ran.
    pub runs: Vec<Federated>,
}

/// Formats the mean of seconds and their standard deviation, which a single value has not.
fn mean_and_deviation(values: &[f64]) -> String {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    if values.len() < 2 {
        return format!("{mean:.2} s");
    }
    format!("{mean:.2} ± {:.2} s", (squares / (n - 1.0)).sqrt())
}

impl Comparison {
    /// Groups the runs by block period.
    fn by_period(&self) -> Vec<Vec<&Federated>> {
        let mut periods: Vec<Vec<&Federated>> = Vec::new();
        for run in &self.runs {
            match periods.iter_mut().find(|of| of[0].block_period_s == run.block_period_s) {
                Some(of) => of.push(run),
                None => periods.push(vec![run]),
            }
        }
        periods
    }

    /// Returns the table over block periods, in Markdown.
    pub fn to_markdown(&self) -> String {
        let Self { how, ledger, .. } = self;
        let mut text = format!("From the announcement to the attachment ({how}, on {ledger})\n\n");
        text += &self.table().to_markdown();
        let [mean, deviation] = PUBLISHED_S;
        line(
            &mut text,
            format_args!(
                "\nThe bound is what waiting for blocks takes at the most: one for the announcement, two for bid and choice, one \
                 for the confirmation; with the longest deployment and attachment. Published, with a block each 5 s: {mean} ± \
                 {deviation} s, and about {LETTER_S} s in the letter (arXiv 2101.07676)."
            ),
        );
        text
    }

    /// Returns a row for each block period.
    fn table(&self) -> DataTable {
        let mut table = DataTable::new([
            "block period",
            "runs",
            "total ± standard deviation",
            "least",
            "most",
            "bound",
            "ours beyond the blocks, median",
            "most",
            "vAP deployed in",
            "gap",
            "without answer",
            "lowest speed",
            "paid for",
        ])
        .right_after(0);
        for runs in self.by_period() {
            let all =
                |figure: &dyn Fn(&Federated) -> f64| runs.iter().map(|run| figure(run)).collect::<Vec<_>>();
            let most = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
            let totals = all(&Federated::total_s);
            let beyond = all(&|run| run.beyond_s() * 1e3);
            // Not "-0" for a span that rounding errors made negative.
            let ms = |span: f64| if span.abs() <= 0.5 { 0.0 } else { span };
            let lost: usize = runs.iter().map(|run| run.lost).sum();
            let samples: usize = runs.iter().map(|run| run.samples).sum();
            table.row([
                format!("{} s", runs[0].block_period_s),
                runs.len().to_string(),
                mean_and_deviation(&totals),
                format!("{:.2} s", least(&totals)),
                format!("{:.2} s", most(&totals)),
                format!("{:.2} s", most(&all(&Federated::bound_s))),
                format!("{:.0} ms", ms(Quantiles::of(beyond.clone()).map_or(0.0, |quantiles| quantiles.p50))),
                format!("{:.0} ms", ms(most(&beyond))),
                format!("{:.0} ms", ms(most(&all(&|run| run.deployment_s() * 1e3)))),
                format!("{:.0} ms", ms(most(&all(&|run| run.gap_s * 1e3)))),
                format!("{lost} of {samples}"),
                format!("{:.0} %", least(&all(&|run| run.slowest * 100.0))),
                format!("{} of {}", runs.iter().filter(|run| run.is_paid).count(), runs.len()),
            ]);
        }
        table
    }

    /// Writes the figure in the published layout, `federation`, in a format.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(&self, folder: &Path, format: Format) -> Result<(), FolderError> {
        let periods = self.by_period();
        let published = periods.iter().find(|runs| runs[0].block_period_s == PUBLISHED_PERIOD_S);
        let Some(runs) = published.or(periods.last()) else { return Ok(()) };
        let mut runs = runs.clone();
        runs.sort_by(|a, b| a.total_s().total_cmp(&b.total_s()));
        let scene = drawn::draw(runs[runs.len() / 2], &self.ledger).draw();
        write_file(folder, &format!("federation.{format}"), scene.render(format))
    }

    /// Writes [`FILES`]: the figure in the published layout, the table, and all steps of all runs. The figure shows the run of
    /// median total time with the published block period, or with the last period if none has the published one.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, folder: &Path) -> Result<(), FolderError> {
        let [_, table, data, csv, for_papers] = FILES;
        self.write_figure(folder, Format::Svg)?;
        write_file(folder, table, self.to_markdown())?;
        write_file(folder, for_papers, self.table().to_latex())?;
        let json = serde_json::to_string_pretty(self).expect("a comparison is valid JSON");
        write_file(folder, data, &(json + "\n"))?;
        let mut rows = String::from("block_period_s,run,seed");
        STEPS.iter().for_each(|step| rows += &format!(",{}_s", step.as_str().replace(' ', "_")));
        rows += ",gap_s,total_s,bound_s,beyond_s\n";
        for (number, run) in self.runs.iter().enumerate() {
            line(&mut rows, format_args!("{},{number},{}", run.block_period_s, run.seed));
            rows.pop();
            run.steps_s.iter().for_each(|at| rows += &format!(",{at:.6}"));
            let figures = [run.gap_s, run.total_s(), run.bound_s(), run.beyond_s()];
            figures.iter().for_each(|figure| rows += &format!(",{figure:.6}"));
            rows.push('\n');
        }
        write_file(folder, csv, &rows)
    }
}

fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    writeln!(text, "{arguments}").expect("writing into a string cannot fail");
}

/// Returns the plug-in settings of a testbed for a ledger with this block period. `phase`, from 0 to 1, is the place of the
/// announcement within a block period, as far as it can be chosen.
pub fn settings(
    testbed: &Testbed,
    on: &LedgerBackend,
    block_period: Duration,
    phase: f64,
) -> Vec<(String, String)> {
    let period = block_period.as_secs_f64();
    // An orchestrator knows its ledger's period. A network also has other load, and its blocks are late now and then.
    let (collect, late) = match on {
        LedgerBackend::Modelled | LedgerBackend::Anvil => (1.25 * period, 0.0),
        LedgerBackend::Network { .. } => (3.0 * period + 2.0, 2.0 * period + 4.0),
    };
    // Four blocks, the deployment, time to attach, and time to halt.
    let lead = period * (f64::from(1 + BLOCKS_BETWEEN) + phase) + 4.0 + late;
    orchestrators(testbed)
        .flat_map(|spec| {
            let path = format!("plugins.{}.settings", spec.id);
            [
                (format!("{path}.ledger"), on.setting(spec.domain.as_ref(), block_period)),
                (format!("{path}.lead"), format!("{lead:.3} s")),
                (format!("{path}.patience"), format!("{:.0} s", lead + 60.0)),
                (format!("{path}.collect"), format!("{collect:.3} s")),
            ]
        })
        .collect()
}

/// Returns the time after which a run is surely over. A robot without a radio unit would wait at the edge forever.
pub fn longest(testbed: &Testbed) -> Duration {
    let walks = testbed.walks.iter().map(walk_time).max().unwrap_or_default();
    (2 * walks).min(Duration::from_hours(24)) + Duration::from_secs(60)
}

/// Returns the domains of the orchestrators, in the order of their plug-ins.
pub fn domains(testbed: &Testbed) -> Vec<DomainId> {
    orchestrators(testbed).filter_map(|spec| spec.domain.clone()).collect()
}

#[cfg(test)]
mod tests;
