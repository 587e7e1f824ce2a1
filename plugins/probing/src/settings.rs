//! The plug-in's settings, as a testbed file gives them.

use std::{ops::RangeInclusive, time::Duration};

use serde_json::{Map, Value};

/// What can be set.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    /// Bounds of the time from one scan to the next.
    pub(crate) interval: RangeInclusive<Duration>,
    /// How much stronger another radio unit must be, dB.
    pub(crate) margin_db: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { interval: Duration::from_secs(20)..=Duration::from_secs(25), margin_db: 0.0 }
    }
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidSettings {
    /// There is no such setting.
    #[error("`{0}` is not a setting of probing; its settings are `interval` and `margin`")]
    Unknown(String),
    /// The time between scans is none.
    #[error(
        "interval: {0} is not a time between scans; write it like `20 s`, or `[20 s, 25 s]` to draw one between; \
         the units are `ms`, `s` and `min`, and it is 1 s to 1 h"
    )]
    Interval(Value),
    /// The bounds are the wrong way round.
    #[error("interval: {shortest:?} to {longest:?} leaves nothing between; put the shorter time first")]
    EmptyInterval {
        /// The first bound.
        shortest: Duration,
        /// The second.
        longest: Duration,
    },
    /// The margin is none.
    #[error("margin: {0} is not a ratio from 0 dB to 100 dB; write it like `3 dB`")]
    Margin(Value),
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let mut decoded = Self::default();
        for (name, value) in settings {
            match name.as_str() {
                "interval" => decoded.interval = interval(value)?,
                "margin" => decoded.margin_db = margin(value)?,
                _ => return Err(InvalidSettings::Unknown(name.clone())),
            }
        }
        Ok(decoded)
    }
}

fn interval(value: &Value) -> Result<RangeInclusive<Duration>, InvalidSettings> {
    let read = |value: &Value| duration(value).ok_or_else(|| InvalidSettings::Interval(value.clone()));
    let (shortest, longest) = match value.as_array().map(Vec::as_slice) {
        None => (read(value)?, read(value)?),
        Some([shortest, longest]) => (read(shortest)?, read(longest)?),
        Some(_) => return Err(InvalidSettings::Interval(value.clone())),
    };
    if shortest <= longest {
        Ok(shortest..=longest)
    } else {
        Err(InvalidSettings::EmptyInterval { shortest, longest })
    }
}

fn duration(value: &Value) -> Option<Duration> {
    let (figure, factor) = [("ms", 1e-3), ("min", 60.0), ("s", 1.0)]
        .into_iter()
        .find_map(|(unit, factor)| Some((figure(value, unit)?, factor)))?;
    let seconds = figure * factor;
    (1.0..=3600.0).contains(&seconds).then(|| Duration::from_secs_f64(seconds))
}

fn margin(value: &Value) -> Result<f64, InvalidSettings> {
    let margin = figure(value, "dB").filter(|margin| (0.0..=100.0).contains(margin));
    margin.ok_or_else(|| InvalidSettings::Margin(value.clone()))
}

/// The number before a unit.
fn figure(value: &Value, unit: &str) -> Option<f64> {
    value.as_str()?.strip_suffix(unit)?.trim_end().parse().ok()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn decode(settings: Value) -> Result<Settings, String> {
        Settings::decode(settings.as_object().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn nothing_set_is_the_published_behaviour() {
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
    fn says_what_is_wrong_and_what_would_be_right() {
        let said = |settings| decode(settings).unwrap_err();
        assert_eq!(
            said(json!({ "intervall": "20 s" })),
            "`intervall` is not a setting of probing; its settings are `interval` and `margin`"
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
            let message = said(json!({ "interval": wrong }));
            assert!(message.starts_with(&format!("interval: {wrong} is not")), "{message}");
            assert!(message.contains("write it like `20 s`"));
        }
        assert_eq!(
            said(json!({ "interval": ["25 s", "20 s"] })),
            "interval: 25s to 20s leaves nothing between; put the shorter time first"
        );
        for wrong in [json!(3), json!("3"), json!("-1 dB"), json!("NaN dB"), json!("101 dB")] {
            let message = said(json!({ "margin": wrong }));
            assert_eq!(
                message,
                format!("margin: {wrong} is not a ratio from 0 dB to 100 dB; write it like `3 dB`")
            );
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC*") {
            let _ = decode(json!({ "interval": text, "margin": text }));
        }
    }
}
