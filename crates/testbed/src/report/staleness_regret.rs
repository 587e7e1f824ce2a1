//! What old context cost in a run, beside its twins.

use std::path::PathBuf;

use cotorra_graph::{PluginDistance, PluginId};
use cotorra_measurements::regret::ServiceRegret;
use serde::Serialize;

/// What the distance of a plug-in cost: the run, less its twin with that plug-in beside the core.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StalenessRegret {
    pub plugin: PluginId,
    /// Its distance in the run.
    pub distance: PluginDistance,
    /// Folder of the twin, from the folder of the run.
    pub twin: PathBuf,
    /// The services, by name.
    pub services: Vec<ServiceRegret>,
}
