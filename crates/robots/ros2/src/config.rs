//! Name, domain and middleware of a node, from the program, ROS 2's environment variables and its arguments.
//!
//! Source: ROS 2 documentation, "The ROS_DOMAIN_ID", "Improved Dynamic Discovery" and "Passing ROS arguments to nodes
//! via the command-line".

use std::{
    env,
    net::{IpAddr, Ipv4Addr},
};

/// Last domain. The UDP ports of a higher one would exceed 65535 (DDSI-RTPS 2.5, 9.6.2.3).
const LAST_DOMAIN: u16 = 232;

/// Reason why a configuration is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The domain is invalid.
    #[error("ROS_DOMAIN_ID: `{0}` is not a number from 0 to {LAST_DOMAIN}")]
    Domain(String),
    /// `from:=` without a value, a value without a name, or `-r` without a remapping.
    #[error("`{0}` is not a remapping such as scan:=/robot/scan; after --ros-args, it follows -r")]
    Remapping(String),
}

/// Middleware (RMW) that carries messages and discovers peers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Middleware {
    /// DDS, as in all of ROS 2's middlewares but one.
    Dds {
        /// Address of the only network interface to use; by default, all are used. Loopback, 127.0.0.1, limits the
        /// node to this machine.
        interface: Option<IpAddr>,
    },
    /// Zenoh, as in `rmw_zenoh`.
    Zenoh {
        /// Endpoint of the Zenoh router, such as `tcp/192.168.0.20:7447`.
        router: String,
    },
}

impl Middleware {
    /// Whether Zenoh was built in.
    pub const HAS_ZENOH: bool = cfg!(feature = "zenoh");
}

/// Name, domain and middleware of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeConfig {
    /// The name, without namespace.
    pub name: String,
    /// The namespace of its names.
    pub namespace: String,
    /// The domain, 0 to 232. Nodes in other domains are not discovered.
    pub domain: u16,
    /// Middleware that carries its messages.
    pub middleware: Middleware,
    /// Remapped names: from, to.
    pub remappings: Vec<(String, String)>,
}

impl NodeConfig {
    /// A node in the namespace `/` and domain 0, over DDS on all interfaces.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            namespace: "/".to_owned(),
            domain: 0,
            middleware: Middleware::Dds { interface: None },
            remappings: Vec::new(),
        }
    }

    /// A node configured by `ROS_DOMAIN_ID`, and by `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` or
    /// `ROS_LOCALHOST_ONLY=1`.
    ///
    /// # Errors
    /// [`ConfigError::Domain`] if the domain is invalid.
    pub fn from_env(name: &str) -> Result<Self, ConfigError> {
        Self::new(name).with_variables(|variable| env::var(variable).ok())
    }

    fn with_variables(mut self, variable: impl Fn(&str) -> Option<String>) -> Result<Self, ConfigError> {
        let variable = |name| variable(name).filter(|value| !value.is_empty());
        if let Some(domain) = variable("ROS_DOMAIN_ID") {
            let number = domain.parse().ok().filter(|number| *number <= LAST_DOMAIN);
            self.domain = number.ok_or(ConfigError::Domain(domain))?;
        }
        let range = variable("ROS_AUTOMATIC_DISCOVERY_RANGE");
        let localhost = variable("ROS_LOCALHOST_ONLY").is_some_and(|only| only == "1");
        if localhost || range.is_some_and(|range| range.eq_ignore_ascii_case("LOCALHOST")) {
            self.middleware = Middleware::Dds { interface: Some(Ipv4Addr::LOCALHOST.into()) };
        }
        Ok(self)
    }

    /// Applies the remappings among a program's arguments, which follow `--ros-args`: `-r from:=to`. `__node` (or
    /// `__name`) and `__ns` set the fields of these names. Other arguments are ignored.
    ///
    /// # Errors
    /// [`ConfigError::Remapping`] if one is invalid.
    pub fn with_args(mut self, args: impl IntoIterator<Item = impl AsRef<str>>) -> Result<Self, ConfigError> {
        let (mut ours, mut follows) = (false, false);
        for arg in args {
            match arg.as_ref() {
                "--ros-args" => ours = true,
                "--" => ours = false,
                "-r" | "--remap" if ours => follows = true,
                remapping if follows => {
                    follows = false;
                    self.remap(remapping)?;
                }
                _ => {}
            }
        }
        if follows { Err(ConfigError::Remapping("-r".to_owned())) } else { Ok(self) }
    }

    fn remap(&mut self, remapping: &str) -> Result<(), ConfigError> {
        let parts = remapping.split_once(":=").filter(|(from, to)| !from.is_empty() && !to.is_empty());
        let (from, to) = parts.ok_or_else(|| ConfigError::Remapping(remapping.to_owned()))?;
        let to = to.to_owned();
        match from {
            "__node" | "__name" => self.name = to,
            "__ns" => self.namespace = to,
            _ => self.remappings.push((from.to_owned(), to)),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environment_variables_set_domain_and_range() {
        let with = |set: &[(&str, &str)]| {
            let value =
                |name: &str| set.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned());
            NodeConfig::new("n").with_variables(value)
        };
        assert_eq!(with(&[]).unwrap(), NodeConfig::new("n"));
        let config = with(&[("ROS_DOMAIN_ID", "42"), ("ROS_LOCALHOST_ONLY", "1")]).unwrap();
        let local = Middleware::Dds { interface: Some(Ipv4Addr::LOCALHOST.into()) };
        assert_eq!((config.domain, config.middleware), (42, local.clone()));
        assert_eq!(with(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")]).unwrap().middleware, local);
        let all = Middleware::Dds { interface: None };
        assert_eq!(with(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")]).unwrap().middleware, all);
        for wrong in ["233", "-1", "a"] {
            assert_eq!(with(&[("ROS_DOMAIN_ID", wrong)]), Err(ConfigError::Domain(wrong.to_owned())));
        }
    }

    #[test]
    fn arguments_remap_names() {
        let args = "-v a:=b --ros-args -r scan:=/lidar --remap __node:=m -r __ns:=/robot -p x:=1 -- -r c:=d";
        let config = NodeConfig::new("n").with_args(args.split(' ')).unwrap();
        assert_eq!((config.name.as_str(), config.namespace.as_str()), ("m", "/robot"));
        assert_eq!(config.remappings, [("scan".to_owned(), "/lidar".to_owned())]);
        for wrong in [&["--ros-args", "-r", "scan"][..], &["--ros-args", "-r"]] {
            assert!(matches!(NodeConfig::new("n").with_args(wrong), Err(ConfigError::Remapping(_))));
        }
    }
}
