//! Names of things in a testbed, one type a kind, so that a link's name is never taken for a node's.

use std::{borrow::Borrow, fmt, sync::Arc};

use serde::{Deserialize, Serialize};

/// Error of a text that cannot be a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` is not a name: {}", rule(*longest, others))]
pub struct InvalidId {
    name: String,
    longest: usize,
    others: &'static str,
}

/// Characters of a rejected text that its error shows.
const SHOWN: usize = 160;
/// A name fits a file name and a DNS label.
const LONGEST: usize = 63;
/// A link's fits the names of its two ends and what joins them.
const LONGEST_LINK: usize = 2 * LONGEST + 1;
/// An agent's fits the common name of a certificate, 64 characters, with a dot and a generation.
const LONGEST_AGENT: usize = 53;

/// Says what a name may be, of this length and with these characters besides letters and digits.
fn rule(longest: usize, others: &str) -> String {
    let mut quoted: Vec<_> = others.chars().map(|c| format!("`{c}`")).collect();
    let last = quoted.pop().unwrap_or_default();
    let others = quoted.join(", ");
    format!("use 1 to {longest} letters, digits, {others} or {last}, beginning with a letter or digit")
}

fn check(name: &str, longest: usize, others: &'static str) -> Result<(), InvalidId> {
    let starts_well = name.chars().next().is_some_and(|c| c.is_ascii_alphanumeric());
    let all_well = name.chars().all(|c| c.is_ascii_alphanumeric() || others.contains(c));
    let well = starts_well && all_well && name.len() <= longest;
    if well { Ok(()) } else { Err(InvalidId { name: name.chars().take(SHOWN).collect(), longest, others }) }
}

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $longest:expr) => {
        id! { $(#[$doc])* $name, $longest, "_-.~" }
    };
    ($(#[$doc:meta])* $name:ident, $longest:expr, $others:expr) => {
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
        #[schema(value_type = String)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(Arc<str>);

        impl $name {
            /// Characters of the longest name.
            pub const LONGEST: usize = $longest;
            /// Characters of names, other than letters and digits.
            pub const OTHERS: &str = $others;

            /// The name, if it can be one.
            ///
            /// # Errors
            /// [`InvalidId`] when it is empty, too long, or holds a character that a file name could not.
            pub fn new(name: &str) -> Result<Self, InvalidId> {
                check(name, Self::LONGEST, Self::OTHERS)?;
                Ok(Self(name.into()))
            }

            /// Says what a name may be.
            pub fn rule() -> String {
                rule(Self::LONGEST, Self::OTHERS)
            }

            /// The name as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Debug::fmt(&self.0, f)
            }
        }

        impl Borrow<str> for $name {
            fn borrow(&self) -> &str {
                &self.0
            }
        }

        impl PartialEq<str> for $name {
            fn eq(&self, other: &str) -> bool {
                &*self.0 == other
            }
        }

        impl PartialEq<&str> for $name {
            fn eq(&self, other: &&str) -> bool {
                &*self.0 == *other
            }
        }

        impl TryFrom<String> for $name {
            type Error = InvalidId;
            fn try_from(name: String) -> Result<Self, InvalidId> {
                Self::new(&name)
            }
        }

        impl From<&$name> for Arc<str> {
            fn from(id: &$name) -> Self {
                id.0.clone()
            }
        }

        impl From<$name> for String {
            fn from(id: $name) -> Self {
                id.0.to_string()
            }
        }

        impl std::str::FromStr for $name {
            type Err = InvalidId;
            fn from_str(name: &str) -> Result<Self, InvalidId> {
                Self::new(name)
            }
        }
    };
}

id! {
    /// An administrative domain.
    DomainId, LONGEST
}
id! {
    /// A node of the hardware graph: a robot, radio unit, switch or server.
    NodeId, LONGEST
}
id! {
    /// An agent: the program that starts VNFs on a real machine. A dot would end the name in its certificate.
    AgentId, LONGEST_AGENT, "_-~"
}
id! {
    /// A link of the hardware graph. A wired one is named in the testbed file (by default `<end>-<end>`);
    /// the wireless one between a robot and a radio unit is `<robot>~<radio unit>`.
    LinkId, LONGEST_LINK
}
id! {
    /// A service: VNFs, the virtual links between them, and the KPIs that they must keep.
    ServiceId, LONGEST
}
id! {
    /// Name of a source of traffic.
    TrafficId, LONGEST
}
id! {
    /// A virtual network function of a service.
    VnfId, LONGEST
}
id! {
    /// A plug-in, as the testbed file names it.
    PluginId, LONGEST
}
id! {
    /// A sensor of a robot.
    SensorId, LONGEST
}
id! {
    /// One of the numbers that a sensor reads.
    ComponentId, LONGEST
}

impl LinkId {
    /// The name that a wired link between two nodes has by default.
    pub fn between(a: &NodeId, b: &NodeId) -> Self {
        Self(format!("{a}-{b}").into())
    }

    /// The name of the wireless link between a robot and a radio unit.
    pub fn wireless(robot: &NodeId, radio_unit: &NodeId) -> Self {
        Self(format!("{robot}~{radio_unit}").into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_agents_have_no_dots_and_fit_a_common_name_with_their_generation() {
        let longest = "a".repeat(AgentId::LONGEST);
        assert_eq!(format!("{longest}.{}", u32::MAX).len(), 64);
        for name in ["edge1", "E-1_a~b", &longest] {
            assert_eq!(AgentId::new(name).unwrap().as_str(), name);
        }
        for name in ["", "edge.1", "-edge", "edge 1", "édge", &(longest.clone() + "a")] {
            let refused = AgentId::new(name).unwrap_err().to_string();
            assert!(refused.contains("1 to 53 letters, digits, `_`, `-` or `~`"), "{refused}");
        }
        let refused = NodeId::new("edge 1").unwrap_err().to_string();
        assert!(refused.contains("1 to 63 letters, digits, `_`, `-`, `.` or `~`"), "{refused}");
    }
}
