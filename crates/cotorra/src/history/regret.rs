//! `cotorra history regret`: what old context cost, from a run with distances of plug-ins and its twin without them.

use std::path::Path;

use cotorra_graph::{PluginDistance, PluginId, PluginSpec};
use cotorra_measurements::{Location, regret::ServiceRegret};
use cotorra_testbed::{Manifest, MaybeTwin, TwinError, check_twin};
use serde::Serialize;

use super::{
    args::RegretArgs,
    services::testbed,
    source::{Error, Source},
};
use crate::{output, regret_table, testbed_file::FileError};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum RegretError {
    #[error(transparent)]
    #[diagnostic(help(
        "`cotorra run --simulate --twin` makes both runs; without it, run the same file with the same seed twice: as it is, \
         and with `--set \"plugins.ID.control_delay=0 ms\"`"
    ))]
    Twin(#[from] TwinError),
}

/// What old context cost, as JSON.
#[derive(Serialize)]
struct Regret {
    /// The plug-ins with a distance in the first run that are beside the core in the second.
    plugins: Vec<Distant>,
    services: Vec<ServiceRegret>,
}

#[derive(Serialize)]
struct Distant {
    plugin: PluginId,
    distance: PluginDistance,
}

impl Distant {
    fn of(spec: &PluginSpec) -> Self {
        Self { plugin: spec.id.clone(), distance: spec.distance.clone() }
    }
}

/// Returns what old context cost by service, and what distances made it old.
///
/// # Errors
/// What else the runs differ in.
fn regret_of(far: &Source, beside: &Source) -> miette::Result<Regret> {
    let testbeds = [testbed(far).map_err(FileError::from)?, testbed(beside).map_err(FileError::from)?];
    let manifests = [far, beside].map(|source| Manifest::read(source.folder.as_deref()?).ok());
    let run = |place: usize| {
        let run = &[far, beside][place].run;
        let (testbed, manifest) = (&testbeds[place], manifests[place].as_ref());
        MaybeTwin { info: &run.info, testbed, manifest, ended: run.ended.is_some() }
    };
    let plugins = check_twin(&run(0), &run(1)).map_err(RegretError::from)?;
    let plugins = plugins.into_iter().map(Distant::of).collect();
    let targets = testbeds[0].services.iter().map(|service| (service.id.clone(), service.kpis.service_time));
    let services = far.history.regrets_with(far.run.id, &beside.history, beside.run.id, &targets.collect());
    Ok(Regret { plugins, services: services.map_err(Error::from)? })
}

/// Returns what old context cost the services of a run whose twin is in another folder. `named` is the history that the user
/// named, with user and password.
pub fn of_folders(far: &Path, beside: &Path, named: Option<&Location>) -> miette::Result<Vec<ServiceRegret>> {
    let [far, beside] = [Source::of_folder(far, named)?, Source::of_folder(beside, named)?];
    Ok(regret_of(&far, &beside)?.services)
}

/// Says what old context cost.
pub fn regret(args: &RegretArgs) -> miette::Result<()> {
    let [far, beside] = &args.pair[..] else { unreachable!("the parser takes two runs") };
    let (far, beside) = (Source::find(far, &args.place)?, Source::find(beside, &args.place)?);
    let found = regret_of(&far, &beside)?;
    if args.json {
        let json = serde_json::to_string_pretty(&found).expect("a regret holds only what JSON can");
        return output::print_exact(&(json + "\n"));
    }
    let distances = found.plugins.iter().map(|its| format!("{}: {}", its.plugin, its.distance));
    let distances = distances.collect::<Vec<_>>().join("; ");
    output::print(&(regret_table::describe(&distances, &found.services) + &regret_table::explain()))
}
