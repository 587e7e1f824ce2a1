//! A sweep's tables and plot, made from its journal of finished runs.

use cotorra_figure::Format;
use cotorra_testbed::{DataTable, FolderError, write_file};

use super::{Runs, figure, samples, tables};
use crate::journal::Journal;

/// Files that [`Runs::write`] makes: a row per run, a row per combination, a row per region of a run, a row per service of
/// a run, a row per service of a combination, and the latter for papers, a row per part of the service times of a run,
/// a row per place where samples of a run without an answer ended, the plot, and a row per figure of a combination that is
/// compared with the first.
pub const FILES: [&str; 10] = [
    "runs.csv",
    "cells.csv",
    "regions.csv",
    "services.csv",
    "service_cells.csv",
    "service_cells.tex",
    "time_parts.csv",
    "unanswered.csv",
    "sweep.svg",
    "differences.csv",
];

/// A row per KPI of a run, where services have KPIs beside their targets.
const KPIS: &str = "kpis.csv";
/// A row per source of traffic of a run, with its goodput, where there are sources.
const TRAFFIC: &str = "traffic.csv";
/// A row per price of a run, and a row per price of a combination for papers, where the testbed file has a currency.
const BILL: [&str; 2] = ["bill.csv", "bill.tex"];
/// The same of energies, where the testbed file has the power of a node.
const ENERGY: [&str; 2] = ["energy.csv", "energy.tex"];

impl Runs {
    /// Writes [`FILES`] into the folder of a journal, `kpis.csv` where services have KPIs beside their targets,
    /// `traffic.csv` where there are sources of traffic, `bill.csv` and `bill.tex` where there is a currency, and `energy.csv` and
    /// `energy.tex` where a node has a power. Of the samples there, only those of these runs stay.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, journal: &Journal) -> Result<(), FolderError> {
        let (path, cells) = (journal.path(), self.cells());
        let [
            of_runs,
            of_cells,
            of_regions,
            of_services,
            of_service_cells,
            for_papers,
            of_parts,
            of_unanswered,
            _,
            of_pairs,
        ] = FILES;
        let csv = |name, table: DataTable| write_file(path, name, table.to_csv());
        csv(of_runs, tables::runs(self))?;
        csv(of_cells, tables::cells(&self.axes, &cells))?;
        csv(of_regions, tables::regions(self))?;
        csv(of_services, tables::services(self))?;
        csv(of_service_cells, tables::service_cells(&self.axes, &cells))?;
        csv(of_parts, tables::time_parts(self))?;
        csv(of_pairs, tables::differences(&self.axes, &self.differences()))?;
        csv(of_unanswered, tables::unanswered(self))?;
        if let Some(of_kpis) = tables::kpis(self) {
            csv(KPIS, of_kpis)?;
        }
        if let Some(of_traffic) = tables::traffic(self) {
            csv(TRAFFIC, of_traffic)?;
        }
        let spent = [
            (BILL, tables::bill(self), self.prices(&cells)),
            (ENERGY, tables::energy(self), self.powers(&cells)),
        ];
        for ([of_runs, for_papers], runs, cells) in spent {
            if let (Some(runs), Some(cells)) = (runs, cells) {
                csv(of_runs, runs)?;
                write_file(path, for_papers, cells.to_latex())?;
            }
        }
        write_file(path, for_papers, tables::by_service(&self.axes, &cells).to_latex())?;
        let measured = self.done.iter().filter(|done| done.outcome.measured().is_some());
        samples::retain(path, &measured.map(|done| done.samples.as_path()).collect())?;
        self.write_figure(journal, Format::Svg)
    }

    /// Writes the plot, `sweep`, in a format.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(&self, journal: &Journal, format: Format) -> Result<(), FolderError> {
        let figure = figure::draw(&self.axes, &self.cells());
        write_file(journal.path(), &format!("sweep.{format}"), figure.draw().render(format))
    }
}
