//! What a topic carries: a message, or one of several messages that mean the same. Robots are driven by `Twist` or by
//! `TwistStamped`, depending on their age, and only their peers tell which.

use cotorra_ros_messages::{DecodeError, Header, Message, Twist, TwistStamped};

use crate::names::{dds_type, ros_type};

/// A type that a topic carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kind {
    /// As ROS calls it.
    pub(crate) name: &'static str,
    /// As DDS calls it.
    pub(crate) dds_name: String,
    /// What peers announce of it.
    pub(crate) hash: String,
}

impl Kind {
    /// Of messages of one type.
    pub fn of<M: Message>() -> Self {
        Self { name: M::ROS2_NAME, dds_name: dds_type(M::ROS2_NAME), hash: M::description().type_hash() }
    }
}

/// What can be published and subscribed to: any [`Message`], and [`Command`].
pub trait Carried: Sized + Send + 'static {
    /// The types as which it travels.
    fn kinds() -> Vec<Kind>;

    /// The message as the type of that number among them.
    fn encode_as(&self, kind: usize, buffer: &mut Vec<u8>);

    /// Reads a message of the type of that number among them.
    ///
    /// # Errors
    /// [`DecodeError`] if it is none.
    fn decode_as(kind: usize, bytes: &[u8]) -> Result<Self, DecodeError>;
}

impl<M: Message + Send + 'static> Carried for M {
    fn kinds() -> Vec<Kind> {
        vec![Kind::of::<M>()]
    }

    fn encode_as(&self, _kind: usize, buffer: &mut Vec<u8>) {
        self.encode_cdr(buffer);
    }

    fn decode_as(_kind: usize, bytes: &[u8]) -> Result<Self, DecodeError> {
        Self::decode_cdr(bytes)
    }
}

/// A velocity to drive at, as `cmd_vel` carries it: [`Twist`] or [`TwistStamped`]. A publisher speaks what its
/// subscribers understand, as soon as they are discovered; a subscriber understands both.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Command {
    /// When and in which frame; a `Twist` has none, and reads as zero.
    pub header: Header,
    /// The velocity.
    pub twist: Twist,
}

impl Carried for Command {
    fn kinds() -> Vec<Kind> {
        vec![Kind::of::<Twist>(), Kind::of::<TwistStamped>()]
    }

    fn encode_as(&self, kind: usize, buffer: &mut Vec<u8>) {
        match kind {
            0 => self.twist.encode_cdr(buffer),
            _ => TwistStamped { header: self.header.clone(), twist: self.twist }.encode_cdr(buffer),
        }
    }

    fn decode_as(kind: usize, bytes: &[u8]) -> Result<Self, DecodeError> {
        if kind == 0 {
            return Ok(Self { header: Header::default(), twist: Twist::decode_cdr(bytes)? });
        }
        let TwistStamped { header, twist } = TwistStamped::decode_cdr(bytes)?;
        Ok(Self { header, twist })
    }
}

/// The ROS name of a type, or DDS's if it is none of ROS.
pub(crate) fn shown(dds_name: &str) -> String {
    ros_type(dds_name).unwrap_or_else(|| dds_name.to_owned())
}

#[cfg(test)]
mod tests {
    use cotorra_ros_messages::Vector3;

    use super::*;

    #[test]
    fn a_command_is_either_type() {
        let twist = Twist { linear: Vector3 { x: 0.5, ..Vector3::default() }, ..Twist::default() };
        let header = Header { frame_id: "base_link".to_owned(), ..Header::default() };
        let command = Command { header, twist };
        for (kind, header) in [(0, Header::default()), (1, command.header.clone())] {
            let mut bytes = Vec::new();
            command.encode_as(kind, &mut bytes);
            let back = Command::decode_as(kind, &bytes).unwrap();
            assert_eq!(back, Command { header, twist });
            assert!(Command::decode_as(1 - kind, &bytes).is_err());
        }
        let names = Command::kinds().into_iter().map(|kind| kind.dds_name);
        let expected = ["Twist", "TwistStamped"].map(|name| format!("geometry_msgs::msg::dds_::{name}_"));
        assert!(names.eq(expected));
    }
}
