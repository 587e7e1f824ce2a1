//! The ledger of an experiment: its settings for orchestrators, and its name in figures. The name distinguishes a model, a
//! single node and a network of several nodes.

use std::{collections::BTreeSet, fmt, time::Duration};

use cotorra_federation::Network;
use cotorra_graph::DomainId;
use serde_json::json;

/// A ledger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LedgerBackend {
    /// The modelled ledger.
    Modelled,
    /// An anvil node for each run.
    Anvil,
    /// An existing network.
    Network {
        /// The network, and each domain's access to it.
        network: Network,
        /// The owner's description, as in `a network of a university`.
        called: Option<String>,
    },
}

impl LedgerBackend {
    /// Returns the setting `ledger` of a domain's orchestrator, in YAML.
    pub(super) fn setting(&self, domain: Option<&DomainId>, block_period: Duration) -> String {
        let period = format!("{} s", block_period.as_secs_f64());
        let setting = match self {
            Self::Modelled => json!({ "kind": "modelled", "block_period": period }),
            Self::Anvil => json!({ "kind": "anvil", "block_period": period }),
            Self::Network { network, .. } => {
                let access = network.accesses.iter().find(|access| Some(&access.domain) == domain);
                // The plug-in reports that it has no access.
                access.map_or(json!("ethereum"), |access| {
                    json!({
                        "kind": "ethereum",
                        "url": access.url,
                        "chain_id": network.chain_id,
                        "contract": network.contract.to_string(),
                        "from_block": network.from_block,
                        "depth": network.depth,
                        "key_store": access.key_store,
                    })
                })
            }
        };
        setting.to_string()
    }
}

impl fmt::Display for LedgerBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Modelled => f.write_str("a modelled ledger"),
            Self::Anvil => f.write_str("an anvil node: one node without consensus"),
            Self::Network { network, called } => {
                let urls: BTreeSet<_> = network.accesses.iter().map(|access| &access.url).collect();
                let hosts: BTreeSet<_> = urls.iter().map(|url| host(url)).collect();
                let called = called.as_deref().unwrap_or("an Ethereum network");
                let (count, plural) = (urls.len(), if urls.len() == 1 { "node" } else { "nodes" });
                let hosts = hosts.into_iter().collect::<Vec<_>>().join(", ");
                let (clients, chain) = (network.clients.join(", "), network.chain_id);
                write!(f, "{called}: {count} {plural} at {hosts} ({clients}; chain {chain})")
            }
        }
    }
}

/// Returns the host and port of a URL. Everything else may be a password.
fn host(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    let authority = rest.split(['/', '?', '#']).next().unwrap_or(rest);
    let authority = authority.rsplit('@').next().unwrap_or(authority);
    // An IPv6 address has colons inside its brackets.
    let port = authority.rfind(':').filter(|colon| !authority[*colon..].contains(']'));
    port.map_or(authority, |colon| &authority[..colon])
}

#[cfg(test)]
mod tests {
    use cotorra_federation::Access;

    use super::*;

    #[test]
    fn a_network_is_named_and_shows_no_password() {
        let access = |domain: &str, url: &str| Access {
            domain: domain.parse().unwrap(),
            url: url.to_owned(),
            key_store: format!("keys/{domain}.json").into(),
        };
        let network = Network {
            accesses: vec![
                access("one", "ws://127.0.0.1:8546"),
                access("two", "wss://me:secret@node.example/secret?key=secret"),
                access("three", "ws://[::1]:8546/x"),
                access("four", "ws://127.0.0.1:8546"),
                access("five", "ws://127.0.0.1:8547"),
            ],
            chain_id: 7701,
            clients: vec!["EthereumJS/1".to_owned()],
            contract: Default::default(),
            from_block: 7,
            depth: 0,
            block_period: Duration::from_secs(1),
        };
        let on = LedgerBackend::Network { network, called: Some("a network of a university".to_owned()) };
        assert_eq!(
            on.to_string(),
            "a network of a university: 4 nodes at 127.0.0.1, [::1], node.example (EthereumJS/1; chain 7701)"
        );
        let setting = on.setting(Some(&"two".parse().unwrap()), Duration::from_secs(1));
        assert!(
            setting.contains(r#""key_store":"keys/two.json""#) && setting.contains("?key=secret"),
            "{setting}"
        );
        assert_eq!(on.setting(None, Duration::from_secs(1)), r#""ethereum""#);
    }
}
