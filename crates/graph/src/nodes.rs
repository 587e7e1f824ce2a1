//! Nodes of a VNF's instances.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::id::NodeId;

/// The nodes of a VNF's instances, in the order in which they are preferred: one, or several different ones. In JSON the
/// one's name, or a list of names.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(try_from = "OneOrSeveral", into = "OneOrSeveral")]
#[schema(as = Nodes, value_type = OneOrSeveral)]
pub struct Nodes(Vec<NodeId>);

/// A node, or several.
#[derive(Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged)]
enum OneOrSeveral {
    One(NodeId),
    Several(Vec<NodeId>),
}

/// Error of nodes that cannot be those of a VNF's instances.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidNodes {
    /// There are too few or too many.
    #[error("a VNF has 1 to {most} instances, and these are {0} nodes", most = Nodes::MOST)]
    Number(usize),
    /// A node has one instance at most.
    #[error("`{0}` is here twice: a node has one instance of a VNF at most")]
    Twice(NodeId),
}

impl Nodes {
    /// The most instances of a VNF.
    pub const MOST: usize = 16;

    /// Several nodes.
    ///
    /// # Errors
    /// [`InvalidNodes`] if there are none, or more than [`Self::MOST`], or a node is there twice.
    pub fn new(nodes: Vec<NodeId>) -> Result<Self, InvalidNodes> {
        if nodes.is_empty() || nodes.len() > Self::MOST {
            return Err(InvalidNodes::Number(nodes.len()));
        }
        let twice = nodes.iter().enumerate().find(|(place, node)| nodes[..*place].contains(node));
        twice.map_or(Ok(()), |(_, node)| Err(InvalidNodes::Twice(node.clone())))?;
        Ok(Self(nodes))
    }

    /// The node that is preferred.
    pub fn first(&self) -> &NodeId {
        &self.0[0]
    }

    /// The node, if there is only one.
    pub fn only(&self) -> Option<&NodeId> {
        if let [node] = &self.0[..] { Some(node) } else { None }
    }

    /// All of them, in order.
    pub fn all(&self) -> &[NodeId] {
        &self.0
    }
}

impl From<NodeId> for Nodes {
    fn from(node: NodeId) -> Self {
        Self(vec![node])
    }
}

impl TryFrom<OneOrSeveral> for Nodes {
    type Error = InvalidNodes;

    fn try_from(nodes: OneOrSeveral) -> Result<Self, InvalidNodes> {
        match nodes {
            OneOrSeveral::One(node) => Ok(node.into()),
            OneOrSeveral::Several(nodes) => Self::new(nodes),
        }
    }
}

impl From<Nodes> for OneOrSeveral {
    fn from(Nodes(mut nodes): Nodes) -> Self {
        if nodes.len() == 1 { Self::One(nodes.remove(0)) } else { Self::Several(nodes) }
    }
}

impl fmt::Display for Nodes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = self.0.iter().map(NodeId::as_str).collect();
        f.pad(&names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Result<Nodes, String> {
        serde_json::from_str(json).map_err(|error: serde_json::Error| error.to_string())
    }

    #[test]
    fn one_node_is_a_name_and_several_are_a_list() {
        for json in [r#""edge""#, r#"["edge","fog"]"#] {
            assert_eq!(serde_json::to_string(&read(json).unwrap()).unwrap(), json);
        }
        let one = read(r#"["edge"]"#).unwrap();
        assert_eq!(
            (serde_json::to_string(&one).unwrap().as_str(), one.to_string().as_str()),
            (r#""edge""#, "edge")
        );
        assert_eq!(read(r#"["fog","edge"]"#).unwrap().to_string(), "fog, edge");
    }

    #[test]
    fn too_many_and_duplicate_nodes_are_rejected() {
        let refused = |json: &str| read(json).unwrap_err();
        assert_eq!(refused("[]"), "a VNF has 1 to 16 instances, and these are 0 nodes");
        let many: Vec<_> = (0..17).map(|n| format!("n{n}")).collect();
        let many = serde_json::to_string(&many).unwrap();
        assert_eq!(refused(&many), "a VNF has 1 to 16 instances, and these are 17 nodes");
        let twice = refused(r#"["a","b","a"]"#);
        assert_eq!(twice, "`a` is here twice: a node has one instance of a VNF at most");
    }
}
