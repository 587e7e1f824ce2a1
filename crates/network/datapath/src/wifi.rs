//! Simulated radios of Linux for the robots and radio units of networks with real Wi-Fi software
//! ([`Hwsim`](cotorra_graph::Hwsim)).
//!
//! A robot's addresses are on its [`WLAN`]. A radio unit's are on its [`BRIDGE`], which joins its port of the fabric with its
//! [`WLAN`], once hostapd adds that. Both have the MAC addresses of [`HostAddress`](cotorra_graph::HostAddress), which are
//! the radio units' BSSIDs, too. The software is for the caller to start, in the nodes' namespaces.

/// The interface of a node's radio.
pub const WLAN: &str = "wlan0";

/// The bridge of a radio unit.
pub const BRIDGE: &str = "br0";
