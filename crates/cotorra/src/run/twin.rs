//! Runs beside their twins: the same run again for each plug-in with a distance, with that plug-in beside the core. The
//! difference is what old context cost.

use std::path::{Path, PathBuf};

use cotorra_graph::PluginSpec;
use cotorra_testbed::{Finished, Options, Place, StalenessRegret, beside_core, distant};

use super::{Error, Stage, complete};
use crate::{
    history::regret_of_folders,
    testbed_file::{self, FileError, Loaded},
};

/// Folder of the twins in the folder of their run.
const TWINS: &str = "twins";

impl Stage {
    /// Runs a testbed in virtual time, and its twins after it. Relative paths in it start at `base`.
    pub(super) fn simulate_with_twins(
        &self,
        loaded: &Loaded,
        base: &Path,
        options: Options,
    ) -> miette::Result<Finished> {
        let far: Vec<_> = distant(&loaded.testbed).collect();
        if far.is_empty() {
            return Err(Error::NoDistance.into());
        }
        let twins: Vec<_> =
            far.into_iter().map(|spec| Twin::of(spec, loaded, base)).collect::<Result<_, _>>()?;
        let (seed, until, history) = (options.seed, options.until, options.history.clone());
        let further = Options { captures: Vec::new(), recording: Default::default(), ..options.clone() };
        let mut finished = self.simulate_as(loaded, options, "", true)?;
        if finished.was_stopped() {
            return Ok(finished);
        }
        let mut regrets = Vec::new();
        for Twin { spec, loaded } in &twins {
            let folder = Place::At(finished.folder.join(TWINS).join(spec.id.as_str()));
            let options = Options { seed, until, folder, ..further.clone() };
            let twin = self.simulate(loaded, options, &format!("twin with {} beside the core: ", spec.id))?;
            if twin.was_stopped() {
                note!("warning: the twin was stopped, so that the summary has no regret of old context");
                return Ok(finished);
            }
            let void = [&finished, &twin].into_iter().find_map(|run| run.summary.void.wrong());
            if let Some(void) = void {
                note!("warning: what the distance of {} cost is unknown: {void}", spec.id);
                continue;
            }
            let services = regret_of_folders(&finished.folder, &twin.folder, history.as_ref())?;
            let twin = PathBuf::from(TWINS).join(spec.id.as_str());
            let (plugin, distance) = (spec.id.clone(), spec.distance.clone());
            regrets.push(StalenessRegret { plugin, distance, twin, services });
        }
        finished.add_staleness_regret(regrets).map_err(Error::from)?;
        complete(&finished)?;
        Ok(finished)
    }
}

/// A testbed with one plug-in beside the core.
struct Twin<'a> {
    /// The plug-in, with its distance.
    spec: &'a PluginSpec,
    loaded: Loaded,
}

impl<'a> Twin<'a> {
    fn of(spec: &'a PluginSpec, loaded: &Loaded, base: &Path) -> Result<Self, FileError> {
        let text = cotorra_testbed_file::annotated(&loaded.text, &beside_core(spec));
        let testbed = testbed_file::recorded(&text, "its twin", base, None)?;
        Ok(Self { spec, loaded: Loaded { testbed, text, warnings: Vec::new() } })
    }
}
