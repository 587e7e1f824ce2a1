//! What a message is made of, as `.msg` text, and its MD5 sum, by which ROS 1 peers see whether they mean the same.
//!
//! Source: ROS wiki, "ROS/Technical Overview", "Message serialization and msg MD5 sums".

use crate::wire::{DecodeError, Field, FieldType, Reader};

/// A ROS 1 message; declared by [`message!`](crate::message!).
pub trait Message: Field + Send + 'static {
    /// The type's ROS name, such as `geometry_msgs/Twist`.
    const TYPE_NAME: &'static str;

    /// What it is made of.
    fn definition() -> Definition;

    /// Reads exactly one message.
    ///
    /// # Errors
    /// [`DecodeError`] if `bytes` are not that.
    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(bytes);
        let message = Self::decode(&mut reader)?;
        match reader.left() {
            0 => Ok(message),
            count => Err(DecodeError::Trailing { count }),
        }
    }
}

/// A ROS 1 service: a request that gets one response.
pub trait Service: 'static {
    /// The type's ROS name, such as `std_srvs/SetBool`.
    const TYPE_NAME: &'static str;
    /// What is asked.
    type Request: Message;
    /// What is answered.
    type Response: Message;

    /// The MD5 sum of the service, in hexadecimal.
    fn md5sum() -> String {
        let (request, response) = (Self::Request::definition(), Self::Response::definition());
        format!("{:x}", md5::compute(request.md5_text() + &response.md5_text()))
    }
}

/// What a message is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Definition {
    /// The type's ROS name.
    pub type_name: &'static str,
    /// Constants, in their order.
    pub constants: Vec<Constant>,
    /// Fields, in their order, with their names.
    pub fields: Vec<(&'static str, FieldType)>,
}

/// A number with a name that a message declares.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constant {
    /// Its type.
    pub kind: FieldType,
    /// Its name.
    pub name: &'static str,
    /// Its value, as written.
    pub value: &'static str,
}

impl Definition {
    /// The MD5 sum, in hexadecimal.
    pub fn md5sum(&self) -> String {
        format!("{:x}", md5::compute(self.md5_text()))
    }

    /// `.msg` text where messages stand as their MD5 sums, without comments, constants first.
    fn md5_text(&self) -> String {
        let field = |(name, kind): &(&str, FieldType)| match &kind.message {
            Some(message) => format!("{} {name}", message.md5sum()),
            None => format!("{} {name}", kind.name),
        };
        self.constants().chain(self.fields.iter().map(field)).collect::<Vec<_>>().join("\n")
    }

    fn constants(&self) -> impl Iterator<Item = String> {
        self.constants.iter().map(|Constant { kind, name, value }| format!("{} {name}={value}", kind.name))
    }

    /// `.msg` text of this message alone.
    fn own_text(&self) -> String {
        let fields = self.fields.iter().map(|(name, kind)| format!("{} {name}", kind.name));
        self.constants().chain(fields).map(|line| line + "\n").collect()
    }

    /// `.msg` text of this message and of all that it is made of, in the form of a connection header's
    /// `message_definition`, from which recorders read what they record.
    pub fn text(&self) -> String {
        let mut parts = Vec::new();
        self.collect_parts(&mut parts);
        let separator = "=".repeat(80);
        let parts =
            parts.iter().map(|part| format!("{separator}\nMSG: {}\n{}", part.type_name, part.own_text()));
        std::iter::once(self.own_text()).chain(parts).collect::<Vec<_>>().join("\n")
    }

    /// All messages below this one, each once.
    fn collect_parts<'a>(&'a self, parts: &mut Vec<&'a Definition>) {
        for part in self.fields.iter().filter_map(|(_, kind)| kind.message.as_ref()) {
            if !parts.iter().any(|known| known.type_name == part.type_name) {
                parts.push(part);
                part.collect_parts(parts);
            }
        }
    }
}

/// Declares a ROS 1 message: a struct with public fields whose types are [`Field`]s, in the order of the `.msg` file,
/// after its constants. Encoding, `.msg` text and MD5 sum follow from that.
///
/// ```
/// cotorra_ros1::message! {
///     /// The state of a battery.
///     pub struct Battery = "my_robot/Battery"
///     const {
///         /// It is being charged.
///         CHARGING: u8 = 1,
///     }
///     {
///         /// V.
///         voltage: f32,
///         /// One of the constants.
///         state: u8,
///     }
/// }
/// use cotorra_ros1::Message;
/// assert_eq!(Battery::definition().text(), "uint8 CHARGING=1\nfloat32 voltage\nuint8 state\n");
/// ```
#[macro_export]
macro_rules! message {
    (
        $(#[$doc:meta])*
        $visibility:vis struct $name:ident = $ros:literal
        $(const { $($(#[$constant_doc:meta])* $constant:ident: $constant_kind:ty = $value:literal,)* })?
        {
            $($(#[$field_doc:meta])* $field:ident: $kind:ty,)*
        }
    ) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        $visibility struct $name { $($(#[$field_doc])* pub $field: $kind,)* }

        impl $name {
            $($($(#[$constant_doc])* pub const $constant: $constant_kind = $value;)*)?
        }

        impl Default for $name {
            fn default() -> Self {
                <Self as $crate::Field>::zero()
            }
        }

        impl $crate::Message for $name {
            const TYPE_NAME: &'static str = $ros;

            fn definition() -> $crate::Definition {
                $crate::Definition {
                    type_name: $ros,
                    constants: vec![$($($crate::Constant {
                        kind: <$constant_kind as $crate::Field>::field_type(),
                        name: stringify!($constant),
                        value: stringify!($value),
                    },)*)?],
                    fields: vec![$((
                        stringify!($field).trim_start_matches("r#"),
                        <$kind as $crate::Field>::field_type(),
                    ),)*],
                }
            }
        }

        impl $crate::Field for $name {
            const MIN_LEN: usize = 0 $(+ <$kind as $crate::Field>::MIN_LEN)*;

            fn zero() -> Self {
                Self { $($field: <$kind as $crate::Field>::zero(),)* }
            }

            fn field_type() -> $crate::FieldType {
                let definition = <Self as $crate::Message>::definition();
                $crate::FieldType { name: definition.type_name.into(), message: Some(definition) }
            }

            fn encode(&self, _buffer: &mut Vec<u8>) {
                $($crate::Field::encode(&self.$field, _buffer);)*
            }

            fn decode(_reader: &mut $crate::Reader<'_>) -> Result<Self, $crate::DecodeError> {
                Ok(Self { $($field: $crate::Field::decode(_reader)?,)* })
            }
        }
    };
}
