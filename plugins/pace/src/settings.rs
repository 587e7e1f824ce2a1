//! The plug-in's settings, as a testbed file gives them.

use serde::Deserialize;
use serde_json::{Map, Value};

/// What can be set.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// A robot that is received with less is slowed, dBm …
    pub weak_dbm: f64,
    /// … until it is received with more than this, dBm.
    pub strong_dbm: f64,
    /// To this speed, m/s.
    pub speed_mps: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { weak_dbm: -75.0, strong_dbm: -70.0, speed_mps: 0.2 }
    }
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidSettings {
    /// There is no such setting, or it has another type.
    #[error("{0}; the settings of pace are `weak_dbm`, `strong_dbm` and `speed_mps`, numbers all three")]
    Unreadable(String),
    /// Every signal is weak or strong.
    #[error("weak_dbm: {0} dBm is not below strong_dbm, {1} dBm")]
    Order(String, String),
    /// A robot does not arrive that stands.
    #[error("speed_mps: {0} m/s is not above 0")]
    Speed(String),
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let settings: Self = serde_json::from_value(Value::Object(settings.clone()))
            .map_err(|error| InvalidSettings::Unreadable(error.to_string()))?;
        let Self { weak_dbm, strong_dbm, speed_mps } = settings;
        if weak_dbm >= strong_dbm {
            return Err(InvalidSettings::Order(weak_dbm.to_string(), strong_dbm.to_string()));
        }
        if speed_mps <= 0.0 {
            return Err(InvalidSettings::Speed(speed_mps.to_string()));
        }
        Ok(settings)
    }
}
