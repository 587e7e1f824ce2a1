//! Requests to hostapd.

use std::{path::Path, time::Duration};

pub use super::neighbour::Neighbour;
use serde::{Deserialize, Serialize};

use crate::{
    access_point::BeaconInterval,
    address::MacAddress,
    channel::{Channel, Width},
    control::{
        answer::{AnswerError, Fields, done},
        request::Request,
    },
    hex,
    names::{InterfaceName, Ssid},
};

/// State of an access point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// Whether it serves, or what it is about.
    pub state: State,
    /// The kernel's name of the radio, such as `phy0`; `None` if hostapd does not know it.
    pub radio: Option<String>,
    /// Centre of the primary channel, in MHz; `None` before it has one.
    pub frequency_mhz: Option<u32>,
    /// The channel; `None` before it has one, or if it is none that this crate knows.
    pub channel: Option<Channel>,
    /// Time between two beacons.
    pub beacon_interval: Option<BeaconInterval>,
    /// Beacons from one DTIM to the next; `None` if hostapd does not report it.
    pub dtim_period: Option<u8>,
    /// Its BSSs.
    pub bss: Vec<BssStatus>,
}

/// Phase of an access point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// It serves.
    Enabled,
    /// It was disabled, or could not be enabled.
    Disabled,
    /// It waits for the regulatory domain.
    CountryUpdate,
    /// It looks for a channel or at its neighbours.
    Scanning,
    /// It listens for radars before it may send.
    RadarCheck,
    /// Another state.
    Other,
}

/// State of a BSS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BssStatus {
    /// Its interface.
    pub interface: InterfaceName,
    /// Its address.
    pub bssid: MacAddress,
    /// Its name; `None` if hostapd's text cannot be read.
    pub ssid: Option<Ssid>,
    /// Its stations.
    pub stations: u32,
}

/// Most BSSs of a [`Status`]; further ones are left out. Drivers have 16 at most.
const MOST_BSS: usize = 64;

/// Returns the request for the access point's state.
pub fn status() -> Request<Status> {
    Request::new("STATUS", |answer| read_status(answer?))
}

fn read_status(text: &str) -> Result<Status, AnswerError> {
    let fields = Fields::of(text);
    let state = match fields.text("state").ok_or(AnswerError::Unexpected("state"))? {
        "ENABLED" => State::Enabled,
        "DISABLED" => State::Disabled,
        "COUNTRY_UPDATE" => State::CountryUpdate,
        "ACS" | "HT_SCAN" => State::Scanning,
        "DFS" => State::RadarCheck,
        _ => State::Other,
    };
    let bss = |index: usize| {
        Some(BssStatus {
            interface: fields.value(&format!("bss[{index}]"))?,
            bssid: fields.value(&format!("bssid[{index}]"))?,
            ssid: fields.text(&format!("ssid[{index}]")).and_then(Ssid::from_printed),
            stations: fields.value(&format!("num_sta[{index}]"))?,
        })
    };
    let frequency_mhz = fields.value("freq").filter(|&frequency| frequency > 0);
    Ok(Status {
        state,
        radio: fields.text("phy").filter(|name| !name.is_empty()).map(str::to_owned),
        frequency_mhz,
        channel: frequency_mhz.and_then(|frequency| read_channel(frequency, &fields)),
        beacon_interval: fields.value("beacon_int").and_then(BeaconInterval::new),
        dtim_period: fields.value("dtim_period"),
        bss: (0..MOST_BSS).map_while(bss).collect(),
    })
}

/// Reads the channel with this centre.
fn read_channel(frequency_mhz: u32, fields: &Fields<'_>) -> Option<Channel> {
    let secondary = fields.value("secondary_channel").unwrap_or(0);
    let widths = ["eht", "he", "vht"].map(|generation| fields.value(&format!("{generation}_oper_chwidth")));
    let width = match widths.into_iter().flatten().max() {
        _ if secondary == 0 => Width::Mhz20,
        None | Some(0_u8) => Width::Mhz40,
        Some(1) => Width::Mhz80,
        Some(2) => Width::Mhz160,
        Some(_) => return None,
    };
    Channel::at_frequency(frequency_mhz, width).ok().filter(|channel| channel.secondary() == secondary)
}

/// Configuration of a BSS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Configuration {
    /// Its address.
    pub bssid: MacAddress,
    /// Its name; `None` if hostapd's text cannot be read.
    pub ssid: Option<Ssid>,
    /// Key management of stations, such as `WPA-PSK FT-PSK`; `None` if they need not.
    pub key_management: Option<String>,
}

/// Returns the request for what the BSS is configured to. Passphrases in the answer are skipped.
pub fn configuration() -> Request<Configuration> {
    Request::new("GET_CONFIG", |answer| {
        let fields = Fields::of(answer?);
        Ok(Configuration {
            bssid: fields.needed("bssid")?,
            ssid: fields.text("ssid").and_then(Ssid::from_printed),
            key_management: fields.text("key_mgmt").map(|methods| methods.trim().to_owned()),
        })
    })
}

/// A station as its access point sees it. Figures are `None` if the driver does not report them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Station {
    /// Its address.
    pub address: MacAddress,
    /// Whether it may send data.
    pub authorized: bool,
    /// Whether its management frames are protected.
    pub protected: bool,
    /// Its key management, as a suite selector, e.g. `00-0f-ac-4` for FT-PSK (IEEE 802.11-2020, table 9-151).
    pub key_management: Option<String>,
    /// Signal of the last frame from it, in dBm.
    pub signal_dbm: Option<i32>,
    /// Bytes from it.
    pub received_bytes: Option<u64>,
    /// Bytes to it.
    pub sent_bytes: Option<u64>,
    /// Time since its last frame.
    pub inactive: Option<Duration>,
    /// Time since it joined.
    pub connected: Option<Duration>,
}

impl Station {
    /// Whether it roams fast: FT-EAP, FT-PSK, FT-SAE and FT-EAP with SHA-384.
    pub fn has_fast_transition(&self) -> bool {
        let suite = self.key_management.as_deref().and_then(|suite| suite.strip_prefix("00-0f-ac-"));
        matches!(suite, Some("3" | "4" | "9" | "13"))
    }
}

/// Returns the request for the first station; `None` if there is none.
pub fn first_station() -> Request<Option<Station>> {
    Request::new("STA-FIRST", |answer| read_station(answer?))
}

/// Returns the request for the station after this one; `None` after the last. hostapd refuses if this one has left.
pub fn next_station(after: MacAddress) -> Request<Option<Station>> {
    Request::new(format!("STA-NEXT {after}"), |answer| read_station(answer?))
}

/// Returns the request for one station; `None` if it has left.
pub fn station(address: MacAddress) -> Request<Option<Station>> {
    Request::new(format!("STA {address}"), |answer| match answer {
        Err(AnswerError::Failed) => Ok(None),
        answer => read_station(answer?),
    })
}

fn read_station(text: &str) -> Result<Option<Station>, AnswerError> {
    let Some(address) = text.lines().next() else { return Ok(None) };
    let fields = Fields::of(text);
    let has_flag = |flag| fields.text("flags").is_some_and(|flags| flags.contains(flag));
    Ok(Some(Station {
        address: address.parse().map_err(|_| AnswerError::Unexpected("address"))?,
        authorized: has_flag("[AUTHORIZED]"),
        protected: has_flag("[MFP]"),
        key_management: fields.text("AKMSuiteSelector").map(str::to_owned),
        signal_dbm: fields.value("signal").filter(|&signal| signal != 0),
        received_bytes: fields.value("rx_bytes"),
        sent_bytes: fields.value("tx_bytes"),
        inactive: fields.value("inactive_msec").map(Duration::from_millis),
        connected: fields.value("connected_time").map(Duration::from_secs),
    }))
}

/// Returns the request to disconnect a station, with a reason (IEEE 802.11-2020, table 9-49) that it receives.
pub fn deauthenticate(station: MacAddress, reason: u16) -> Request<()> {
    Request::new(format!("DEAUTHENTICATE {station} reason={reason}"), done)
}

/// Returns the request to start serving.
pub fn enable() -> Request<()> {
    Request::new("ENABLE", done)
}

/// Returns the request to stop serving. Stations are disconnected.
pub fn disable() -> Request<()> {
    Request::new("DISABLE", done)
}

/// Returns the request to announce another channel in this many beacons (802.11h), and then to move there.
pub fn switch_channel(channel: Channel, beacons: u8) -> Request<()> {
    Request::new(format!("CHAN_SWITCH {beacons} {}", channel.switch_parameters()), done)
}

/// Returns the request to add or change a neighbour that is announced to stations when they ask.
pub fn set_neighbour(neighbour: &Neighbour) -> Request<()> {
    let Neighbour { bssid, ssid, .. } = neighbour;
    let element = hex::encode(&neighbour.element());
    Request::new(format!("SET_NEIGHBOR {bssid} ssid={} nr={element}", ssid.hex()), done)
}

/// Returns the request to forget a neighbour.
pub fn remove_neighbour(bssid: MacAddress, ssid: &Ssid) -> Request<()> {
    Request::new(format!("REMOVE_NEIGHBOR {bssid} ssid={}", ssid.hex()), done)
}

/// A request to a station (802.11v).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Urgency {
    /// It may stay.
    Suggestion,
    /// It is disconnected after this many beacons.
    DisconnectAfter(u16),
}

/// Returns the request to ask a station to move to one of these neighbours, best first. Its answer is an
/// [`Event`](crate::Event). hostapd refuses if the station is unknown, cannot be asked, or if there are too many neighbours.
pub fn ask_to_move(station: MacAddress, to: &[Neighbour], urgency: Urgency) -> Request<()> {
    // In beacons: how long the list is valid.
    const VALID: u8 = 255;
    let mut text = format!("BSS_TM_REQ {station} pref=1 abridged=1 valid_int={VALID}");
    if let Urgency::DisconnectAfter(beacons) = urgency {
        text += &format!(" disassoc_imminent=1 disassoc_timer={beacons}");
    }
    for (rank, neighbour) in to.iter().enumerate() {
        // The candidate preference, a subelement with one byte: 255 is best.
        let preference = 255_u8.saturating_sub(u8::try_from(rank).unwrap_or(u8::MAX));
        text += &format!(
            " neighbor={},0x{:x},{},{},{},0301{preference:02x}",
            neighbour.bssid,
            neighbour.information(),
            neighbour.channel.operating_class(),
            neighbour.channel.number(),
            neighbour.phy_type()
        );
    }
    Request::new(text, done)
}

/// Returns the request to add a BSS from a configuration file, for hostapd's global socket. `radio` is the [`Status::radio`] of an
/// access point; with another name, hostapd takes the BSS for an access point of its own. The file has one BSS.
///
/// hostapd reads 255 bytes of a global request, so the path has to be short; it refuses what it cannot find.
pub fn add_bss(radio: &str, configuration: &Path) -> Request<()> {
    Request::new(format!("ADD bss_config={radio}:{}", configuration.display()), done)
}

/// Returns the request to remove the interface of an access point or of a BSS, for hostapd's global socket.
pub fn remove_interface(interface: &InterfaceName) -> Request<()> {
    Request::new(format!("REMOVE {interface}"), done)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{access_point::Generation, channel::Band};

    /// An answer of hostapd 2.10 on mac80211_hwsim, shortened.
    const STATUS: &[u8] = b"state=ENABLED\nphy=phy0\nfreq=2412\nnum_sta_non_erp=0\nchannel=1\nsecondary_channel=0\n\
        beacon_int=100\ndtim_period=2\nbss[0]=wlan0\nbssid[0]=02:00:00:00:00:00\nssid[0]=cor\\x00idor\nnum_sta[0]=1\n\
        bss[1]=wlan0-1\nbssid[1]=02:00:00:00:00:01\nssid[1]=other\nnum_sta[1]=0\n";
    const STATION: &[u8] = b"02:00:00:00:02:00\nflags=[AUTH][ASSOC][AUTHORIZED][SHORT_PREAMBLE][WMM][MFP][HT]\naid=1\n\
        timeout_next=NULLFUNC POLL\nAKMSuiteSelector=00-0f-ac-4\nrx_packets=31\ntx_packets=11\nrx_bytes=3014\n\
        tx_bytes=1536\ninactive_msec=1250\nsignal=-31\nconnected_time=7\n";

    fn address(last: u8) -> MacAddress {
        MacAddress([2, 0, 0, 0, 0, last])
    }

    fn neighbour(last: u8, band: Band, number: u8) -> Neighbour {
        let channel = Channel::new(band, number, Width::Mhz20).expect("a channel");
        Neighbour {
            bssid: address(last),
            ssid: "ab".parse().expect("an SSID"),
            channel,
            same_domain: true,
            generation: Generation::Wifi5,
        }
    }

    #[test]
    fn status_is_read() {
        let status = status().read(STATUS).expect("a status");
        assert_eq!((status.state, status.radio.as_deref()), (State::Enabled, Some("phy0")));
        assert_eq!(status.frequency_mhz, Some(2412));
        assert_eq!(status.channel, Channel::new(Band::Ghz2, 1, Width::Mhz20).ok());
        assert_eq!((status.beacon_interval, status.dtim_period), (BeaconInterval::new(100), Some(2)));
        let bss: Vec<_> =
            status.bss.iter().map(|bss| (bss.interface.as_str(), bss.bssid, bss.stations)).collect();
        assert_eq!(bss, [("wlan0", address(0), 1), ("wlan0-1", address(1), 0)]);
        assert_eq!(status.bss[0].ssid.as_ref().map(Ssid::as_bytes), Some(&b"cor\0idor"[..]));
    }

    #[test]
    fn channel_is_read_with_its_width() {
        let read = |text: &str| {
            status().read(format!("state=ENABLED\n{text}").as_bytes()).expect("a status").channel
        };
        let wide = "freq=5200\nsecondary_channel=-1\nvht_oper_chwidth=1\nhe_oper_chwidth=0\n";
        assert_eq!(read(wide), Channel::new(Band::Ghz5, 40, Width::Mhz80).ok());
        assert_eq!(read("freq=5180\nsecondary_channel=1\n"), Channel::new(Band::Ghz5, 36, Width::Mhz40).ok());
        // The second half on a side that it does not have here, two separate halves, and 6 GHz.
        assert_eq!(read("freq=2437\nsecondary_channel=-1\n"), None);
        assert_eq!(read("freq=5180\nsecondary_channel=1\nvht_oper_chwidth=3\n"), None);
        assert_eq!(read("freq=5955\nsecondary_channel=0\n"), None);
        assert_eq!(read("freq=0\nchannel=1\n"), None);
    }

    #[test]
    fn configuration_is_read() {
        let answer =
            b"bssid=02:00:00:00:00:01\nssid=ab\npassphrase=secret words\nwpa=2\nkey_mgmt=WPA-PSK FT-PSK \n";
        let expected = Configuration {
            bssid: address(1),
            ssid: "ab".parse().ok(),
            key_management: Some("WPA-PSK FT-PSK".to_owned()),
        };
        assert_eq!(configuration().read(answer), Ok(expected));
    }

    #[test]
    fn station_is_read() {
        let station = first_station().read(STATION).expect("an answer").expect("a station");
        assert!(station.authorized && station.protected && station.has_fast_transition());
        assert_eq!(
            (station.signal_dbm, station.received_bytes, station.sent_bytes),
            (Some(-31), Some(3014), Some(1536))
        );
        assert_eq!(station.inactive, Some(Duration::from_millis(1250)));
        assert_eq!(station.connected, Some(Duration::from_secs(7)));
    }

    #[test]
    fn no_station_is_told_from_an_error() {
        assert_eq!(first_station().read(b""), Ok(None));
        assert_eq!(station(address(1)).read(b"FAIL\n"), Ok(None));
        assert_eq!(next_station(address(1)).read(b"FAIL\n"), Err(AnswerError::Failed));
        assert_eq!(first_station().read(b"what\n"), Err(AnswerError::Unexpected("address")));
    }

    #[test]
    fn requests_have_their_words() {
        let texts = [
            deauthenticate(address(1), 3),
            switch_channel(Channel::new(Band::Ghz2, 6, Width::Mhz20).expect("a channel"), 5),
            set_neighbour(&neighbour(2, Band::Ghz5, 36)),
            remove_neighbour(address(2), &"ab".parse().expect("an SSID")),
            ask_to_move(
                address(9),
                &[neighbour(2, Band::Ghz5, 36), neighbour(3, Band::Ghz2, 6)],
                Urgency::DisconnectAfter(20),
            ),
            ask_to_move(address(9), &[], Urgency::Suggestion),
            add_bss("phy0", Path::new("/run/a/bss")),
            remove_interface(&"wlan0-1".parse().expect("a name")),
        ]
        .map(|request| request.text().to_owned());
        assert_eq!(
            texts,
            [
                "DEAUTHENTICATE 02:00:00:00:00:01 reason=3",
                "CHAN_SWITCH 5 2437 bandwidth=20 ht",
                "SET_NEIGHBOR 02:00:00:00:00:02 ssid=6162 nr=020000000002a71c0000732409",
                "REMOVE_NEIGHBOR 02:00:00:00:00:02 ssid=6162",
                "BSS_TM_REQ 02:00:00:00:00:09 pref=1 abridged=1 valid_int=255 disassoc_imminent=1 disassoc_timer=20 \
                 neighbor=02:00:00:00:00:02,0x1ca7,115,36,9,0301ff neighbor=02:00:00:00:00:03,0xca7,81,6,7,0301fe",
                "BSS_TM_REQ 02:00:00:00:00:09 pref=1 abridged=1 valid_int=255",
                "ADD bss_config=phy0:/run/a/bss",
                "REMOVE wlan0-1",
            ]
        );
    }

    proptest! {
        #[test]
        fn no_answer_makes_the_readers_panic(bytes: Vec<u8>) {
            _ = status().read(&bytes);
            _ = first_station().read(&bytes);
            _ = station(address(1)).read(&bytes);
        }
    }
}
