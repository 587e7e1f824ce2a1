//! Configurations of Zenoh.

use std::net::SocketAddr;

use cotorra_agent_protocol::LEASE;
use cotorra_graph::AgentId;
use serde_json::{Value, json};
use zenoh::Config;

use crate::{error::TransportError, keys};

/// Key and certificate of one end, and the authority that signed those of the other, in PEM.
#[derive(Debug, Clone, Copy)]
pub struct Credentials<'a> {
    pub authority: &'a str,
    pub certificate: &'a str,
    pub key: &'a str,
}

/// A certificate that may speak for an agent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    pub agent: AgentId,
    /// The common name of the certificate.
    pub common_name: String,
}

/// Returns the configuration of the core's router.
pub(crate) fn router(
    listen: SocketAddr,
    credentials: Credentials<'_>,
    granted: &[Granted],
) -> Result<Config, TransportError> {
    configured(json!({
        "mode": "router",
        "listen": { "endpoints": [format!("tls/{listen}")] },
        "access_control": access(granted),
        "transport": { "link": {
            "tx": link(),
            "tls": {
                "enable_mtls": true,
                "close_link_on_expiration": true,
                "root_ca_certificate_base64": base64(credentials.authority),
                "listen_certificate_base64": base64(credentials.certificate),
                "listen_private_key_base64": base64(credentials.key),
            },
        } },
    }))
}

/// Returns the configuration of an agent's session. Zenoh also trusts the public authorities of the web when it connects. The
/// session therefore verifies the core's address, and takes messages of this common name alone, which only the core has.
pub(crate) fn client(
    core: &str,
    core_common_name: &str,
    agent: &AgentId,
    credentials: Credentials<'_>,
) -> Result<Config, TransportError> {
    let core_alone = [Granted { agent: agent.clone(), common_name: core_common_name.to_owned() }];
    configured(json!({
        // A client's session would not open before the core is there. Neither would a peer's that waits for peers.
        "mode": "peer",
        "open": { "return_conditions": { "connect_scouted": false, "declares": false } },
        "listen": { "endpoints": [] },
        "connect": {
            "endpoints": [format!("tls/{core}")],
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5 },
        },
        "access_control": access(&core_alone),
        "transport": { "link": {
            "tx": link(),
            "tls": {
                "enable_mtls": true,
                "verify_name_on_connect": true,
                "root_ca_certificate_base64": base64(credentials.authority),
                "connect_certificate_base64": base64(credentials.certificate),
                "connect_private_key_base64": base64(credentials.key),
            },
        } },
    }))
}

/// Applies settings, and switches scouting and gossip off.
fn configured(mut settings: Value) -> Result<Config, TransportError> {
    settings["scouting"] = json!({ "multicast": { "enabled": false }, "gossip": { "enabled": false } });
    // Shared memory would map files that other users of the machine can open.
    settings["transport"]["shared_memory"] = json!({ "enabled": false });
    Config::from_json5(&settings.to_string()).map_err(|e| TransportError::Configuration(e.to_string()))
}

/// A lost connection is noticed after the lease.
fn link() -> Value {
    json!({ "lease": LEASE.as_millis() as u64, "keep_alive": 4 })
}

/// The access control: each certificate may use the keys of its agent, and nothing else.
fn access(granted: &[Granted]) -> Value {
    const MESSAGES: [&str; 9] = [
        "put",
        "delete",
        "declare_subscriber",
        "query",
        "declare_queryable",
        "reply",
        "liveliness_token",
        "declare_liveliness_subscriber",
        "liveliness_query",
    ];
    if granted.is_empty() {
        // Lists may not be empty.
        return json!({ "enabled": true, "default_permission": "deny" });
    }
    let rule = |granted: &Granted| {
        json!({
            "id": granted.common_name,
            "messages": MESSAGES,
            "flows": ["ingress", "egress"],
            "permission": "allow",
            "key_exprs": [format!("{}/**", keys::of_agent(&granted.agent))],
        })
    };
    let subject =
        |granted: &Granted| json!({ "id": granted.common_name, "cert_common_names": [granted.common_name] });
    let policy =
        |granted: &Granted| json!({ "rules": [granted.common_name], "subjects": [granted.common_name] });
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": granted.iter().map(rule).collect::<Vec<_>>(),
        "subjects": granted.iter().map(subject).collect::<Vec<_>>(),
        "policies": granted.iter().map(policy).collect::<Vec<_>>(),
    })
}

fn base64(pem: &str) -> String {
    use base64::Engine;
    base64::engine::general_purpose::STANDARD.encode(pem)
}
