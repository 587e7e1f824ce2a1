//! Bundled plug-ins: makes them from a testbed file, in a run or in a rehearsal.

use std::path::Path;

use cotorra_federation::{Federation, LedgerChoice, Ledgers, Settings};
use cotorra_graph::{PluginProgram, PluginSpec, Testbed};
use cotorra_okpi::Okpi;
use cotorra_pace::Pace;
use cotorra_plugin::Plugin;
use cotorra_probing::Probing;
use cotorra_testbed_file::LEDGER_PATHS;
use serde_json::{Map, Value};

use super::{error::PluginError, programs::check_programs};
use crate::history::links::RunHistory;

/// Makes the bundled plug-ins of a testbed.
pub(crate) struct Bundled<'a> {
    testbed: &'a Testbed,
    seed: u64,
    ledgers: Ledgers,
    /// The run's history, if one is kept.
    history: Option<RunHistory>,
}

impl<'a> Bundled<'a> {
    pub(crate) fn new(testbed: &'a Testbed, seed: u64, ledgers: Ledgers) -> Self {
        Self { testbed, seed, ledgers, history: None }
    }

    /// The same, with the history of the run.
    pub(crate) fn reading(self, history: Option<RunHistory>) -> Self {
        Self { history, ..self }
    }

    /// Returns the ledgers that the plug-ins share. They have to live as long as the plug-ins.
    pub(crate) fn into_ledgers(self) -> Ledgers {
        self.ledgers
    }

    /// Makes a plug-in by its bundled name.
    pub(crate) fn make(&mut self, spec: &PluginSpec, name: &str) -> Result<Box<dyn Plugin>, PluginError> {
        let settings =
            |e: &dyn ToString| PluginError::Settings { plugin: spec.id.clone(), reason: e.to_string() };
        match name {
            "federation" => {
                let domain = spec.domain.as_ref();
                let resolved = from_folder(&spec.settings, &self.testbed.folder);
                let orchestrator = Federation::open(&resolved, domain, self.seed, &mut self.ledgers);
                Ok(Box::new(orchestrator.map_err(|e| settings(&e))?))
            }
            "okpi" => {
                let okpi = Okpi::from_settings(&spec.settings).map_err(|e| settings(&e))?;
                let okpi = match &self.history {
                    Some(history) => okpi.reading(history.clone()),
                    None => okpi,
                };
                Ok(Box::new(okpi.for_testbed(self.testbed).map_err(|e| settings(&e))?))
            }
            "pace" => Ok(Box::new(Pace::from_settings(&spec.settings).map_err(|e| settings(&e))?)),
            "probing" => {
                let probing = Probing::from_settings(&spec.settings, self.seed);
                Ok(Box::new(probing.map_err(|e| settings(&e))?))
            }
            _ => Err(PluginError::NotBundled { plugin: spec.id.clone(), name: name.to_owned() }),
        }
    }
}

/// Lets relative paths in an orchestrator's settings start at the testbed file's folder. A program without a slash is one
/// on the path.
fn from_folder(settings: &Map<String, Value>, folder: &Path) -> Map<String, Value> {
    let mut settings = settings.clone();
    let ledger = settings.get_mut("ledger").and_then(Value::as_object_mut);
    for (key, value) in ledger.into_iter().flatten() {
        if let Value::String(path) = value
            && LEDGER_PATHS.contains(&key.as_str())
            && (key != "program" || path.contains('/'))
        {
            *path = folder.join(&*path).to_string_lossy().into_owned();
        }
    }
    settings
}

/// Whether a bundled plug-in reads the run's history.
pub(crate) fn reads_history(testbed: &Testbed) -> bool {
    let reads = |spec: &PluginSpec| {
        matches!(&spec.program, PluginProgram::Bundled(name) if name == "okpi")
            && spec.settings.get("delays").is_some_and(|delays| delays == "history")
    };
    testbed.plugins.iter().any(reads)
}

/// Checks that a run could make the plug-ins. Real ledgers, which only a run uses, are not contacted.
pub(crate) fn rehearse(testbed: &Testbed) -> Result<(), PluginError> {
    check_programs(testbed)?;
    let mut maker =
        Bundled::new(testbed, testbed.seed, Ledgers::default()).reading(Some(RunHistory::default()));
    for spec in &testbed.plugins {
        let PluginProgram::Bundled(name) = &spec.program else { continue };
        if name == "federation" && has_real_ledger(spec) {
            let mut modelled = spec.clone();
            modelled.settings.remove("ledger");
            Bundled::new(testbed, testbed.seed, Ledgers::default()).make(&modelled, name)?;
        } else {
            maker.make(spec, name)?;
        }
    }
    Ok(())
}

/// Whether an orchestrator would use a ledger outside this process. Invalid settings use none.
fn has_real_ledger(spec: &PluginSpec) -> bool {
    let is_real = |choice| !matches!(choice, LedgerChoice::Modelled { .. });
    cfg!(feature = "ethereum") && Settings::decode(&spec.settings).is_ok_and(|set| is_real(set.ledger))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn paths_in_settings_start_at_the_testbed_files_folder() {
        let ledger =
            json!({ "ledger": { "key_store": "keys/a.json", "password_file": "/p", "url": "ws://a/b" } });
        let told = from_folder(ledger.as_object().unwrap(), Path::new("/bed"));
        let expected = json!({ "ledger": { "key_store": "/bed/keys/a.json", "password_file": "/p", "url": "ws://a/b" } });
        assert_eq!(Value::Object(told), expected);
        for (program, expected) in [("anvil", "anvil"), ("./anvil", "/bed/./anvil")] {
            let settings = json!({ "ledger": { "program": program } });
            let told = from_folder(settings.as_object().unwrap(), Path::new("/bed"));
            assert_eq!(told["ledger"]["program"], expected);
        }
    }
}
