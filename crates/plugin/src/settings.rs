//! Settings of plug-ins, as testbed files give them: decoded by serde, with figures that have units.
//!
//! ```
//! use cotorra_plugin::settings::{self, Figure};
//! use serde::{Deserialize, Deserializer};
//!
//! #[derive(Debug, Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Settings {
//!     #[serde(deserialize_with = "floor")]
//!     floor: f64,
//! }
//!
//! fn floor<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
//!     Figure::SIGNAL.deserialize(deserializer)
//! }
//!
//! let given = serde_json::json!({ "floor": "-80 dBm" });
//! let settings: Settings = settings::decode(given.as_object().unwrap())?;
//! assert_eq!(settings.floor, -80.0);
//! # Ok::<(), settings::InvalidSettings>(())
//! ```

use std::{fmt::Display, ops::RangeInclusive, time::Duration};

use cotorra_graph::Dbm;
use serde::{
    Deserialize, Deserializer,
    de::{DeserializeOwned, Error},
};
use serde_json::{Map, Value};

/// A setting that a plug-in cannot use, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{setting}{reason}")]
pub struct InvalidSettings {
    /// Path of the setting with a colon; empty for the settings as a whole.
    setting: String,
    reason: String,
}

impl InvalidSettings {
    /// Rejects a setting. `setting` is its path, such as `processing.navigation`.
    pub fn new(setting: &str, reason: impl Display) -> Self {
        let setting = if setting == "." { String::new() } else { format!("{setting}: ") };
        Self { setting, reason: reason.to_string() }
    }
}

/// Decodes settings by their declaration. Declare them with `deny_unknown_fields`, so that typing errors are found.
///
/// # Errors
/// [`InvalidSettings`] for the first setting that does not exist or has no such value.
pub fn decode<T: DeserializeOwned>(settings: &Map<String, Value>) -> Result<T, InvalidSettings> {
    serde_path_to_error::deserialize(Value::Object(settings.clone()))
        .map_err(|error| InvalidSettings::new(&error.path().to_string(), error.inner()))
}

/// A kind of figure with a unit.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Name with bounds, such as "a time from 1 ms to 1 day".
    pub what: &'static str,
    /// A correct one, for error messages.
    pub example: &'static str,
    /// Units and their factors. A unit that ends in another unit comes first.
    pub units: &'static [(&'static str, f64)],
    /// Bounds, in the unit whose factor is 1.
    pub range: RangeInclusive<f64>,
}

impl Figure {
    /// A signal, dBm.
    pub const SIGNAL: Self = Self {
        what: "a signal from -120 dBm to 0 dBm",
        example: "-80 dBm",
        units: &[("dBm", 1.0)],
        range: -120.0..=0.0,
    };
    /// A ratio of signals, dB.
    pub const RATIO: Self = Self {
        what: "a ratio from 0 dB to 100 dB",
        example: "3 dB",
        units: &[("dB", 1.0)],
        range: 0.0..=100.0,
    };
    /// A distance, metres.
    pub const DISTANCE: Self = Self {
        what: "a distance from 0 m to 100 m",
        example: "0.8 m",
        units: &[("m", 1.0)],
        range: 0.0..=100.0,
    };
    /// A time, seconds.
    pub const TIME: Self = Self {
        what: "a time from 1 ms to 1 day",
        example: "30 s",
        units: &[("ms", 1e-3), ("min", 60.0), ("s", 1.0)],
        range: 0.001..=86_400.0,
    };

    /// Reads a figure, in the unit whose factor is 1; `None` if it has no such unit or is out of bounds.
    pub fn read(&self, value: &Value) -> Option<f64> {
        let text = value.as_str()?;
        let (number, factor) =
            self.units.iter().find_map(|(unit, factor)| Some((text.strip_suffix(unit)?, factor)))?;
        let figure = number.trim_end().parse::<f64>().ok()? * factor;
        self.range.contains(&figure).then_some(figure)
    }

    /// Decodes a figure with serde.
    ///
    /// # Errors
    /// A message that names the kind of figure and shows a correct one.
    pub fn deserialize<'de, D: Deserializer<'de>>(&self, deserializer: D) -> Result<f64, D::Error> {
        let value = Value::deserialize(deserializer)?;
        self.read(&value).ok_or_else(|| D::Error::custom(self.mismatch(&value)))
    }

    /// The message for a value that is no such figure.
    pub fn mismatch(&self, value: &Value) -> String {
        format!("{value} is not {}; write it like `{}`", self.what, self.example)
    }
}

/// Decodes a time from 1 ms to 1 day, for `deserialize_with`.
///
/// # Errors
/// A message with a correct example.
pub fn duration<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    Figure::TIME.deserialize(deserializer).map(Duration::from_secs_f64)
}

/// Decodes a signal from -120 dBm to 0 dBm, for `deserialize_with`.
///
/// # Errors
/// A message with a correct example.
pub fn signal<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Dbm, D::Error> {
    Figure::SIGNAL.deserialize(deserializer).map(Dbm)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    #[test]
    fn figures_have_a_unit_and_bounds() {
        let time = |text: &str| Figure::TIME.read(&json!(text));
        assert_eq!([time("1500 ms"), time("0.5min"), time("10 s")], [Some(1.5), Some(30.0), Some(10.0)]);
        for wrong in ["20", "20 m", "-5 s", "0.1 ms", "inf s", "NaN s", "2 day", ""] {
            assert_eq!(time(wrong), None, "{wrong}");
        }
        assert_eq!(Figure::TIME.read(&json!(20)), None);
        assert_eq!(
            Figure::RATIO.mismatch(&json!(3)),
            "3 is not a ratio from 0 dB to 100 dB; write it like `3 dB`"
        );
    }

    #[test]
    fn errors_name_the_setting() {
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Settings {
            #[serde(deserialize_with = "duration", rename = "lead")]
            _lead: Duration,
        }
        let error = |given: Value| decode::<Settings>(given.as_object().unwrap()).unwrap_err().to_string();
        assert_eq!(
            error(json!({ "lead": "soon" })),
            "lead: \"soon\" is not a time from 1 ms to 1 day; write it like `30 s`"
        );
        assert_eq!(error(json!({ "laed": "1 s" })), "laed: unknown field `laed`, expected `lead`");
    }

    proptest! {
        #[test]
        fn figures_of_any_text_are_read_or_rejected(text in "\\PC*") {
            for figure in [Figure::SIGNAL, Figure::RATIO, Figure::DISTANCE, Figure::TIME] {
                let read = figure.read(&json!(text));
                prop_assert!(read.is_none_or(|read| figure.range.contains(&read)));
            }
        }
    }
}
