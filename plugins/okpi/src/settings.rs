//! Settings of the plug-in.

use std::{collections::BTreeMap, num::NonZeroUsize};

use cotorra_graph::{NodeId, Position, ServiceId, Testbed, VnfId};
use cotorra_plugin::{
    links::Measurements,
    settings::{self, Figure, InvalidSettings},
};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::{Map, Value};

use crate::{coverage::Coverage, model::Queue, search::Search};

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    pub(crate) search: Search,
    pub(crate) coverage: Coverage,
    /// Queues of VNFs whose processing takes time.
    pub(crate) processing: BTreeMap<VnfId, Queue>,
    pub(crate) delays: Delays,
    /// Use of measurements.
    pub(crate) measurements: Measurements,
    /// Services that are orchestrated; `None` for all.
    pub(crate) services: Option<Vec<ServiceId>>,
}

/// Source of links' delays, throughputs and losses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Delays {
    /// The configuration.
    Asked,
    /// Links' contexts as they are published. The configuration is the least.
    #[default]
    Measured,
    /// The same contexts as the history has them, read at each decision.
    History,
}

/// Settings as a testbed file declares them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Declared {
    #[serde(deserialize_with = "gamma")]
    gamma: u16,
    #[serde(deserialize_with = "k_paths")]
    k_paths: Option<NonZeroUsize>,
    relax: bool,
    #[serde(deserialize_with = "floor")]
    floor: Option<f64>,
    #[serde(deserialize_with = "margin")]
    margin: Option<f64>,
    #[serde(deserialize_with = "hysteresis")]
    hysteresis: Option<f64>,
    coverage: Option<BTreeMap<NodeId, Area>>,
    processing: BTreeMap<VnfId, QueueSettings>,
    delays: Delays,
    measurements: Option<Measurements>,
    services: Option<Vec<ServiceId>>,
}

impl Default for Declared {
    fn default() -> Self {
        Self {
            gamma: 4,
            k_paths: None,
            relax: false,
            floor: None,
            margin: None,
            hysteresis: None,
            coverage: None,
            processing: BTreeMap::new(),
            delays: Delays::default(),
            measurements: None,
            services: None,
        }
    }
}

/// Corners of a surveyed area, metres.
#[derive(Deserialize)]
#[serde(try_from = "Vec<[f64; 2]>")]
struct Area(Vec<Position>);

impl TryFrom<Vec<[f64; 2]>> for Area {
    type Error = &'static str;

    fn try_from(corners: Vec<[f64; 2]>) -> Result<Self, Self::Error> {
        if corners.len() < 3 {
            return Err(
                "an area has three corners or more; write it like `[[0, 0], [5, 0], [5, 5]]`, in metres",
            );
        }
        Ok(Self(corners.into_iter().map(|[x, y]| Position::new(x, y)).collect()))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct QueueSettings {
    #[serde(deserialize_with = "service_rate")]
    service_rate: f64,
    #[serde(deserialize_with = "arrival_rate")]
    arrival_rate: f64,
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let declared: Declared = settings::decode(settings)?;
        let mut search = Search::at(declared.gamma);
        search.k_paths = declared.k_paths.unwrap_or(search.k_paths);
        search.relax = declared.relax;
        let Declared { coverage, floor, margin, hysteresis, .. } = declared;
        let coverage = match (coverage, floor, margin, hysteresis) {
            (Some(_), Some(_), _, _) => return Err(with_coverage("floor")),
            (Some(_), _, Some(_), _) => return Err(with_coverage("margin")),
            (None, _, _, Some(_)) => {
                let reason = "needs `coverage`: it is how far beyond its area a radio unit is kept";
                return Err(InvalidSettings::new("hysteresis", reason));
            }
            (Some(areas), None, None, hysteresis) => Coverage::Survey {
                areas: areas.into_iter().map(|(unit, area)| (unit, area.0)).collect(),
                hysteresis_m: hysteresis.unwrap_or(0.0),
            },
            (None, floor, margin, None) => {
                Coverage::Signal { floor_dbm: floor.unwrap_or(-80.0), margin_db: margin.unwrap_or(7.5) }
            }
        };
        if declared.delays == Delays::Asked && declared.measurements.is_some() {
            let reason = "are not used with `delays: asked`; leave one of the two out";
            return Err(InvalidSettings::new("measurements", reason));
        }
        let queue =
            |(vnf, QueueSettings { service_rate, arrival_rate })| (vnf, Queue { service_rate, arrival_rate });
        Ok(Self {
            search,
            coverage,
            processing: declared.processing.into_iter().map(queue).collect(),
            delays: declared.delays,
            measurements: declared.measurements.unwrap_or_default(),
            services: declared.services,
        })
    }

    /// Whether a service is orchestrated.
    pub(crate) fn orchestrates(&self, service: &ServiceId) -> bool {
        self.services.as_ref().is_none_or(|services| services.contains(service))
    }

    /// Checks that the testbed has all nodes, services and VNFs that settings name.
    ///
    /// # Errors
    /// [`InvalidSettings`] for the first that it does not have.
    pub(crate) fn check(&self, testbed: &Testbed) -> Result<(), InvalidSettings> {
        if let Coverage::Survey { areas, .. } = &self.coverage {
            let units: Vec<_> = testbed.graph.radio_units().map(|(node, _)| node.id.as_str()).collect();
            check_names("coverage", "radio unit", areas.keys().map(NodeId::as_str), &units)?;
        }
        let services: Vec<_> = testbed.services.iter().map(|service| service.id.as_str()).collect();
        let wanted = self.services.iter().flatten().map(ServiceId::as_str);
        check_names("services", "service", wanted, &services)?;
        let vnfs = testbed.services.iter().flat_map(|service| &service.vnfs);
        let vnfs: Vec<_> = vnfs.map(|vnf| vnf.id.as_str()).collect();
        check_names("processing", "VNF", self.processing.keys().map(VnfId::as_str), &vnfs)
    }
}

fn with_coverage(setting: &str) -> InvalidSettings {
    InvalidSettings::new(setting, "cannot be set together with `coverage`: areas take the place of signals")
}

fn check_names<'a>(
    setting: &'static str,
    kind: &'static str,
    mut names: impl Iterator<Item = &'a str>,
    known: &[&str],
) -> Result<(), InvalidSettings> {
    let Some(name) = names.find(|name| !known.contains(name)) else { return Ok(()) };
    let distance = |known: &&&str| strsim::damerau_levenshtein(&known.to_lowercase(), &name.to_lowercase());
    let nearest = known.iter().min_by_key(distance);
    let hint = nearest.map_or_else(String::new, |nearest| format!("; did you mean `{nearest}`?"));
    Err(InvalidSettings::new(setting, format!("the testbed has no {kind} `{name}`{hint}")))
}

/// Packets a second.
const RATE: Figure =
    Figure { what: "a rate of 0 /s or more", example: "20 /s", units: &[("/s", 1.0)], range: 0.0..=f64::MAX };

fn gamma<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    count(deserializer, 1000)
}

fn k_paths<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<NonZeroUsize>, D::Error> {
    count(deserializer, 3).map(|count| NonZeroUsize::new(count.into()))
}

fn count<'de, D: Deserializer<'de>>(deserializer: D, most: u16) -> Result<u16, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let count = value.as_u64().and_then(|count| u16::try_from(count).ok());
    count
        .filter(|count| (1..=most).contains(count))
        .ok_or_else(|| D::Error::custom(format!("{value} is not a whole number from 1 to {most}")))
}

fn floor<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Figure::SIGNAL.deserialize(deserializer).map(Some)
}

fn margin<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Figure::RATIO.deserialize(deserializer).map(Some)
}

fn hysteresis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Figure::DISTANCE.deserialize(deserializer).map(Some)
}

fn arrival_rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    RATE.deserialize(deserializer)
}

fn service_rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let above =
        Figure { what: "a rate above 0 /s", example: "500 /s", range: f64::MIN_POSITIVE..=f64::MAX, ..RATE };
    above.deserialize(deserializer)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn decode(settings: Value) -> Result<Settings, String> {
        Settings::decode(settings.as_object().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn defaults_are_the_published_resolution() {
        let settings = decode(json!({})).unwrap();
        assert_eq!(settings.search, Search::at(4));
        assert_eq!(settings.coverage, Coverage::Signal { floor_dbm: -80.0, margin_db: 7.5 });
        assert!(settings.processing.is_empty());
        assert_eq!((settings.delays, settings.measurements), (Delays::Measured, Measurements::default()));
    }

    #[test]
    fn all_settings_are_read() {
        let settings = decode(json!({
            "gamma": 10, "k_paths": 2, "relax": true, "hysteresis": "0.8 m",
            "coverage": { "R1": [[0, 0], [1.5, 0], [0, 2]] },
            "processing": { "navigation": { "service_rate": "500 /s", "arrival_rate": "20/s" } },
            "measurements": { "tolerance": "2 ms", "window": "20 s", "every": "1 s", "hold": "2 min", "candidates": true },
        }))
        .unwrap();
        assert_eq!(settings.search, Search { k_paths: 2.try_into().unwrap(), relax: true, ..Search::at(10) });
        let area = vec![Position::new(0.0, 0.0), Position::new(1.5, 0.0), Position::new(0.0, 2.0)];
        let areas = BTreeMap::from([(NodeId::new("R1").unwrap(), area)]);
        assert_eq!(settings.coverage, Coverage::Survey { areas, hysteresis_m: 0.8 });
        let queue = Queue { service_rate: 500.0, arrival_rate: 20.0 };
        assert_eq!(settings.processing, BTreeMap::from([(VnfId::new("navigation").unwrap(), queue)]));
        let [tolerance, window, every, hold] = [2, 20_000, 1000, 120_000].map(Duration::from_millis);
        assert_eq!(settings.measurements, Measurements { tolerance, window, every, hold, candidates: true });
        let signals = decode(json!({ "floor": "-70 dBm", "margin": "3dB" })).unwrap();
        assert_eq!(signals.coverage, Coverage::Signal { floor_dbm: -70.0, margin_db: 3.0 });
    }

    #[test]
    fn errors_show_a_correct_value() {
        for (wrong, said) in [
            (json!({ "gama": 4 }), "gama: unknown field `gama`, expected one of `gamma`, `k_paths`"),
            (json!({ "gamma": 0 }), "gamma: 0 is not a whole number from 1 to 1000"),
            (json!({ "gamma": 2.5 }), "gamma: 2.5 is not a whole number from 1 to 1000"),
            (json!({ "k_paths": "3" }), "k_paths: \"3\" is not a whole number from 1 to 3"),
            (json!({ "relax": 1 }), "relax: invalid type: integer `1`, expected a boolean"),
            (json!({ "services": "all" }), "services: invalid type: string \"all\", expected a sequence"),
            (json!({ "services": [7] }), "services[0]: invalid type: integer `7`, expected a string"),
            (
                json!({ "delays": "guessed" }),
                "delays: unknown variant `guessed`, expected one of `asked`, `measured`, `history`",
            ),
            (
                json!({ "measurements": { "window": "10 ms" } }),
                "measurements.window: \"10 ms\" is not a time from 1 s to 1 h; write it like `10 s`",
            ),
            (
                json!({ "measurements": { "evry": "1 s" } }),
                "measurements.evry: unknown field `evry`, expected one of `tolerance`, `window`, `every`, `hold`",
            ),
            (
                json!({ "delays": "asked", "measurements": {} }),
                "measurements: are not used with `delays: asked`",
            ),
            (
                json!({ "floor": "-80" }),
                "floor: \"-80\" is not a signal from -120 dBm to 0 dBm; write it like `-80",
            ),
            (json!({ "margin": "NaN dB" }), "margin: \"NaN dB\" is not a ratio"),
            (json!({ "hysteresis": "1 m" }), "hysteresis: needs `coverage`"),
            (
                json!({ "coverage": { "R1": [[0, 0], [1, 1]] } }),
                "coverage.R1: an area has three corners or more",
            ),
            (json!({ "coverage": { "R1": [[0, 0], [1, 1], [2]] } }), "coverage.R1"),
            (json!({ "coverage": {}, "floor": "-80 dBm" }), "floor: cannot be set together with `coverage`"),
            (json!({ "processing": { "n": { "service_rate": "5 /s" } } }), "processing.n"),
            (
                json!({ "processing": { "n": { "service_rate": "0 /s", "arrival_rate": "0 /s" } } }),
                "processing.n",
            ),
        ] {
            let message = decode(wrong).unwrap_err();
            assert!(message.starts_with(said), "{message}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC*") {
            for name in ["gamma", "k_paths", "relax", "floor", "margin", "hysteresis", "coverage", "processing", "delays", "measurements", "services"] {
                let _ = decode(json!({ name: text }));
            }
        }
    }
}
