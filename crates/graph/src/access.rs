//! Virtual access points: their settings, and the keys of robots that attach to them.

use std::{fmt, net::SocketAddr, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::id::{NodeId, VnfId};

/// The VNF that makes a radio unit an access point: it serves its network while a(R) = {vAP}.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AccessPoint {
    /// The network's name.
    pub ssid: String,
    /// Mobility domain of fast transition (IEEE 802.11r). Between access points of one domain, a robot changes without
    /// key handshakes.
    pub mobility_domain: u16,
    /// Key that admits its holder, whatever the holder's domain. Without one, robots of the radio unit's own domain may
    /// attach. Recorded decisions leave it out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub key: Option<FtKey>,
    /// Address of the core that it is on, if that is not the robot's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub core: Option<SocketAddr>,
}

impl AccessPoint {
    /// The same without its key, as all may know it.
    #[must_use]
    pub fn public(&self) -> Self {
        Self { key: None, ..self.clone() }
    }

    /// Returns the name of the access point's VNF on a radio unit: `vAP-` and the radio unit's name.
    pub fn vnf(radio_unit: &NodeId) -> VnfId {
        let name = format!("vAP-{radio_unit}");
        // A radio unit's name may be as long as any.
        let end = name.floor_char_boundary(VnfId::LONGEST);
        VnfId::new(&name[..end]).expect("a node's name behind letters is a name")
    }
}

/// A pairwise master key of fast transition (IEEE 802.11-2020, 12.7.1.6.4: PMK-R1), for a robot and an access point; 64
/// hexadecimal digits in JSON.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FtKey(pub [u8; 32]);

/// Text that is no key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a key of fast transition has 64 hexadecimal digits")]
pub struct InvalidFtKey;

impl fmt::Debug for FtKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FtKey(…)")
    }
}

impl From<FtKey> for String {
    fn from(key: FtKey) -> Self {
        key.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl FromStr for FtKey {
    type Err = InvalidFtKey;

    fn from_str(text: &str) -> Result<Self, InvalidFtKey> {
        let digits: Option<Vec<u8>> =
            text.chars().map(|c| c.to_digit(16).and_then(|digit| u8::try_from(digit).ok())).collect();
        let digits = digits.filter(|digits| digits.len() == 64).ok_or(InvalidFtKey)?;
        let mut key = [0; 32];
        for (byte, pair) in key.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = 16 * pair[0] + pair[1];
        }
        Ok(Self(key))
    }
}

impl TryFrom<String> for FtKey {
    type Error = InvalidFtKey;

    fn try_from(text: String) -> Result<Self, InvalidFtKey> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_64_digits_in_json_and_is_not_printed() {
        let key = FtKey(std::array::from_fn(|i| i as u8 * 7));
        let json = serde_json::to_string(&key).unwrap();
        assert_eq!(serde_json::from_str::<FtKey>(&json).unwrap(), key);
        assert_eq!(format!("{key:?}"), "FtKey(…)");
        for wrong in ["", "00", &"0".repeat(63), &"g".repeat(64), &"0".repeat(66)] {
            assert_eq!(wrong.parse::<FtKey>(), Err(InvalidFtKey), "{wrong}");
        }
    }

    #[test]
    fn public_settings_of_an_access_point_have_no_key() {
        let secret =
            AccessPoint { ssid: "lab".into(), mobility_domain: 7, key: Some(FtKey([1; 32])), core: None };
        assert_eq!(
            serde_json::to_value(secret.public()).unwrap(),
            serde_json::json!({"ssid": "lab", "mobility_domain": 7})
        );
    }

    #[test]
    fn vnf_names_fit_for_radio_units_with_long_names() {
        assert_eq!(AccessPoint::vnf(&NodeId::new("R3").unwrap()).as_str(), "vAP-R3");
        let _ = AccessPoint::vnf(&NodeId::new(&"r".repeat(NodeId::LONGEST)).unwrap());
    }
}
