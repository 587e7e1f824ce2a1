//! Descriptions of messages: `.msg` text, and the checksums by which peers compare types.
//!
//! Sources: ROS wiki, "ROS/Technical Overview", "Message serialization and msg MD5 sums"; REP 2011, "Evolving Message
//! Types"; REP 2016, "Type Description Distribution" (RIHS01); `type_description_interfaces/msg/FieldType`.

use sha2::{Digest, Sha256};

use crate::codec::Version;

/// The name, constants and fields of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// The package, such as `geometry_msgs`.
    pub package: &'static str,
    /// The name in the package, such as `Twist`.
    pub name: &'static str,
    /// Constants, in order.
    pub constants: Vec<Constant>,
    /// Fields, in order.
    pub fields: Vec<FieldDescription>,
}

/// A constant of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constant {
    /// Its type.
    pub kind: FieldType,
    /// Its name.
    pub name: &'static str,
    /// Its value, as written.
    pub value: &'static str,
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldDescription {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub kind: FieldType,
    /// The only version that has it; `None` for both.
    pub only: Option<Version>,
}

/// The type of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldType {
    element: Element,
    arity: Arity,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Element {
    /// A built-in type, with its number in ROS 2's `FieldType.msg`.
    Builtin {
        name: &'static str,
        id: u8,
    },
    Message(Description),
    /// A built-in type of ROS 1 that is a message in ROS 2.
    Time {
        ros1: &'static str,
        ros2: Description,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arity {
    One,
    Array(usize),
    Sequence,
}

impl FieldType {
    pub(crate) fn builtin(name: &'static str, id: u8) -> Self {
        Self { element: Element::Builtin { name, id }, arity: Arity::One }
    }

    /// Describes a message as a field.
    pub fn message(description: Description) -> Self {
        Self { element: Element::Message(description), arity: Arity::One }
    }

    /// Describes a built-in type of ROS 1 that is a message in ROS 2.
    pub(crate) fn time(ros1: &'static str, ros2: Description) -> Self {
        Self { element: Element::Time { ros1, ros2 }, arity: Arity::One }
    }

    /// Describes an array of variable length with elements of this type.
    pub(crate) fn sequence(self) -> Self {
        Self { arity: Arity::Sequence, ..self }
    }

    /// Describes an array of fixed length with elements of this type.
    pub(crate) fn array(self, length: usize) -> Self {
        Self { arity: Arity::Array(length), ..self }
    }

    /// The message that the field is, or has as elements.
    pub(crate) fn description(&self, version: Version) -> Option<&Description> {
        match (&self.element, version) {
            (Element::Message(description), _) | (Element::Time { ros2: description, .. }, Version::Ros2) => {
                Some(description)
            }
            (Element::Builtin { .. }, _) | (Element::Time { .. }, Version::Ros1) => None,
        }
    }

    /// The type as a `.msg` file names it, such as `geometry_msgs/Point[]`.
    pub(crate) fn text(&self, version: Version) -> String {
        let name = match (&self.element, version) {
            (Element::Builtin { name, .. }, _) | (Element::Time { ros1: name, .. }, Version::Ros1) => {
                (*name).to_owned()
            }
            (Element::Message(description) | Element::Time { ros2: description, .. }, _) => {
                description.short_name()
            }
        };
        match self.arity {
            Arity::One => name,
            Arity::Array(capacity) => format!("{name}[{capacity}]"),
            Arity::Sequence => format!("{name}[]"),
        }
    }

    /// The number in ROS 2's `FieldType.msg`, and the capacity of an array or 0.
    pub(crate) fn id_and_capacity(&self) -> (u8, usize) {
        let id = match self.element {
            Element::Builtin { id, .. } => id,
            Element::Message(_) | Element::Time { .. } => 1,
        };
        match self.arity {
            Arity::One => (id, 0),
            Arity::Array(capacity) => (id + 48, capacity),
            Arity::Sequence => (id + 144, 0),
        }
    }
}

impl Description {
    /// The MD5 sum by which ROS 1 peers compare types, in hexadecimal.
    pub fn md5sum(&self) -> String {
        format!("{:x}", md5::compute(self.md5_text()))
    }

    /// `.msg` text in which the MD5 sums of messages stand for their names, without comments and with constants first.
    pub(crate) fn md5_text(&self) -> String {
        let field = |FieldDescription { name, kind, .. }: &FieldDescription| {
            let message = kind.description(Version::Ros1);
            format!("{} {name}", message.map_or_else(|| kind.text(Version::Ros1), Self::md5sum))
        };
        self.constants().chain(self.fields(Version::Ros1).map(field)).collect::<Vec<_>>().join("\n")
    }

    /// `.msg` text of this message and of all in it, in the form of a ROS 1 connection header's `message_definition`.
    pub fn ros1_text(&self) -> String {
        let own =
            self.constants().map(|line| line + "\n").collect::<String>() + &self.own_text(Version::Ros1);
        let parts = self.parts(Version::Ros1).into_iter().map(|part| {
            let constants = part.constants().map(|line| line + "\n").collect::<String>();
            format!("\n{}{constants}{}", part.separator(), part.own_text(Version::Ros1))
        });
        own + &parts.collect::<String>()
    }

    /// `.msg` text of this message and of all in it, as `ros2 bag` puts it into a recording (MCAP's encoding `ros2msg`).
    /// Constants are left out.
    pub fn ros2_text(&self) -> String {
        let parts = self.parts(Version::Ros2).into_iter();
        let parts = parts.map(|part| part.separator() + &part.own_text(Version::Ros2));
        self.own_text(Version::Ros2) + &parts.collect::<String>()
    }

    /// The type hash by which ROS 2 peers compare types: `RIHS01_` and a SHA-256 in hexadecimal.
    pub fn type_hash(&self) -> String {
        let mut parts = self.parts(Version::Ros2);
        parts.sort_by_key(|part| part.ros2_name());
        let parts: Vec<_> = parts.into_iter().map(Self::own_json).collect();
        // Every space counts.
        let json = format!(
            r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
            self.own_json(),
            parts.join(", ")
        );
        Sha256::digest(json).iter().fold("RIHS01_".to_owned(), |hash, byte| hash + &format!("{byte:02x}"))
    }

    /// The name in `.msg` text and in ROS 1, such as `geometry_msgs/Twist`.
    pub(crate) fn short_name(&self) -> String {
        format!("{}/{}", self.package, self.name)
    }

    fn ros2_name(&self) -> String {
        format!("{}/msg/{}", self.package, self.name)
    }

    fn fields(&self, version: Version) -> impl Iterator<Item = &FieldDescription> {
        self.fields.iter().filter(move |field| version.has(field.only))
    }

    fn constants(&self) -> impl Iterator<Item = String> {
        let line = |Constant { kind, name, value }: &Constant| {
            format!("{} {name}={value}", kind.text(Version::Ros1))
        };
        self.constants.iter().map(line)
    }

    /// The fields as `.msg` text.
    fn own_text(&self, version: Version) -> String {
        let line = |field: &FieldDescription| format!("{} {}\n", field.kind.text(version), field.name);
        self.fields(version).map(line).collect()
    }

    /// The lines before the text of a message that another one has.
    fn separator(&self) -> String {
        format!("{}\nMSG: {}\n", "=".repeat(80), self.short_name())
    }

    fn own_json(&self) -> String {
        let json = |name, id, capacity, nested| {
            let kind = format!(
                r#"{{"type_id": {id}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}"#
            );
            format!(r#"{{"name": "{name}", "type": {kind}}}"#)
        };
        let field = |FieldDescription { name, kind, .. }: &FieldDescription| {
            let nested = kind.description(Version::Ros2).map(Self::ros2_name).unwrap_or_default();
            let (id, capacity) = kind.id_and_capacity();
            json(*name, id, capacity, nested)
        };
        let mut fields: Vec<_> = self.fields(Version::Ros2).map(field).collect();
        if fields.is_empty() {
            fields.push(json("structure_needs_at_least_one_member", 3, 0, String::new()));
        }
        format!(r#"{{"type_name": "{}", "fields": [{}]}}"#, self.ros2_name(), fields.join(", "))
    }

    /// All messages below this one, each once.
    fn parts(&self, version: Version) -> Vec<&Self> {
        let mut parts = Vec::new();
        self.collect_parts(version, &mut parts);
        parts
    }

    fn collect_parts<'a>(&'a self, version: Version, parts: &mut Vec<&'a Self>) {
        for part in self.fields(version).filter_map(|field| field.kind.description(version)) {
            if !parts.iter().any(|known| (known.package, known.name) == (part.package, part.name)) {
                parts.push(part);
                part.collect_parts(version, parts);
            }
        }
    }
}
