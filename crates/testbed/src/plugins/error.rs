//! Errors of starting plug-ins.

use std::io;

use cotorra_graph::PluginId;

/// Why a plug-in cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum PluginError {
    /// No such plug-in is bundled.
    #[error("plug-in `{plugin}`: `{name}` is not bundled; bundled are: federation, okpi, pace, probing")]
    NotBundled {
        /// Which.
        plugin: PluginId,
        /// The name in the file.
        name: String,
    },
    /// Its settings are wrong.
    #[error("plug-in `{plugin}`: {reason}")]
    Settings {
        /// Which.
        plugin: PluginId,
        /// What is wrong.
        reason: String,
    },
    /// It needs the API, which only a whole run serves.
    #[error("plug-in `{0}` is a program of its own: it takes part in a run, not in a bare simulation")]
    NeedsRun(PluginId),
    /// Its program cannot be started.
    #[error("plug-in `{plugin}`: cannot start `{program}`: {source}")]
    Start {
        /// Which.
        plugin: PluginId,
        /// The program.
        program: String,
        /// What the system says.
        source: io::Error,
    },
}
