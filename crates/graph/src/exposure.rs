//! Settings of the WLAN Access Information Service (ETSI GS MEC 028): the data that a testbed exposes beyond its own
//! API, and the hosts that it may call back.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    str::FromStr,
};

use serde::{Deserialize, Serialize};

/// Settings of the WLAN Access Information Service.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WaisSettings {
    /// Networks that notifications may be sent to beside this machine's loopback addresses.
    pub callbacks: Vec<IpNetwork>,
    /// Place of the map's origin on Earth. Without it, no locations are exposed.
    pub origin: Option<GeoOrigin>,
}

/// Place of the map's origin on Earth (WGS 84), and the map's orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeoOrigin {
    /// Degrees to the north, -90 to 90.
    pub latitude: f64,
    /// Degrees to the east, -180 to 180.
    pub longitude: f64,
    /// Direction of the map's y axis: radians from north, clockwise.
    pub bearing: f64,
    /// Altitude of the map's floor, metres above the ellipsoid; `None` if unknown.
    pub altitude: Option<f64>,
}

/// A network of IP addresses, such as `10.1.0.0/16` or `fd00::/8`; an address alone is a network of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct IpNetwork {
    address: IpAddr,
    prefix: u8,
}

/// Error of a text that is not a network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is neither an address nor a network: write it like 10.1.2.3, 10.1.0.0/16 or fd00::/8")]
pub struct InvalidIpNetwork(String);

impl IpNetwork {
    /// This machine's own addresses: 127.0.0.0/8 and ::1.
    pub const LOOPBACK: [Self; 2] = [
        Self { address: IpAddr::V4(Ipv4Addr::new(127, 0, 0, 0)), prefix: 8 },
        Self { address: IpAddr::V6(Ipv6Addr::LOCALHOST), prefix: 128 },
    ];

    /// Returns the network of an address with a prefix of so many bits, and clears the other bits; `None` if the address has
    /// fewer.
    pub fn new(address: IpAddr, prefix: u8) -> Option<Self> {
        let address: IpAddr = match address {
            IpAddr::V4(v4) if prefix <= 32 => {
                let mask = u32::MAX.checked_shl(32 - u32::from(prefix)).unwrap_or(0);
                (v4.to_bits() & mask).to_be_bytes().into()
            }
            IpAddr::V6(v6) if prefix <= 128 => {
                let mask = u128::MAX.checked_shl(128 - u32::from(prefix)).unwrap_or(0);
                (v6.to_bits() & mask).to_be_bytes().into()
            }
            _ => return None,
        };
        Some(Self { address, prefix })
    }

    /// Returns the first address.
    pub fn address(&self) -> IpAddr {
        self.address
    }

    /// Whether it is one address alone.
    pub fn is_one(&self) -> bool {
        self.prefix == longest(self.address)
    }

    /// Bits that all its addresses have in common.
    pub fn prefix(&self) -> u8 {
        self.prefix
    }

    /// Whether an address is in it. An IPv4 address that is written as an IPv6 one counts as IPv4.
    pub fn contains(&self, address: IpAddr) -> bool {
        let same = |a: u128, b: u128, bits: u32| {
            let shift = bits - u32::from(self.prefix);
            a.checked_shr(shift) == b.checked_shr(shift)
        };
        match (self.address, address.to_canonical()) {
            (IpAddr::V4(own), IpAddr::V4(other)) => same(own.to_bits().into(), other.to_bits().into(), 32),
            (IpAddr::V6(own), IpAddr::V6(other)) => same(own.to_bits(), other.to_bits(), 128),
            _ => false,
        }
    }
}

impl FromStr for IpNetwork {
    type Err = InvalidIpNetwork;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parse = || {
            let (address, prefix) = match text.split_once('/') {
                Some((address, prefix)) => (address.parse().ok()?, Some(prefix.parse().ok()?)),
                None => (text.parse().ok()?, None),
            };
            Self::new(address, prefix.unwrap_or(longest(address)))
        };
        parse().ok_or_else(|| InvalidIpNetwork(text.to_owned()))
    }
}

/// Returns the number of bits of an address.
fn longest(address: IpAddr) -> u8 {
    if address.is_ipv4() { 32 } else { 128 }
}

impl fmt::Display for IpNetwork {
    /// Writes address and prefix. The alternate form (`{:#}`) leaves out the prefix of one address alone.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if f.alternate() && self.is_one() {
            write!(f, "{}", self.address)
        } else {
            write!(f, "{}/{}", self.address, self.prefix)
        }
    }
}

impl TryFrom<String> for IpNetwork {
    type Error = InvalidIpNetwork;
    fn try_from(text: String) -> Result<Self, InvalidIpNetwork> {
        text.parse()
    }
}

impl From<IpNetwork> for String {
    fn from(network: IpNetwork) -> Self {
        network.to_string()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn network(text: &str) -> IpNetwork {
        text.parse().unwrap()
    }

    #[test]
    fn a_network_holds_its_addresses_and_no_others() {
        for (net, inside, outside) in [
            ("10.1.0.0/16", "10.1.255.1", "10.2.0.1"),
            ("10.1.2.3", "10.1.2.3", "10.1.2.4"),
            ("fd00::/8", "fd12::1", "fe80::1"),
            ("127.0.0.0/8", "::ffff:127.0.0.1", "::7f00:1"),
            ("0.0.0.0/0", "192.0.2.1", "2001:db8::1"),
        ] {
            assert!(network(net).contains(inside.parse().unwrap()), "{net} {inside}");
            assert!(!network(net).contains(outside.parse().unwrap()), "{net} {outside}");
        }
        assert_eq!(network("10.1.2.3").to_string(), "10.1.2.3/32");
        assert_eq!(network("10.1.2.3/8"), network("10.0.0.0/8"));
        assert_eq!(network("fd00::7/0").to_string(), "::/0");
        assert_eq!(network("fd00::1:2/64").to_string(), "fd00::/64");
        assert_eq!(format!("{:#} {:#}", network("10.1.2.3"), network("10.1.2.3/8")), "10.1.2.3 10.0.0.0/8");
        for wrong in ["", "10.0.0", "10.0.0.0/33", "::/129", "10.0.0/8", "lab", "10.0.0.0/", "10.0.0.0/-1"] {
            assert!(wrong.parse::<IpNetwork>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn loopback_is_recognised() {
        for address in ["127.0.0.1", "127.1.2.3", "::1", "::ffff:127.0.0.1"] {
            let address: IpAddr = address.parse().unwrap();
            assert!(IpNetwork::LOOPBACK.iter().any(|net| net.contains(address)), "{address}");
        }
        // Connecting to the unspecified address leads to this machine, too.
        for address in ["0.0.0.0", "::", "10.0.0.1", "169.254.169.254"] {
            let address: IpAddr = address.parse().unwrap();
            assert!(!IpNetwork::LOOPBACK.iter().any(|net| net.contains(address)), "{address}");
        }
    }

    proptest! {
        #[test]
        fn displayed_networks_parse_back(bits: u128, prefix in 0_u8..=128) {
            let v6 = IpNetwork::new(bits.to_be_bytes().into(), prefix).unwrap();
            let v4 = IpNetwork::new((bits as u32).to_be_bytes().into(), prefix / 4).unwrap();
            for network in [v6, v4] {
                prop_assert_eq!(network.to_string().parse(), Ok(network));
                prop_assert_eq!(format!("{network:#}").parse(), Ok(network));
            }
        }
    }
}
