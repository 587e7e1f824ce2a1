//! Settings of the plug-in.

use cotorra_plugin::settings::{self, InvalidSettings};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Settings of the plug-in.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// A robot is slowed when its signal falls below this, dBm.
    pub weak_dbm: f64,
    /// A slowed robot goes on at full speed when its signal rises above this, dBm.
    pub strong_dbm: f64,
    /// Speed of a slowed robot, m/s.
    pub speed_mps: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { weak_dbm: -75.0, strong_dbm: -70.0, speed_mps: 0.2 }
    }
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let settings: Self = settings::decode(settings)?;
        let Self { weak_dbm, strong_dbm, speed_mps } = settings;
        if weak_dbm >= strong_dbm {
            let reason = format!("{weak_dbm} dBm is not below strong_dbm, {strong_dbm} dBm");
            return Err(InvalidSettings::new("weak_dbm", reason));
        }
        if speed_mps <= 0.0 {
            return Err(InvalidSettings::new("speed_mps", format!("{speed_mps} m/s is not above 0")));
        }
        Ok(settings)
    }
}
