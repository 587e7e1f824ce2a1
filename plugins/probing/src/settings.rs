//! Settings of the plug-in.

use std::{ops::RangeInclusive, time::Duration};

use cotorra_plugin::settings::{self, Figure, InvalidSettings};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::{Map, Value};

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Settings {
    /// Bounds of the time from one scan to the next.
    #[serde(deserialize_with = "interval")]
    pub(crate) interval: RangeInclusive<Duration>,
    /// Lead of another radio unit's signal at which the robot changes, dB.
    #[serde(rename = "margin", deserialize_with = "margin")]
    pub(crate) margin_db: f64,
    /// Whether the robot changes after each scan.
    pub(crate) always: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { interval: Duration::from_secs(20)..=Duration::from_secs(25), margin_db: 0.0, always: false }
    }
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        settings::decode(settings)
    }
}

const INTERVAL: Figure = Figure {
    what: "a time between scans from 1 s to 1 h",
    example: "20 s` or `[20 s, 25 s]",
    range: 1.0..=3600.0,
    ..Figure::TIME
};

/// Decodes one time, or the bounds between which each time is drawn.
fn interval<'de, D: Deserializer<'de>>(deserializer: D) -> Result<RangeInclusive<Duration>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let bounds = match value.as_array().map(Vec::as_slice) {
        None => INTERVAL.read(&value).map(|time| (time, time)),
        Some([shortest, longest]) => INTERVAL.read(shortest).zip(INTERVAL.read(longest)),
        Some(_) => None,
    };
    let (shortest, longest) = bounds.ok_or_else(|| D::Error::custom(INTERVAL.mismatch(&value)))?;
    let [shortest, longest] = [shortest, longest].map(Duration::from_secs_f64);
    if shortest > longest {
        let reason =
            format!("{shortest:?} to {longest:?} leaves nothing between; put the shorter time first");
        return Err(D::Error::custom(reason));
    }
    Ok(shortest..=longest)
}

fn margin<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Figure::RATIO.deserialize(deserializer)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn decode(settings: Value) -> Result<Settings, String> {
        Settings::decode(settings.as_object().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn defaults_are_the_published_behaviour() {
        let settings = decode(json!({})).unwrap();
        assert_eq!(settings.interval, Duration::from_secs(20)..=Duration::from_secs(25));
        assert_eq!(settings.margin_db, 0.0);
    }

    #[test]
    fn reads_figures_with_their_units() {
        let settings = decode(json!({ "interval": ["1500 ms", "0.5min"], "margin": "2.5 dB" })).unwrap();
        assert_eq!(settings.interval, Duration::from_millis(1500)..=Duration::from_secs(30));
        assert_eq!(settings.margin_db, 2.5);
        let fixed = decode(json!({ "interval": "10 s" })).unwrap();
        assert_eq!(fixed.interval, Duration::from_secs(10)..=Duration::from_secs(10));
    }

    #[test]
    fn errors_show_a_correct_value() {
        let error = |settings| decode(settings).unwrap_err();
        assert_eq!(
            error(json!({ "intervall": "20 s" })),
            "intervall: unknown field `intervall`, expected one of `interval`, `margin`, `always`"
        );
        for wrong in [
            json!(20),
            json!("20"),
            json!("20 m"),
            json!("-5 s"),
            json!("10 ms"),
            json!("inf s"),
            json!(["20 s"]),
        ] {
            let message = error(json!({ "interval": wrong }));
            assert!(message.starts_with(&format!("interval: {wrong} is not")), "{message}");
            assert!(message.contains("write it like `20 s`"));
        }
        assert_eq!(
            error(json!({ "interval": ["25 s", "20 s"] })),
            "interval: 25s to 20s leaves nothing between; put the shorter time first"
        );
        for wrong in [json!(3), json!("3"), json!("-1 dB"), json!("NaN dB"), json!("101 dB")] {
            let message = error(json!({ "margin": wrong }));
            assert_eq!(
                message,
                format!("margin: {wrong} is not a ratio from 0 dB to 100 dB; write it like `3 dB`")
            );
        }
    }
}
