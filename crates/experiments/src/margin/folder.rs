//! The tables of a search.

use cotorra_testbed::{DataTable, FolderError, Void, write_file};

use super::finding::{Finding, Margins};
use crate::{cell::number, journal::Journal};

/// Files that [`Margins::write`] makes: a row per search, and everything.
pub const FILES: [&str; 2] = ["margins.csv", "margins.json"];

impl Margins {
    /// Writes [`FILES`] into the folder of a journal.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, journal: &Journal) -> Result<(), FolderError> {
        let [table, all] = FILES;
        write_file(journal.path(), table, table_of(&self.findings).to_csv())?;
        let json = serde_json::to_string_pretty(self).expect("results are valid JSON");
        write_file(journal.path(), all, json + "\n")
    }
}

fn table_of(findings: &[Finding]) -> DataTable {
    let mut table = DataTable::new([
        "change",
        "on",
        "down",
        "complete",
        "breaks",
        "service",
        "survives_ms",
        "breaks_ms",
        "survives_loss",
        "breaks_loss",
        "kept",
        "void",
    ]);
    for finding in findings {
        let Finding { change, on, down, breaks, survives_ms, breaks_ms, service, kept, complete, .. } =
            finding;
        let name = |name: Option<String>| name.unwrap_or_default();
        let names = [
            (*change).to_owned(),
            name(on.clone()),
            name(down.as_ref().map(ToString::to_string)),
            complete.to_string(),
            breaks.to_string(),
            name(service.as_ref().map(ToString::to_string)),
        ];
        let figures = [*survives_ms, *breaks_ms, finding.survives_loss, finding.breaks_loss, *kept];
        let void = finding.void.as_ref().map(Void::reason).unwrap_or_default().to_owned();
        table.row(names.into_iter().chain(figures.map(number)).chain([void]));
    }
    table
}
