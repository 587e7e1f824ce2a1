//! Events that hostapd and wpa_supplicant send to attached sockets.

use std::{str::FromStr, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{address::MacAddress, names::InterfaceName};

/// Longest text of an [`Event::Other`], in characters. More is cut off.
const LONGEST_TEXT: usize = 512;

/// An event with its level.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The interface; `None` at the socket of an interface.
    pub interface: Option<InterfaceName>,
    /// Its level: 0 and 1 are for debugging, 2 is information, 3 is what programs want, 4 a warning, 5 an error.
    pub level: u8,
    /// The event.
    pub event: Event,
}

/// Something that happened at an access point or at a station.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// A station: it asks an access point for authentication.
    Authenticating {
        /// The access point.
        bssid: MacAddress,
    },
    /// A station: it asks an access point for association.
    Associating {
        /// The access point.
        bssid: MacAddress,
    },
    /// A station: it is associated. With fast transition, it may now send data.
    Associated {
        /// The access point.
        bssid: MacAddress,
    },
    /// A station: what the kernel reported of its association is dealt with. With fast transition, it is connected before that;
    /// otherwise a handshake of keys follows.
    AssociationHandled,
    /// A station: it may send data.
    Connected {
        /// The access point.
        bssid: MacAddress,
    },
    /// A station: it may no longer send data.
    Disconnected {
        /// The access point.
        bssid: MacAddress,
        /// The reason (IEEE 802.11-2020, table 9-49).
        reason: u16,
        /// Whether the station itself decided so.
        locally: bool,
    },
    /// A station: an access point rejected its authentication.
    AuthenticationRejected {
        /// The access point.
        bssid: MacAddress,
        /// The status (IEEE 802.11-2020, table 9-50).
        status: u16,
    },
    /// A station: an access point rejected its association, or did not answer.
    AssociationRejected {
        /// The access point, if wpa_supplicant names it.
        bssid: Option<MacAddress>,
        /// The status (IEEE 802.11-2020, table 9-50).
        status: u16,
    },
    /// A station: it leaves a network alone for a while, because it could not join.
    NetworkDisabled {
        /// The network's number.
        network: u32,
        /// Failures in a row.
        failures: u32,
        /// For how long.
        duration: Duration,
        /// Why it could not join.
        reason: DisabledReason,
    },
    /// A station: it may try a network again.
    NetworkEnabled {
        /// The network's number.
        network: u32,
    },
    /// A station: no network is in reach.
    NetworkNotFound,
    /// A station: it scans.
    ScanStarted,
    /// A station: a scan has ended, and its results can be read.
    ScanResults,
    /// A station: a scan could not be started.
    ScanFailed,
    /// A station: its signal crossed the watched threshold.
    SignalChange {
        /// Whether it is above now.
        above: bool,
        /// The signal, in dBm.
        signal_dbm: i32,
    },
    /// A station: several beacons in a row are missing.
    BeaconLoss,
    /// A station: it found a better access point and roams there.
    RoamDecided {
        /// The present access point.
        from: MacAddress,
        /// The next one.
        to: MacAddress,
    },
    /// The channel is about to change.
    ChannelSwitchStarted {
        /// Centre of the new primary channel, in MHz.
        frequency_mhz: u32,
    },
    /// The channel has changed.
    ChannelSwitched {
        /// Centre of the new primary channel, in MHz.
        frequency_mhz: u32,
    },
    /// An access point: it serves.
    AccessPointEnabled,
    /// An access point: it no longer serves.
    AccessPointDisabled,
    /// An access point: a station may send data, and there are keys for it. hostapd reports it once or twice after a handshake of
    /// keys, and once after a fast transition.
    StationConnected {
        /// The station.
        station: MacAddress,
    },
    /// An access point: a station has left.
    StationDisconnected {
        /// The station.
        station: MacAddress,
    },
    /// An access point: a station seems to have another passphrase.
    PossibleWrongKey {
        /// The station.
        station: MacAddress,
    },
    /// An access point: a station answered whether it moves (802.11v).
    MoveAnswered {
        /// The station.
        station: MacAddress,
        /// The status (IEEE 802.11-2020, table 9-428): 0 if it moves.
        status: u8,
        /// Access point to which it moves.
        target: Option<MacAddress>,
    },
    /// The interface is up.
    InterfaceEnabled,
    /// The interface is down.
    InterfaceDisabled,
    /// The program ends.
    Terminating,
    /// Something else, as the program words it.
    Other(String),
}

/// Why a station could not join a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DisabledReason {
    /// Its passphrase is wrong.
    WrongKey,
    /// The authentication failed.
    AuthenticationFailed,
    /// The connection failed otherwise.
    ConnectionFailed,
    /// Another reason.
    Other,
}

impl Message {
    /// Reads a datagram; `None` if it is no event but an answer.
    pub fn parse(datagram: &[u8]) -> Option<Self> {
        let text = String::from_utf8_lossy(datagram);
        let (interface, text) = match text.strip_prefix("IFNAME=") {
            Some(rest) => {
                let (name, rest) = rest.split_once(' ')?;
                (name.parse().ok(), rest)
            }
            None => (None, &*text),
        };
        let (level, text) = text.strip_prefix('<')?.split_once('>')?;
        Some(Self { interface, level: level.parse().ok()?, event: Event::parse(text.trim_end()) })
    }
}

impl Event {
    fn parse(text: &str) -> Self {
        Self::known(text).unwrap_or_else(|| Self::Other(text.chars().take(LONGEST_TEXT).collect()))
    }

    /// Reads an event; `None` if it is unknown or incomplete.
    fn known(text: &str) -> Option<Self> {
        const AUTHENTICATING: &str = "SME: Trying to authenticate with ";
        const ASSOCIATING: &str = "Trying to associate with ";
        const ASSOCIATED: &str = "Associated with ";
        if let Some(rest) = text.strip_prefix(AUTHENTICATING) {
            return Some(Self::Authenticating { bssid: first(rest)? });
        }
        if let Some(rest) = text.strip_prefix(ASSOCIATING) {
            return Some(Self::Associating { bssid: first(rest)? });
        }
        if let Some(rest) = text.strip_prefix(ASSOCIATED) {
            return Some(Self::Associated { bssid: first(rest)? });
        }
        let (name, rest) = text.split_once(' ').unwrap_or((text, ""));
        Some(match name {
            "CTRL-EVENT-SUBNET-STATUS-UPDATE" => Self::AssociationHandled,
            "CTRL-EVENT-CONNECTED" => Self::Connected { bssid: first(rest.split_once(" to ")?.1)? },
            "CTRL-EVENT-DISCONNECTED" => Self::Disconnected {
                bssid: value(rest, "bssid")?,
                reason: value(rest, "reason")?,
                locally: value(rest, "locally_generated") == Some(1),
            },
            "CTRL-EVENT-AUTH-REJECT" => {
                Self::AuthenticationRejected { bssid: first(rest)?, status: value(rest, "status_code")? }
            }
            "CTRL-EVENT-ASSOC-REJECT" => {
                Self::AssociationRejected { bssid: value(rest, "bssid"), status: value(rest, "status_code")? }
            }
            "CTRL-EVENT-SSID-TEMP-DISABLED" => {
                // The SSID between may have any words.
                let (before, after) = rest.rsplit_once("\" ")?;
                Self::NetworkDisabled {
                    network: value(before, "id")?,
                    failures: value(after, "auth_failures")?,
                    duration: Duration::from_secs(value(after, "duration")?),
                    reason: match &*value::<String>(after, "reason")? {
                        "WRONG_KEY" => DisabledReason::WrongKey,
                        "AUTH_FAILED" => DisabledReason::AuthenticationFailed,
                        "CONN_FAILED" => DisabledReason::ConnectionFailed,
                        _ => DisabledReason::Other,
                    },
                }
            }
            "CTRL-EVENT-SSID-REENABLED" => Self::NetworkEnabled { network: value(rest, "id")? },
            "CTRL-EVENT-NETWORK-NOT-FOUND" => Self::NetworkNotFound,
            "CTRL-EVENT-SCAN-STARTED" => Self::ScanStarted,
            "CTRL-EVENT-SCAN-RESULTS" => Self::ScanResults,
            "CTRL-EVENT-SCAN-FAILED" => Self::ScanFailed,
            "CTRL-EVENT-SIGNAL-CHANGE" => Self::SignalChange {
                above: value(rest, "above") == Some(1),
                signal_dbm: value(rest, "signal")?,
            },
            "CTRL-EVENT-BEACON-LOSS" => Self::BeaconLoss,
            "CTRL-EVENT-DO-ROAM" => {
                Self::RoamDecided { from: value(rest, "cur_bssid")?, to: value(rest, "sel_bssid")? }
            }
            "CTRL-EVENT-STARTED-CHANNEL-SWITCH" => {
                Self::ChannelSwitchStarted { frequency_mhz: value(rest, "freq")? }
            }
            "CTRL-EVENT-CHANNEL-SWITCH" => Self::ChannelSwitched { frequency_mhz: value(rest, "freq")? },
            "AP-ENABLED" => Self::AccessPointEnabled,
            "AP-DISABLED" => Self::AccessPointDisabled,
            // hostapd 2.10 leaves out the first of a station that comes back without fast transition.
            "AP-STA-CONNECTED" | "EAPOL-4WAY-HS-COMPLETED" => {
                Self::StationConnected { station: first(rest)? }
            }
            "AP-STA-DISCONNECTED" => Self::StationDisconnected { station: first(rest)? },
            "AP-STA-POSSIBLE-PSK-MISMATCH" => Self::PossibleWrongKey { station: first(rest)? },
            "BSS-TM-RESP" => Self::MoveAnswered {
                station: first(rest)?,
                status: value(rest, "status_code")?,
                target: value(rest, "target_bssid"),
            },
            "INTERFACE-ENABLED" => Self::InterfaceEnabled,
            "INTERFACE-DISABLED" => Self::InterfaceDisabled,
            "CTRL-EVENT-TERMINATING" => Self::Terminating,
            _ => return None,
        })
    }
}

/// Reads the first word.
fn first<T: FromStr>(text: &str) -> Option<T> {
    text.split(' ').next()?.parse().ok()
}

/// Reads the value of the first word `name=value`.
fn value<T: FromStr>(text: &str, name: &str) -> Option<T> {
    let of_word = |word: &str| word.strip_prefix(name)?.strip_prefix('=')?.parse().ok();
    text.split(' ').find_map(of_word)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn address(last: u8) -> MacAddress {
        MacAddress([2, 0, 0, 0, 0, last])
    }

    /// Lines of hostapd and wpa_supplicant 2.10.
    #[test]
    fn events_are_read() {
        for (text, event) in [
            (
                "SME: Trying to authenticate with 02:00:00:00:00:01 (SSID='ab' freq=2412 MHz)",
                Event::Authenticating { bssid: address(1) },
            ),
            (
                "Trying to associate with 02:00:00:00:00:01 (SSID='ab' freq=2412 MHz)",
                Event::Associating { bssid: address(1) },
            ),
            ("Associated with 02:00:00:00:00:01", Event::Associated { bssid: address(1) }),
            ("CTRL-EVENT-SUBNET-STATUS-UPDATE status=0", Event::AssociationHandled),
            (
                "CTRL-EVENT-CONNECTED - Connection to 02:00:00:00:00:01 completed [id=0 id_str=]",
                Event::Connected { bssid: address(1) },
            ),
            (
                "CTRL-EVENT-DISCONNECTED bssid=02:00:00:00:00:01 reason=3 locally_generated=1",
                Event::Disconnected { bssid: address(1), reason: 3, locally: true },
            ),
            (
                "CTRL-EVENT-DISCONNECTED bssid=02:00:00:00:00:01 reason=7",
                Event::Disconnected { bssid: address(1), reason: 7, locally: false },
            ),
            (
                "CTRL-EVENT-AUTH-REJECT 02:00:00:00:00:01 auth_type=2 auth_transaction=2 status_code=53",
                Event::AuthenticationRejected { bssid: address(1), status: 53 },
            ),
            (
                "CTRL-EVENT-ASSOC-REJECT bssid=02:00:00:00:00:01 status_code=16 timeout",
                Event::AssociationRejected { bssid: Some(address(1)), status: 16 },
            ),
            ("CTRL-EVENT-ASSOC-REJECT status_code=1", Event::AssociationRejected { bssid: None, status: 1 }),
            (
                "CTRL-EVENT-SSID-TEMP-DISABLED id=0 ssid=\"a\\\" duration=9 b\" auth_failures=2 duration=20 reason=WRONG_KEY",
                Event::NetworkDisabled {
                    network: 0,
                    failures: 2,
                    duration: Duration::from_secs(20),
                    reason: DisabledReason::WrongKey,
                },
            ),
            ("CTRL-EVENT-SSID-REENABLED id=0 ssid=\"ab\"", Event::NetworkEnabled { network: 0 }),
            ("CTRL-EVENT-NETWORK-NOT-FOUND ", Event::NetworkNotFound),
            ("CTRL-EVENT-SCAN-STARTED ", Event::ScanStarted),
            ("CTRL-EVENT-SCAN-RESULTS id=4", Event::ScanResults),
            ("CTRL-EVENT-SCAN-FAILED ret=-1 retry=1", Event::ScanFailed),
            (
                "CTRL-EVENT-SIGNAL-CHANGE above=0 signal=-71 noise=9999 txrate=54000",
                Event::SignalChange { above: false, signal_dbm: -71 },
            ),
            ("CTRL-EVENT-BEACON-LOSS ", Event::BeaconLoss),
            (
                "CTRL-EVENT-DO-ROAM cur_bssid=02:00:00:00:00:01 cur_freq=2412 cur_level=-80 cur_est=1 \
                 sel_bssid=02:00:00:00:00:02 sel_freq=2437 sel_level=-50 sel_est=2",
                Event::RoamDecided { from: address(1), to: address(2) },
            ),
            (
                "CTRL-EVENT-STARTED-CHANNEL-SWITCH freq=2437 ht_enabled=1 ch_offset=0",
                Event::ChannelSwitchStarted { frequency_mhz: 2437 },
            ),
            (
                "CTRL-EVENT-CHANNEL-SWITCH freq=2437 ht_enabled=1",
                Event::ChannelSwitched { frequency_mhz: 2437 },
            ),
            ("AP-ENABLED ", Event::AccessPointEnabled),
            ("AP-DISABLED ", Event::AccessPointDisabled),
            (
                "AP-STA-CONNECTED 02:00:00:00:00:09 auth_alg=ft",
                Event::StationConnected { station: address(9) },
            ),
            ("EAPOL-4WAY-HS-COMPLETED 02:00:00:00:00:09", Event::StationConnected { station: address(9) }),
            ("AP-STA-DISCONNECTED 02:00:00:00:00:09", Event::StationDisconnected { station: address(9) }),
            (
                "AP-STA-POSSIBLE-PSK-MISMATCH 02:00:00:00:00:09",
                Event::PossibleWrongKey { station: address(9) },
            ),
            (
                "BSS-TM-RESP 02:00:00:00:00:09 status_code=0 bss_termination_delay=0 target_bssid=02:00:00:00:00:02",
                Event::MoveAnswered { station: address(9), status: 0, target: Some(address(2)) },
            ),
            (
                "BSS-TM-RESP 02:00:00:00:00:09 status_code=7 bss_termination_delay=0",
                Event::MoveAnswered { station: address(9), status: 7, target: None },
            ),
            ("INTERFACE-DISABLED ", Event::InterfaceDisabled),
            ("CTRL-EVENT-TERMINATING ", Event::Terminating),
        ] {
            let message = Message::parse(format!("<3>{text}").as_bytes());
            assert_eq!(message, Some(Message { interface: None, level: 3, event }), "{text}");
        }
    }

    #[test]
    fn other_events_keep_their_words_up_to_a_bound() {
        let event = |text: &str| Message::parse(text.as_bytes()).map(|message| message.event);
        assert_eq!(
            event("<2>CTRL-EVENT-DSCP-POLICY clear_all"),
            Some(Event::Other("CTRL-EVENT-DSCP-POLICY clear_all".into()))
        );
        // One that lacks what it should have.
        assert_eq!(event("<3>CTRL-EVENT-CONNECTED "), Some(Event::Other("CTRL-EVENT-CONNECTED".into())));
        assert_eq!(event(&format!("<3>{}", "é".repeat(600))), Some(Event::Other("é".repeat(LONGEST_TEXT))));
    }

    #[test]
    fn answers_are_no_events() {
        for answer in ["OK\n", "PONG\n", "", "<", "<x>AP-ENABLED", "<999>AP-ENABLED", "IFNAME=wlan0"] {
            assert_eq!(Message::parse(answer.as_bytes()), None, "{answer}");
        }
    }

    #[test]
    fn global_sockets_name_the_interface() {
        let message = Message::parse(b"IFNAME=wlan0-1 <3>AP-ENABLED ").expect("an event");
        assert_eq!(message.interface.map(|name| name.to_string()).as_deref(), Some("wlan0-1"));
        assert_eq!(message.event, Event::AccessPointEnabled);
    }

    proptest! {
        #[test]
        fn no_datagram_makes_the_reader_panic(bytes: Vec<u8>, name in "(CTRL-EVENT|AP|BSS)-[A-Z-]*", rest in ".*") {
            _ = Message::parse(&bytes);
            let message = Message::parse(format!("<3>{name} {rest}").as_bytes());
            prop_assert!(message.is_some());
        }
    }
}
