//! Authentication of stations, and protection of frames.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::{
    address::MacAddress,
    names::NameError,
    secret::{DomainKey, Passphrase},
};

/// The security of a BSS.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Security {
    /// Everybody may join, and nothing is encrypted.
    Open,
    /// WPA2-PSK, with AES-CCMP.
    Wpa2 {
        /// Secret that stations need.
        passphrase: Passphrase,
        /// Protection of management frames.
        protection: Protection,
        /// Fast transition (FT-PSK, 802.11r). Each unit derives a station's keys from the passphrase.
        fast_transition: Option<FastTransition>,
    },
    /// WPA3-SAE, with AES-CCMP. Management frames are always protected.
    Wpa3 {
        /// Secret that stations need.
        passphrase: Passphrase,
        /// Fast transition (FT-SAE, 802.11r). The keys of each association differ, so the units must exchange them.
        fast_transition: Option<(FastTransition, KeyExchange)>,
    },
}

/// Protection of management frames (802.11w): without it, anybody can disconnect a station by a forged frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Protection {
    /// No station has it.
    Off,
    /// Stations that can have it.
    #[default]
    Optional,
    /// Stations that cannot are rejected.
    Required,
}

/// The identity of a mobility domain (802.11r). Stations roam fast between units of the same domain, SSID and security.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MobilityDomain(pub u16);

impl fmt::Display for MobilityDomain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}", self.0)
    }
}

/// A unit's part in a mobility domain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FastTransition {
    /// The domain.
    pub domain: MobilityDomain,
    /// This unit's name in the domain. No other unit has it.
    pub holder: KeyHolder,
    /// Whether stations may also ask for the next unit through the present one, over the distribution system.
    pub over_ds: bool,
}

/// The name of a unit among those of a mobility domain (R0KH-ID): 1 to 48 letters, digits, `-`, `_`, `.` and `:`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KeyHolder(String);

impl fmt::Display for KeyHolder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for KeyHolder {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.:".contains(&byte);
        let is_name = matches!(text.len(), 1..=48) && text.bytes().all(is_allowed);
        if is_name { Ok(Self(text.to_owned())) } else { Err(NameError::KeyHolder(text.to_owned())) }
    }
}

/// Exchange of keys between the units of a mobility domain. They reach each other through the bridges of their BSSs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyExchange {
    /// The key of all units.
    pub key: DomainKey,
    /// The units that take part.
    pub units: Units,
}

/// Units of a mobility domain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Units {
    /// All that know the key. Units find each other by broadcasts, which costs the first roam a round trip.
    Any,
    /// These, each by its BSSID and its name. The unit itself may be among them. Keys are then sent to all of them as soon as a
    /// station joins.
    These(Vec<(MacAddress, KeyHolder)>),
}

impl Security {
    /// Returns what a station needs to join.
    pub fn credentials(&self) -> Credentials {
        match self {
            Self::Open => Credentials::Open,
            Self::Wpa2 { passphrase, protection, fast_transition } => Credentials::Wpa2 {
                passphrase: passphrase.clone(),
                protection: *protection,
                fast_transition: fast_transition.is_some(),
            },
            Self::Wpa3 { passphrase, fast_transition } => Credentials::Wpa3 {
                passphrase: passphrase.clone(),
                fast_transition: fast_transition.is_some(),
            },
        }
    }

    /// Returns the unit's part in a mobility domain; `None` if stations do not roam fast.
    pub fn fast_transition(&self) -> Option<&FastTransition> {
        match self {
            Self::Open => None,
            Self::Wpa2 { fast_transition, .. } => fast_transition.as_ref(),
            Self::Wpa3 { fast_transition, .. } => fast_transition.as_ref().map(|(transition, _)| transition),
        }
    }

    /// Returns the lines of hostapd's file.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines = vec!["auth_algs=1".to_owned()];
        let (passphrase, methods, protection) = match self {
            Self::Open => return lines,
            Self::Wpa2 { passphrase, protection, .. } => (passphrase, ["WPA-PSK", "FT-PSK"], *protection),
            Self::Wpa3 { passphrase, .. } => (passphrase, ["SAE", "FT-SAE"], Protection::Required),
        };
        let fast_transition = self.fast_transition();
        let methods = &methods[..1 + usize::from(fast_transition.is_some())];
        lines.push("wpa=2".to_owned());
        lines.push(format!("wpa_key_mgmt={}", methods.join(" ")));
        lines.push("rsn_pairwise=CCMP".to_owned());
        lines.push(format!("wpa_passphrase={}", passphrase.expose()));
        lines.push(format!("ieee80211w={}", protection.number()));
        if let Self::Wpa3 { .. } = self {
            lines.extend(["sae_require_mfp=1", "sae_pwe=2"].map(str::to_owned));
        }
        if let Some(FastTransition { domain, holder, over_ds }) = fast_transition {
            lines.push(format!("nas_identifier={holder}"));
            lines.push(format!("mobility_domain={domain}"));
            lines.push(format!("ft_over_ds={}", u8::from(*over_ds)));
        }
        match self {
            Self::Wpa2 { fast_transition: Some(_), .. } => lines.push("ft_psk_generate_local=1".to_owned()),
            Self::Wpa3 { fast_transition: Some((_, exchange)), .. } => lines.extend(exchange.lines()),
            _ => {}
        }
        lines
    }
}

impl KeyExchange {
    fn lines(&self) -> Vec<String> {
        let key = self.key.hex();
        let mut lines = vec!["pmk_r1_push=1".to_owned()];
        match &self.units {
            Units::Any => {
                lines.push(format!("r0kh=ff:ff:ff:ff:ff:ff * {key}"));
                lines.push(format!("r1kh=00:00:00:00:00:00 00:00:00:00:00:00 {key}"));
            }
            Units::These(units) => {
                for (bssid, holder) in units {
                    lines.push(format!("r0kh={bssid} {holder} {key}"));
                    lines.push(format!("r1kh={bssid} {bssid} {key}"));
                }
            }
        }
        lines
    }
}

impl Protection {
    pub(crate) fn number(self) -> u8 {
        match self {
            Self::Off => 0,
            Self::Optional => 1,
            Self::Required => 2,
        }
    }
}

/// Secrets that a station needs to join a network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Credentials {
    /// Nothing.
    Open,
    /// Those of WPA2-PSK.
    Wpa2 {
        /// The passphrase.
        passphrase: Passphrase,
        /// Protection of management frames.
        protection: Protection,
        /// Whether it roams by FT-PSK where it can.
        fast_transition: bool,
    },
    /// Those of WPA3-SAE.
    Wpa3 {
        /// The passphrase.
        passphrase: Passphrase,
        /// Whether it roams by FT-SAE where it can.
        fast_transition: bool,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_holders_are_words() {
        for wrong in ["", "*", "a b", "a\n", &"x".repeat(49)] {
            assert_eq!(wrong.parse::<KeyHolder>(), Err(NameError::KeyHolder(wrong.to_owned())));
        }
        assert!("02:00:00:00:01:00".parse::<KeyHolder>().is_ok());
    }

    #[test]
    fn credentials_are_those_of_the_access_point() {
        let passphrase: Passphrase = "correct horse".parse().expect("a passphrase");
        let holder: KeyHolder = "r1".parse().expect("a key holder");
        let transition = FastTransition { domain: MobilityDomain(1), holder, over_ds: true };
        let security = Security::Wpa2 {
            passphrase: passphrase.clone(),
            protection: Protection::Required,
            fast_transition: Some(transition),
        };
        let expected = Credentials::Wpa2 {
            passphrase: passphrase.clone(),
            protection: Protection::Required,
            fast_transition: true,
        };
        assert_eq!(security.credentials(), expected);
        let security = Security::Wpa3 { passphrase: passphrase.clone(), fast_transition: None };
        assert_eq!(security.credentials(), Credentials::Wpa3 { passphrase, fast_transition: false });
        assert_eq!(Security::Open.credentials(), Credentials::Open);
        assert!(!format!("{security:?}").contains("horse"));
    }
}
