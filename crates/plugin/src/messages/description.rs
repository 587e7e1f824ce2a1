//! What a message is made of, and its type hash, by which ROS 2 peers see whether they mean the same.
//!
//! Sources: REP 2011, "Evolving Message Types"; REP 2016, "Type Description Distribution" (RIHS01);
//! `type_description_interfaces/msg/FieldType`.

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
    ($($kind:ty = $id:literal,)*) => {
        $(impl Field for $kind {
            fn field_type() -> FieldType {
                FieldType::scalar($id)
            }
        })*
    };
}

scalars! { i8 = 2, u8 = 3, i32 = 6, u32 = 7, f32 = 10, f64 = 11, String = 17, }

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
