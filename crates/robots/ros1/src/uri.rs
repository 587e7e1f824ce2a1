//! Addresses as ROS 1 writes them: `http://host:port/` of nodes and masters, `rosrpc://host:port` of services.

use std::{fmt, net::Ipv6Addr, str::FromStr};

/// Text that is not an address of a node.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not an address such as http://localhost:11311")]
pub struct UriError(pub String);

/// Address on which a node, a master or a service listens.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Endpoint {
    /// Host name or address; IPv6 without brackets.
    pub host: String,
    /// The port.
    pub port: u16,
}

impl FromStr for Endpoint {
    type Err = UriError;

    fn from_str(uri: &str) -> Result<Self, UriError> {
        let parse = || {
            let (scheme, rest) = uri.trim().split_once("://")?;
            let authority = rest.split('/').next()?;
            let (host, port) = authority.rsplit_once(':')?;
            let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
            let known = matches!(scheme, "http" | "rosrpc") && !host.is_empty();
            known.then_some(Self { host: host.to_owned(), port: port.parse().ok()? })
        };
        parse().ok_or_else(|| UriError(uri.to_owned()))
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port } = self;
        if host.parse::<Ipv6Addr>().is_ok() {
            write!(f, "[{host}]:{port}")
        } else {
            write!(f, "{host}:{port}")
        }
    }
}

impl Endpoint {
    /// Returns the address of a node or a master as text.
    pub fn http(&self) -> String {
        format!("http://{self}/")
    }

    /// Returns the address of a service as text.
    pub fn rosrpc(&self) -> String {
        format!("rosrpc://{self}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_survive_parsing_and_printing() {
        for (uri, host, port) in [
            ("http://localhost:11311", "localhost", 11311),
            ("http://10.0.0.1:1/", "10.0.0.1", 1),
            ("rosrpc://robot:5", "robot", 5),
            ("http://[fd00::1]:2/", "fd00::1", 2),
        ] {
            assert_eq!(uri.parse(), Ok(Endpoint { host: host.to_owned(), port }));
        }
        assert_eq!("http://[fd00::1]:2".parse::<Endpoint>().unwrap().http(), "http://[fd00::1]:2/");
        assert_eq!("http://a:2/".parse::<Endpoint>().unwrap().rosrpc(), "rosrpc://a:2");
    }

    #[test]
    fn invalid_addresses_are_rejected() {
        for uri in ["", "localhost:11311", "http://a", "http://:1", "ftp://a:1", "http://a:70000"] {
            assert_eq!(uri.parse::<Endpoint>(), Err(UriError(uri.to_owned())));
        }
    }
}
