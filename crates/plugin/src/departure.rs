//! When a robot is about to leave the coverage of its domain, and who says so.

use std::time::Duration;

use cotorra_graph::{Dbm, DomainId, PluginProgram, Testbed};
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::settings::{self, InvalidSettings};

/// Name of the bundled plug-in whose settings these are.
const FEDERATION: &str = "federation";

/// Settings of the plug-in `federation` that say when it announces a service. A robot's brain reads the same.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub struct Departure {
    /// Weakest signal of the domain's own radio units that counts as coverage.
    #[serde(deserialize_with = "settings::signal")]
    pub edge: Dbm,
    /// Time before a robot leaves coverage at which a service is needed.
    #[serde(deserialize_with = "settings::duration")]
    pub lead: Duration,
    /// Who says that it is needed.
    pub trigger: Trigger,
}

/// Who says that a robot needs a federation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trigger {
    /// The plug-in, from κ(r), the walk and the coverage.
    #[default]
    Coverage,
    /// The robot's brain, in its answers to position packets.
    Brain,
}

impl Default for Departure {
    fn default() -> Self {
        Self { edge: Dbm(-70.0), lead: Duration::from_secs(30), trigger: Trigger::default() }
    }
}

impl Departure {
    /// Decodes its part of the plug-in's settings.
    ///
    /// # Errors
    /// [`InvalidSettings`].
    pub fn decode(given: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        settings::decode(given)
    }

    /// Returns what brains of a domain's robots have to say; `None` if the domain's plug-in does not wait for them. Settings
    /// that the plug-in rejects count as none.
    pub fn by_brain(testbed: &Testbed, domain: &DomainId) -> Option<Self> {
        let mut plugins = testbed.plugins.iter().filter(|spec| spec.domain.as_ref() == Some(domain));
        let spec = plugins
            .find(|spec| matches!(&spec.program, PluginProgram::Bundled(name) if name == FEDERATION))?;
        Self::decode(&spec.settings).ok().filter(|departure| departure.trigger == Trigger::Brain)
    }
}
