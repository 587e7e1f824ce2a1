//! Handles of disciplines and classes in the kernel's traffic control, and the IP networks that filters match.

use std::{fmt, net::IpAddr, str::FromStr};

use cotorra_graph::IpNetwork;
use serde::{Deserialize, Serialize};

/// Handle of a discipline (minor 0) or a class, such as `c070:1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Handle(pub(crate) u32);

impl Handle {
    /// Parent of an interface's root discipline.
    pub(crate) const ROOT: Self = Self(0xffff_ffff);
    /// Parent of the ingress discipline.
    pub(crate) const INGRESS: Self = Self(0xffff_fff1);
    /// Parent of the ingress filters.
    pub(crate) const ARRIVING: Self = Self(0xffff_fff2);
    /// The ingress discipline.
    pub(crate) const INGRESS_DISCIPLINE: Self = Self::new(0xffff, 0);
    /// Root discipline of this crate. Its major number marks what this crate created.
    pub(crate) const OURS: Self = Self::new(0xc070, 0);

    pub(crate) const fn new(major: u16, minor: u16) -> Self {
        Self((major as u32) << 16 | minor as u32)
    }

    pub(crate) const fn major(self) -> u16 {
        (self.0 >> 16) as u16
    }

    pub(crate) const fn minor(self) -> u16 {
        self.0 as u16
    }

    /// Returns the handle of our class with this number.
    pub(crate) const fn class(number: u16) -> Self {
        Self::new(Self::OURS.major(), number)
    }

    /// Returns the handle of the discipline in our class with this number.
    pub(crate) const fn leaf(number: u16) -> Self {
        Self::new(Self::OURS.major() + number, 0)
    }
}

impl fmt::Display for Handle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (*self, self.minor()) {
            (Self::ROOT, _) => f.write_str("root"),
            (Self::INGRESS, _) => f.write_str("ingress"),
            (_, 0) => write!(f, "{:x}:", self.major()),
            (_, minor) => write!(f, "{:x}:{minor:x}", self.major()),
        }
    }
}

/// An IP network, or a single address.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Network {
    address: IpAddr,
    prefix: u8,
}

/// Text that is not an IP network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is neither an address nor a network: write it like 10.0.0.7, 10.0.0.0/16 or fd00::/64")]
pub struct ParseNetworkError(String);

impl Network {
    /// Creates the network of `address` with a prefix of `prefix` bits and clears the remaining bits. Returns `None`
    /// if the prefix is longer than the address.
    pub fn new(address: IpAddr, prefix: u8) -> Option<Self> {
        let address: IpAddr = match address {
            IpAddr::V4(v4) if prefix <= 32 => {
                let mask = u32::MAX.checked_shl(32 - u32::from(prefix)).unwrap_or(0);
                (u32::from(v4) & mask).to_be_bytes().into()
            }
            IpAddr::V6(v6) if prefix <= 128 => {
                let mask = u128::MAX.checked_shl(128 - u32::from(prefix)).unwrap_or(0);
                (u128::from(v6) & mask).to_be_bytes().into()
            }
            _ => return None,
        };
        Some(Self { address, prefix })
    }

    /// Returns the first address.
    pub fn address(self) -> IpAddr {
        self.address
    }

    /// Returns the length of the prefix, bits.
    pub fn prefix(self) -> u8 {
        self.prefix
    }
}

impl FromStr for Network {
    type Err = ParseNetworkError;
    fn from_str(text: &str) -> Result<Self, ParseNetworkError> {
        let parse = || {
            let (address, prefix) = match text.split_once('/') {
                Some((address, prefix)) => (address.parse().ok()?, Some(prefix.parse().ok()?)),
                None => (text.parse().ok()?, None),
            };
            let whole = if matches!(address, IpAddr::V4(_)) { 32 } else { 128 };
            Self::new(address, prefix.unwrap_or(whole))
        };
        parse().ok_or_else(|| ParseNetworkError(text.to_owned()))
    }
}

impl From<IpNetwork> for Network {
    fn from(network: IpNetwork) -> Self {
        Self::new(network.address(), network.prefix()).expect("a network has no more bits than addresses")
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.address, self.prefix) {
            (IpAddr::V4(address), 32) => write!(f, "{address}"),
            (IpAddr::V6(address), 128) => write!(f, "{address}"),
            (address, prefix) => write!(f, "{address}/{prefix}"),
        }
    }
}

impl TryFrom<String> for Network {
    type Error = ParseNetworkError;
    fn try_from(text: String) -> Result<Self, ParseNetworkError> {
        text.parse()
    }
}

impl From<Network> for String {
    fn from(network: Network) -> Self {
        network.to_string()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn networks_parse_with_and_without_prefix() {
        let read = |text: &str| text.parse::<Network>().map(|n| n.to_string());
        assert_eq!(read("10.1.2.3"), Ok("10.1.2.3".into()));
        assert_eq!(read("10.1.2.3/8"), Ok("10.0.0.0/8".into()));
        assert_eq!(read("0.0.0.0/0"), Ok("0.0.0.0/0".into()));
        assert_eq!(read("fd00::1:2/64"), Ok("fd00::/64".into()));
        for wrong in ["", "10.0.0", "10.0.0.1/33", "::/129", "10.0.0.1/", "host"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn displayed_networks_parse_back(bits: u128, prefix in 0_u8..=128) {
            let v6 = Network::new(bits.to_be_bytes().into(), prefix).unwrap();
            prop_assert_eq!(v6.to_string().parse(), Ok(v6));
            let v4 = Network::new((bits as u32).to_be_bytes().into(), prefix / 4).unwrap();
            prop_assert_eq!(v4.to_string().parse(), Ok(v4));
        }
    }
}
