//! What a message is made of, and its type hash, by which ROS 2 peers see whether they mean the same.
//!
//! Sources: REP 2011, "Evolving Message Types"; REP 2016, "Type Description Distribution" (RIHS01);
//! `type_description_interfaces/msg/FieldType`.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// What a message is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// The type's ROS name, such as `geometry_msgs/msg/Twist`.
    pub type_name: &'static str,
    /// Fields, in their order, with their names.
    pub fields: Vec<(&'static str, FieldType)>,
}

/// The type of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldType {
    /// Number in `FieldType.msg`.
    id: u8,
    /// How many elements an array has; else 0.
    capacity: usize,
    /// What it is made of, if it is a message or has some.
    message: Option<Description>,
}

/// What can be a field of a message.
pub trait Field {
    /// Its type.
    fn field_type() -> FieldType;
}

impl FieldType {
    const MESSAGE: u8 = 1;
    /// What is added to an element's number.
    const ARRAY: u8 = 48;
    const SEQUENCE: u8 = 144;

    const fn scalar(id: u8) -> Self {
        Self { id, capacity: 0, message: None }
    }

    /// As in a `.msg` file, such as `geometry_msgs/Point[]`.
    fn text(&self) -> String {
        let (id, brackets) = match self.id {
            id @ Self::SEQUENCE.. => (id - Self::SEQUENCE, "[]".to_owned()),
            id @ Self::ARRAY.. => (id - Self::ARRAY, format!("[{}]", self.capacity)),
            id => (id, String::new()),
        };
        let scalar = SCALARS.iter().find(|(known, _)| *known == id).map(|(_, name)| *name);
        let name =
            self.message.as_ref().map(|message| short(message.type_name)).or(scalar.map(str::to_owned));
        name.expect("a field is a message or a scalar") + &brackets
    }

    /// A message.
    pub fn message(description: Description) -> Self {
        Self { id: Self::MESSAGE, capacity: 0, message: Some(description) }
    }

    /// So many of it.
    pub fn array(self, capacity: usize) -> Self {
        Self { id: self.id + Self::ARRAY, capacity, ..self }
    }

    /// Any number of it.
    pub fn sequence(self) -> Self {
        Self { id: self.id + Self::SEQUENCE, ..self }
    }
}

macro_rules! scalars {
    ($($kind:ty = $id:literal $name:literal,)*) => {
        /// Numbers in `FieldType.msg`, and names in `.msg` files.
        const SCALARS: &[(u8, &str)] = &[$(($id, $name),)*];

        $(impl Field for $kind {
            fn field_type() -> FieldType {
                FieldType::scalar($id)
            }
        })*
    };
}

scalars! {
    i8 = 2 "int8",
    u8 = 3 "uint8",
    i32 = 6 "int32",
    u32 = 7 "uint32",
    u64 = 9 "uint64",
    f32 = 10 "float32",
    f64 = 11 "float64",
    bool = 15 "bool",
    Byte = 16 "byte",
    String = 17 "string",
}

/// ROS's `byte`, which is a type of its own beside `uint8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Byte(pub u8);

impl<T: Field> Field for Vec<T> {
    fn field_type() -> FieldType {
        T::field_type().sequence()
    }
}

impl<T: Field, const N: usize> Field for [T; N] {
    fn field_type() -> FieldType {
        T::field_type().array(N)
    }
}

impl Description {
    /// The type hash, as peers announce it: `RIHS01_` and a SHA-256 in hexadecimal.
    pub fn hash(&self) -> String {
        let mut parts = Vec::new();
        self.collect_parts(&mut parts);
        parts.sort_by_key(|part| part.type_name);
        let parts: Vec<_> = parts.into_iter().map(Self::own_json).collect();
        // Every space counts.
        let json = format!(
            r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
            self.own_json(),
            parts.join(", ")
        );
        Sha256::digest(json).iter().fold("RIHS01_".to_owned(), |hash, byte| hash + &format!("{byte:02x}"))
    }

    /// The `.msg` text of the type, and behind it those of all types in it, as `ros2 bag` puts them into a recording
    /// (MCAP's encoding `ros2msg`): each after a line of 80 `=` and one that names it.
    pub fn definition(&self) -> String {
        let mut parts = Vec::new();
        self.collect_parts(&mut parts);
        let named = |part: &&Self| {
            format!("{}\nMSG: {}\n{}", "=".repeat(80), short(part.type_name), part.own_definition())
        };
        self.own_definition() + &parts.iter().map(named).collect::<String>()
    }

    fn own_definition(&self) -> String {
        self.fields.iter().map(|(name, kind)| format!("{} {name}\n", kind.text())).collect()
    }

    fn own_json(&self) -> String {
        let field = |(name, kind): &(&str, FieldType)| {
            let FieldType { id, capacity, message } = kind;
            let nested = message.as_ref().map_or("", |message| message.type_name);
            let kind = format!(
                r#"{{"type_id": {id}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}"#
            );
            format!(r#"{{"name": "{name}", "type": {kind}}}"#)
        };
        let fields: Vec<_> = self.fields.iter().map(field).collect();
        format!(r#"{{"type_name": "{}", "fields": [{}]}}"#, self.type_name, fields.join(", "))
    }

    /// All messages below this one, each once.
    fn collect_parts<'a>(&'a self, parts: &mut Vec<&'a Description>) {
        for part in self.fields.iter().filter_map(|(_, kind)| kind.message.as_ref()) {
            if !parts.iter().any(|known| known.type_name == part.type_name) {
                parts.push(part);
                part.collect_parts(parts);
            }
        }
    }
}

/// `geometry_msgs/msg/Point` as `.msg` files call it: `geometry_msgs/Point`.
fn short(type_name: &str) -> String {
    type_name.replace("/msg/", "/")
}
