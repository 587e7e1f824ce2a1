//! The tables of examined decisions.

use cotorra_testbed::{DataTable, FolderError, write_file};

use super::{Examined, Regrets};
use crate::{cell::number, journal::Journal};

/// Files that [`Regrets::write`] makes: a row per decision and per alternative, and everything.
pub const FILES: [&str; 2] = ["decisions.csv", "decisions.json"];

impl Regrets {
    /// Writes [`FILES`] into the folder of a journal.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, journal: &Journal) -> Result<(), FolderError> {
        let [table, all] = FILES;
        write_file(journal.path(), table, table_of(&self.examined).to_csv())?;
        let json = serde_json::to_string_pretty(self).expect("results are valid JSON");
        write_file(journal.path(), all, json + "\n")
    }
}

fn table_of(examined: &[Examined]) -> DataTable {
    let mut table = DataTable::new([
        "decision",
        "at_ns",
        "plugin",
        "subject",
        "target",
        "chosen",
        "walked",
        "refused",
        "samples",
        "kept",
        "service_time_p50_ms",
        "regret_kept",
        "regret_ms",
        "regret_cost",
        "late_samples",
        "cost",
        "migrations",
        "handovers",
        "seed",
        "void",
    ]);
    for Examined { seed, decided, stood, tried, regret_kept, regret_ms, regret_cost, .. } in examined {
        let own =
            (decided.chosen(), true, Some(stood), [None, None], [*regret_kept, *regret_ms, *regret_cost]);
        let others = tried.iter().map(|tried| {
            let without = [tried.refused.clone(), tried.void.as_ref().map(|void| void.reason().to_owned())];
            (tried.target.clone(), false, tried.stood.as_ref(), without, [None; 3])
        });
        for (target, chosen, stood, [refused, void], regrets) in std::iter::once(own).chain(others) {
            let names = [
                decided.number.to_string(),
                decided.at.as_nanos().to_string(),
                decided.plugin.to_string(),
                decided.subject().to_owned(),
                target,
                chosen.to_string(),
                stood.map(|stood| stood.walked.to_string()).unwrap_or_default(),
                refused.unwrap_or_default(),
                stood.map(|stood| stood.samples.to_string()).unwrap_or_default(),
            ];
            let count = |count: Option<usize>| count.map(|count| count as f64);
            let kept =
                [stood.and_then(|stood| stood.kept), stood.and_then(|stood| stood.service_time_p50_ms)];
            let others = [
                stood.and_then(|stood| count(stood.late)),
                stood.and_then(|stood| stood.cost),
                stood.and_then(|stood| count(stood.migrations)),
                stood.and_then(|stood| count(stood.handovers)),
            ];
            let figures = kept.into_iter().chain(regrets).chain(others).map(number);
            table.row(names.into_iter().chain(figures).chain([seed.to_string(), void.unwrap_or_default()]));
        }
    }
    table
}
