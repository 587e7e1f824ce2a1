//! Names of the ROS 2 graph: resolving a node's names to global ones, remapping them, and the names of topics and types in
//! DDS.
//!
//! Source: ROS 2 design, "Topic and Service name mapping to DDS" and "Remapping Names".

use std::collections::BTreeMap;

/// A name that the ROS graph does not allow.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not a name: its parts, between single `/`, begin with a letter or `_`, have letters, digits and single `_` \
     after that; `~/` in front is the node's own"
)]
pub struct NameError(pub String);

/// The names of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    /// Without namespace.
    name: String,
    /// Begins with `/`, and does not end with one unless it is the root.
    namespace: String,
    /// From global name to global name.
    remapped: BTreeMap<String, String>,
}

impl Names {
    /// The names of the node `name` (without namespace) in `namespace`, with its remappings.
    ///
    /// # Errors
    /// [`NameError`] if one of them is invalid.
    pub fn new<'a>(
        name: &str,
        namespace: &str,
        remappings: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, NameError> {
        if !is_part(name) {
            return Err(NameError(name.to_owned()));
        }
        let parts = namespace.trim_matches('/');
        if !parts.is_empty() && !parts.split('/').all(is_part) {
            return Err(NameError(namespace.to_owned()));
        }
        let namespace = format!("/{parts}");
        let mut names = Self { name: name.to_owned(), namespace, remapped: BTreeMap::new() };
        for (from, to) in remappings {
            let (from, to) = (names.global(from)?, names.global(to)?);
            names.remapped.insert(from, to);
        }
        Ok(names)
    }

    /// The node's name, without namespace.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The node's namespace.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The node's global name.
    pub fn node(&self) -> String {
        joined(&self.namespace, &self.name)
    }

    /// Resolves a name to its global one: `/a` is global, `a` is in the node's namespace, `~/a` is private to the node.
    /// Then applies remappings.
    ///
    /// # Errors
    /// [`NameError`] if `name` is invalid.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        let global = self.global(name)?;
        Ok(self.remapped.get(&global).cloned().unwrap_or(global))
    }

    fn global(&self, name: &str) -> Result<String, NameError> {
        let (base, parts) = match (name.strip_prefix("~/"), name.strip_prefix('/')) {
            (Some(parts), _) => (self.node(), parts),
            (_, Some(parts)) => ("/".to_owned(), parts),
            _ => (self.namespace.clone(), name),
        };
        if !parts.split('/').all(is_part) {
            return Err(NameError(name.to_owned()));
        }
        Ok(joined(&base, parts))
    }
}

fn joined(base: &str, name: &str) -> String {
    if base == "/" { format!("/{name}") } else { format!("{base}/{name}") }
}

/// Whether `text` is a valid part of a name, between two slashes.
fn is_part(part: &str) -> bool {
    let mut rest = part.chars();
    rest.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && rest.all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !part.contains("__")
}

/// Returns the DDS name of the topic of a global name.
pub fn dds_topic(global: &str) -> String {
    format!("rt{global}")
}

/// Returns the DDS name of a type: `a::msg::dds_::B_` for `a/msg/B`.
pub fn dds_type(name: &str) -> String {
    let mut parts: Vec<_> = name.split('/').map(str::to_owned).collect();
    if let Some(last) = parts.last_mut() {
        *last = format!("dds_::{last}_");
    }
    parts.join("::")
}

/// Returns the ROS name of a type, if the DDS name is that of one.
pub fn ros_type(dds: &str) -> Option<String> {
    let (package, name) = dds.strip_suffix('_')?.split_once("::dds_::")?;
    Some(format!("{}/{name}", package.replace("::", "/")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_resolve_as_specified() {
        for (node, namespace, name, expected) in [
            ("my_node", "/", "ping", "/ping"),
            ("my_node", "/my_ns", "ping", "/my_ns/ping"),
            ("my_node", "my_ns/", "ping", "/my_ns/ping"),
            ("my_node", "/my_ns", "/ping", "/ping"),
            ("my_node", "/my_ns", "~/ping", "/my_ns/my_node/ping"),
            ("my_node", "/", "~/ping/pong", "/my_node/ping/pong"),
        ] {
            assert_eq!(Names::new(node, namespace, []).unwrap().resolve(name).unwrap(), expected);
        }
    }

    #[test]
    fn remapping_applies_to_resolved_names() {
        let names =
            Names::new("n", "/robot", [("scan", "/lidar"), ("~/rate", "hz"), ("/map", "map")]).unwrap();
        assert_eq!(names.node(), "/robot/n");
        assert_eq!(names.resolve("scan").unwrap(), "/lidar");
        assert_eq!(names.resolve("/robot/scan").unwrap(), "/lidar");
        assert_eq!(names.resolve("/scan").unwrap(), "/scan");
        assert_eq!(names.resolve("~/rate").unwrap(), "/robot/hz");
        assert_eq!(names.resolve("/map").unwrap(), "/robot/map");
    }

    #[test]
    fn invalid_names_are_rejected() {
        for name in ["", "/", "1a", "a b", "a:=b", "ä", "a~b", "~a", "a//b", "a/", "a__b", "a/2"] {
            assert_eq!(Names::new("n", "/", []).unwrap().resolve(name), Err(NameError(name.to_owned())));
        }
        assert!(Names::new("a/b", "/", []).is_err());
        assert!(Names::new("a", "/b//c", []).is_err());
    }

    #[test]
    fn topics_and_types_have_names_in_dds() {
        assert_eq!(dds_topic("/r1/scan"), "rt/r1/scan");
        assert_eq!(dds_type("sensor_msgs/msg/LaserScan"), "sensor_msgs::msg::dds_::LaserScan_");
        assert_eq!(ros_type("sensor_msgs::msg::dds_::LaserScan_").unwrap(), "sensor_msgs/msg/LaserScan");
        assert_eq!(ros_type("LaserScan"), None);
    }
}
