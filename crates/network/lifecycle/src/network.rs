//! Virtual networks of Eclipse fog05 v0.2. The emulated network stands for each of them: it joins all nodes already.

use std::collections::BTreeSet;

use cotorra_graph::{DomainId, HostAddress, NodeId};
use serde::{Deserialize, de::IgnoredAny};
use serde_json::{Value, json};

use crate::descriptor::{DescriptorError, LONGEST_DESCRIPTOR, check_name, check_uuid, says_nothing, shown};

/// Network of all IPv6 addresses of hosts.
const IPV6_NETWORK: &str = "fd77::/64";

/// The keys of a descriptor, and those that its record has beside them. Scripts add records again.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    uuid: String,
    name: String,
    net_type: String,
    #[serde(default)]
    is_mgmt: Value,
    #[serde(default)]
    ip_configuration: Option<Addresses>,
    #[serde(default)]
    vni: Value,
    #[serde(default)]
    mcast_addr: Value,
    #[serde(default)]
    vlan_id: Value,
    #[serde(default)]
    face: Value,
    /// Whether fog05 spans it over several nodes.
    #[serde(default, rename = "overlay")]
    _overlay: Option<bool>,
    #[serde(default, rename = "status")]
    _status: Option<String>,
    #[serde(default, rename = "properties")]
    _properties: Option<IgnoredAny>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Addresses {
    #[serde(default)]
    ip_version: Option<String>,
    #[serde(default)]
    subnet: Option<String>,
    #[serde(default)]
    gateway: Value,
    #[serde(default)]
    dhcp_enable: Value,
    #[serde(default)]
    dhcp_range: Value,
    #[serde(default)]
    dns: Value,
}

/// A virtual network as its descriptor gives it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkDescriptor {
    /// Its identifier.
    pub uuid: String,
    /// Its name for people.
    pub name: String,
}

impl NetworkDescriptor {
    /// Reads a descriptor's text.
    ///
    /// # Errors
    /// [`DescriptorError`].
    pub fn read(text: &[u8]) -> Result<Self, DescriptorError> {
        if text.len() > LONGEST_DESCRIPTOR {
            return Err(DescriptorError::TooLong(text.len()));
        }
        let unreadable =
            |error: serde_json::Error| DescriptorError::Unreadable("a network", error.to_string());
        let keys: Keys = serde_json::from_slice(text).map_err(unreadable)?;
        if keys.net_type != "ELAN" {
            let (key, value) = ("net_type", shown(&keys.net_type));
            let wanted = "ELAN: the emulated network joins all nodes";
            return Err(DescriptorError::Value { key, value, wanted });
        }
        let addresses = keys.ip_configuration.unwrap_or_default();
        let own = match addresses.ip_version.as_deref() {
            None | Some("IPV4") => HostAddress::NETWORK,
            Some("IPV6") => IPV6_NETWORK,
            Some(other) => {
                let (key, value, wanted) = ("ip_configuration.ip_version", shown(other), "IPV4 or IPV6");
                return Err(DescriptorError::Value { key, value, wanted });
            }
        };
        if let Some(subnet) = addresses.subnet.filter(|subnet| !subnet.is_empty() && subnet != own) {
            let wanted = "10.77.0.0/16 or, for IPV6, fd77::/64, where all nodes have their addresses";
            let key = "ip_configuration.subnet";
            return Err(DescriptorError::Value { key, value: shown(&subnet), wanted });
        }
        let frames = "frames of the emulated network have no tags, and cross no network of the machine";
        for (key, value, reason) in [
            ("is_mgmt", &keys.is_mgmt, "there is no network for management"),
            ("vni", &keys.vni, frames),
            ("mcast_addr", &keys.mcast_addr, frames),
            ("vlan_id", &keys.vlan_id, frames),
            ("face", &keys.face, frames),
            ("ip_configuration.gateway", &addresses.gateway, "the emulated network leads nowhere else"),
            ("ip_configuration.dhcp_enable", &addresses.dhcp_enable, "nodes have their addresses already"),
            ("ip_configuration.dhcp_range", &addresses.dhcp_range, "nodes have their addresses already"),
            ("ip_configuration.dns", &addresses.dns, "the names of nodes are in `/etc/hosts`"),
        ] {
            if !says_nothing(value) {
                return Err(DescriptorError::NotHonoured { key, reason });
            }
        }
        check_uuid("uuid", &keys.uuid)?;
        check_name("name", &keys.name)?;
        Ok(Self { uuid: keys.uuid, name: keys.name })
    }
}

/// A virtual network in the catalog.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Network {
    /// As its descriptor gives it.
    pub descriptor: NetworkDescriptor,
    /// The nodes that it was added to. All others are in the emulated network, too.
    pub nodes: BTreeSet<NodeId>,
    pub(crate) owner: Option<DomainId>,
}

impl Network {
    /// Returns its record, which can be added again as a descriptor.
    pub fn record(&self) -> Value {
        let NetworkDescriptor { uuid, name } = &self.descriptor;
        json!({
            "uuid": uuid, "name": name, "net_type": "ELAN", "is_mgmt": false, "status": "CREATE",
            "ip_configuration": { "ip_version": "IPV4", "subnet": HostAddress::NETWORK, "dhcp_enable": false },
            "properties": { "nodes": self.nodes },
        })
    }
}
