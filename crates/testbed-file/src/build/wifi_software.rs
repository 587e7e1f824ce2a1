//! Networks with hostapd and wpa_supplicant in place of the model.

use cotorra_graph::{AgentId, NodeId, RadioKind, RealRadio, Security, WifiSoftware};

use super::builder::Builder;
use crate::{
    records::{
        AccessWord, PassphraseRecord, SecurityRecord, SecurityWord, USUAL_PASSPHRASE, WifiWord,
        WirelessRecord, Wpa2Record, Wpa3Record,
    },
    yaml::decode::{Either, Spanned},
};

/// Lengths of an SSID in bytes (IEEE 802.11-2020, 9.4.2.2). That of 0 bytes names no network.
const SSID: std::ops::RangeInclusive<usize> = 1..=32;
/// Lengths of a passphrase (IEEE 802.11-2020, J.4.1).
const PASSPHRASE: std::ops::RangeInclusive<usize> = 8..=63;

impl Builder<'_> {
    /// Returns the real software of a network; `Some(None)` if it has the model.
    pub(super) fn software(&mut self, record: &WirelessRecord) -> Option<Option<WifiSoftware>> {
        let security = self.security(&record.security)?;
        let ssid = self.ssid(record.ssid.as_ref())?;
        let radios = match record.wifi.value {
            WifiWord::Model => return Some(None),
            WifiWord::Hwsim => RadioKind::Hwsim,
            WifiWord::Hardware => RadioKind::Hardware,
        };
        let (message, help) = match record.access.value {
            Either::Short(AccessWord::Edca) => return Some(Some(WifiSoftware { radios, ssid, security })),
            Either::Short(AccessWord::Turns) => (
                "hostapd and wpa_supplicant in a network whose senders take turns",
                "leave `access: turns` out, so that its stations sense the channel",
            ),
            Either::Long(_) => (
                "settings of EDCA for hostapd and wpa_supplicant, whose kernel chooses rates, aggregates, queues and sleeps \
                 by itself",
                "leave `access` out, or write `wifi: model`",
            ),
        };
        self.sink.error(&record.wifi.span, message).help(help);
        None
    }

    /// Returns the real radio of a robot or a radio unit of a network; `Some(None)` if the network's radios are no hardware.
    pub(super) fn radio(
        &mut self,
        id: &Spanned<NodeId>,
        network: &str,
        (agent, interface): (Option<&Spanned<AgentId>>, Option<&Spanned<String>>),
        bridge: Option<&Spanned<String>>,
    ) -> Option<Option<RealRadio>> {
        let interface = interface.map(|interface| Some((interface, self.interface(interface)?)));
        let bridge = bridge.map_or(Some(None), |bridge| self.interface(bridge).map(Some))?;
        let record = self.record.wireless.0.iter().find(|(name, _)| name.value == network);
        let is_hardware = record.is_some_and(|(_, record)| record.wifi.value == WifiWord::Hardware);
        match (agent, interface) {
            (None, Some(interface)) => {
                let (given, _) = interface?;
                self.sink
                    .error(&given.span, "an interface, and no agent of its machine")
                    .help("add the agent that runs there, such as `agent: ap1`, or leave out `interface`");
                None
            }
            (Some(agent), Some(interface)) => {
                let (_, interface) = interface?;
                Some(is_hardware.then(|| RealRadio { agent: agent.value.clone(), interface, bridge }))
            }
            (_, None) if is_hardware => {
                let wrong = format!("`{}` has no radio, and its network has `wifi: hardware`", id.value);
                self.sink.error(&id.span, wrong).help(
                    "name its Wi-Fi interface and the agent there, such as `agent: ap1, interface: wlan0`",
                );
                None
            }
            (_, None) => Some(None),
        }
    }

    fn ssid(&mut self, ssid: Option<&Spanned<String>>) -> Option<Option<String>> {
        let Some(ssid) = ssid else { return Some(None) };
        let length = ssid.value.len();
        if !SSID.contains(&length) {
            let wrong = format!("an SSID of {length} bytes");
            self.sink.error(&ssid.span, wrong).help("write 1 to 32 bytes");
            return None;
        }
        Some(Some(ssid.value.clone()))
    }

    fn security(&mut self, record: &Either<SecurityWord, SecurityRecord>) -> Option<Security> {
        Some(match record {
            Either::Short(SecurityWord::Open) => Security::Open,
            Either::Short(SecurityWord::Wpa2) => Security::Wpa2 {
                passphrase: USUAL_PASSPHRASE.to_owned(),
                management_frames: Default::default(),
                over_ds: false,
            },
            Either::Short(SecurityWord::Wpa3) => {
                Security::Wpa3 { passphrase: USUAL_PASSPHRASE.to_owned(), over_ds: false }
            }
            Either::Long(SecurityRecord::Wpa2(Wpa2Record { management_frames, secret })) => Security::Wpa2 {
                passphrase: self.passphrase(secret)?,
                management_frames: *management_frames,
                over_ds: secret.over_ds,
            },
            Either::Long(SecurityRecord::Wpa3(Wpa3Record { secret })) => {
                Security::Wpa3 { passphrase: self.passphrase(secret)?, over_ds: secret.over_ds }
            }
        })
    }

    fn passphrase(&mut self, PassphraseRecord { passphrase, .. }: &PassphraseRecord) -> Option<String> {
        let is_printable = passphrase.value.bytes().all(|byte| matches!(byte, b' '..=b'~'));
        let length = passphrase.value.chars().count();
        let wrong = match () {
            () if !is_printable => {
                "a passphrase with other characters than printable ones of ASCII".to_owned()
            }
            () if !PASSPHRASE.contains(&length) => format!("a passphrase of {length} characters"),
            () => return Some(passphrase.value.clone()),
        };
        self.sink.error(&passphrase.span, wrong).help("write 8 to 63 printable ASCII characters");
        None
    }
}
