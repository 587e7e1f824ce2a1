//! The tables of a search.

use cotorra_testbed::{FolderError, write_file};

use super::finding::{Finding, Margins};
use crate::{
    csv::{push, quoted, values},
    journal::Journal,
    outcome::Void,
};

/// Files that [`Margins::write`] makes: a row per search, and everything.
pub const FILES: [&str; 2] = ["margins.csv", "margins.json"];

impl Margins {
    /// Writes [`FILES`] into the folder of a journal.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, journal: &Journal) -> Result<(), FolderError> {
        let [table, all] = FILES;
        write_file(journal.path(), table, table_of(&self.findings))?;
        let json = serde_json::to_string_pretty(self).expect("results are valid JSON");
        write_file(journal.path(), all, json + "\n")
    }
}

fn table_of(findings: &[Finding]) -> String {
    let mut text =
        "change,on,down,complete,breaks,service,survives_ms,breaks_ms,survives_loss,breaks_loss,kept,void\n"
            .to_owned();
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
        ];
        values(&mut text, &names);
        text += &name(service.as_ref().map(ToString::to_string));
        let figures = [*survives_ms, *breaks_ms, finding.survives_loss, finding.breaks_loss, *kept];
        figures.into_iter().for_each(|figure| push(&mut text, figure));
        text.push(',');
        text += &quoted(finding.void.as_ref().map(Void::reason).unwrap_or_default());
        text.push('\n');
    }
    text
}
