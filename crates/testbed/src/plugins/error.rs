//! Errors of starting plug-ins.

use std::io;

use cotorra_graph::PluginId;

/// Error of starting a plug-in.
#[derive(Debug, thiserror::Error)]
pub enum PluginError {
    /// No bundled plug-in has this name.
    #[error("plug-in `{plugin}`: `{name}` is not bundled; bundled are: federation, okpi, pace, probing")]
    NotBundled {
        plugin: PluginId,
        /// The name in the file.
        name: String,
    },
    /// The plug-in's settings are invalid.
    #[error("plug-in `{plugin}`: {reason}")]
    Settings {
        plugin: PluginId,
        /// The mistake in the settings.
        reason: String,
    },
    /// The plug-in is a program. It needs the API, which only a whole run serves.
    #[error("plug-in `{0}` is a program: it takes part in a run, not in a bare simulation")]
    NeedsRun(PluginId),
    /// The CPU time of a program, which its decisions take, is unknown.
    #[error("plug-in `{plugin}`: cannot measure its CPU time (`decides_in: cpu`): {source}")]
    CpuTime {
        plugin: PluginId,
        /// The system's error.
        source: io::Error,
    },
    /// The plug-in's program cannot be started.
    #[error("plug-in `{plugin}`: cannot start `{program}`: {source}")]
    Start {
        plugin: PluginId,
        program: String,
        /// The system's error.
        source: io::Error,
    },
}
