//! Wireless networks with real Wi-Fi software, on radios that Linux simulates or on real ones.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Real software in place of the modelled stations: wpa_supplicant at each robot, and hostapd at each radio unit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WifiSoftware {
    /// The radios that it drives.
    pub radios: RadioKind,
    /// Name of the network in its beacons, of 1 to 32 bytes. Without one: the network's own name. Networks with the same name on
    /// the air can be told apart only by their keys.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ssid: Option<String>,
    /// The security of its access points.
    pub security: Security,
}

/// RadioKind of real Wi-Fi software.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RadioKind {
    /// RadioKind of mac80211_hwsim in the nodes. The air between them is the model's.
    Hwsim,
    /// RadioKind of real machines, each with an agent. The air between them is real.
    Hardware,
}

/// Authentication of stations, and protection of frames. The passphrase is neither serialized nor printed.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "method")]
pub enum Security {
    /// Everybody may join, and nothing is encrypted.
    Open,
    /// WPA2-PSK.
    Wpa2 {
        /// The passphrase: 8 to 63 printable ASCII characters.
        #[serde(default, skip_serializing)]
        passphrase: String,
        /// Protection of management frames.
        management_frames: Protection,
        /// Whether fast transitions go over the distribution system, by way of the present radio unit.
        over_ds: bool,
    },
    /// WPA3-SAE. Management frames are always protected.
    Wpa3 {
        /// The passphrase: 8 to 63 printable ASCII characters.
        #[serde(default, skip_serializing)]
        passphrase: String,
        /// Whether fast transitions go over the distribution system, by way of the present radio unit.
        over_ds: bool,
    },
}

impl fmt::Debug for Security {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open => f.write_str("Open"),
            Self::Wpa2 { passphrase: _, management_frames, over_ds } => f
                .debug_struct("Wpa2")
                .field("management_frames", management_frames)
                .field("over_ds", over_ds)
                .finish_non_exhaustive(),
            Self::Wpa3 { passphrase: _, over_ds } => {
                f.debug_struct("Wpa3").field("over_ds", over_ds).finish_non_exhaustive()
            }
        }
    }
}

/// Protection of management frames (802.11w). Without it, anybody can disconnect a station by a forged frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Protection {
    /// No station has it.
    Off,
    /// Stations that can have it do.
    #[default]
    Optional,
    /// Stations that cannot are refused.
    Required,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_else_learns_a_passphrase() {
        let passphrase = "correct horse".to_owned();
        let wpa2 = Security::Wpa2 {
            passphrase: passphrase.clone(),
            management_frames: Protection::Required,
            over_ds: true,
        };
        for (security, named) in [(wpa2, "wpa2"), (Security::Wpa3 { passphrase, over_ds: true }, "wpa3")] {
            let json = serde_json::to_string(&security).unwrap();
            assert!(json.contains(named) && !json.contains("horse"), "{json}");
            assert!(serde_json::from_str::<Security>(&json).is_ok());
            assert!(!format!("{security:?}").contains("horse"));
        }
    }
}
