//! Wireless networks with real Wi-Fi software on simulated radios of Linux.

use serde::{Deserialize, Serialize};

/// Real software in place of the modelled stations: each robot and radio unit has a radio of mac80211_hwsim, with
/// wpa_supplicant or hostapd. The air between them is the model's.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Hwsim {
    /// The security of its access points.
    pub security: Security,
}

/// How stations prove who they are, and how frames are protected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "method")]
pub enum Security {
    /// Everybody may join, and nothing is encrypted.
    Open,
    /// WPA2-PSK.
    Wpa2 {
        /// The passphrase: 8 to 63 printable ASCII characters.
        passphrase: String,
        /// Protection of management frames.
        management_frames: Protection,
        /// Whether fast transitions go over the distribution system, by way of the present radio unit.
        over_ds: bool,
    },
    /// WPA3-SAE. Management frames are always protected.
    Wpa3 {
        /// The passphrase: 8 to 63 printable ASCII characters.
        passphrase: String,
        /// Whether fast transitions go over the distribution system, by way of the present radio unit.
        over_ds: bool,
    },
}

/// Protection of management frames (802.11w). Without it, anybody can disconnect a station by a forged frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
