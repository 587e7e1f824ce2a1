//! Neighbours of an access point, as it announces them to stations.

use serde::{Deserialize, Serialize};

use crate::{
    access_point::{Bss, Generation, Radio},
    address::MacAddress,
    channel::{Band, Channel},
    names::Ssid,
};

/// A BSS that is announced to stations, to roam to (802.11k and 802.11v).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Neighbour {
    /// Its address.
    pub bssid: MacAddress,
    /// Its name.
    pub ssid: Ssid,
    /// Its channel.
    pub channel: Channel,
    /// Whether it is in the mobility domain of the BSS that announces it.
    pub same_domain: bool,
    /// The newest generation of Wi-Fi that it offers.
    pub generation: Generation,
}

impl Neighbour {
    /// Describes a BSS with this address to those of its own testbed.
    pub fn new(bssid: MacAddress, bss: &Bss, radio: &Radio) -> Self {
        let same_domain = bss.security.fast_transition().is_some();
        let (channel, generation) = (radio.channel, radio.generation);
        Self { bssid, ssid: bss.ssid.clone(), channel, same_domain, generation }
    }

    /// Returns the BSSID information (IEEE 802.11-2020, figure 9-337): reachable, with the same security, QoS, and what else it
    /// has.
    pub(crate) fn information(&self) -> u32 {
        const REACHABLE: u32 = 0b11;
        const SAME_SECURITY: u32 = 1 << 2;
        const QOS: u32 = 1 << 5;
        const RADIO_MEASUREMENT: u32 = 1 << 7;
        const MOBILITY_DOMAIN: u32 = 1 << 10;
        const HT: u32 = 1 << 11;
        const VHT: u32 = 1 << 12;
        let when = |is: bool, bit| if is { bit } else { 0 };
        REACHABLE
            | SAME_SECURITY
            | QOS
            | RADIO_MEASUREMENT
            | when(self.generation >= Generation::Wifi4, HT)
            | when(self.same_domain, MOBILITY_DOMAIN)
            | when(self.generation >= Generation::Wifi5 && self.channel.band() == Band::Ghz5, VHT)
    }

    /// Returns the PHY type (IEEE 802.11-2020, annex C, `dot11PHYType`).
    pub(crate) fn phy_type(&self) -> u8 {
        const OFDM: u8 = 4;
        const ERP: u8 = 6;
        const HT: u8 = 7;
        const VHT: u8 = 9;
        const HE: u8 = 14;
        match (self.generation, self.channel.band()) {
            (Generation::Wifi6, _) => HE,
            (Generation::Wifi5, Band::Ghz5) => VHT,
            (Generation::Wifi5 | Generation::Wifi4, _) => HT,
            (Generation::Ofdm, Band::Ghz2) => ERP,
            (Generation::Ofdm, Band::Ghz5) => OFDM,
        }
    }

    /// Returns the neighbour report element without its header (IEEE 802.11-2020, 9.4.2.36).
    pub(crate) fn element(&self) -> Vec<u8> {
        let mut bytes = self.bssid.0.to_vec();
        bytes.extend(self.information().to_le_bytes());
        bytes.extend([self.channel.operating_class(), self.channel.number(), self.phy_type()]);
        bytes
    }
}
