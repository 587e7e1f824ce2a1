//! Age of the contexts on which plug-ins decide.

use std::{fmt, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{id::PluginId, units::millis};

/// Age of the contexts of one kind that a plug-in knew when it decided, at the time when its instruction is carried out.
///
/// Only the newest context of each robot, radio unit, direction of a link, sensor or machine counts. A plug-in that is beside
/// the core and decides at once has none of these records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Staleness {
    /// The plug-in.
    pub plugin: PluginId,
    /// Kind of the contexts.
    pub kind: ContextKind,
    /// Number of contexts.
    pub contexts: u32,
    /// Age of the youngest.
    #[serde(rename = "youngest_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub youngest: Duration,
    /// Age of the oldest.
    #[serde(rename = "oldest_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub oldest: Duration,
}

/// Kind of a context that is sampled all the time.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum ContextKind {
    /// κ of robots.
    Robot,
    /// ι of radio units.
    Radio,
    /// d, λ and conditions of links.
    Link,
    /// Readings of sensors.
    Sensor,
    /// Contexts of machines.
    Machine,
}

impl ContextKind {
    /// All kinds.
    pub const ALL: [Self; 5] = [Self::Robot, Self::Radio, Self::Link, Self::Sensor, Self::Machine];

    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Radio => "radio",
            Self::Link => "link",
            Self::Sensor => "sensor",
            Self::Machine => "machine",
        }
    }
}

impl fmt::Display for ContextKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
