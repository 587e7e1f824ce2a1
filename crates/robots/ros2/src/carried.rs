//! The content of a topic: a message, or one of several messages with the same meaning. Robots take `Twist` or
//! `TwistStamped`, depending on their age; discovery shows which.

use cotorra_ros_messages::{DecodeError, Header, Message, Twist, TwistStamped};

use crate::names::{dds_type, ros_type};

/// A message type on a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kind {
    /// Its name in ROS.
    pub(crate) name: &'static str,
    /// Its name in DDS.
    pub(crate) dds_name: String,
    /// The type hash that peers announce.
    pub(crate) hash: String,
}

impl Kind {
    /// The type `M`.
    pub fn of<M: Message>() -> Self {
        Self { name: M::ROS2_NAME, dds_name: dds_type(M::ROS2_NAME), hash: M::description().type_hash() }
    }
}

/// The content of a topic: any [`Message`], and [`Command`].
pub trait Carried: Sized + Send + 'static {
    /// Returns the message types that it can be sent as.
    fn kinds() -> Vec<Kind>;

    /// Appends the content as the message type `kind`, an index into [`Self::kinds`].
    fn encode_as(&self, kind: usize, buffer: &mut Vec<u8>);

    /// Reads a message of the type `kind`, an index into [`Self::kinds`].
    ///
    /// # Errors
    /// [`DecodeError`] if `bytes` are not one message of that type.
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

/// A velocity command on `cmd_vel`: [`Twist`] or [`TwistStamped`]. A publisher sends the types of the subscribers that it
/// discovered; a subscriber reads both.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Command {
    /// Time and frame of the command; default if it came as a `Twist`.
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

/// Returns the ROS name of a type, or the DDS name if ROS has none.
pub(crate) fn shown(dds_name: &str) -> String {
    ros_type(dds_name).unwrap_or_else(|| dds_name.to_owned())
}

#[cfg(test)]
mod tests {
    use cotorra_ros_messages::Vector3;

    use super::*;

    #[test]
    fn commands_are_encoded_as_either_type() {
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
