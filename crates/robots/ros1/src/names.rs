//! Names of the ROS graph: resolving a node's names to global ones, and remapping them.
//!
//! Source: ROS wiki, "Names" and "Remapping Arguments".

use std::collections::BTreeMap;

/// A name that the ROS graph does not allow.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not a name: names begin with a letter, `/` or `~`, and have letters, digits, `_` and `/` after that"
)]
pub struct NameError(pub String);

/// The names of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    /// The node's global name.
    node: String,
    /// Ends with `/`.
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
        node: &str,
        namespace: &str,
        remappings: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, NameError> {
        if node.contains(['/', '~']) {
            return Err(NameError(node.to_owned()));
        }
        let namespace = joined("/", checked(namespace)?) + "/";
        let namespace = if namespace == "//" { "/".to_owned() } else { namespace };
        let mut names =
            Self { node: joined(&namespace, checked(node)?), namespace, remapped: BTreeMap::new() };
        for (from, to) in remappings {
            let (from, to) = (names.global(from)?, names.global(to)?);
            names.remapped.insert(from, to);
        }
        Ok(names)
    }

    /// The node's global name.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// Resolves a name to its global one: `/a` is global, `a` is in the node's namespace, `~a` is private to the node.
    /// Then applies remappings.
    ///
    /// # Errors
    /// [`NameError`] if `name` is invalid.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        let global = self.global(name)?;
        Ok(self.remapped.get(&global).cloned().unwrap_or(global))
    }

    fn global(&self, name: &str) -> Result<String, NameError> {
        let name = checked(name)?;
        Ok(match name.strip_prefix('~') {
            Some(private) => joined(&self.node, private.trim_start_matches('/')),
            None if name.starts_with('/') => joined("/", name),
            None => joined(&self.namespace, name),
        })
    }
}

/// Removes doubled slashes, and one at the end.
fn joined(base: &str, name: &str) -> String {
    let parts = base.split('/').chain(name.split('/')).filter(|part| !part.is_empty());
    let joined: String = parts.flat_map(|part| ["/", part]).collect();
    if joined.is_empty() { "/".to_owned() } else { joined }
}

fn checked(name: &str) -> Result<&str, NameError> {
    let mut rest = name.chars();
    let begins = rest.next().is_none_or(|c| c.is_ascii_alphabetic() || c == '/' || c == '~');
    let goes_on = rest.all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '/');
    if begins && goes_on { Ok(name) } else { Err(NameError(name.to_owned())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_resolve_as_specified() {
        // Source: the table of the wiki's "Names", 1.2.
        for (node, namespace, name, expected) in [
            ("node1", "/", "bar", "/bar"),
            ("node1", "/", "/bar", "/bar"),
            ("node1", "/", "~bar", "/node1/bar"),
            ("node2", "/wg", "bar", "/wg/bar"),
            ("node2", "/wg", "/bar", "/bar"),
            ("node2", "/wg", "~bar", "/wg/node2/bar"),
            ("node3", "wg/", "foo/bar", "/wg/foo/bar"),
            ("node3", "wg", "/foo/bar", "/foo/bar"),
            ("node3", "/wg", "~foo/bar", "/wg/node3/foo/bar"),
        ] {
            assert_eq!(Names::new(node, namespace, []).unwrap().resolve(name).unwrap(), expected);
        }
    }

    #[test]
    fn remapping_applies_to_resolved_names() {
        let names =
            Names::new("n", "/robot", [("scan", "/lidar"), ("~rate", "hz"), ("/map", "map")]).unwrap();
        assert_eq!(names.node(), "/robot/n");
        assert_eq!(names.resolve("scan").unwrap(), "/lidar");
        assert_eq!(names.resolve("/robot/scan").unwrap(), "/lidar");
        assert_eq!(names.resolve("/scan").unwrap(), "/scan");
        assert_eq!(names.resolve("~rate").unwrap(), "/robot/hz");
        assert_eq!(names.resolve("/map").unwrap(), "/robot/map");
    }

    #[test]
    fn invalid_names_are_rejected() {
        for name in ["1a", "a b", "a:=b", "ä", "a~b", "_a"] {
            assert_eq!(Names::new("n", "/", []).unwrap().resolve(name), Err(NameError(name.to_owned())));
        }
        assert!(Names::new("a/b", "/", []).is_err());
    }
}
