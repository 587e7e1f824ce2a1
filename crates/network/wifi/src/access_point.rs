//! Access points, and hostapd's configuration file.

use std::{fmt::Write, num::NonZeroU8, path::Path};

use serde::{Deserialize, Serialize};

use crate::{
    address::MacAddress,
    channel::{Band, Channel, Width},
    names::{CountryCode, InterfaceName, Ssid},
    security::Security,
};

/// An access point: one radio with one BSS or more.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AccessPoint {
    /// The radio's interface.
    pub interface: InterfaceName,
    /// Driver that carries its frames.
    pub driver: AccessPointDriver,
    /// The settings of its radio.
    pub radio: Radio,
    /// The BSS of its interface.
    pub bss: Bss,
    /// Virtual access points: further BSSs on interfaces that hostapd makes.
    pub virtual_aps: Vec<(InterfaceName, Bss)>,
}

/// Driver that carries an access point's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccessPointDriver {
    /// Linux's cfg80211, through nl80211.
    #[default]
    Nl80211,
    /// Nothing: hostapd only answers.
    None,
}

/// The settings of an access point's radio.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Radio {
    /// The channel.
    pub channel: Channel,
    /// The country; `None` leaves the kernel's regulatory domain as it is.
    pub country: Option<CountryCode>,
    /// Time between two beacons.
    pub beacon_interval: BeaconInterval,
    /// The newest generation of Wi-Fi that it offers.
    pub generation: Generation,
}

impl Radio {
    /// Returns the usual settings for a channel: Wi-Fi 4 at 2.4 GHz, and Wi-Fi 5 at 5 GHz.
    pub fn new(channel: Channel) -> Self {
        let generation = match channel.band() {
            Band::Ghz2 => Generation::Wifi4,
            Band::Ghz5 => Generation::Wifi5,
        };
        Self { channel, country: None, beacon_interval: BeaconInterval::default(), generation }
    }
}

/// A generation of Wi-Fi. A radio offers the earlier ones, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Generation {
    /// 802.11g at 2.4 GHz, and 802.11a at 5 GHz.
    Ofdm,
    /// 802.11n.
    Wifi4,
    /// 802.11ac, which is 802.11n at 2.4 GHz.
    Wifi5,
    /// 802.11ax.
    Wifi6,
}

/// Time between two beacons, in time units of 1.024 ms: 15 to 65535. The default is 100.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BeaconInterval(u16);

impl BeaconInterval {
    /// Shortest interval that hostapd takes, in time units.
    pub const SHORTEST: u16 = 15;

    /// Makes one from time units; `None` below [`Self::SHORTEST`].
    pub fn new(time_units: u16) -> Option<Self> {
        (time_units >= Self::SHORTEST).then_some(Self(time_units))
    }

    /// Returns the time units.
    pub fn time_units(self) -> u16 {
        self.0
    }
}

impl Default for BeaconInterval {
    fn default() -> Self {
        Self(100)
    }
}

/// A basic service set: a network on an access point.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bss {
    /// Its name.
    pub ssid: Ssid,
    /// Its address; `None` leaves the choice to the driver, or to hostapd for virtual access points.
    pub bssid: Option<MacAddress>,
    /// Its security.
    pub security: Security,
    /// The bridge that its interface joins. Over it, units of a mobility domain reach each other.
    pub bridge: Option<InterfaceName>,
    /// Beacons from one with broadcasts for sleeping stations (DTIM) to the next.
    pub dtim_period: NonZeroU8,
    /// Whether stations may ask for neighbours and beacon reports (802.11k).
    pub neighbour_reports: bool,
    /// Whether stations can be asked to move (802.11v).
    pub transitions: bool,
}

impl Bss {
    /// Returns the usual settings: reports and transitions are on, and the DTIM period is 2.
    pub fn new(ssid: Ssid, security: Security) -> Self {
        let dtim_period = const { NonZeroU8::new(2).unwrap() };
        Self {
            ssid,
            bssid: None,
            security,
            bridge: None,
            dtim_period,
            neighbour_reports: true,
            transitions: true,
        }
    }
}

impl AccessPoint {
    /// Returns hostapd's configuration file. hostapd makes its control sockets in the folder `control`, each with the name of an
    /// interface.
    pub fn configuration(&self, control: &Path) -> String {
        let mut text = String::new();
        let mut line = |line: &str| writeln!(text, "{line}").expect("a string takes all");
        let driver = match self.driver {
            AccessPointDriver::Nl80211 => "nl80211",
            AccessPointDriver::None => "none",
        };
        line(&format!("interface={}", self.interface));
        line(&format!("driver={driver}"));
        line(&format!("ctrl_interface={}", control.display()));
        for of_radio in self.radio.lines() {
            line(&of_radio);
        }
        for of_bss in self.bss.lines() {
            line(&of_bss);
        }
        for (interface, bss) in &self.virtual_aps {
            line("");
            line(&format!("bss={interface}"));
            line(&format!("ctrl_interface={}", control.display()));
            for of_bss in bss.lines() {
                line(&of_bss);
            }
        }
        text
    }
}

impl Radio {
    fn lines(&self) -> Vec<String> {
        let channel = self.channel;
        let mut lines = Vec::new();
        if let Some(country) = self.country {
            lines.push(format!("country_code={country}"));
            lines.push("ieee80211d=1".to_owned());
            if channel.has_radar() {
                lines.push("ieee80211h=1".to_owned());
            }
        }
        let mode = if channel.band() == Band::Ghz2 { "g" } else { "a" };
        lines.push(format!("hw_mode={mode}"));
        lines.push(format!("channel={}", channel.number()));
        lines.push(format!("beacon_int={}", self.beacon_interval.time_units()));
        lines.push("wmm_enabled=1".to_owned());
        if self.generation >= Generation::Wifi4 {
            lines.push("ieee80211n=1".to_owned());
            match channel.secondary() {
                1 => lines.push("ht_capab=[HT40+]".to_owned()),
                -1 => lines.push("ht_capab=[HT40-]".to_owned()),
                _ => {}
            }
        }
        let mut with_width = |generation: &str, on: &str| {
            lines.push(format!("{on}=1"));
            let width = match channel.width() {
                Width::Mhz20 | Width::Mhz40 => 0,
                Width::Mhz80 => 1,
                Width::Mhz160 => 2,
            };
            lines.push(format!("{generation}_oper_chwidth={width}"));
            if width > 0 {
                lines.push(format!("{generation}_oper_centr_freq_seg0_idx={}", channel.center()));
            }
        };
        if self.generation >= Generation::Wifi5 && channel.band() == Band::Ghz5 {
            with_width("vht", "ieee80211ac");
        }
        if self.generation >= Generation::Wifi6 {
            with_width("he", "ieee80211ax");
        }
        lines
    }
}

impl Bss {
    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(bssid) = self.bssid {
            lines.push(format!("bssid={bssid}"));
        }
        if let Some(bridge) = &self.bridge {
            lines.push(format!("bridge={bridge}"));
        }
        lines.push(format!("ssid2={}", self.ssid.in_file()));
        lines.push(format!("dtim_period={}", self.dtim_period));
        lines.extend(self.security.lines());
        if self.neighbour_reports {
            lines.extend(["rrm_neighbor_report=1", "rrm_beacon_report=1"].map(str::to_owned));
        }
        if self.transitions {
            lines.push("bss_transition=1".to_owned());
        }
        lines
    }
}
