//! Stations, and wpa_supplicant's configuration file.

use std::{fmt::Write, path::Path};

use serde::{Deserialize, Serialize};

use crate::{
    address::MacAddress,
    channel::Channel,
    names::{CountryCode, InterfaceName, Ssid},
    security::{Credentials, Protection},
};

/// A station: an interface that joins networks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Station {
    /// The interface.
    pub interface: InterfaceName,
    /// Driver that carries its frames.
    pub driver: StationDriver,
    /// The country; `None` leaves the kernel's regulatory domain as it is.
    pub country: Option<CountryCode>,
    /// The networks that it may join, with numbers from 0.
    pub networks: Vec<Network>,
}

/// Driver that carries a station's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum StationDriver {
    /// Linux's cfg80211, through nl80211.
    #[default]
    Nl80211,
    /// A wired interface, on which nothing is negotiated.
    Wired,
    /// Nothing: wpa_supplicant only answers.
    None,
}

impl StationDriver {
    /// Returns the name that wpa_supplicant has for it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Nl80211 => "nl80211",
            Self::Wired => "wired",
            Self::None => "none",
        }
    }
}

/// A network that a station may join.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Network {
    /// Its name.
    pub ssid: Ssid,
    /// Secrets to join.
    pub credentials: Credentials,
    /// The only access point to join; `None` takes the best.
    pub bssid: Option<MacAddress>,
    /// Channels on which it looks for the network; all, if there are none.
    pub channels: Vec<Channel>,
    /// Scans for a better access point while it is connected; `None` stays as long as it can.
    pub background_scan: Option<BackgroundScan>,
}

impl Network {
    /// Returns a network that the station looks for on all channels, without background scans.
    pub fn new(ssid: Ssid, credentials: Credentials) -> Self {
        Self { ssid, credentials, bssid: None, channels: Vec::new(), background_scan: None }
    }
}

/// Scans of a connected station, from which it decides whether to roam.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct BackgroundScan {
    /// Channels to scan.
    pub method: BackgroundScanMethod,
    /// Signal below which it scans at the short interval, in dBm.
    pub threshold_dbm: i8,
    /// Interval while the signal is weak, in seconds.
    pub short_s: u16,
    /// Interval while the signal is strong, in seconds.
    pub long_s: u16,
}

/// The channels of background scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BackgroundScanMethod {
    /// All channels.
    Simple,
    /// Channels on which the network was seen before, and now and then another.
    Learn,
}

impl std::fmt::Display for BackgroundScan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let method = match self.method {
            BackgroundScanMethod::Simple => "simple",
            BackgroundScanMethod::Learn => "learn",
        };
        write!(f, "{method}:{}:{}:{}", self.short_s, self.threshold_dbm, self.long_s)
    }
}

impl Station {
    /// Returns wpa_supplicant's configuration file. wpa_supplicant makes its control socket in the folder `control`, with the
    /// name of the interface.
    pub fn configuration(&self, control: &Path) -> String {
        let mut text = String::new();
        let mut line = |line: String| writeln!(text, "{line}").expect("a string takes all");
        line(format!("ctrl_interface={}", control.display()));
        if let Some(country) = self.country {
            line(format!("country={country}"));
        }
        line("sae_pwe=2".to_owned());
        for network in &self.networks {
            line(String::new());
            line("network={".to_owned());
            for of_network in network.lines() {
                line(format!("\t{of_network}"));
            }
            line("}".to_owned());
        }
        text
    }
}

impl Network {
    /// Returns the lines of its block in the file.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!("ssid={}", self.ssid.in_file())];
        if let Some(bssid) = self.bssid {
            lines.push(format!("bssid={bssid}"));
        }
        if !self.channels.is_empty() {
            lines.push(format!("scan_freq={}", frequencies(&self.channels)));
        }
        // Not in quotes: wpa_supplicant takes a `#` after a `"` of the passphrase for the start of a comment.
        let (methods, fast_transition, secret, protection) = match &self.credentials {
            Credentials::Open => {
                lines.push("key_mgmt=NONE".to_owned());
                return self.with_scan(lines);
            }
            Credentials::Wpa2 { passphrase, protection, fast_transition } => {
                let psk = format!("psk={}", passphrase.psk_hex(&self.ssid));
                (["WPA-PSK", "FT-PSK"], *fast_transition, psk, *protection)
            }
            Credentials::Wpa3 { passphrase, fast_transition } => {
                let password = format!("sae_password={}", passphrase.hex());
                (["SAE", "FT-SAE"], *fast_transition, password, Protection::Required)
            }
        };
        let methods = &methods[..1 + usize::from(fast_transition)];
        lines.push(format!("key_mgmt={}", methods.join(" ")));
        lines.extend(["proto=RSN", "pairwise=CCMP", "group=CCMP"].map(str::to_owned));
        lines.push(secret);
        lines.push(format!("ieee80211w={}", protection.number()));
        self.with_scan(lines)
    }

    fn with_scan(&self, mut lines: Vec<String>) -> Vec<String> {
        if let Some(scan) = self.background_scan {
            lines.push(format!("bgscan=\"{scan}\""));
        }
        lines
    }
}

/// Returns the centres of channels, in MHz.
pub(crate) fn frequencies(channels: &[Channel]) -> String {
    let each: Vec<_> = channels.iter().map(|channel| channel.frequency_mhz().to_string()).collect();
    each.join(" ")
}
