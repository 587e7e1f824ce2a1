//! The address at which agents reach the core.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    num::NonZeroU16,
    str::FromStr,
};

use serde::{Deserialize, Serialize};

/// The address at which agents reach the core: a host name or an IP address, and a port.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct CoreEndpoint {
    host: String,
    port: NonZeroU16,
}

/// Error of a text that is not the address of a core.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{problem}: write a host and a port, as in 192.168.1.10:7448, [fd00::10]:7448 or lab.example.org:7448"
)]
pub struct InvalidEndpoint {
    problem: String,
}

impl CoreEndpoint {
    /// The host's name, in lower case, or its IP address, without brackets.
    pub fn host(&self) -> &str {
        &self.host
    }

    /// The port.
    pub fn port(&self) -> u16 {
        self.port.get()
    }
}

impl FromStr for CoreEndpoint {
    type Err = InvalidEndpoint;

    fn from_str(text: &str) -> Result<Self, InvalidEndpoint> {
        let invalid = |problem: String| InvalidEndpoint { problem };
        let (host, port) = text.rsplit_once(':').ok_or_else(|| invalid("it has no port".to_owned()))?;
        let port = port.parse().ok().filter(|_| port.bytes().all(|byte| byte.is_ascii_digit()));
        let port = port.ok_or_else(|| invalid("its port is not a number from 1 to 65535".to_owned()))?;
        let host = match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
            Some(address) => ipv6(address),
            None => ipv4_or_name(host.to_ascii_lowercase()),
        };
        Ok(Self { host: host.map_err(|problem| invalid(problem.to_owned()))?, port })
    }
}

fn ipv6(text: &str) -> Result<String, &'static str> {
    // Zones, as in fe80::1%eth0, are of one machine.
    let address = text.parse::<Ipv6Addr>().map_err(|_| "its host is not an IPv6 address")?;
    let can_be_reached = !address.is_unspecified() && !address.is_multicast();
    if can_be_reached { Ok(address.to_string()) } else { Err("no core has this address") }
}

fn ipv4_or_name(host: String) -> Result<String, &'static str> {
    if host.contains(':') {
        return Err("an IPv6 address has brackets before its port");
    }
    if let Ok(address) = host.parse::<Ipv4Addr>() {
        let can_be_reached = !address.is_unspecified() && !address.is_broadcast() && !address.is_multicast();
        return if can_be_reached { Ok(host) } else { Err("no core has this address") };
    }
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let is_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label.chars().all(|c| is_word(c) || c == '-')
            && label.starts_with(is_word)
            && label.ends_with(is_word)
    };
    let last = host.rsplit('.').next().unwrap_or_default();
    let is_name =
        host.len() <= 253 && host.split('.').all(is_label) && !last.bytes().all(|byte| byte.is_ascii_digit());
    if is_name { Ok(host) } else { Err("its host is neither a name nor an IP address") }
}

impl fmt::Display for CoreEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.parse() {
            Ok(IpAddr::V6(address)) => write!(f, "[{address}]:{}", self.port),
            _ => write!(f, "{}:{}", self.host, self.port),
        }
    }
}

impl TryFrom<String> for CoreEndpoint {
    type Error = InvalidEndpoint;
    fn try_from(text: String) -> Result<Self, InvalidEndpoint> {
        text.parse()
    }
}

impl From<CoreEndpoint> for String {
    fn from(endpoint: CoreEndpoint) -> Self {
        endpoint.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn hosts_have_a_name_or_an_address_and_a_port() {
        for text in [
            "192.168.1.10:7448",
            "[::1]:7448",
            "[fd00::1:10]:1",
            "lab:1",
            "a-b.example.org:65535",
            "robot_lab.local:7448",
        ] {
            assert_eq!(text.parse::<CoreEndpoint>().unwrap().to_string(), text);
        }
        assert_eq!(
            "[FD00:0:0:0:0:0:0:1]:7448".parse::<CoreEndpoint>().unwrap().to_string(),
            "[fd00::1]:7448"
        );
        assert_eq!("LAB.local:7448".parse::<CoreEndpoint>().unwrap().host(), "lab.local");
    }

    #[test]
    fn wrong_addresses_say_what_is_right() {
        for (text, part) in [
            ("lab", "no port"),
            ("lab:", "1 to 65535"),
            ("lab:0", "1 to 65535"),
            ("lab:+7", "1 to 65535"),
            ("lab:65536", "1 to 65535"),
            ("[::]:7448", "no core"),
            ("[ff02::1]:7448", "no core"),
            ("[fe80::1%eth0]:7448", "not an IPv6"),
            ("[10.0.0.1]:7448", "not an IPv6"),
            ("fe80::1:7448", "brackets"),
            ("0.0.0.0:7448", "no core"),
            ("224.0.0.1:7448", "no core"),
            ("10.0.0.300:7448", "neither a name"),
            (":7448", "neither a name"),
            ("a..b:7448", "neither a name"),
            ("-a:7448", "neither a name"),
            ("lab :7448", "neither a name"),
        ] {
            let error = text.parse::<CoreEndpoint>().unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("as in 192.168.1.10:7448"), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn tls_takes_every_accepted_host(text in r"([a-zA-Z0-9_.-]{1,30}|\[[0-9a-f:]{2,20}\]):[0-9]{1,5}") {
            if let Ok(endpoint) = text.parse::<CoreEndpoint>() {
                prop_assert!(rustls::pki_types::ServerName::try_from(endpoint.host().to_owned()).is_ok());
                prop_assert_eq!(endpoint.to_string().parse::<CoreEndpoint>(), Ok(endpoint));
            }
        }
    }
}
