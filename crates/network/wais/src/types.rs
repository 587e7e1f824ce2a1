//! The data types of ETSI GS MEC 028 v2.3.1 that this service provides, with the standard's names. Attributes unknown
//! to the testbed are omitted rather than sent as zero.

use std::{fmt, str::FromStr, sync::Arc};

pub use cotorra_mec::{Epoch, LinkType, SelfLink, TimeStamp};
use serde::{Deserialize, Serialize};

/// A MAC address, written in lower case with colons.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[schema(value_type = String, pattern = "^([0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}$",
    examples("02:77:00:00:00:01"))]
#[serde(try_from = "String", into = "String")]
pub struct Mac(pub [u8; 6]);

/// A text that is not a MAC address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a MAC address: write it like 02:77:00:00:00:01")]
pub struct ParseMacError(String);

impl FromStr for Mac {
    type Err = ParseMacError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut octets = text.split([':', '-']).map(|octet| {
            let digits = octet.len() == 2 && octet.bytes().all(|digit| digit.is_ascii_hexdigit());
            digits.then(|| u8::from_str_radix(octet, 16).ok()).flatten()
        });
        let mut mac = [0; 6];
        let complete = mac.iter_mut().all(|slot| {
            let octet = octets.next().flatten();
            octet.map(|octet| *slot = octet).is_some()
        });
        if complete && octets.next().is_none() { Ok(Self(mac)) } else { Err(ParseMacError(text.to_owned())) }
    }
}

impl TryFrom<String> for Mac {
    type Error = ParseMacError;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Mac> for String {
    fn from(mac: Mac) -> Self {
        mac.to_string()
    }
}

impl fmt::Display for Mac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{g:02x}")
    }
}

/// An access point's identity (6.5.3).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ApIdentity {
    /// MAC address.
    pub bssid: Mac,
    /// Networks that it serves.
    #[serde(default, skip_serializing_if = "<[_]>::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub ssid: Arc<[String]>,
    /// IP addresses.
    #[serde(default, skip_serializing_if = "<[_]>::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub ip_address: Arc<[String]>,
}

/// A station's identity (6.5.11).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaIdentity {
    /// MAC address.
    pub mac_id: Mac,
    /// Network that it joins.
    #[serde(default, skip_serializing_if = "<[_]>::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub ssid: Arc<[String]>,
    /// IP addresses.
    #[serde(default, skip_serializing_if = "<[_]>::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub ip_address: Arc<[String]>,
}

/// An access point and its state (6.2.2).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ApInfo {
    /// Time of the survey; omitted with `fields`.
    #[schema(required = false)]
    pub time_stamp: TimeStamp,
    pub ap_id: ApIdentity,
    pub channel: u32,
    /// The wired link behind it, if it has exactly one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wan_metrics: Option<WanMetrics>,
    /// Number of its stations, and load of its channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bss_load: Option<BssLoad>,
    /// Location, if the testbed file gives the origin of its map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap_location: Option<ApLocation>,
}

/// The BSS Load element (6.5.7; IEEE 802.11-2016, 9.4.2.28).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BssLoad {
    /// Number of associated stations.
    pub sta_count: u16,
    /// Share of the last second in which the channel was busy; 255 is all of it.
    pub channel_utilization: u8,
    /// Medium time left by admission control, 32 µs/s: always 0, because there is none.
    pub avail_adm_cap: u16,
}

/// The wired link behind an access point (6.5.6; Hotspot 2.0).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct WanMetrics {
    /// 1: the link is up; 5: it is also equally fast in both directions.
    pub wan_info: u8,
    /// Rate to the access point, kbit/s.
    pub downlink_speed: u32,
    /// Rate from the access point, kbit/s.
    pub uplink_speed: u32,
    /// Share of the downlink used over the last second; 255 is all of it.
    pub downlink_load: u8,
    /// Share of the uplink used over the last second; 255 is all of it.
    pub uplink_load: u8,
    /// Duration of the load measurement, tenths of a second.
    pub lmd: u16,
}

/// Location of an access point (6.5.9).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ApLocation {
    /// Location on Earth.
    pub geolocation: GeoLocation,
}

/// A place on Earth (6.5.19; RFC 6225): fixed point with 25 bits of fraction, two's complement in 34 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct GeoLocation {
    /// 0: unknown.
    pub lat_uncertainty: u8,
    /// Degrees north.
    pub lat: u64,
    /// 0: unknown.
    pub long_uncertainty: u8,
    /// Degrees east.
    pub long: u64,
    /// 1: WGS 84.
    pub datum: u8,
    /// 1: metres; omitted if the altitude of the map's floor is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_type: Option<u8>,
    /// 0: unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_uncertainty: Option<u8>,
    /// Metres above the ellipsoid: fixed point with 8 bits of fraction, two's complement in 30 bits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude: Option<u32>,
}

/// A station and its state (6.2.3).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaInfo {
    /// Time of the survey; omitted with `fields`.
    #[schema(required = false)]
    pub time_stamp: TimeStamp,
    pub sta_id: StaIdentity,
    /// Channel of its access point.
    pub channel: u32,
    /// Its access point; omitted with `fields`.
    #[schema(required = false)]
    pub ap_associated: ApIdentity,
    /// Signal received by its access point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rssi: Option<Rssi>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sta_data_rate: Option<StaDataRate>,
    /// Beacons that it hears, for measurement configurations that request them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub beacon_report: Vec<BeaconReport>,
    /// Access points that it could roam to, for measurement configurations that request them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub neighbor_report: Vec<NeighborReport>,
    /// Loads of channels, for measurement configurations that request them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub channel_load: Vec<ChannelLoad>,
}

/// Received signal (6.5.21).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct Rssi {
    /// Encoded as RCPI (IEEE 802.11-2016, 9.4.2.38): 2·(P + 110), P in dBm.
    #[schema(maximum = 220)]
    pub rssi: u8,
}

/// Rates of a station (6.5.22).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StaDataRate {
    /// The station; omitted where the enclosing object names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sta_id: Option<StaIdentity>,
    /// PHY rate to the station, kbit/s.
    pub sta_last_data_downlink_rate: u32,
    /// PHY rate from the station, kbit/s.
    pub sta_last_data_uplink_rate: u32,
}

/// An access point that a station hears (6.5.27).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BeaconReport {
    /// The station; omitted where the enclosing object names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sta_id: Option<StaIdentity>,
    /// Measurement that requested it.
    pub measurement_id: Arc<str>,
    /// Global operating class (IEEE 802.11-2016, Table E-4).
    pub operating_class: u8,
    pub channel: u8,
    /// The received frame.
    pub reported_frame_info: ReportedBeaconFrameInfo,
    /// The access point.
    pub bssid: Mac,
    /// The network.
    pub ssid: String,
    /// Received power: 2·(P + 110), P in dBm.
    #[schema(maximum = 220)]
    pub rcpi: u8,
    /// Signal over the noise floor: 2·(SNR + 10), SNR in dB (IEEE 802.11-2016, 9.4.2.41).
    pub rsni: u8,
}

/// A received frame (6.5.29).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ReportedBeaconFrameInfo {
    /// `dot11PHYType`: 4 OFDM, 6 ERP, 7 HT, 9 VHT.
    pub phy_type: u8,
    /// 0: a Beacon or Probe Response.
    pub frame_type: u8,
}

/// An access point that a station could roam to (6.5.10).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct NeighborReport {
    /// The station; omitted where the enclosing object names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sta_id: Option<StaIdentity>,
    /// Measurement that requested it.
    pub measurement_id: Arc<str>,
    /// The access point.
    pub bssid: Mac,
    /// Its capabilities.
    pub bssid_info: BssidInfo,
    /// Global operating class (IEEE 802.11-2016, Table E-4).
    pub operating_class: u8,
    pub channel: u8,
    /// `dot11PHYType`: 4 OFDM, 6 ERP, 7 HT, 9 VHT.
    pub phy_type: u8,
}

/// Capabilities of a neighbor (6.5.30).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BssidInfo {
    /// 2: unknown; 3: reachable.
    pub ap_reachability: u8,
    /// Whether the security is the same as in the station's association, which holds within a network.
    pub security: bool,
    /// Options of the emulated access point.
    pub capabilities: BssCapabilities,
    /// Fast transition (IEEE 802.11r) between the two.
    pub mobility_domain: bool,
    /// IEEE 802.11n or ac.
    pub high_throughput: bool,
    /// IEEE 802.11ac.
    pub very_high_throughput: bool,
    /// Fine timing measurement: never.
    pub ftm: bool,
}

/// Options of an access point (6.5.31).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct BssCapabilities {
    /// Not emulated.
    pub spectrum_management: bool,
    /// Not emulated.
    pub qos: bool,
    /// Not emulated.
    pub apsd: bool,
    /// Whether measurement reports are available: always.
    pub radio_measurements: bool,
    /// Not emulated.
    #[serde(rename = "delayedBACK")]
    pub delayed_back: bool,
    /// Not emulated.
    #[serde(rename = "immediateBACK")]
    pub immediate_back: bool,
}

/// Load of a channel (6.5.39).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ChannelLoad {
    /// The station; omitted where the enclosing object names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sta_id: Option<StaIdentity>,
    /// Measurement that requested it.
    pub measurement_id: Arc<str>,
    /// Global operating class (IEEE 802.11-2016, Table E-4).
    pub operating_class: u8,
    pub channel: u8,
    /// Duration in units of 1024 µs. The load covers the last second, but the standard's type holds at most 255.
    pub measurement_duration: u8,
    /// Share of that time in which the channel was busy; 255 is all of it.
    pub channel_load: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_parse_in_any_notation() {
        let mac = Mac([2, 0x77, 0, 0, 1, 0xfe]);
        for text in ["02:77:00:00:01:fe", "02-77-00-00-01-FE"] {
            assert_eq!(text.parse(), Ok(mac));
        }
        assert_eq!(mac.to_string(), "02:77:00:00:01:fe");
        for wrong in
            ["", "02:77:00:00:01", "02:77:00:00:01:fe:00", "02:77:00:00:01:+e", "2:77:0:0:1:fe", "hello"]
        {
            assert!(wrong.parse::<Mac>().is_err(), "{wrong}");
        }
    }
}
