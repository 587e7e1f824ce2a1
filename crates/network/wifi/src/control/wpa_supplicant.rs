//! Requests to wpa_supplicant.

use serde::{Deserialize, Serialize};

use crate::{
    address::MacAddress,
    channel::Channel,
    control::{
        answer::{AnswerError, Fields, done},
        request::Request,
    },
    names::Ssid,
    secret::Passphrase,
    station::{Network, frequencies},
};

/// State of a station.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// Its phase.
    pub state: State,
    /// Its own address.
    pub address: Option<MacAddress>,
    /// The access point that it is at or on its way to.
    pub bssid: Option<MacAddress>,
    /// The network's name.
    pub ssid: Option<Ssid>,
    /// The network's number.
    pub network: Option<u32>,
    /// Centre of the primary channel, in MHz.
    pub frequency_mhz: Option<u32>,
    /// Its key management, such as `FT-PSK`, `WPA2-PSK`, `SAE` or `NONE`.
    pub key_management: Option<String>,
}

/// Phase of a station.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// It is not connected and does not look for a network.
    Disconnected,
    /// There is no network that it could join.
    Inactive,
    /// Its interface is down.
    InterfaceDisabled,
    /// It looks for a network.
    Scanning,
    /// It joins: authentication, association and key exchange.
    Joining,
    /// It may send data.
    Completed,
    /// Another state.
    Other,
}

/// Returns the request for the station's state.
pub fn status() -> Request<Status> {
    Request::new("STATUS", |answer| read_status(answer?))
}

fn read_status(text: &str) -> Result<Status, AnswerError> {
    let fields = Fields::of(text);
    let state = match fields.text("wpa_state").ok_or(AnswerError::Unexpected("wpa_state"))? {
        "DISCONNECTED" => State::Disconnected,
        "INACTIVE" => State::Inactive,
        "INTERFACE_DISABLED" => State::InterfaceDisabled,
        "SCANNING" => State::Scanning,
        "AUTHENTICATING" | "ASSOCIATING" | "ASSOCIATED" | "4WAY_HANDSHAKE" | "GROUP_HANDSHAKE" => {
            State::Joining
        }
        "COMPLETED" => State::Completed,
        _ => State::Other,
    };
    Ok(Status {
        state,
        address: fields.value("address"),
        bssid: fields.value("bssid"),
        ssid: fields.text("ssid").and_then(Ssid::from_printed),
        network: fields.value("id"),
        frequency_mhz: fields.value("freq").filter(|&frequency| frequency > 0),
        key_management: fields.text("key_mgmt").map(str::to_owned),
    })
}

/// Returns the request to scan these channels, or all if there are none. Its end is an [`Event`](crate::Event). The station may
/// roam to what it finds.
pub fn scan(channels: &[Channel]) -> Request<()> {
    Request::new(format!("SCAN{}", frequencies_of(channels)), done)
}

/// Returns the same request for a station that stays where it is, whatever it finds.
pub fn scan_only(channels: &[Channel]) -> Request<()> {
    Request::new(format!("SCAN TYPE=ONLY{}", frequencies_of(channels)), done)
}

fn frequencies_of(channels: &[Channel]) -> String {
    if channels.is_empty() {
        return String::new();
    }
    format!(" freq={}", frequencies(channels).replace(' ', ","))
}

/// A BSS that a station has heard.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heard {
    /// Its address.
    pub bssid: MacAddress,
    /// Centre of its primary channel, in MHz.
    pub frequency_mhz: u32,
    /// Its signal, in dBm.
    pub signal_dbm: i32,
    /// Its capabilities, in brackets, such as `[WPA2-PSK+FT/PSK-CCMP][ESS]`.
    pub flags: String,
    /// Its name; `None` if it hides it.
    pub ssid: Option<Ssid>,
}

/// Returns the request for the BSSs that were heard lately. wpa_supplicant ends the list after 4096 bytes, i.e. after about 40.
pub fn scan_results() -> Request<Vec<Heard>> {
    Request::new("SCAN_RESULTS", |answer| read_scan_results(answer?))
}

fn read_scan_results(text: &str) -> Result<Vec<Heard>, AnswerError> {
    let mut lines = text.lines();
    if !lines.next().is_some_and(|head| head.starts_with("bssid / ")) {
        return Err(AnswerError::Unexpected("head of the table"));
    }
    let heard = |line: &str| {
        let mut columns = line.splitn(5, '\t');
        let mut column = || columns.next().ok_or(AnswerError::Unexpected("column"));
        Ok(Heard {
            bssid: column()?.parse().map_err(|_| AnswerError::Unexpected("bssid"))?,
            frequency_mhz: column()?.parse().map_err(|_| AnswerError::Unexpected("frequency"))?,
            signal_dbm: column()?.parse().map_err(|_| AnswerError::Unexpected("signal level"))?,
            flags: column()?.to_owned(),
            ssid: Ssid::from_printed(column()?),
        })
    };
    lines.map(heard).collect()
}

/// A station's view of its link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signal {
    /// Signal of the last frame, in dBm.
    pub signal_dbm: i32,
    /// Mean signal, in dBm; `None` if the driver has none.
    pub mean_dbm: Option<i32>,
    /// Mean signal of beacons, in dBm; `None` if the driver has none.
    pub beacons_dbm: Option<i32>,
    /// Noise, in dBm; `None` if the driver has none.
    pub noise_dbm: Option<i32>,
    /// Rate of the last frame sent, in Mbit/s.
    pub rate_mbps: u32,
    /// Centre of the primary channel, in MHz.
    pub frequency_mhz: u32,
}

/// Returns the request for the link's signal. wpa_supplicant refuses it without a link.
pub fn signal() -> Request<Signal> {
    // wpa_supplicant reports this if the driver has no noise.
    const UNKNOWN: i32 = 9999;
    Request::new("SIGNAL_POLL", |answer| {
        let fields = Fields::of(answer?);
        Ok(Signal {
            signal_dbm: fields.needed("RSSI")?,
            mean_dbm: fields.value("AVG_RSSI"),
            beacons_dbm: fields.value("AVG_BEACON_RSSI"),
            noise_dbm: fields.value("NOISE").filter(|&noise| noise != UNKNOWN),
            rate_mbps: fields.needed("LINKSPEED")?,
            frequency_mhz: fields.needed("FREQUENCY")?,
        })
    })
}

/// Returns the request to roam to an access point of the same network. wpa_supplicant refuses if it was not heard lately.
pub fn roam(to: MacAddress) -> Request<()> {
    Request::new(format!("ROAM {to}"), done)
}

/// Returns the request to roam by fast transition through the present access point, over the distribution system. Nothing happens
/// if the other access point does not answer there, e.g. because it belongs to another mobility domain.
pub fn roam_over_ds(to: MacAddress) -> Request<()> {
    Request::new(format!("FT_DS {to}"), done)
}

/// Returns the request to use another passphrase of WPA2 from the next 4-way handshake on, in the station's network of this number.
/// A present association stays.
pub fn set_passphrase(network: u32, ssid: &Ssid, passphrase: &Passphrase) -> Request<()> {
    Request::new(format!("SET_NETWORK {network} psk {}", passphrase.psk_hex(ssid)), done)
}

/// Returns the request to leave the network, and to stay away until [`reconnect`].
pub fn disconnect() -> Request<()> {
    Request::new("DISCONNECT", done)
}

/// Returns the request to join a network.
pub fn reconnect() -> Request<()> {
    Request::new("RECONNECT", done)
}

/// Returns the request to read the configuration file again.
pub fn reconfigure() -> Request<()> {
    Request::new("RECONFIGURE", done)
}

/// Returns the request to join this access point of a network only; the best one if there is none.
pub fn pin(network: u32, to: Option<MacAddress>) -> Request<()> {
    let bssid = to.map_or_else(|| "any".to_owned(), |to| to.to_string());
    Request::new(format!("SET_NETWORK {network} bssid {bssid}"), done)
}

/// Returns the request to forget all BSSs that were heard, but for that at which the station is.
pub fn forget_heard() -> Request<()> {
    Request::new("BSS_FLUSH 0", done)
}

/// Returns the request to try all access points again that the station ignores after failures. Programs before 2.10 do not know
/// it.
pub fn ignore_none() -> Request<()> {
    Request::new("BSSID_IGNORE clear", done)
}

/// A network of a station's configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    /// Its number.
    pub network: u32,
    /// Whether the station may join it.
    pub is_enabled: bool,
}

/// Returns the request for the networks after this one, in the order of their numbers. wpa_supplicant ends the list after 4096
/// bytes.
pub fn networks(after: Option<u32>) -> Request<Vec<Listed>> {
    let after = after.map(|last| format!(" LAST_ID={last}")).unwrap_or_default();
    Request::new(format!("LIST_NETWORKS{after}"), |answer| {
        let mut lines = answer?.lines();
        if !lines.next().is_some_and(|head| head.starts_with("network id / ")) {
            return Err(AnswerError::Unexpected("head of the table"));
        }
        let listed = |line: &str| {
            let number = line.split('\t').next().and_then(|number| number.parse().ok());
            let flags = line.rsplit('\t').next().unwrap_or_default();
            let network = number.ok_or(AnswerError::Unexpected("network id"))?;
            Ok(Listed { network, is_enabled: !flags.contains("[DISABLED]") })
        };
        lines.map(listed).collect()
    })
}

/// Returns the request to add a network. It is disabled, and the answer is its number.
pub fn add_network() -> Request<u32> {
    Request::new("ADD_NETWORK", |answer| {
        answer?.trim().parse().map_err(|_| AnswerError::Unexpected("network id"))
    })
}

/// Returns the requests to make an added network like this.
pub fn describe(number: u32, network: &Network) -> Vec<Request<()>> {
    let lines = network.lines().into_iter();
    let set = |line: String| {
        let (name, value) = line.split_once('=').unwrap_or((&line, ""));
        Request::new(format!("SET_NETWORK {number} {name} {value}"), done)
    };
    lines.map(set).collect()
}

/// Returns the request to name a network for programs. The name has letters, digits and `-` only.
pub fn mark(number: u32, name: &str) -> Request<()> {
    Request::new(format!("SET_NETWORK {number} id_str \"{name}\""), done)
}

/// Returns the request for a network's name for programs, in quotes; `None` if it has none.
pub fn marked(number: u32) -> Request<Option<String>> {
    Request::new(format!("GET_NETWORK {number} id_str"), |answer| match answer {
        Err(AnswerError::Failed) => Ok(None),
        answer => answer.map(|name| Some(name.to_owned())),
    })
}

/// Returns the request to join a network, and to disable all others.
pub fn select_network(number: u32) -> Request<()> {
    Request::new(format!("SELECT_NETWORK {number}"), done)
}

/// Returns the request to let the station join a network.
pub fn enable_network(number: u32) -> Request<()> {
    Request::new(format!("ENABLE_NETWORK {number}"), done)
}

/// Returns the request to remove a network.
pub fn remove_network(number: u32) -> Request<()> {
    Request::new(format!("REMOVE_NETWORK {number}"), done)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{
        channel::{Band, Width},
        station::{BackgroundScan, BackgroundScanMethod},
    };

    fn address(last: u8) -> MacAddress {
        MacAddress([2, 0, 0, 0, 0, last])
    }

    #[test]
    fn networks_are_listed_with_whether_they_are_enabled() {
        let answer = b"network id / ssid / bssid / flags\n0\thome\tany\t[CURRENT]\n2\t\tany\t[DISABLED]\n";
        let listed = |network, is_enabled| Listed { network, is_enabled };
        assert_eq!(networks(None).read(answer), Ok(vec![listed(0, true), listed(2, false)]));
        assert_eq!(networks(None).read(b"FAIL\n"), Err(AnswerError::Failed));
        assert_eq!(networks(Some(7)).text(), "LIST_NETWORKS LAST_ID=7");
        assert_eq!(add_network().read(b"3\n"), Ok(3));
    }

    #[test]
    fn an_added_network_is_described_as_in_a_file() {
        let network = Network {
            background_scan: Some(BackgroundScan {
                method: BackgroundScanMethod::Simple,
                threshold_dbm: -65,
                short_s: 5,
                long_s: 60,
            }),
            ..Network::new("corridor".parse().expect("an SSID"), crate::security::Credentials::Open)
        };
        let requests = describe(4, &network);
        let texts: Vec<_> = requests.iter().map(Request::text).collect();
        let expected = ["ssid \"corridor\"", "key_mgmt NONE", "bgscan \"simple:5:-65:60\""];
        assert_eq!(texts, expected.map(|line| format!("SET_NETWORK 4 {line}")));
    }

    #[test]
    fn status_is_read() {
        let answer = b"bssid=02:00:00:00:00:00\nfreq=2412\nssid=cor\\xffidor\nid=0\nmode=station\npairwise_cipher=CCMP\n\
            group_cipher=CCMP\nkey_mgmt=FT-PSK\nwpa_state=COMPLETED\naddress=02:00:00:00:02:00\n";
        let status = status().read(answer).expect("a status");
        assert_eq!(
            (status.state, status.bssid, status.frequency_mhz),
            (State::Completed, Some(address(0)), Some(2412))
        );
        assert_eq!((status.network, status.key_management.as_deref()), (Some(0), Some("FT-PSK")));
        assert_eq!(status.ssid.as_ref().map(Ssid::as_bytes), Some(&b"cor\xffidor"[..]));
        let status =
            super::status().read(b"wpa_state=SCANNING\naddress=02:00:00:00:02:00\n").expect("a status");
        assert_eq!((status.state, status.bssid), (State::Scanning, None));
        assert_eq!(super::status().read(b"OK\n"), Err(AnswerError::Unexpected("wpa_state")));
    }

    #[test]
    fn scan_results_are_read() {
        let answer = b"bssid / frequency / signal level / flags / ssid\n\
            02:00:00:00:00:00\t2412\t-30\t[WPA2-PSK+FT/PSK-CCMP][ESS]\ta\tb\n02:00:00:00:00:01\t5180\t-71\t[ESS]\t\n";
        let heard = scan_results().read(answer).expect("results");
        assert_eq!((heard[0].bssid, heard[0].frequency_mhz, heard[0].signal_dbm), (address(0), 2412, -30));
        assert_eq!(heard[0].ssid.as_ref().map(Ssid::as_bytes), Some(&b"a\tb"[..]));
        assert_eq!((heard[1].signal_dbm, &heard[1].ssid, heard[1].flags.as_str()), (-71, &None, "[ESS]"));
        assert_eq!(heard.len(), 2);
        assert_eq!(scan_results().read(b""), Err(AnswerError::Unexpected("head of the table")));
        let cut = b"bssid / frequency / signal level / flags / ssid\n02:00:00:00:00:00\t24";
        assert_eq!(scan_results().read(cut), Err(AnswerError::Unexpected("column")));
    }

    #[test]
    fn signal_is_read() {
        let answer = b"RSSI=-52\nLINKSPEED=54\nNOISE=9999\nFREQUENCY=2412\nWIDTH=20 MHz\nAVG_RSSI=-51\n";
        let expected = Signal {
            signal_dbm: -52,
            mean_dbm: Some(-51),
            beacons_dbm: None,
            noise_dbm: None,
            rate_mbps: 54,
            frequency_mhz: 2412,
        };
        assert_eq!(signal().read(answer), Ok(expected));
        assert_eq!(signal().read(b"FAIL\n"), Err(AnswerError::Failed));
        assert_eq!(signal().read(b"RSSI=-52\n"), Err(AnswerError::Unexpected("LINKSPEED")));
    }

    #[test]
    fn requests_have_their_words() {
        let channels =
            [1, 6].map(|number| Channel::new(Band::Ghz2, number, Width::Mhz20).expect("a channel"));
        let texts = [
            scan(&[]),
            scan(&channels),
            scan_only(&[]),
            scan_only(&channels),
            roam(address(1)),
            roam_over_ds(address(1)),
            pin(2, Some(address(1))),
            pin(2, None),
        ]
        .map(|request| request.text().to_owned());
        assert_eq!(
            texts,
            [
                "SCAN",
                "SCAN freq=2412,2437",
                "SCAN TYPE=ONLY",
                "SCAN TYPE=ONLY freq=2412,2437",
                "ROAM 02:00:00:00:00:01",
                "FT_DS 02:00:00:00:00:01",
                "SET_NETWORK 2 bssid 02:00:00:00:00:01",
                "SET_NETWORK 2 bssid any",
            ]
        );
    }

    proptest! {
        #[test]
        fn no_answer_makes_the_readers_panic(bytes: Vec<u8>, text in "(bssid / \n)?.*") {
            for bytes in [&bytes[..], text.as_bytes()] {
                _ = status().read(bytes);
                _ = scan_results().read(bytes);
                _ = signal().read(bytes);
            }
        }
    }
}
