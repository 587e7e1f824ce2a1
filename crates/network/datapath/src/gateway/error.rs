//! Reasons for which an interface cannot be that of a gateway or a real server.

use std::{io, path::PathBuf};

/// An interface that cannot be that of a gateway or a real server. Nothing has changed.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// The namespace cannot be entered.
    #[error("cannot enter the network namespace {}: {source}", path.display())]
    Namespace { path: PathBuf, source: io::Error },
    /// There is no such interface.
    #[error(
        "there is no interface `{0}` there: `ip link` lists them, and docs/use/gateway.md makes a virtual one"
    )]
    Missing(String),
    /// It is down.
    #[error("`{0}` is down: `ip link set {0} up` sets it up")]
    Down(String),
    /// It carries no Ethernet frames to other machines.
    #[error("`{0}` is not an Ethernet interface")]
    NotEthernet(String),
    /// Its frames are shorter than those of hosts.
    #[error(
        "`{interface}` has an MTU of {mtu} bytes, and hosts have {needed}: `ip link set {interface} mtu {needed}` raises it"
    )]
    ShortFrames { interface: String, mtu: u32, needed: u32 },
    /// It carries the default route, so that frames of hosts would go to the network that others use.
    #[error(
        "`{0}` carries the default route, and frames of hosts would go to that network: pass `--allow-interface {0}` to \
         use it anyway"
    )]
    DefaultRoute(String),
    /// Another run has it.
    #[error("`{0}` is in use by another run")]
    Held(String),
    /// The kernel does not list its routes.
    #[error(transparent)]
    Routes(#[from] cotorra_netem::Error),
    /// The kernel rejected the socket.
    #[error("cannot open a packet socket on `{interface}`: {source} (gateways and real servers need root)")]
    Socket { interface: String, source: io::Error },
}
