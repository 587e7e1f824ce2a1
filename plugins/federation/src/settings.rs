//! Settings of the plug-in.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::Dbm;
use cotorra_ledger::{Price, Terms};
use cotorra_plugin::{
    departure::{Departure, Trigger},
    settings::{self, Figure, InvalidSettings, duration, signal},
};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::{Map, Value};

use crate::network::PASSWORD;

/// Settings of the orchestrator of a domain.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    #[serde(deserialize_with = "ledger")]
    pub ledger: LedgerChoice,
    /// Address of its orchestrator, stated in its bids.
    pub endpoint: String,
    /// Price of a vAP, wei per second. Without it, the domain offers none.
    #[serde(deserialize_with = "price")]
    pub price: Option<Price>,
    /// Highest price that it pays, wei per second. Without it, the domain requests none.
    #[serde(deserialize_with = "price")]
    pub highest_price: Option<Price>,
    /// Weakest signal of its own radio units that counts as coverage.
    #[serde(deserialize_with = "signal")]
    pub edge: Dbm,
    /// Time before a robot leaves coverage at which a service is announced.
    #[serde(deserialize_with = "duration")]
    pub lead: Duration,
    /// Who says that a robot needs a service.
    pub trigger: Trigger,
    /// Time before a robot leaves coverage at which it is halted if no other domain serves it.
    #[serde(deserialize_with = "duration")]
    pub stop: Duration,
    /// Time for collecting bids after the announcement was received. Defaults to one and a quarter block periods, or
    /// 15 s if the period is unknown.
    #[serde(deserialize_with = "optional_duration")]
    pub collect: Option<Duration>,
    /// Bond of each bid for its services, wei: a winner that does not deploy in time loses it to this domain.
    /// Defaults to a tenth of the cost of the longest use at the highest price.
    pub bond: Option<u64>,
    /// Longest time from the choice to the confirmation on the chain, both granted to others and needed by this
    /// domain. Defaults to two block periods, at least 2 s, or 30 s if the period is unknown.
    #[serde(deserialize_with = "optional_duration")]
    pub deploy_within: Option<Duration>,
    /// Longest time from the confirmation of its vAP to the creator's acceptance. The creator may never accept, and then owes
    /// nothing for it.
    #[serde(deserialize_with = "duration")]
    pub accepted_within: Duration,
    /// Number of bids that ends the collection early.
    pub enough: usize,
    /// Time after the announcement at which a negotiation is given up.
    #[serde(deserialize_with = "duration")]
    pub patience: Duration,
    /// Time for attaching to a vAP once it is deployed and the robot would have to wait for it.
    #[serde(deserialize_with = "duration")]
    pub attach_within: Duration,
    /// Distance around the edge that the vAP must cover, metres.
    pub radius_m: f64,
    /// Longest use, paid for by the deposit.
    #[serde(deserialize_with = "duration")]
    pub use_for: Duration,
    /// Whether its own radio unit is taken down when the last robot leaves it.
    pub release: bool,
    /// Behaviour as a provider. Dishonest ones exist to test how others react.
    pub behaviour: Behaviour,
}

/// The ledger that a domain uses.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum LedgerChoice {
    /// A model in virtual or real time, without network, consensus or fees.
    Modelled {
        /// Time between blocks.
        #[serde(default = "published", deserialize_with = "duration")]
        block_period: Duration,
        /// Span during which the domain cannot reach it.
        #[serde(default, deserialize_with = "range")]
        outage: Option<[Duration; 2]>,
    },
    /// An anvil node started with the run: one node, without consensus.
    Anvil {
        /// Time between blocks.
        #[serde(default = "published", deserialize_with = "duration")]
        block_period: Duration,
        /// The program; by default the value of `COTORRA_ANVIL`, or `anvil` on the path.
        #[serde(default)]
        program: Option<PathBuf>,
    },
    /// An Ethereum network.
    Ethereum(Joining),
}

/// Access to an Ethereum network.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Joining {
    /// WebSocket of a node.
    pub url: String,
    /// Chain ID (EIP-155). Nodes of other chains are rejected, because IDs and keys are bound to one chain.
    pub chain_id: u64,
    /// Address of the contract.
    pub contract: String,
    /// Block of the contract's deployment, or any earlier one.
    #[serde(default)]
    pub from_block: u64,
    /// Number of further blocks that make a transaction final.
    #[serde(default)]
    pub depth: u64,
    /// File with the domain's key (Web3 Secret Storage, version 3).
    pub key_store: PathBuf,
    /// File with its password. Without it, the password is in the environment variable `password_variable`.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable with its password.
    #[serde(default = "variable")]
    pub password_variable: String,
}

/// Behaviour of a provider.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Behaviour {
    /// Keeps its promises.
    Honest,
    /// Never answers.
    Silent,
    /// Bids, but does not deploy what it won.
    Idle,
    /// Confirms deployments that it did not make.
    Lying,
}

/// The published period: a block every 5 s.
const fn published() -> Duration {
    Duration::from_secs(5)
}

fn variable() -> String {
    PASSWORD.to_owned()
}

impl Default for Settings {
    fn default() -> Self {
        let Departure { edge, lead, trigger } = Departure::default();
        Self {
            ledger: LedgerChoice::Modelled { block_period: published(), outage: None },
            endpoint: String::new(),
            price: None,
            highest_price: None,
            edge,
            lead,
            trigger,
            stop: Duration::from_secs(2),
            collect: None,
            bond: None,
            deploy_within: None,
            accepted_within: Duration::from_secs(120),
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

impl Settings {
    /// Reads the settings of a testbed file.
    ///
    /// # Errors
    /// [`InvalidSettings`].
    pub fn decode(settings: &Map<String, Value>) -> Result<Self, InvalidSettings> {
        let decoded: Self = settings::decode(settings)?;
        if !(0.0..=1000.0).contains(&decoded.radius_m) {
            let reason = format!("{} is not a radius from 0 to 1000 m", decoded.radius_m);
            return Err(InvalidSettings::new("radius_m", reason));
        }
        if decoded.stop >= decoded.lead {
            let reason = "a robot is halted after the announcement: `stop` must be less than `lead`";
            return Err(InvalidSettings::new("stop", reason));
        }
        Ok(decoded)
    }

    /// Returns the longest duration of each step on the chain.
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

    /// Returns the longest duration of a deployment, seconds.
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

    /// Returns the longest wait for a creator's acceptance, seconds.
    pub(crate) fn accepted_within(&self) -> u32 {
        // At most a day.
        self.accepted_within.as_secs_f64().ceil() as u32
    }

    /// Returns the time for collecting bids.
    pub(crate) fn collect(&self) -> Duration {
        self.collect.unwrap_or(match self.ledger {
            LedgerChoice::Modelled { block_period, .. } | LedgerChoice::Anvil { block_period, .. } => {
                block_period + block_period / 4
            }
            LedgerChoice::Ethereum(_) => Duration::from_secs(15),
        })
    }
}

/// Reads a kind alone, or a mapping with more settings.
fn ledger<'de, D: Deserializer<'de>>(deserializer: D) -> Result<LedgerChoice, D::Error> {
    let value = match Value::deserialize(deserializer)? {
        Value::String(kind) => serde_json::json!({ "kind": kind }),
        other => other,
    };
    LedgerChoice::deserialize(value).map_err(D::Error::custom)
}

fn optional_duration<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Duration>, D::Error> {
    duration(deserializer).map(Some)
}

fn range<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[Duration; 2]>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let bounds = value.as_array().and_then(|bounds| {
        let [from, until] = &bounds[..] else { return None };
        let [from, until] =
            [Figure::TIME.read(from)?, Figure::TIME.read(until)?].map(Duration::from_secs_f64);
        (from < until).then_some([from, until])
    });
    let wrong = || D::Error::custom(format!("{value} is not a time span; write it like `[40 s, 60 s]`"));
    bounds.map(Some).ok_or_else(wrong)
}

fn price<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Price>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let price = value.as_u64().filter(|wei| *wei > 0).and_then(|wei| Price::new(wei.into()));
    price
        .map(Some)
        .ok_or_else(|| D::Error::custom(format!("{value} is not a price; write whole wei above 0")))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn decode(settings: Value) -> Result<Settings, String> {
        Settings::decode(settings.as_object().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn default_is_a_modelled_ledger_with_the_published_period() {
        let settings = decode(json!({})).unwrap();
        assert_eq!(settings, Settings::default());
        assert_eq!(settings.collect(), Duration::from_millis(6250));
    }

    #[test]
    fn settings_of_a_testbed_file_are_read() {
        let settings = decode(json!({
            "ledger": { "kind": "anvil", "block_period": "500 ms" }, "price": 100, "edge": "-65 dBm",
            "lead": "1 min", "behaviour": "lying", "accepted_within": "90 s",
        }))
        .unwrap();
        assert_eq!(
            settings.ledger,
            LedgerChoice::Anvil { block_period: Duration::from_millis(500), program: None }
        );
        assert_eq!((settings.price, settings.edge), (Price::new(100), Dbm(-65.0)));
        assert_eq!((settings.accepted_within(), Settings::default().accepted_within()), (90, 120));
        assert_eq!(settings.trigger, Trigger::Coverage);
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
    fn errors_name_the_place_and_the_remedy() {
        let error_of = |settings| decode(settings).unwrap_err();
        assert!(
            error_of(json!({ "pirce": 1 }))
                .starts_with("pirce: unknown field `pirce`, expected one of `ledger`")
        );
        assert_eq!(
            error_of(json!({ "lead": "soon" })),
            "lead: \"soon\" is not a time from 1 ms to 1 day; write it like `30 s`"
        );
        assert_eq!(error_of(json!({ "price": 0 })), "price: 0 is not a price; write whole wei above 0");
        assert!(error_of(json!({ "edge": -70 })).contains("write it like `-80 dBm`"));
        assert!(
            error_of(json!({ "lead": "2 s", "stop": "2 s" })).starts_with("stop: a robot is halted after")
        );
        assert!(error_of(json!({ "radius_m": -1 })).contains("not a radius"));
        assert!(error_of(json!({ "ledger": "paper" })).contains("unknown variant `paper`"));
        assert!(error_of(json!({ "ledger": { "kind": "ethereum" } })).contains("missing field `url`"));
    }
}
