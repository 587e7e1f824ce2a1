//! Callbacks: URIs for notifications, restricted to networks that the operator allows. The check applies to the
//! address that is then connected to, so that a name cannot be resolved differently in between.

use std::net::{IpAddr, SocketAddr};

use cotorra_graph::IpNetwork;

/// A callback that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CallbackError {
    /// The text is not a URI that this service can post to.
    #[error(
        "`{0}` is not a callback: write it like http://host:port/path, without a user name, and not https"
    )]
    Invalid(String),
    /// The host has no address.
    #[error("the callback's host `{0}` has no address")]
    Unknown(String),
    /// The operator does not allow the address.
    #[error(
        "callbacks to {0} are not allowed: name their network in the testbed file (wais.callbacks) or in \
         --wais-callbacks; only the operator may use loopback"
    )]
    Forbidden(IpAddr),
}

/// A URI that notifications can be posted to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Callback {
    /// The URI as given.
    pub uri: String,
    /// Name or address; IPv6 addresses without brackets.
    pub host: String,
    /// 80 unless given.
    pub port: u16,
    /// Path and query.
    pub target: String,
    /// Value of the `Host` header.
    pub authority: String,
}

impl Callback {
    /// Parses an `http://…` URI.
    ///
    /// # Errors
    /// [`CallbackError::Invalid`].
    pub fn read(text: &str) -> Result<Self, CallbackError> {
        let invalid = || CallbackError::Invalid(text.to_owned());
        let uri: axum::http::Uri = text.parse().map_err(|_| invalid())?;
        let authority = uri.authority().ok_or_else(invalid)?;
        let host = authority.host().trim_start_matches('[').trim_end_matches(']').to_owned();
        let is_http = uri.scheme_str().is_some_and(|scheme| scheme.eq_ignore_ascii_case("http"));
        if !is_http || host.is_empty() || authority.as_str().contains('@') {
            return Err(invalid());
        }
        // A port that is given must be valid.
        let port = match authority.as_str().rsplit_once(':') {
            Some((_, digits)) if !digits.contains(']') => digits.parse().map_err(|_| invalid())?,
            _ => 80,
        };
        Ok(Self {
            uri: text.to_owned(),
            host,
            port,
            target: uri.path_and_query().map_or_else(|| "/".to_owned(), ToString::to_string),
            authority: authority.to_string(),
        })
    }
}

/// Networks that notifications may be sent to.
#[derive(Debug, Clone)]
pub struct Allowed(Vec<IpNetwork>);

impl Allowed {
    /// Allows only these networks.
    pub fn new(networks: impl IntoIterator<Item = IpNetwork>) -> Self {
        Self(networks.into_iter().collect())
    }

    /// Also allows loopback addresses, where services may listen that trust every caller. Only for consumers with
    /// full rights over the testbed.
    #[must_use]
    pub fn and_loopback(mut self) -> Self {
        self.0.extend(IpNetwork::LOOPBACK);
        self
    }

    /// Returns the first of a host's addresses that is allowed.
    ///
    /// # Errors
    /// [`CallbackError`] if there is none.
    pub fn choose(
        &self,
        host: &str,
        addresses: impl IntoIterator<Item = SocketAddr>,
    ) -> Result<SocketAddr, CallbackError> {
        let mut refused = CallbackError::Unknown(host.to_owned());
        for address in addresses {
            if self.0.iter().any(|network| network.contains(address.ip())) {
                return Ok(address);
            }
            refused = CallbackError::Forbidden(address.ip());
        }
        Err(refused)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_are_parsed() {
        for (uri, host, port, target) in [
            ("http://127.0.0.1:8080/a/b?c=d", "127.0.0.1", 8080, "/a/b?c=d"),
            ("http://[::1]:8080", "::1", 8080, "/"),
            ("http://[::1]/x", "::1", 80, "/x"),
            ("HTTP://app.lab/x", "app.lab", 80, "/x"),
        ] {
            let callback = Callback::read(uri).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!((&*callback.host, callback.port, &*callback.target), (host, port, target));
        }
        for wrong in [
            "",
            "x",
            "/x",
            "http://",
            "http:///x",
            "https://127.0.0.1/",
            "ftp://127.0.0.1/",
            "http://a@127.0.0.1/",
            "http://127.0.0.1:99999/",
            "http://127.0.0.1:x/",
            "http://127.0.0.1:/",
            "http://a b/",
        ] {
            assert!(Callback::read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_allowed_addresses_are_chosen() {
        let at = |ip: &str| SocketAddr::new(ip.parse().unwrap(), 80);
        let loopback = Allowed::new([]).and_loopback();
        assert_eq!(loopback.choose("h", [at("10.0.0.1"), at("127.0.0.1")]), Ok(at("127.0.0.1")));
        for forbidden in ["10.0.0.1", "0.0.0.0", "169.254.169.254", "::ffff:10.0.0.1", "::", "fe80::1"] {
            let refused = loopback.choose("h", [at(forbidden)]);
            assert!(matches!(refused, Err(CallbackError::Forbidden(_))), "{forbidden}");
        }
        assert_eq!(loopback.choose("h", []), Err(CallbackError::Unknown("h".to_owned())));
        let lab = Allowed::new(["10.0.0.0/8".parse().unwrap()]);
        assert_eq!(lab.choose("h", [at("10.0.0.1")]), Ok(at("10.0.0.1")));
        for local in ["127.0.0.1", "127.9.9.9", "::1", "::ffff:127.0.0.1"] {
            let refused = lab.choose("h", [at(local)]);
            assert!(matches!(refused, Err(CallbackError::Forbidden(_))), "{local}");
        }
    }
}
