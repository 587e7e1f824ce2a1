//! The services' datagrams: a robot's position packets and the navigation packets that answer them; and its scans, and
//! the poses that answer these ([`ScanPacket`], [`PosePacket`]); and the images of its cameras ([`ImagePacket`]).
//!
//! Everything that a navigation VNF must know to answer travels in the position packet, so that an instance on
//! another server can take over with the next one. Both are a header of [`HEADER_LEN`] bytes, little endian like the
//! CDR behind it, then the robot's name (position packets only), what is said of a goal (only where there is one), then
//! one ROS message in CDR: a pose in the one, a twist in the other. The pose comes without stamp, which is in the header,
//! and without covariance, which navigation does not need, and which would be most of the packet. Its frame is the map's.
//!
//! | bytes | field |
//! |---|---|
//! | 0..4 | magic, `ctra` |
//! | 4 | version, 3 |
//! | 5 | kind: 1 position, 2 navigation, 3 scan, 4 pose, 5 image |
//! | 6 | length of the robot's name; 0 in answers |
//! | 7 | 0 on the walk, 1 on the way to a goal; in answers also 2 at the goal, 3 no way leads there, and 128 more if the robot needs a federation |
//! | 8..12 | sequence number |
//! | 12..16 | next waypoint |
//! | 16..24 | time of emission, ns since the run began |
//! | 24..32 | nonce: an answer has that of the packet that it answers |
//!
//! Of a goal, a position packet has x, y and z as 64-bit floats in metres. An answer on the way to it has the metres that
//! are left, as one; an answer that no way leads there has why, in UTF-8, and the length of that in byte 6.

mod image;
mod localization;

use cotorra_graph::{NodeId, Position, Testbed, Timestamp, VnfId};
use cotorra_ros_messages::{DecodeError, Message, Pose, Twist};

pub use image::{FRAGMENT, ImagePacket, LARGEST_IMAGE};
pub use localization::{MAX_BEAMS, PosePacket, ScanPacket};

/// The UDP port of a testbed's first VNF.
const FIRST_PORT: u16 = 7711;
/// First port that the system assigns by itself.
const END_OF_PORTS: u16 = 32_768;
/// Bytes of the header.
pub const HEADER_LEN: usize = 32;
/// Offset of the nonce in the header.
pub const NONCE_AT: usize = 24;

const MAGIC: [u8; 4] = *b"ctra";
const VERSION: u8 = 3;
/// The place in the header of the length of the text behind it …
const TEXT_LEN_AT: usize = 6;
/// … and of what is said of a goal.
const GOAL_AT: usize = 7;
/// The bit of that byte by which a brain requests a federation.
const FEDERATION: u8 = 128;

/// The UDP port where a bundled VNF of a testbed listens, and where others receive images, wherever it runs: each VNF has one of
/// its own, in the order of the file, so that one server carries the VNFs of many robots. They begin anew after 25,057 VNFs. `None` for one that the testbed does not have.
pub fn port(testbed: &Testbed, vnf: &VnfId) -> Option<u16> {
    let mut all = testbed.services.iter().flat_map(|service| &service.vnfs);
    let place = all.position(|other| other.id == *vnf)?;
    Some(FIRST_PORT + (place % usize::from(END_OF_PORTS - FIRST_PORT)) as u16)
}

/// Error of a datagram that is not a packet of the service.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// Fewer bytes than the header and the robot's name have.
    #[error("{0} bytes are too few for a packet of the service")]
    Short(usize),
    /// Some other program's datagram.
    #[error("the datagram does not begin with `ctra`")]
    Magic,
    /// Made by another version of cotorra.
    #[error("the packet has version {0}, and this is version {VERSION}")]
    Version(u8),
    /// Another packet than should be there.
    #[error("the packet is of kind {found}, expected was {expected}")]
    Kind {
        /// Value in the datagram.
        found: u8,
        /// Expected value.
        expected: u8,
    },
    /// The robot's name can be no name.
    #[error("the robot's name is invalid")]
    Robot,
    /// More bytes than the packet has.
    #[error("{0} bytes are too many for a packet of the service")]
    Long(usize),
    /// A scan has other ranges than it says, or more than fit.
    #[error("a scan of {announced} beams has {found} ranges")]
    Beams {
        /// Beams that it says.
        announced: usize,
        /// Ranges that it has.
        found: usize,
    },
    /// The goal's fields contradict one another.
    #[error("the goal's fields contradict one another")]
    Goal,
    /// A part of an image that cannot be one.
    #[error("the packet is not a fragment of an image")]
    Image,
    /// The sensor's name can be no name.
    #[error("the sensor's name is invalid")]
    Sensor,
    /// NaN or infinity where only a number makes sense.
    #[error("a number in the packet is not finite")]
    NotFinite,
    /// The message behind the header is broken.
    #[error(transparent)]
    Message(#[from] DecodeError),
}

/// A robot says where it is, and asks how to go on.
#[derive(Debug, Clone, PartialEq)]
pub struct PositionPacket {
    /// Number of the packet, from 0.
    pub sequence: u32,
    /// Time of emission, on the robot's clock.
    pub emitted: Timestamp,
    /// A number that only a receiver of the packet knows.
    pub nonce: u64,
    /// The next waypoint of the robot's walk, from 0.
    pub waypoint: u32,
    /// Goal that takes the place of its walk.
    pub goal: Option<Position>,
    /// The robot.
    pub robot: NodeId,
    /// Pose of the robot.
    pub pose: Pose,
}

impl PositionPacket {
    /// Writes the packet to `buffer`, in place of what it held.
    pub fn encode(&self, buffer: &mut Vec<u8>) {
        let name = self.robot.as_str();
        let name_len = u8::try_from(name.len()).expect("a name has 63 bytes at most");
        let PositionPacket { sequence, waypoint, emitted, nonce, .. } = *self;
        write_header(buffer, Kind::Position, name_len, sequence, waypoint, emitted, nonce);
        buffer.extend_from_slice(name.as_bytes());
        if let Some(Position { x, y, z }) = self.goal {
            buffer[GOAL_AT] = 1;
            [x, y, z].iter().for_each(|metres| buffer.extend_from_slice(&metres.to_le_bytes()));
        }
        self.pose.encode_cdr(buffer);
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one position packet.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let header = Header::read(datagram, Kind::Position)?;
        let (robot, mut message) = header.robot(datagram)?;
        let goal = match header.goal {
            0 => None,
            1 => {
                let mut metres = || header.metres(&mut message, datagram);
                Some(Position { x: metres()?, y: metres()?, z: metres()? })
            }
            _ => return Err(WireError::Goal),
        };
        Ok(Self {
            sequence: header.sequence,
            emitted: header.emitted,
            nonce: header.nonce,
            waypoint: header.waypoint,
            goal,
            robot,
            pose: Pose::decode_cdr(message)?,
        })
    }
}

/// The answer: how the robot shall move.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigationPacket {
    /// Number of the position packet that it answers.
    pub sequence: u32,
    /// Time of emission of the position packet, copied from it.
    pub emitted: Timestamp,
    /// The nonce of that one.
    pub nonce: u64,
    /// The next waypoint from here on; the walk's length at its end.
    pub waypoint: u32,
    /// Velocity for the robot.
    pub velocity: Twist,
    /// Progress on the way to the goal, if there is one.
    pub headway: Option<Headway>,
    /// Whether the robot needs a federation, because its walk is about to leave the coverage of its domain.
    pub needs_federation: bool,
}

/// Progress of a robot on the way to its goal.
#[derive(Debug, Clone, PartialEq)]
pub enum Headway {
    /// Metres that are left.
    Left(f64),
    /// The robot has arrived.
    Arrived,
    /// No way leads there, and why; of the reason, 255 bytes at most are sent.
    Blocked(String),
}

impl NavigationPacket {
    /// The answer to a position packet of a robot on its walk.
    pub fn answering(position: &PositionPacket, waypoint: u32, velocity: Twist) -> Self {
        let PositionPacket { sequence, emitted, nonce, .. } = *position;
        Self { sequence, emitted, nonce, waypoint, velocity, headway: None, needs_federation: false }
    }

    /// Writes the packet to `buffer`, in place of what it held.
    pub fn encode(&self, buffer: &mut Vec<u8>) {
        write_header(buffer, Kind::Navigation, 0, self.sequence, self.waypoint, self.emitted, self.nonce);
        match &self.headway {
            None => {}
            Some(Headway::Left(metres)) => {
                buffer[GOAL_AT] = 1;
                buffer.extend_from_slice(&metres.to_le_bytes());
            }
            Some(Headway::Arrived) => buffer[GOAL_AT] = 2,
            Some(Headway::Blocked(reason)) => {
                let reason = &reason[..reason.floor_char_boundary(usize::from(u8::MAX))];
                [buffer[TEXT_LEN_AT], buffer[GOAL_AT]] = [reason.len() as u8, 3];
                buffer.extend_from_slice(reason.as_bytes());
            }
        }
        if self.needs_federation {
            buffer[GOAL_AT] |= FEDERATION;
        }
        self.velocity.encode_cdr(buffer);
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one navigation packet.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let header = Header::read(datagram, Kind::Navigation)?;
        let mut rest = header.rest;
        let headway = match (header.goal & !FEDERATION, header.name_len) {
            (0, 0) => None,
            (1, 0) => Some(Headway::Left(header.metres(&mut rest, datagram)?)),
            (2, 0) => Some(Headway::Arrived),
            (3, len) => {
                let (reason, behind) = rest.split_at_checked(len).ok_or(WireError::Short(datagram.len()))?;
                rest = behind;
                Some(Headway::Blocked(str::from_utf8(reason).map_err(|_| WireError::Goal)?.to_owned()))
            }
            (0..=2, _) => return Err(WireError::Robot),
            _ => return Err(WireError::Goal),
        };
        Ok(Self {
            sequence: header.sequence,
            emitted: header.emitted,
            nonce: header.nonce,
            waypoint: header.waypoint,
            velocity: Twist::decode_cdr(rest)?,
            headway,
            needs_federation: header.goal & FEDERATION != 0,
        })
    }
}

/// Packet that answers a robot.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// Answer to a position packet.
    Navigation(NavigationPacket),
    /// Answer to a scan.
    Pose(PosePacket),
}

impl Answer {
    /// Reads an answer.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        const POSE: u8 = Kind::Pose as u8;
        match datagram.get(5) {
            Some(&POSE) => PosePacket::decode(datagram).map(Self::Pose),
            _ => NavigationPacket::decode(datagram).map(Self::Navigation),
        }
    }
}

#[derive(Clone, Copy)]
enum Kind {
    Position = 1,
    Navigation = 2,
    Scan = 3,
    Pose = 4,
    Image = 5,
}

struct Header<'a> {
    name_len: usize,
    goal: u8,
    sequence: u32,
    waypoint: u32,
    emitted: Timestamp,
    nonce: u64,
    rest: &'a [u8],
}

fn write_header(
    buffer: &mut Vec<u8>,
    kind: Kind,
    name_len: u8,
    sequence: u32,
    waypoint: u32,
    emitted: Timestamp,
    nonce: u64,
) {
    buffer.clear();
    buffer.extend_from_slice(&MAGIC);
    buffer.extend_from_slice(&[VERSION, kind as u8, name_len, 0]);
    buffer.extend_from_slice(&sequence.to_le_bytes());
    buffer.extend_from_slice(&waypoint.to_le_bytes());
    buffer.extend_from_slice(&emitted.as_nanos().to_le_bytes());
    buffer.extend_from_slice(&nonce.to_le_bytes());
}

impl<'a> Header<'a> {
    fn read(datagram: &'a [u8], kind: Kind) -> Result<Self, WireError> {
        let Some((header, rest)) = datagram.split_first_chunk::<HEADER_LEN>() else {
            return Err(WireError::Short(datagram.len()));
        };
        let word =
            |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 4)) << 32;
        if !header.starts_with(&MAGIC) {
            return Err(WireError::Magic);
        }
        let [version, found, name_len] = [header[4], header[5], header[6]];
        if version != VERSION {
            return Err(WireError::Version(version));
        }
        if found != kind as u8 {
            return Err(WireError::Kind { found, expected: kind as u8 });
        }
        Ok(Self {
            name_len: usize::from(name_len),
            goal: header[GOAL_AT],
            sequence: word(8),
            waypoint: word(12),
            emitted: Timestamp::from_nanos(long(16)),
            nonce: long(24),
            rest,
        })
    }

    /// Takes metres off the front of what follows.
    fn metres(&self, rest: &mut &'a [u8], datagram: &[u8]) -> Result<f64, WireError> {
        let (metres, behind) = rest.split_first_chunk().ok_or(WireError::Short(datagram.len()))?;
        *rest = behind;
        Some(f64::from_le_bytes(*metres)).filter(|metres| metres.is_finite()).ok_or(WireError::NotFinite)
    }

    /// The robot's name, and what follows it.
    fn robot(&self, datagram: &[u8]) -> Result<(NodeId, &'a [u8]), WireError> {
        let (name, rest) =
            self.rest.split_at_checked(self.name_len).ok_or(WireError::Short(datagram.len()))?;
        let robot = std::str::from_utf8(name).ok().and_then(|name| NodeId::new(name).ok());
        Ok((robot.ok_or(WireError::Robot)?, rest))
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Pose, PoseSource, Velocity};
    use proptest::prelude::*;

    use super::*;
    use crate::convert::{to_pose, to_twist};

    fn position() -> PositionPacket {
        let pose = Pose::planar(25.5, -27.8, 1.5, [0.0; 9], PoseSource::Simulator);
        PositionPacket {
            sequence: 7,
            emitted: Timestamp::from_nanos(1_400_000_123),
            nonce: 0x0123_4567_89ab_cdef,
            waypoint: 3,
            goal: None,
            robot: NodeId::new("robot1").unwrap(),
            pose: to_pose(&pose),
        }
    }

    #[test]
    fn a_position_packet_has_the_documented_layout() {
        let mut bytes = Vec::new();
        position().encode(&mut bytes);
        assert_eq!(bytes[..8], *b"ctra\x03\x01\x06\x00");
        assert_eq!(bytes[8..16], [7, 0, 0, 0, 3, 0, 0, 0]);
        assert_eq!(bytes[16..24], 1_400_000_123u64.to_le_bytes());
        assert_eq!(bytes[24..32], 0x0123_4567_89ab_cdef_u64.to_le_bytes());
        assert_eq!(bytes[32..38], *b"robot1");
        assert_eq!(bytes.len(), 32 + 6 + 4 + 56);
        assert_eq!(PositionPacket::decode(&bytes).unwrap(), position());
    }

    #[test]
    fn a_navigation_packet_answers_with_the_same_sequence_and_emission() {
        let answer = NavigationPacket::answering(&position(), 4, to_twist(Velocity::planar(0.3, -0.1)));
        let mut bytes = b"old".to_vec();
        answer.encode(&mut bytes);
        assert_eq!(bytes.len(), 32 + 4 + 48);
        let read = NavigationPacket::decode(&bytes).unwrap();
        assert_eq!(read, answer);
        assert_eq!((read.sequence, read.emitted, read.waypoint), (7, position().emitted, 4));
        assert_eq!(read.nonce, position().nonce);
    }

    #[test]
    fn goals_follow_the_name_and_answers_have_their_progress() {
        let goal = Some(Position::new(-1.5, 2.25).at_height(0.5));
        let packet = PositionPacket { goal, ..position() };
        let (mut with, mut without) = (Vec::new(), Vec::new());
        packet.encode(&mut with);
        position().encode(&mut without);
        assert_eq!((with[7], with.len()), (1, without.len() + 24));
        let metres = [-1.5f64, 2.25, 0.5].map(f64::to_le_bytes).concat();
        assert_eq!(with[38..62], metres);
        assert_eq!((&with[8..38], &with[62..]), (&without[8..38], &without[38..]));
        assert_eq!(PositionPacket::decode(&with).unwrap(), packet);

        let walks = NavigationPacket::answering(&packet, 3, to_twist(Velocity::planar(0.3, -0.1)));
        for (headway, said, more) in [
            (Headway::Left(4.75), 1, 8),
            (Headway::Arrived, 2, 0),
            (Headway::Blocked("a wall is there".to_owned()), 3, 15),
            (Headway::Blocked(String::new()), 3, 0),
        ] {
            let answer = NavigationPacket { headway: Some(headway), ..walks.clone() };
            answer.encode(&mut with);
            assert_eq!((with[7], with.len()), (said, 32 + more + 4 + 48));
            assert_eq!(NavigationPacket::decode(&with).unwrap(), answer);
        }
        // A reason is cut between two letters.
        let long = NavigationPacket { headway: Some(Headway::Blocked("ä".repeat(200))), ..walks };
        long.encode(&mut with);
        assert_eq!(NavigationPacket::decode(&with).unwrap().headway, Some(Headway::Blocked("ä".repeat(127))));
    }

    #[test]
    fn contradictory_goals_are_rejected() {
        let mut bytes = Vec::new();
        PositionPacket { goal: Some(Position::default()), ..position() }.encode(&mut bytes);
        let with = |at: usize, values: &[u8]| {
            let mut changed = bytes.clone();
            changed[at..at + values.len()].copy_from_slice(values);
            PositionPacket::decode(&changed)
        };
        assert!(matches!(with(7, &[2]), Err(WireError::Goal)));
        assert!(matches!(with(46, &f64::NAN.to_le_bytes()), Err(WireError::NotFinite)));
        assert!(matches!(with(7, &[0]), Err(WireError::Message(_))), "the goal is no pose");
        assert!(matches!(PositionPacket::decode(&bytes[..61]), Err(WireError::Short(61))));

        let answer = NavigationPacket::answering(&position(), 3, to_twist(Velocity::default()));
        NavigationPacket { headway: Some(Headway::Blocked("ä".to_owned())), ..answer }.encode(&mut bytes);
        let with = |at: usize, value: u8| {
            let mut changed = bytes.clone();
            changed[at] = value;
            NavigationPacket::decode(&changed)
        };
        assert!(matches!(with(7, 4), Err(WireError::Goal)));
        assert!(matches!(with(7, 2), Err(WireError::Robot)), "a reason, though it is there");
        assert!(matches!(with(32, 0xff), Err(WireError::Goal)), "the reason is no UTF-8");
        assert!(matches!(with(6, 255), Err(WireError::Short(86))));
    }

    #[test]
    fn a_request_for_a_federation_changes_one_bit() {
        let usual = NavigationPacket::answering(&position(), 4, to_twist(Velocity::planar(0.3, 0.0)));
        let asking = NavigationPacket { needs_federation: true, ..usual.clone() };
        let [mut without, mut with] = [Vec::new(), Vec::new()];
        usual.encode(&mut without);
        asking.encode(&mut with);
        assert_eq!(NavigationPacket::decode(&with).unwrap(), asking);
        with[7] ^= 128;
        assert_eq!(with, without);
    }

    #[test]
    fn invalid_packets_are_rejected_with_a_reason() {
        let mut bytes = Vec::new();
        position().encode(&mut bytes);
        assert!(matches!(PositionPacket::decode(&bytes[..31]), Err(WireError::Short(31))));
        assert!(matches!(PositionPacket::decode(&bytes[..36]), Err(WireError::Short(36))));
        assert!(matches!(PositionPacket::decode(&bytes[..60]), Err(WireError::Message(_))));
        assert!(matches!(NavigationPacket::decode(&bytes), Err(WireError::Kind { found: 1, expected: 2 })));
        let with = |at: usize, value| {
            let mut changed = bytes.clone();
            changed[at] = value;
            PositionPacket::decode(&changed)
        };
        assert!(matches!(with(0, b'x'), Err(WireError::Magic)));
        assert!(matches!(with(4, 9), Err(WireError::Version(9))));
        assert!(matches!(with(32, b'/'), Err(WireError::Robot)));
        assert!(matches!(with(32, 0xff), Err(WireError::Robot)));
        bytes.extend_from_slice(&[0; 4]);
        assert!(matches!(PositionPacket::decode(&bytes), Err(WireError::Message(_))));
    }

    proptest! {
        #[test]
        fn decoding_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..500)) {
            let _ = PositionPacket::decode(&bytes);
            let _ = NavigationPacket::decode(&bytes);
        }

        #[test]
        fn a_damaged_packet_never_panics(at in 0usize..98, value: u8, len in 0usize..=98) {
            let mut bytes = Vec::new();
            position().encode(&mut bytes);
            bytes[at] = value;
            bytes.truncate(len);
            let _ = PositionPacket::decode(&bytes);
        }

        #[test]
        fn packets_survive_encoding(
            sequence: u32, waypoint: u32, emitted: u64, nonce: u64, name in "[a-z0-9][a-zA-Z0-9_.~-]{0,62}",
            x in any::<f64>().prop_filter("NaN is unequal to itself", |x| !x.is_nan()),
            goal in proptest::option::of((-1e9..1e9, -1e9..1e9, 0.0..1e3)), reason in ".{0,60}",
        ) {
            let mut packet = position();
            (packet.sequence, packet.waypoint) = (sequence, waypoint);
            (packet.emitted, packet.nonce) = (Timestamp::from_nanos(emitted), nonce);
            packet.robot = NodeId::new(&name).unwrap();
            packet.pose.position.x = x;
            packet.goal = goal.map(|(x, y, z)| Position { x, y, z });
            let mut bytes = Vec::new();
            packet.encode(&mut bytes);
            prop_assert_eq!(PositionPacket::decode(&bytes).unwrap(), packet.clone());

            let mut twist = Twist::default();
            twist.angular.z = x;
            let answer = NavigationPacket::answering(&packet, waypoint, twist);
            let left = packet.goal.map(|goal| Headway::Left(goal.z));
            for headway in [None, Some(Headway::Arrived), Some(Headway::Blocked(reason)), left] {
                let answer = NavigationPacket { headway, ..answer.clone() };
                answer.encode(&mut bytes);
                prop_assert_eq!(NavigationPacket::decode(&bytes).unwrap(), answer);
            }
        }
    }
}
