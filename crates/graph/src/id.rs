//! Names of things in a testbed, one type a kind, so that a link's name is never taken for a node's.

use std::{borrow::Borrow, fmt, sync::Arc};

use serde::{Deserialize, Serialize};

/// Error of a text that cannot be a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{name}` is not a name: use 1 to {longest} letters, digits, {marks}, beginning with a letter or digit"
)]
pub struct InvalidId {
    name: String,
    longest: usize,
    marks: &'static str,
}

/// A name fits a file name and a DNS label.
const LONGEST: usize = 63;
/// A link's fits the names of its two ends and what joins them.
const LONGEST_LINK: usize = 2 * LONGEST + 1;
/// An agent's fits the common name of a certificate, 64 characters, with a dot and a generation.
const LONGEST_AGENT: usize = 53;

/// Characters of names besides letters and digits, as an error lists them.
const MARKS: &str = "`_`, `-`, `.` or `~`";
/// A dot ends an agent's name in a certificate.
const MARKS_WITHOUT_DOT: &str = "`_`, `-` or `~`";

fn check(name: &str, longest: usize, marks: &'static str) -> Result<(), InvalidId> {
    let is_mark = |c: char| "_-.~".contains(c) && marks.contains(c);
    let starts_well = name.chars().next().is_some_and(|c| c.is_ascii_alphanumeric());
    let all_well = name.chars().all(|c| c.is_ascii_alphanumeric() || is_mark(c));
    let well = starts_well && all_well && name.len() <= longest;
    if well { Ok(()) } else { Err(InvalidId { name: name.to_owned(), longest, marks }) }
}

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $longest:expr, $marks:expr) => {
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
        #[cfg_attr(feature = "openapi", schema(value_type = String))]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(Arc<str>);

        impl $name {
            /// Characters of the longest name.
            pub const LONGEST: usize = $longest;

            /// The name, if it can be one.
            ///
            /// # Errors
            /// [`InvalidId`] when it is empty, too long, or holds a character that a file name could not.
            pub fn new(name: &str) -> Result<Self, InvalidId> {
                check(name, Self::LONGEST, $marks)?;
                Ok(Self(name.into()))
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
    DomainId, LONGEST, MARKS
}
id! {
    /// A node of the hardware graph: a robot, radio unit, switch or server.
    NodeId, LONGEST, MARKS
}
id! {
    /// A link of the hardware graph. A wired one is named in the testbed file (by default `<end>-<end>`);
    /// the wireless one between a robot and a radio unit is `<robot>~<radio unit>`.
    LinkId, LONGEST_LINK, MARKS
}
id! {
    /// A service: VNFs, the virtual links between them, and the KPIs that they must keep.
    ServiceId, LONGEST, MARKS
}
id! {
    /// A virtual network function of a service.
    VnfId, LONGEST, MARKS
}
id! {
    /// A plug-in, as the testbed file names it.
    PluginId, LONGEST, MARKS
}
id! {
    /// A sensor of a robot.
    SensorId, LONGEST, MARKS
}
id! {
    /// One of the numbers that a sensor reads.
    ComponentId, LONGEST, MARKS
}
id! {
    /// An agent: the program on a real machine that connects it to a testbed. Its name has no dot.
    AgentId, LONGEST_AGENT, MARKS_WITHOUT_DOT
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
    fn names_have_a_first_letter_or_digit_marks_and_a_length() {
        for name in ["a", "7", "robot-2", "lan.cloud_1~x", &"n".repeat(63)] {
            assert_eq!(NodeId::new(name).unwrap().as_str(), name);
        }
        for name in ["", "-a", ".a", "a b", "é", "a/b", "a`", "a,b", &"n".repeat(64)] {
            assert!(NodeId::new(name).is_err(), "{name}");
        }
        assert!(LinkId::new(&"n".repeat(127)).is_ok() && LinkId::new(&"n".repeat(128)).is_err());
    }

    #[test]
    fn agents_have_no_dot_and_fit_a_common_name_with_their_generation() {
        let longest = "a".repeat(AgentId::LONGEST);
        assert_eq!(format!("{}.{}", AgentId::new(&longest).unwrap(), u32::MAX).len(), 64);
        assert!(AgentId::new("robot-2_a~b").is_ok() && AgentId::new(&(longest + "a")).is_err());
        let error = AgentId::new("robot.2").unwrap_err().to_string();
        let expected = "`robot.2` is not a name: use 1 to 53 letters, digits, `_`, `-` or `~`, beginning with a letter or digit";
        assert_eq!(error, expected);
    }
}
