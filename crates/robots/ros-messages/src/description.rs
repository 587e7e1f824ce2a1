//! Descriptions of messages: `.msg` text, and the checksums by which peers compare types.
//!
//! Sources: ROS wiki, "ROS/Technical Overview", "Message serialization and msg MD5 sums"; REP 2011, "Evolving Message
//! Types"; REP 2016, "Type Description Distribution" (RIHS01); `type_description_interfaces/msg/FieldType`.

use sha2::{Digest, Sha256};

use crate::{codec::Version, field::FieldType};

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
