//! The attributes of the data types that can be queried. A service declares all attributes of the standard: filters and
//! selectors can also name those that it omits.

use Kind::Structure;

/// An attribute of a data type.
#[derive(Debug)]
pub struct Attribute {
    /// Its name.
    pub name: &'static str,
    /// Type of its value.
    pub kind: Kind,
    /// Whether it is an array.
    pub many: bool,
    /// Whether its minimum cardinality is 1.
    pub required: bool,
}

/// Type of an attribute's value.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    Text,
    /// A MAC address: a string compared without regard to case.
    Address,
    Number,
    Flag,
    /// A structure with these attributes.
    Structure(&'static [Attribute]),
}

impl Attribute {
    /// Whether it is a structure or an array, which ETSI GS MEC 009 calls complex.
    pub(crate) fn is_complex(&self) -> bool {
        self.many || matches!(self.kind, Structure(_))
    }
}

pub(crate) fn find(attributes: &'static [Attribute], name: &str) -> Option<&'static Attribute> {
    attributes.iter().find(|attribute| attribute.name == name)
}

/// Declares the attributes of data types: `name: kind` for one, `name: [kind]` for an array, `(TYPE)` for a structure,
/// `!` before required ones, which come first.
#[macro_export]
macro_rules! attributes {
    (@kind $kind:ident) => { $crate::Kind::$kind };
    (@kind ($kind:ident)) => { $crate::Kind::Structure($kind) };
    (@one $required:literal $name:literal [$kind:tt]) => {
        $crate::Attribute { name: $name, kind: $crate::attributes!(@kind $kind), many: true, required: $required }
    };
    (@one $required:literal $name:literal $kind:tt) => {
        $crate::Attribute { name: $name, kind: $crate::attributes!(@kind $kind), many: false, required: $required }
    };
    ($( $visibility:vis $data_type:ident { $( ! $must:literal: $must_kind:tt, )* $( $may:literal: $may_kind:tt, )* } )*) => {
        $( $visibility static $data_type: &[$crate::Attribute] = &[
            $( $crate::attributes!(@one true $must $must_kind), )*
            $( $crate::attributes!(@one false $may $may_kind), )*
        ]; )*
    };
}
