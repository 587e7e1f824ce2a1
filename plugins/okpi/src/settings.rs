//! The plug-in's settings, as a testbed file gives them.

use std::{collections::BTreeMap, num::NonZeroUsize, ops::RangeInclusive};

use cotorra_graph::{NodeId, Position, ServiceId, Testbed, VnfId};
use serde_json::{Map, Value};

use crate::{coverage::Coverage, model::Queue, placement::Search};

/// What can be set.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    pub(crate) search: Search,
    pub(crate) coverage: Coverage,
    /// The queues of VNFs whose processing takes time.
    pub(crate) processing: BTreeMap<VnfId, Queue>,
    pub(crate) delays: Delays,
    /// The services that are orchestrated; `None` for all.
    pub(crate) services: Option<Vec<ServiceId>>,
}

/// Where delays and throughputs of links come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Delays {
    /// As they happen.
    #[default]
    Events,
    /// The history is asked for its state at each new location.
    History,
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidSettings {
    /// There is no such setting.
    #[error(
        "`{0}` is not a setting of okpi; its settings are `gamma`, `k_paths`, `relax`, `floor`, `margin`, \
         `coverage`, `hysteresis`, `processing`, `delays` and `services`"
    )]
    Unknown(String),
    /// γ or the number of paths is none.
    #[error("{name}: {value} is not a whole number from 1 to {most}")]
    Count {
        /// The setting.
        name: &'static str,
        /// What it says.
        value: Value,
        /// The largest that it can be.
        most: u64,
    },
    /// `relax` is neither.
    #[error("relax: {0} is neither `true` nor `false`")]
    Relax(Value),
    /// A figure has no such value or unit.
    #[error("{name}: {value} is not {what}; write it like `{example}`")]
    Figure {
        /// The setting.
        name: &'static str,
        /// What it says.
        value: Value,
        /// What it can be.
        what: &'static str,
        /// One that is right.
        example: &'static str,
    },
    /// An area is none.
    #[error(
        "coverage: {0} is not a map from radio units to areas; write one like \
         `R1: [[0, 0], [5, 0], [5, 5]]`, with three corners or more, in metres"
    )]
    Coverage(Value),
    /// A queue is none.
    #[error(
        "processing: {0} is not a map from VNFs to queues; write one like \
         `navigation: {{ service_rate: 500 /s, arrival_rate: 20 /s }}`, with the service rate above 0 /s"
    )]
    Processing(Value),
    /// Services are none.
    #[error("services: {0} is not a list of services; write one like `[navigation]`")]
    Services(Value),
    /// `delays` is neither.
    #[error("delays: {0} is neither `events` nor `history`")]
    Delays(Value),
    /// The history is asked over the API.
    #[error(
        "delays: `history` is for an okpi that is a program of its own, and asks over the API; let the plug-in's \
         `command` name one, or leave `delays` out"
    )]
    NoClient,
    /// Signals say nothing where areas are surveyed, and the other way round.
    #[error("`{0}` cannot be set together with `coverage`: areas take the place of signals")]
    WithCoverage(&'static str),
    /// A testbed has no thing of that name.
    #[error("{setting}: the testbed has no {kind} `{name}`{}", did_you_mean(.nearest))]
    UnknownName {
        /// The setting.
        setting: &'static str,
        /// What it names.
        kind: &'static str,
        /// The name.
        name: String,
        /// The name of that kind that is most like it; `None` where there is none.
        nearest: Option<String>,
    },
    /// Only areas have an edge to be kept beyond.
    #[error("`hysteresis` needs `coverage`: it is how far beyond its area a radio unit is kept")]
    HysteresisAlone,
}

impl Settings {
    pub(crate) fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let mut search = Search::at(4);
        let (mut floor, mut margin, mut areas, mut hysteresis) = (None, None, None, None);
        let (mut queues, mut delays, mut services) = (BTreeMap::new(), Delays::default(), None);
        for (name, value) in settings {
            match name.as_str() {
                "gamma" => search.gamma = count("gamma", value, 1000)? as u16,
                "k_paths" => {
                    let paths = count("k_paths", value, 3)? as usize;
                    search.k_paths = search.k_paths.min(NonZeroUsize::MIN).saturating_add(paths - 1);
                }
                "relax" => {
                    search.relax = value.as_bool().ok_or_else(|| InvalidSettings::Relax(value.clone()))?;
                }
                "floor" => floor = Some(FLOOR.read(value)?),
                "margin" => margin = Some(MARGIN.read(value)?),
                "hysteresis" => hysteresis = Some(HYSTERESIS.read(value)?),
                "coverage" => {
                    areas = Some(surveyed(value).ok_or_else(|| InvalidSettings::Coverage(value.clone()))?);
                }
                "processing" => {
                    queues = processing(value).ok_or_else(|| InvalidSettings::Processing(value.clone()))?;
                }
                "delays" => {
                    delays = match value.as_str() {
                        Some("events") => Delays::Events,
                        Some("history") => Delays::History,
                        _ => return Err(InvalidSettings::Delays(value.clone())),
                    };
                }
                "services" => {
                    services = Some(listed(value).ok_or_else(|| InvalidSettings::Services(value.clone()))?);
                }
                _ => return Err(InvalidSettings::Unknown(name.clone())),
            }
        }
        let coverage = match (areas, floor, margin, hysteresis) {
            (Some(_), Some(_), _, _) => return Err(InvalidSettings::WithCoverage("floor")),
            (Some(_), _, Some(_), _) => return Err(InvalidSettings::WithCoverage("margin")),
            (None, _, _, Some(_)) => return Err(InvalidSettings::HysteresisAlone),
            (Some(areas), None, None, hysteresis) => {
                Coverage::Survey { areas, hysteresis_m: hysteresis.unwrap_or(0.0) }
            }
            (None, floor, margin, None) => {
                Coverage::Signal { floor_dbm: floor.unwrap_or(-80.0), margin_db: margin.unwrap_or(7.5) }
            }
        };
        Ok(Self { search, coverage, processing: queues, delays, services })
    }

    /// Whether a service is orchestrated.
    pub(crate) fn orchestrates(&self, service: &ServiceId) -> bool {
        self.services.as_ref().is_none_or(|services| services.contains(service))
    }

    /// Whether all that is named exists in a testbed.
    ///
    /// # Errors
    /// [`InvalidSettings::UnknownName`] for the first that does not.
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

fn check_names<'a>(
    setting: &'static str,
    kind: &'static str,
    mut names: impl Iterator<Item = &'a str>,
    known: &[&str],
) -> Result<(), InvalidSettings> {
    let Some(name) = names.find(|name| !known.contains(name)) else { return Ok(()) };
    let unlike = |known: &&&str| strsim::damerau_levenshtein(&known.to_lowercase(), &name.to_lowercase());
    let nearest = known.iter().min_by_key(unlike).map(|&nearest| nearest.to_owned());
    Err(InvalidSettings::UnknownName { setting, kind, name: name.to_owned(), nearest })
}

fn did_you_mean(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |nearest| format!("; did you mean `{nearest}`?"))
}

/// A setting that is a figure with a unit.
struct Figure {
    name: &'static str,
    unit: &'static str,
    range: RangeInclusive<f64>,
    what: &'static str,
    example: &'static str,
}

const FLOOR: Figure = Figure {
    name: "floor",
    unit: "dBm",
    range: -120.0..=0.0,
    what: "a signal from -120 dBm to 0 dBm",
    example: "-80 dBm",
};
const MARGIN: Figure = Figure {
    name: "margin",
    unit: "dB",
    range: 0.0..=100.0,
    what: "a ratio from 0 dB to 100 dB",
    example: "7.5 dB",
};
const HYSTERESIS: Figure = Figure {
    name: "hysteresis",
    unit: "m",
    range: 0.0..=100.0,
    what: "a distance from 0 m to 100 m",
    example: "0.8 m",
};

impl Figure {
    fn read(&self, value: &Value) -> Result<f64, InvalidSettings> {
        figure(value, self.unit).filter(|figure| self.range.contains(figure)).ok_or_else(|| {
            InvalidSettings::Figure {
                name: self.name,
                value: value.clone(),
                what: self.what,
                example: self.example,
            }
        })
    }
}

fn count(name: &'static str, value: &Value, most: u64) -> Result<u64, InvalidSettings> {
    let count = value.as_u64().filter(|count| (1..=most).contains(count));
    count.ok_or_else(|| InvalidSettings::Count { name, value: value.clone(), most })
}

fn surveyed(value: &Value) -> Option<BTreeMap<NodeId, Vec<Position>>> {
    let place = |corner: &Value| match corner.as_array()?.as_slice() {
        [x, y] => Some(Position::new(x.as_f64()?, y.as_f64()?)),
        _ => None,
    };
    let area = |(unit, area): (&String, &Value)| {
        let corners: Vec<_> = area.as_array()?.iter().map(place).collect::<Option<_>>()?;
        (corners.len() >= 3).then_some((NodeId::new(unit).ok()?, corners))
    };
    value.as_object()?.iter().map(area).collect()
}

fn processing(value: &Value) -> Option<BTreeMap<VnfId, Queue>> {
    let queue = |(vnf, queue): (&String, &Value)| {
        let queue = queue.as_object().filter(|queue| queue.len() == 2)?;
        let rate = |name| figure(queue.get(name)?, "/s").filter(|rate| rate.is_finite() && *rate >= 0.0);
        let (service_rate, arrival_rate) = (rate("service_rate")?, rate("arrival_rate")?);
        (service_rate > 0.0).then_some((VnfId::new(vnf).ok()?, Queue { service_rate, arrival_rate }))
    };
    value.as_object()?.iter().map(queue).collect()
}

fn listed(value: &Value) -> Option<Vec<ServiceId>> {
    value.as_array()?.iter().map(|name| ServiceId::new(name.as_str()?).ok()).collect()
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
    fn nothing_set_is_the_published_resolution() {
        let settings = decode(json!({})).unwrap();
        assert_eq!(settings.search, Search::at(4));
        assert_eq!(settings.coverage, Coverage::Signal { floor_dbm: -80.0, margin_db: 7.5 });
        assert!(settings.processing.is_empty());
    }

    #[test]
    fn reads_all_that_can_be_set() {
        let settings = decode(json!({
            "gamma": 10, "k_paths": 2, "relax": true, "hysteresis": "0.8 m",
            "coverage": { "R1": [[0, 0], [1.5, 0], [0, 2]] },
            "processing": { "navigation": { "service_rate": "500 /s", "arrival_rate": "20/s" } },
        }))
        .unwrap();
        assert_eq!(settings.search, Search { k_paths: 2.try_into().unwrap(), relax: true, ..Search::at(10) });
        let area = vec![Position::new(0.0, 0.0), Position::new(1.5, 0.0), Position::new(0.0, 2.0)];
        let areas = BTreeMap::from([(NodeId::new("R1").unwrap(), area)]);
        assert_eq!(settings.coverage, Coverage::Survey { areas, hysteresis_m: 0.8 });
        let queue = Queue { service_rate: 500.0, arrival_rate: 20.0 };
        assert_eq!(settings.processing, BTreeMap::from([(VnfId::new("navigation").unwrap(), queue)]));
        let signals = decode(json!({ "floor": "-70 dBm", "margin": "3dB" })).unwrap();
        assert_eq!(signals.coverage, Coverage::Signal { floor_dbm: -70.0, margin_db: 3.0 });
    }

    #[test]
    fn says_what_is_wrong_and_what_would_be_right() {
        for (wrong, said) in [
            (json!({ "gama": 4 }), "`gama` is not a setting of okpi; its settings are `gamma`"),
            (json!({ "gamma": 0 }), "gamma: 0 is not a whole number from 1 to 1000"),
            (json!({ "gamma": 2.5 }), "gamma: 2.5 is not a whole number from 1 to 1000"),
            (json!({ "k_paths": "3" }), "k_paths: \"3\" is not a whole number from 1 to 3"),
            (json!({ "relax": 1 }), "relax: 1 is neither"),
            (json!({ "services": "all" }), "services: \"all\" is not a list of services"),
            (json!({ "services": [7] }), "services: [7] is not a list of services"),
            (json!({ "delays": "guessed" }), "delays: \"guessed\" is neither `events` nor `history`"),
            (
                json!({ "floor": "-80" }),
                "floor: \"-80\" is not a signal from -120 dBm to 0 dBm; write it like `-80",
            ),
            (json!({ "margin": "NaN dB" }), "margin: \"NaN dB\" is not a ratio"),
            (json!({ "hysteresis": "1 m" }), "`hysteresis` needs `coverage`"),
            (
                json!({ "coverage": { "R1": [[0, 0], [1, 1]] } }),
                "coverage: {\"R1\":[[0,0],[1,1]]} is not a map",
            ),
            (json!({ "coverage": { "R1": [[0, 0], [1, 1], [2]] } }), "coverage: "),
            (json!({ "coverage": {}, "floor": "-80 dBm" }), "`floor` cannot be set together with `coverage`"),
            (json!({ "processing": { "n": { "service_rate": "5 /s" } } }), "processing: "),
            (
                json!({ "processing": { "n": { "service_rate": "0 /s", "arrival_rate": "0 /s" } } }),
                "processing: ",
            ),
        ] {
            let message = decode(wrong).unwrap_err();
            assert!(message.starts_with(said), "{message}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC*") {
            for name in ["gamma", "k_paths", "relax", "floor", "margin", "hysteresis", "coverage", "processing", "delays", "services"] {
                let _ = decode(json!({ name: text }));
            }
        }
    }
}
