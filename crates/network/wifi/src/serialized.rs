//! Values on their way between machines. What is read has been checked as if it were made here.

use std::{fmt::Display, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

use crate::{
    access_point::BeaconInterval,
    address::MacAddress,
    channel::{Band, Channel, Width},
    hex,
    names::{CountryCode, InterfaceName, Ssid},
    secret::{DomainKey, Passphrase},
    security::KeyHolder,
};

/// Longest text of a value, in bytes. Longer ones are rejected without being repeated in the error.
const LONGEST: usize = 256;

fn text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let text = String::deserialize(deserializer)?;
    if text.len() > LONGEST {
        Err(D::Error::custom(format!("a text of {} bytes", text.len())))
    } else {
        Ok(text)
    }
}

fn parsed<'de, T, D>(deserializer: D) -> Result<T, D::Error>
where
    T: FromStr<Err: Display>,
    D: Deserializer<'de>,
{
    text(deserializer)?.parse().map_err(D::Error::custom)
}

fn bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
    let text = text(deserializer)?;
    hex::decode(&text).ok_or_else(|| D::Error::custom("no pairs of hexadecimal digits"))
}

macro_rules! as_text {
    ($($name:ty),*) => {$(
        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                parsed(deserializer)
            }
        }
    )*};
}

as_text!(MacAddress, InterfaceName, CountryCode, KeyHolder);

/// In hexadecimal digits, because it need not be text.
impl Serialize for Ssid {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.hex())
    }
}

impl<'de> Deserialize<'de> for Ssid {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::new(bytes(deserializer)?).map_err(D::Error::custom)
    }
}

/// In clear: only for those who may know it.
impl Serialize for Passphrase {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.expose())
    }
}

impl<'de> Deserialize<'de> for Passphrase {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        parsed(deserializer)
    }
}

/// In clear: only for those who may know it.
impl Serialize for DomainKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.hex())
    }
}

impl<'de> Deserialize<'de> for DomainKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let bytes: [u8; 32] =
            bytes(deserializer)?.try_into().map_err(|_| D::Error::custom("a domain's key has 32 bytes"))?;
        Ok(Self::new(bytes))
    }
}

impl Serialize for BeaconInterval {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.time_units().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for BeaconInterval {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let units = u16::deserialize(deserializer)?;
        Self::new(units).ok_or_else(|| D::Error::custom(format!("a beacon interval of {units} is too short")))
    }
}

impl Serialize for Channel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.band(), self.number(), self.width()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Channel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (band, number, width) = <(Band, u8, Width)>::deserialize(deserializer)?;
        Self::new(band, number, width).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use serde::de::DeserializeOwned;

    use super::*;

    fn survives<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(value: &T) {
        let json = serde_json::to_string(value).expect("JSON");
        assert_eq!(serde_json::from_str::<T>(&json).as_ref().ok(), Some(value), "{json}");
    }

    #[test]
    fn values_are_read_as_they_were_written() {
        survives(&"wlan0".parse::<InterfaceName>().expect("a name"));
        survives(&MacAddress([2, 0, 0, 0, 1, 0]));
        survives(&Ssid::new([0, 255, b'"']).expect("an SSID"));
        survives(&"correct \"horse\"".parse::<Passphrase>().expect("a passphrase"));
        survives(&DomainKey::new([7; 32]));
        survives(&BeaconInterval::default());
        survives(&Channel::new(Band::Ghz5, 36, Width::Mhz80).expect("a channel"));
    }

    #[test]
    fn values_that_nobody_can_make_are_rejected() {
        let error = |json: &str| serde_json::from_str::<Passphrase>(json).map(drop).expect_err("too short");
        let reason = error("\"secret\"").to_string();
        assert!(reason.contains("8 to 63") && !reason.contains("secret"), "{reason}");
        assert!(error(&format!("\"{}\"", "x".repeat(LONGEST + 1))).to_string().contains("257 bytes"));
        assert!(serde_json::from_str::<InterfaceName>("\"a b\"").is_err());
        assert!(serde_json::from_str::<MacAddress>("\"02:00\"").is_err());
        for wrong in ["\"\"", "\"0\"", "\"0g\"", &format!("\"{}\"", "00".repeat(33))] {
            assert!(serde_json::from_str::<Ssid>(wrong).is_err(), "{wrong}");
        }
        assert!(serde_json::from_str::<DomainKey>("\"00\"").is_err());
        assert!(serde_json::from_str::<BeaconInterval>("14").is_err());
        assert!(serde_json::from_str::<Channel>("[\"ghz2\",36,\"mhz20\"]").is_err());
    }
}
