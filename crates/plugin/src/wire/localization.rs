//! The localization service's datagrams: a robot's scans, and the poses that answer them.
//!
//! A scan of 360 beams fits into one Ethernet frame, because each range is a whole number of millimetres. All that an
//! instance on another node must know to take over travels with it: what the robot believes of its place, and whose
//! answer that is from. Behind the service's header, whose waypoint is the number of that answer:
//!
//! | packet | fields, little endian |
//! |---|---|
//! | scan, kind 3 | robot's name; pose by odometry (3 × f64); way during the scan (3 × f32); pose believed (3 × f64) and its covariance (6 × f64: xx, xy, xθ, yy, yθ, θθ); direction of the first beam and step to the next (2 × f32); number of beams (u16); ranges (u16 each, mm; 0: hit nothing) |
//! | pose, kind 4 | pose (3 × f64) and its covariance (6 × f64) |

use cotorra_graph::{NodeId, Pose, PoseSource, Timestamp};

use super::{Header, Kind, WireError, write_header};

/// Most beams of a scan. With these and a name of 63 letters, a scan fits into one Ethernet frame.
pub const MAX_BEAMS: usize = 480;

/// No answer of a localization VNF yet.
const NONE: u32 = u32::MAX;
const MILLIMETRES: f32 = 1e3;

/// A robot says what it sees, and asks where it is.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanPacket {
    /// Number of the packet, from 0.
    pub sequence: u32,
    /// Time of emission, on the robot's clock.
    pub emitted: Timestamp,
    /// A number that only a receiver of the packet knows.
    pub nonce: u64,
    /// The robot.
    pub robot: NodeId,
    /// Pose by odometry, in the frame of its start: x, y (metres), heading (radians).
    pub odometry: [f64; 3],
    /// Motion from the first beam to the last, in the robot's own frame.
    pub sweep: [f32; 3],
    /// The robot's present estimate on the map.
    pub believed: Pose,
    /// The number of the scan whose answer that is from; `None` if it is from none.
    pub since: Option<u32>,
    /// Direction of the first beam, radians from the robot's heading, counter-clockwise.
    pub first_angle: f32,
    /// Angle between beams.
    pub angle_step: f32,
    /// Millimetres; 0 where a beam hit nothing that can be used. [`MAX_BEAMS`] at most.
    pub ranges: Vec<u16>,
}

impl ScanPacket {
    /// Ranges in metres as millimetres. What is not finite, not above zero or farther than 65.5 m hit nothing.
    pub fn in_millimetres(ranges: impl IntoIterator<Item = f32>) -> impl Iterator<Item = u16> {
        let most = f32::from(u16::MAX);
        ranges.into_iter().map(move |range| {
            let range = (range * MILLIMETRES).round();
            if range >= 1.0 && range <= most { range as u16 } else { 0 }
        })
    }

    /// The ranges in metres; infinite where a beam hit nothing.
    pub fn in_metres(&self) -> impl Iterator<Item = f32> {
        self.ranges.iter().map(|&range| match range {
            0 => f32::INFINITY,
            range => f32::from(range) / MILLIMETRES,
        })
    }

    /// Writes the packet to `buffer`, in place of what it held.
    ///
    /// # Panics
    /// With more than [`MAX_BEAMS`].
    pub fn encode(&self, buffer: &mut Vec<u8>) {
        assert!(self.ranges.len() <= MAX_BEAMS, "a scan fits into one packet");
        let name = self.robot.as_str();
        let name_len = u8::try_from(name.len()).expect("a name has 63 bytes at most");
        let since = self.since.unwrap_or(NONE);
        write_header(buffer, Kind::Scan, name_len, self.sequence, since, self.emitted, self.nonce);
        buffer.extend_from_slice(name.as_bytes());
        put(buffer, &self.odometry);
        self.sweep.iter().for_each(|part| buffer.extend_from_slice(&part.to_le_bytes()));
        put_pose(buffer, &self.believed);
        buffer.extend_from_slice(&self.first_angle.to_le_bytes());
        buffer.extend_from_slice(&self.angle_step.to_le_bytes());
        let beams = u16::try_from(self.ranges.len()).expect("it was compared above");
        buffer.extend_from_slice(&beams.to_le_bytes());
        self.ranges.iter().for_each(|range| buffer.extend_from_slice(&range.to_le_bytes()));
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one scan, or says what is no finite number.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let header = Header::read(datagram, Kind::Scan)?;
        let (robot, rest) = header.robot(datagram)?;
        let mut fields = Fields { rest, whole: datagram.len() };
        let odometry = fields.numbers()?;
        let sweep = fields.small_numbers()?;
        let believed = fields.pose()?;
        let [first_angle, angle_step] = fields.small_numbers()?;
        let [beams] = fields.words()?;
        let beams = usize::from(beams);
        let (ranges, left) = fields.rest.as_chunks::<2>();
        if beams > MAX_BEAMS || ranges.len() != beams || !left.is_empty() {
            return Err(WireError::Beams { announced: beams, found: ranges.len() });
        }
        Ok(Self {
            sequence: header.sequence,
            emitted: header.emitted,
            nonce: header.nonce,
            robot,
            odometry,
            sweep,
            believed,
            since: (header.waypoint != NONE).then_some(header.waypoint),
            first_angle,
            angle_step,
            ranges: ranges.iter().map(|range| u16::from_le_bytes(*range)).collect(),
        })
    }
}

/// The answer: where the robot was when it took the scan.
#[derive(Debug, Clone, PartialEq)]
pub struct PosePacket {
    /// Number of the scan that it answers.
    pub sequence: u32,
    /// Time of emission of the scan, copied from it.
    pub emitted: Timestamp,
    /// The nonce of that one.
    pub nonce: u64,
    /// Estimated pose of the robot.
    pub pose: Pose,
}

impl PosePacket {
    /// Writes the packet to `buffer`, in place of what it held.
    pub fn encode(&self, buffer: &mut Vec<u8>) {
        write_header(buffer, Kind::Pose, 0, self.sequence, 0, self.emitted, self.nonce);
        put_pose(buffer, &self.pose);
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one pose, or says what is no finite number.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let header = Header::read(datagram, Kind::Pose)?;
        if header.name_len != 0 {
            return Err(WireError::Robot);
        }
        let mut fields = Fields { rest: header.rest, whole: datagram.len() };
        let pose = fields.pose()?;
        if !fields.rest.is_empty() {
            return Err(WireError::Long(datagram.len()));
        }
        Ok(Self { sequence: header.sequence, emitted: header.emitted, nonce: header.nonce, pose })
    }
}

fn put(buffer: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| buffer.extend_from_slice(&number.to_le_bytes()));
}

/// A covariance is symmetric: half of it and the diagonal say all.
const UPPER: [usize; 6] = [0, 1, 2, 4, 5, 8];

fn put_pose(buffer: &mut Vec<u8>, pose: &Pose) {
    put(buffer, &[pose.x, pose.y, pose.heading]);
    put(buffer, &UPPER.map(|entry| pose.covariance[entry]));
}

/// Bytes that are left to read.
struct Fields<'a> {
    rest: &'a [u8],
    whole: usize,
}

impl Fields<'_> {
    fn take<const N: usize, const BYTES: usize, T>(
        &mut self,
        read: impl Fn([u8; BYTES]) -> T,
    ) -> Result<[T; N], WireError> {
        let (fields, rest) = self.rest.split_at_checked(N * BYTES).ok_or(WireError::Short(self.whole))?;
        self.rest = rest;
        let (fields, _) = fields.as_chunks::<BYTES>();
        Ok(std::array::from_fn(|i| read(fields[i])))
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], WireError> {
        let numbers = self.take(f64::from_le_bytes)?;
        if numbers.iter().all(|number: &f64| number.is_finite()) {
            Ok(numbers)
        } else {
            Err(WireError::NotFinite)
        }
    }

    fn small_numbers<const N: usize>(&mut self) -> Result<[f32; N], WireError> {
        let numbers = self.take(f32::from_le_bytes)?;
        if numbers.iter().all(|number: &f32| number.is_finite()) {
            Ok(numbers)
        } else {
            Err(WireError::NotFinite)
        }
    }

    fn words<const N: usize>(&mut self) -> Result<[u16; N], WireError> {
        self.take(u16::from_le_bytes)
    }

    fn pose(&mut self) -> Result<Pose, WireError> {
        let [x, y, heading] = self.numbers()?;
        let [xx, xy, xh, yy, yh, hh] = self.numbers()?;
        let covariance = [xx, xy, xh, xy, yy, yh, xh, yh, hh];
        Ok(Pose::planar(x, y, heading, covariance, PoseSource::Localization))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pose() -> Pose {
        let covariance = [0.04, 0.01, -0.002, 0.01, 0.03, 0.001, -0.002, 0.001, 0.005];
        Pose::planar(25.5, -27.8, 1.5, covariance, PoseSource::Localization)
    }

    fn scan() -> ScanPacket {
        ScanPacket {
            sequence: 7,
            emitted: Timestamp::from_nanos(1_400_000_123),
            nonce: 0x0123_4567_89ab_cdef,
            robot: NodeId::new("robot1").unwrap(),
            odometry: [25.4, -27.7, 1.49],
            sweep: [0.03, 0.0, 0.01],
            believed: pose(),
            since: Some(6),
            first_angle: -3.125,
            angle_step: 0.017,
            ranges: ScanPacket::in_millimetres([
                1.2344,
                f32::INFINITY,
                f32::NEG_INFINITY,
                f32::NAN,
                0.0,
                70.0,
            ])
            .collect(),
        }
    }

    #[test]
    fn scans_have_the_documented_layout_with_misses() {
        let mut bytes = b"old".to_vec();
        scan().encode(&mut bytes);
        assert_eq!(bytes[..16], *b"ctra\x03\x03\x06\x00\x07\0\0\0\x06\0\0\0");
        assert_eq!(bytes[32..38], *b"robot1");
        assert_eq!(bytes.len(), 38 + 24 + 12 + 72 + 8 + 2 + 2 * 6);
        assert_eq!(ScanPacket::decode(&bytes).unwrap(), scan());
        let metres: Vec<f32> = scan().in_metres().collect();
        assert_eq!((metres[0], &metres[1..]), (1.234, &[f32::INFINITY; 5][..]));
        let first = ScanPacket { since: None, ..scan() };
        first.encode(&mut bytes);
        assert_eq!(ScanPacket::decode(&bytes).unwrap(), first);
    }

    #[test]
    fn the_longest_scan_fits_into_one_frame() {
        let robot = NodeId::new(&"r".repeat(63)).unwrap();
        let mut bytes = Vec::new();
        ScanPacket { robot, ranges: vec![9; MAX_BEAMS], ..scan() }.encode(&mut bytes);
        // 1500 bytes hold an IPv4 and a UDP header, too.
        assert!(bytes.len() <= 1500 - 28, "{}", bytes.len());
        ScanPacket { ranges: vec![9; 360], ..scan() }.encode(&mut bytes);
        assert!(bytes.len() < 900, "{}", bytes.len());
    }

    #[test]
    fn invalid_scans_and_poses_are_rejected() {
        let (mut bytes, mut answer) = (Vec::new(), Vec::new());
        scan().encode(&mut bytes);
        let packet = PosePacket { sequence: 7, emitted: Timestamp::from_nanos(5), nonce: 9, pose: pose() };
        packet.encode(&mut answer);
        assert_eq!(answer.len(), 32 + 72);
        assert_eq!(PosePacket::decode(&answer).unwrap(), packet);
        for length in 0..bytes.len() {
            assert!(ScanPacket::decode(&bytes[..length]).is_err(), "{length} bytes");
        }
        for length in 0..answer.len() {
            assert!(PosePacket::decode(&answer[..length]).is_err(), "{length} bytes");
        }
        assert!(matches!(ScanPacket::decode(&answer), Err(WireError::Kind { found: 4, expected: 3 })));
        answer.push(0);
        assert!(matches!(PosePacket::decode(&answer), Err(WireError::Long(105))));
        bytes[38..46].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(matches!(ScanPacket::decode(&bytes), Err(WireError::NotFinite)));
    }

    proptest! {
        #[test]
        fn decoding_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..300), at in 0usize..160, value: u8) {
            let _ = (ScanPacket::decode(&bytes), PosePacket::decode(&bytes));
            let mut damaged = Vec::new();
            scan().encode(&mut damaged);
            if let Some(byte) = damaged.get_mut(at) {
                *byte = value;
            }
            let _ = ScanPacket::decode(&damaged);
        }
    }
}
