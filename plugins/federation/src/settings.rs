//! The plug-in's settings, as a testbed file gives them.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::Dbm;
use cotorra_ledger::{Price, Terms};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::{Map, Value};

use crate::network::PASSWORD;

/// What can be set.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The ledger.
    #[serde(deserialize_with = "ledger")]
    pub ledger: LedgerChoice,
    /// Where its orchestrator is reached, as its bids say.
    pub endpoint: String,
    /// What it asks for a second of a vAP, wei; without one it offers none.
    #[serde(deserialize_with = "price")]
    pub price: Option<Price>,
    /// The most that it pays for a second, wei; without one it asks for none.
    #[serde(deserialize_with = "price")]
    pub highest_price: Option<Price>,
    /// Where the signal of its own radio units is weaker, it has no coverage.
    #[serde(deserialize_with = "signal")]
    pub edge: Dbm,
    /// So long before a robot leaves coverage a service is announced.
    #[serde(deserialize_with = "duration")]
    pub lead: Duration,
    /// So long before it leaves coverage a robot is halted that is attached to nobody else.
    #[serde(deserialize_with = "duration")]
    pub stop: Duration,
    /// Bids are collected for so long from when the announcement was heard; without it for one and a quarter block
    /// periods, and 15 s where that is not known.
    #[serde(deserialize_with = "optional_duration")]
    pub collect: Option<Duration>,
    /// What goes with each bid for its services, wei: whoever wins and does not deploy in time loses it to this domain.
    /// Without it a tenth of what the longest use costs at the highest price.
    pub bond: Option<u64>,
    /// The longest time from the choice to the confirmation on the chain: what it grants others, and what it needs itself.
    /// Without it two block periods, 2 s at least, and 30 s where that is not known.
    #[serde(deserialize_with = "optional_duration")]
    pub deploy_within: Option<Duration>,
    /// With so many bids there is no more waiting.
    pub enough: usize,
    /// So long after the announcement a negotiation is given up.
    #[serde(deserialize_with = "duration")]
    pub patience: Duration,
    /// How long is tried to attach to a vAP, once it is deployed and the robot would have to wait for it.
    #[serde(deserialize_with = "duration")]
    pub attach_within: Duration,
    /// How far around the edge the vAP is to reach, metres.
    pub radius_m: f64,
    /// The longest use, which the deposit pays for.
    #[serde(deserialize_with = "duration")]
    pub use_for: Duration,
    /// Whether its own radio unit is taken down that a robot left, if nobody else needs it.
    pub release: bool,
    /// How it behaves as a provider: other than honestly, to try what others do about it.
    pub behaviour: Behaviour,
}

/// The ledger that a domain uses.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum LedgerChoice {
    /// A model in virtual or real time: no network, no consensus, no fees.
    Modelled {
        /// Between blocks.
        #[serde(default = "published", deserialize_with = "duration")]
        block_period: Duration,
        /// From when to when the domain cannot reach it.
        #[serde(default, deserialize_with = "range")]
        outage: Option<[Duration; 2]>,
    },
    /// An anvil node that is started with the run: one node, without consensus.
    Anvil {
        /// Between blocks.
        #[serde(default = "published", deserialize_with = "duration")]
        block_period: Duration,
        /// The program; without it what `COTORRA_ANVIL` says, or `anvil` on the path.
        #[serde(default)]
        program: Option<PathBuf>,
    },
    /// An Ethereum network.
    Ethereum(Joining),
}

/// How an Ethereum network is reached.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Joining {
    /// A node's WebSocket.
    pub url: String,
    /// The chain's ID (EIP-155). A node of another chain is none: ids and keys are of one chain.
    pub chain_id: u64,
    /// Where the contract is.
    pub contract: String,
    /// The block that it was deployed in, or any before.
    #[serde(default)]
    pub from_block: u64,
    /// How many blocks make a transaction final.
    #[serde(default)]
    pub depth: u64,
    /// The file with the domain's key (Web3 Secret Storage, version 3).
    pub key_store: PathBuf,
    /// The file with its password; else it is in the environment variable `password_variable`.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// The environment variable with its password.
    #[serde(default = "variable")]
    pub password_variable: String,
}

/// What a provider does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Behaviour {
    /// What it says.
    Honest,
    /// It never answers.
    Silent,
    /// It bids, and does not deploy what it won.
    Idle,
    /// It says that it deployed what it did not.
    Lying,
}

/// As published: a block each 5 s.
const fn published() -> Duration {
    Duration::from_secs(5)
}

fn variable() -> String {
    PASSWORD.to_owned()
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            ledger: LedgerChoice::Modelled { block_period: published(), outage: None },
            endpoint: String::new(),
            price: None,
            highest_price: None,
            edge: Dbm(-70.0),
            lead: Duration::from_secs(30),
            stop: Duration::from_secs(2),
            collect: None,
            bond: None,
            deploy_within: None,
            enough: usize::MAX,
            patience: Duration::from_secs(60),
            attach_within: Duration::from_secs(5),
            radius_m: 1.0,
            use_for: Duration::from_secs(600),
            release: true,
            behaviour: Behaviour::Honest,
        }
    }
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}{reason}")]
pub struct InvalidSettings {
    /// Where, and a colon.
    path: String,
    reason: String,
}

impl Settings {
    /// Reads the settings of a testbed file.
    ///
    /// # Errors
    /// [`InvalidSettings`].
    pub fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let invalid = |path: &str, reason: String| {
            let path = if path == "." { String::new() } else { format!("{path}: ") };
            Err(InvalidSettings { path, reason })
        };
        let decoded: Self = match serde_path_to_error::deserialize(Value::Object(settings.clone())) {
            Ok(decoded) => decoded,
            Err(error) => return invalid(&error.path().to_string(), error.inner().to_string()),
        };
        if !(0.0..=1000.0).contains(&decoded.radius_m) {
            return invalid("radius_m", format!("{} is no radius from 0 to 1000 m", decoded.radius_m));
        }
        if decoded.stop >= decoded.lead {
            let reason =
                "a robot is halted after the service was announced: `stop` is to be less than `lead`";
            return invalid("stop", reason.to_owned());
        }
        Ok(decoded)
    }

    /// How long each step may take on the chain.
    pub(crate) fn terms(&self) -> Terms {
        let seconds = |time: Duration| u32::try_from(time.as_secs()).unwrap_or(u32::MAX).max(1);
        Terms {
            open_for: seconds(self.patience),
            deploy_within: self.deploy_within(),
            accept_within: seconds(self.patience),
            use_for: seconds(self.use_for),
            bond: self.bond.unwrap_or_else(|| {
                let use_for = seconds(self.use_for);
                let longest = self.highest_price.map_or(0, |price| price.times(use_for).0);
                u64::try_from(longest / 10).unwrap_or(u64::MAX)
            }),
        }
    }

    /// How long a deployment takes at most, seconds.
    pub(crate) fn deploy_within(&self) -> u32 {
        let within = self.deploy_within.unwrap_or(match self.ledger {
            LedgerChoice::Modelled { block_period, .. } | LedgerChoice::Anvil { block_period, .. } => {
                (2 * block_period).max(Duration::from_secs(2))
            }
            LedgerChoice::Ethereum(_) => Duration::from_secs(30),
        });
        // At most a day, or two block periods of a day.
        within.as_secs_f64().ceil() as u32
    }

    /// How long bids are collected.
    pub(crate) fn collect(&self) -> Duration {
        self.collect.unwrap_or(match self.ledger {
            LedgerChoice::Modelled { block_period, .. } | LedgerChoice::Anvil { block_period, .. } => {
                block_period + block_period / 4
            }
            LedgerChoice::Ethereum(_) => Duration::from_secs(15),
        })
    }
}

/// A kind alone, or a mapping with more.
fn ledger<'de, D: Deserializer<'de>>(deserializer: D) -> Result<LedgerChoice, D::Error> {
    let value = match Value::deserialize(deserializer)? {
        Value::String(kind) => serde_json::json!({ "kind": kind }),
        other => other,
    };
    LedgerChoice::deserialize(value).map_err(D::Error::custom)
}

fn duration<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    let value = Value::deserialize(deserializer)?;
    parse_duration(&value).ok_or_else(|| {
        D::Error::custom(format!("{value} is no time from 1 ms to 1 day; write it like `30 s`"))
    })
}

fn optional_duration<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Duration>, D::Error> {
    duration(deserializer).map(Some)
}

fn range<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[Duration; 2]>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let bounds = value.as_array().and_then(|bounds| {
        let [from, until] = &bounds[..] else { return None };
        let [from, until] = [parse_duration(from)?, parse_duration(until)?];
        (from < until).then_some([from, until])
    });
    let wrong = || D::Error::custom(format!("{value} is no span of time; write it like `[40 s, 60 s]`"));
    bounds.map(Some).ok_or_else(wrong)
}

fn parse_duration(value: &Value) -> Option<Duration> {
    let text = value.as_str()?;
    let (figure, factor) = [("ms", 1e-3), ("min", 60.0), ("s", 1.0)]
        .into_iter()
        .find_map(|(unit, factor)| Some((text.strip_suffix(unit)?.trim_end(), factor)))?;
    let seconds = figure.parse::<f64>().ok()? * factor;
    (0.001..=86_400.0).contains(&seconds).then(|| Duration::from_secs_f64(seconds))
}

fn price<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Price>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let price = value.as_u64().filter(|wei| *wei > 0).and_then(|wei| Price::new(wei.into()));
    price.map(Some).ok_or_else(|| D::Error::custom(format!("{value} is no price; write whole wei above 0")))
}

fn signal<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Dbm, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let figure = value.as_str().and_then(|text| text.strip_suffix("dBm")?.trim_end().parse().ok());
    let signal = figure.filter(|dbm: &f64| (-120.0..=0.0).contains(dbm));
    signal.map(Dbm).ok_or_else(|| {
        D::Error::custom(format!("{value} is no signal from -120 dBm to 0 dBm; write it like `-70 dBm`"))
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn decode(settings: Value) -> Result<Settings, String> {
        Settings::decode(settings.as_object().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn nothing_set_is_a_modelled_ledger_with_the_published_blocks() {
        let settings = decode(json!({})).unwrap();
        assert_eq!(settings, Settings::default());
        assert_eq!(settings.collect(), Duration::from_millis(6250));
    }

    #[test]
    fn reads_what_a_testbed_file_says() {
        let settings = decode(json!({
            "ledger": { "kind": "anvil", "block_period": "500 ms" }, "price": 100, "edge": "-65 dBm",
            "lead": "1 min", "behaviour": "lying",
        }))
        .unwrap();
        assert_eq!(
            settings.ledger,
            LedgerChoice::Anvil { block_period: Duration::from_millis(500), program: None }
        );
        assert_eq!((settings.price, settings.edge), (Price::new(100), Dbm(-65.0)));
        assert_eq!((settings.lead, settings.behaviour), (Duration::from_secs(60), Behaviour::Lying));
        let modelled = decode(json!({ "ledger": "modelled" })).unwrap().ledger;
        assert_eq!(modelled, Settings::default().ledger);
        let outage = json!({ "kind": "modelled", "outage": ["40 s", "60 s"] });
        let LedgerChoice::Modelled { outage, .. } = decode(json!({ "ledger": outage })).unwrap().ledger
        else {
            panic!("another ledger")
        };
        assert_eq!(outage, Some([Duration::from_secs(40), Duration::from_secs(60)]));
    }

    #[test]
    fn says_where_something_is_wrong_and_what_would_be_right() {
        let said = |settings| decode(settings).unwrap_err();
        assert!(
            said(json!({ "pirce": 1 })).starts_with("pirce: unknown field `pirce`, expected one of `ledger`")
        );
        assert_eq!(
            said(json!({ "lead": "soon" })),
            "lead: \"soon\" is no time from 1 ms to 1 day; write it like `30 s`"
        );
        assert_eq!(said(json!({ "price": 0 })), "price: 0 is no price; write whole wei above 0");
        assert!(said(json!({ "edge": -70 })).contains("write it like `-70 dBm`"));
        assert!(said(json!({ "lead": "2 s", "stop": "2 s" })).starts_with("stop: a robot is halted after"));
        assert!(said(json!({ "radius_m": -1 })).contains("no radius"));
        assert!(said(json!({ "ledger": "paper" })).contains("unknown variant `paper`"));
        assert!(said(json!({ "ledger": { "kind": "ethereum" } })).contains("missing field `url`"));
    }
}
