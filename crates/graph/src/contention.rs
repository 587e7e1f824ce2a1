//! Medium access of a wireless network as real stations have it, and what disturbs it.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    fixed_rate::FixedRate,
    queue::{QueueDiscipline, QueueLimit},
    units::{Dbm, Position, Probability, millis},
    wifi_software::WifiSoftware,
};

/// Sharing of a wireless network's channels by its senders.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(into = "AccessFields", try_from = "AccessFields")]
pub enum Access {
    /// Senders take turns and never collide.
    #[default]
    Turns,
    /// Stations contend, as real ones do.
    Contention(Box<Contention>),
}

/// Contention for the channels of a network. Only stations that contend can sense others, or be real software.
#[derive(Debug, Clone, PartialEq)]
pub struct Contention {
    /// Contention of stations.
    pub edca: Edca,
    /// Other senders on the network's channels.
    pub interference: Vec<Interferer>,
    /// Real Wi-Fi software. Without it, stations are modelled.
    pub software: Option<WifiSoftware>,
}

/// Sharing of a wireless network's channels by its senders, and what only stations that contend have.
#[derive(Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = Access)]
pub(crate) struct AccessFields {
    /// Contention for the channel. Without it, senders take turns and never collide.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    access: Option<Edca>,
    /// Other senders on its channels. Only where stations contend.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    interference: Vec<Interferer>,
    /// Real Wi-Fi software. Without it, stations are modelled. Only where stations contend.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    software: Option<WifiSoftware>,
}

impl Access {
    /// Returns the contention; `None` if senders take turns.
    pub fn contention(&self) -> Option<&Contention> {
        match self {
            Self::Turns => None,
            Self::Contention(contention) => Some(contention),
        }
    }

    /// Returns the contention, to change it; `None` if senders take turns.
    pub fn contention_mut(&mut self) -> Option<&mut Contention> {
        match self {
            Self::Turns => None,
            Self::Contention(contention) => Some(contention),
        }
    }

    /// Whether stations contend.
    pub fn contends(&self) -> bool {
        self.contention().is_some()
    }

    /// Returns how stations contend; `None` if senders take turns.
    pub fn edca(&self) -> Option<&Edca> {
        self.contention().map(|contention| &contention.edca)
    }

    /// Returns what else sends on the network's channels.
    pub fn interference(&self) -> &[Interferer] {
        self.contention().map_or(&[], |contention| &contention.interference)
    }

    /// Returns the real software of the network's stations; `None` if they are modelled.
    pub fn software(&self) -> Option<&WifiSoftware> {
        self.contention().and_then(|contention| contention.software.as_ref())
    }
}

impl From<Edca> for Access {
    fn from(edca: Edca) -> Self {
        Self::Contention(Box::new(Contention { edca, interference: Vec::new(), software: None }))
    }
}

impl From<Access> for AccessFields {
    fn from(access: Access) -> Self {
        match access {
            Access::Turns => Self { access: None, interference: Vec::new(), software: None },
            Access::Contention(contention) => {
                let Contention { edca, interference, software } = *contention;
                Self { access: Some(edca), interference, software }
            }
        }
    }
}

impl TryFrom<AccessFields> for Access {
    type Error = &'static str;

    fn try_from(AccessFields { access, interference, software }: AccessFields) -> Result<Self, Self::Error> {
        match access {
            Some(edca) => Ok(Self::Contention(Box::new(Contention { edca, interference, software }))),
            None if interference.is_empty() && software.is_none() => Ok(Self::Turns),
            None => Err(
                "interference and real Wi-Fi software need `access`, because senders take turns without it",
            ),
        }
    }
}

/// Contention for the channel by EDCA (IEEE 802.11-2020, 10.23.2), with its collisions, hidden nodes and capture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Edca {
    /// Whether frames for one receiver are sent together as A-MPDU, and acknowledged together. 802.11n and ac can.
    pub aggregation: bool,
    /// Stations' choice of rates.
    pub rate_control: RateControl,
    /// Sleep of stations. Without it, they never sleep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power_save: Option<PowerSave>,
    /// Limit of each sender's queue for one receiver and category.
    #[serde(default, skip_serializing_if = "is_usual")]
    pub queue: QueueLimit,
    /// Discipline of these queues: drop tail or FQ-CoDel. With the latter, radio units give stations equal shares of airtime.
    #[serde(default, skip_serializing_if = "QueueDiscipline::is_drop_tail")]
    pub queue_discipline: QueueDiscipline,
}

fn is_usual(limit: &QueueLimit) -> bool {
    *limit == QueueLimit::default()
}

/// Sleep between beacons (IEEE 802.11-2020, 11.2.3), as Linux's stations do it by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PowerSave {
    /// Time without frames after which a station sleeps.
    #[serde(rename = "idle_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub idle: Duration,
    /// Beacons from one to the next after which a radio unit sends group frames, if any of its stations sleeps.
    pub dtim_period: u8,
}

/// Stations' choice of rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RateControl {
    /// By the present signal: the rate with the highest expected goodput.
    Ideal,
    /// By acknowledgements, as Linux does (Minstrel-HT).
    Minstrel,
    /// None: all data frames have this rate.
    Fixed(FixedRate),
}

/// Something else that sends on a channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Interferer {
    /// Its name, which decides its random numbers.
    pub name: String,
    /// Channel number.
    pub channel: u8,
    /// Position of its antenna.
    pub position: Position,
    /// Transmission power.
    #[serde(rename = "tx_power_dbm")]
    pub tx_power: Dbm,
    /// Its frames.
    #[serde(flatten)]
    pub kind: InterfererKind,
    /// When it is there; always, if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub presence: Option<Presence>,
}

/// Frames of an interferer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum InterfererKind {
    /// Another Wi-Fi network, which contends as best effort. Its frames come at random (Poisson).
    Network {
        /// Share of the time that its frames would take on a channel of their own.
        load: Probability,
        /// Time of one frame with its acknowledgement.
        #[serde(rename = "airtime_ms", with = "millis")]
        #[schema(value_type = f64)]
        airtime: Duration,
    },
    /// A device that sends in a fixed cycle without listening, such as a microwave oven.
    Device {
        /// Time for which it sends.
        #[serde(rename = "on_ms", with = "millis")]
        #[schema(value_type = f64)]
        on: Duration,
        /// Time until it sends again.
        #[serde(rename = "off_ms", with = "millis")]
        #[schema(value_type = f64)]
        off: Duration,
    },
}

/// Times for which an interferer is there and away, each exponentially distributed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Presence {
    /// Mean time for which it is there.
    #[serde(rename = "present_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub on: Duration,
    /// Mean time for which it is away.
    #[serde(rename = "absent_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub off: Duration,
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn only_stations_that_contend_have_interference_and_real_software() {
        let edca = json!({ "aggregation": true, "rate_control": "ideal" });
        let software = json!({ "radios": "hwsim", "security": { "method": "open" } });
        let read = |json: &serde_json::Value| serde_json::from_value::<Access>(json.clone());
        let contending = json!({ "access": edca, "software": software });
        let access = read(&contending).unwrap();
        assert!(access.contends() && access.software().is_some());
        assert_eq!(serde_json::to_value(&access).unwrap(), contending);
        assert_eq!(read(&json!({})).unwrap(), Access::Turns);
        assert_eq!(serde_json::to_value(Access::Turns).unwrap(), json!({}));
        assert!(read(&json!({ "software": software })).unwrap_err().to_string().contains("need `access`"));
    }
}
