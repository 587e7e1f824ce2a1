//! Medium access of a wireless network as real stations have it, and what disturbs it.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::units::{Dbm, Position, Probability, millis};

/// Contention for the channel by EDCA (IEEE 802.11-2020, 10.23.2), with its collisions, hidden nodes and capture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Edca {
    /// Whether frames for one receiver are sent together as A-MPDU, and acknowledged together. 802.11n and ac can.
    pub aggregation: bool,
    /// How stations choose their rates.
    pub rate_control: RateControl,
    /// How stations sleep. Without it, they never do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power_save: Option<PowerSave>,
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

/// How stations choose their rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RateControl {
    /// By the present signal: the rate with the highest expected goodput.
    Ideal,
    /// By acknowledgements, as Linux does (Minstrel-HT).
    Minstrel,
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
    /// What it sends.
    #[serde(flatten)]
    pub kind: InterfererKind,
    /// When it is there; always, if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub presence: Option<Presence>,
}

/// What an interferer sends.
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
