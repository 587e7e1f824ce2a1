//! Name and master of a node, from the program, ROS's environment variables and remapping arguments.
//!
//! Source: ROS wiki, "ROS/EnvironmentVariables" and "Remapping Arguments".

use std::{
    env,
    net::{IpAddr, ToSocketAddrs, UdpSocket},
};

use crate::{
    uri::{Endpoint, UriError},
    xmlrpc::Value,
};

/// Reason why a configuration is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The master's address is invalid.
    #[error("ROS_MASTER_URI or __master: {0}")]
    Master(#[from] UriError),
    /// `name:=` without a value, or a value without a name.
    #[error("`{0}` is not a remapping such as scan:=/robot/scan or _rate:=10")]
    Remapping(String),
}

/// Name, master and address of a node.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeConfig {
    /// The name, without namespace.
    pub name: String,
    /// The namespace of its names.
    pub namespace: String,
    /// Address of its master.
    pub master: Endpoint,
    /// Host name or address under which others reach it. By default, the address of the interface towards the master.
    pub host: Option<String>,
    /// Remapped names: from, to.
    pub remappings: Vec<(String, String)>,
    /// Private parameters to set at the start.
    pub params: Vec<(String, Value)>,
}

impl NodeConfig {
    /// A node in the namespace `/`, with a master on this host.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            namespace: "/".to_owned(),
            master: Endpoint { host: "localhost".to_owned(), port: 11311 },
            host: None,
            remappings: Vec::new(),
            params: Vec::new(),
        }
    }

    /// A node configured by `ROS_MASTER_URI`, `ROS_HOSTNAME`, `ROS_IP` and `ROS_NAMESPACE`. The host name takes
    /// precedence over the address, as in ROS.
    ///
    /// # Errors
    /// [`ConfigError::Master`] if the master's address is invalid.
    pub fn from_env(name: &str) -> Result<Self, ConfigError> {
        Self::new(name).with_variables(|variable| env::var(variable).ok())
    }

    fn with_variables(mut self, variable: impl Fn(&str) -> Option<String>) -> Result<Self, ConfigError> {
        let variable = |name| variable(name).filter(|value| !value.is_empty());
        if let Some(uri) = variable("ROS_MASTER_URI") {
            self.master = uri.parse()?;
        }
        if let Some(namespace) = variable("ROS_NAMESPACE") {
            self.namespace = namespace;
        }
        self.host = variable("ROS_HOSTNAME").or_else(|| variable("ROS_IP"));
        Ok(self)
    }

    /// Applies the remappings among a program's arguments, `from:=to`, and ignores other arguments. `__name`, `__ns`,
    /// `__master`, `__hostname` and `__ip` set the fields of these names. `_param:=value` sets a private parameter: a
    /// number or a flag if it looks like one, else text.
    ///
    /// # Errors
    /// [`ConfigError`] if a remapping is invalid.
    pub fn with_args(mut self, args: impl IntoIterator<Item = impl AsRef<str>>) -> Result<Self, ConfigError> {
        for arg in args {
            let Some((from, to)) = arg.as_ref().split_once(":=") else { continue };
            if from.is_empty() || to.is_empty() {
                return Err(ConfigError::Remapping(arg.as_ref().to_owned()));
            }
            let to = to.to_owned();
            match from {
                "__name" => self.name = to,
                "__ns" => self.namespace = to,
                "__master" => self.master = to.parse()?,
                "__hostname" | "__ip" => self.host = Some(to),
                // Others, such as __log, are for the tools that start nodes.
                _ if from.starts_with("__") => {}
                _ => match from.strip_prefix('_') {
                    Some(param) => self.params.push((format!("~{param}"), scalar(&to))),
                    None => self.remappings.push((from.to_owned(), to)),
                },
            }
        }
        Ok(self)
    }

    /// Returns the host name or address under which others reach the node.
    pub(crate) fn reachable_host(&self) -> String {
        let towards_master = || {
            let master = (self.master.host.as_str(), self.master.port).to_socket_addrs().ok()?.next()?;
            let any: IpAddr = if master.is_ipv4() { [0; 4].into() } else { [0u16; 8].into() };
            let socket = UdpSocket::bind((any, 0)).ok()?;
            // Sends nothing, and only chooses a route.
            socket.connect(master).ok()?;
            Some(socket.local_addr().ok()?.ip().to_string())
        };
        self.host.clone().or_else(towards_master).unwrap_or_else(|| "localhost".to_owned())
    }
}

/// Parses a number or a flag as YAML does; other text stays text.
fn scalar(text: &str) -> Value {
    match (text.parse(), text.parse()) {
        (Ok(value), _) => Value::Int(value),
        (_, Ok(value)) => Value::Double(value),
        _ if text.eq_ignore_ascii_case("true") => Value::Bool(true),
        _ if text.eq_ignore_ascii_case("false") => Value::Bool(false),
        _ => text.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environment_variables_set_master_host_and_namespace() {
        let variables = |name: &str| match name {
            "ROS_MASTER_URI" => Some("http://master:11312/".to_owned()),
            "ROS_IP" => Some("10.0.0.7".to_owned()),
            "ROS_HOSTNAME" => Some("robot".to_owned()),
            _ => None,
        };
        let config = NodeConfig::new("n").with_variables(variables).unwrap();
        assert_eq!(config.master, Endpoint { host: "master".to_owned(), port: 11312 });
        assert_eq!((config.host.as_deref(), config.namespace.as_str()), (Some("robot"), "/"));
        let wrong = NodeConfig::new("n").with_variables(|_| Some("master".to_owned()));
        assert!(matches!(wrong, Err(ConfigError::Master(_))));
    }

    #[test]
    fn arguments_remap_names_and_set_parameters() {
        let args = [
            "-v",
            "scan:=/lidar",
            "__name:=m",
            "__ns:=/robot",
            "_rate:=10",
            "_fast:=True",
            "_k:=0.5",
            "__log:=x",
        ];
        let config = NodeConfig::new("n").with_args(args).unwrap();
        assert_eq!((config.name.as_str(), config.namespace.as_str()), ("m", "/robot"));
        assert_eq!(config.remappings, [("scan".to_owned(), "/lidar".to_owned())]);
        let params = [("~rate", 10.into()), ("~fast", true.into()), ("~k", 0.5.into())];
        assert_eq!(config.params, params.map(|(name, value): (&str, Value)| (name.to_owned(), value)));
        let wrong = NodeConfig::new("n").with_args(["scan:="]);
        assert_eq!(wrong, Err(ConfigError::Remapping("scan:=".to_owned())));
    }

    #[test]
    fn master_on_this_host_is_reached_by_loopback() {
        let master = Endpoint { host: "127.0.0.1".to_owned(), port: 11311 };
        assert_eq!(NodeConfig { master, ..NodeConfig::new("n") }.reachable_host(), "127.0.0.1");
    }
}
