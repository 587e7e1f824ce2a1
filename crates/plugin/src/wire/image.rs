//! A camera's images on their way to a VNF: each in fragments, one a datagram.
//!
//! The service's header has other fields here, and the robot's and the sensor's names follow it, each length in a byte of
//! its own. Then come the fragment's bytes. Each fragment but the last of an image has [`FRAGMENT`] bytes.
//!
//! | bytes | field, little endian |
//! |---|---|
//! | 0..4 | magic, `ctra` |
//! | 4 | version, 3 |
//! | 5 | kind, 5 |
//! | 6 | length of the robot's name |
//! | 7 | format: 1 `mono8`, 2 `rgb8`, 3 `jpeg`, 4 `png` |
//! | 8..12 | number of the sensor's reading |
//! | 12..16 | where the fragment's bytes begin in the image |
//! | 16..24 | when the image was taken, ns since the run began |
//! | 24..28 | bytes of the whole image |
//! | 28..30 | its columns |
//! | 30..32 | its rows |

use cotorra_graph::{DataFormat, NodeId, SensorId, Timestamp};

use super::{GOAL_AT, Header, Kind, WireError, write_header};

/// Bytes of each fragment but the last. With the longest names it fits into one Ethernet frame.
pub const FRAGMENT: usize = 1280;
/// Bytes of the largest image that goes to a VNF.
pub const LARGEST_IMAGE: usize = 64 << 20;

/// A part of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImagePacket<'a> {
    /// The robot.
    pub robot: NodeId,
    /// Its camera.
    pub sensor: SensorId,
    /// Number of the sensor's reading; the lowest 32 bits of it.
    pub sequence: u32,
    /// Time of the image.
    pub measured: Timestamp,
    /// Encoding of the image.
    pub format: DataFormat,
    /// Columns of the image.
    pub width: u16,
    /// Rows of the image.
    pub height: u16,
    /// Bytes of the whole image.
    pub length: u32,
    /// Offset of this fragment's bytes in the image.
    pub offset: u32,
    /// The fragment's bytes.
    pub bytes: &'a [u8],
}

impl<'a> ImagePacket<'a> {
    /// The fragments of an image, in order. `whole` says of which; its `length`, `offset` and `bytes` count for nothing.
    /// An image of more than [`LARGEST_IMAGE`] bytes has none.
    pub fn fragments(whole: &ImagePacket<'_>, image: &'a [u8]) -> impl Iterator<Item = Self> {
        let image = if image.len() <= LARGEST_IMAGE { image } else { &[] };
        let (robot, sensor) = (whole.robot.clone(), whole.sensor.clone());
        let ImagePacket { sequence, measured, format, width, height, .. } = *whole;
        image.chunks(FRAGMENT).enumerate().map(move |(place, bytes)| Self {
            robot: robot.clone(),
            sensor: sensor.clone(),
            sequence,
            measured,
            format,
            width,
            height,
            length: image.len() as u32,
            offset: (place * FRAGMENT) as u32,
            bytes,
        })
    }

    /// Writes the packet to `buffer`, in place of what it held.
    pub fn encode(&self, buffer: &mut Vec<u8>) {
        let [robot, sensor] = [self.robot.as_str(), self.sensor.as_str()];
        let [robot_len, sensor_len] =
            [robot, sensor].map(|name| u8::try_from(name.len()).expect("a name has 63 bytes at most"));
        let size = u64::from(self.length) | u64::from(self.width) << 32 | u64::from(self.height) << 48;
        write_header(buffer, Kind::Image, robot_len, self.sequence, self.offset, self.measured, size);
        buffer[GOAL_AT] = match self.format {
            DataFormat::Scan => 0,
            DataFormat::Mono8 => 1,
            DataFormat::Rgb8 => 2,
            DataFormat::Jpeg => 3,
            DataFormat::Png => 4,
        };
        buffer.extend_from_slice(robot.as_bytes());
        buffer.push(sensor_len);
        buffer.extend_from_slice(sensor.as_bytes());
        buffer.extend_from_slice(self.bytes);
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// [`WireError`] if `datagram` is not exactly one fragment of an image.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let header = Header::read(datagram, Kind::Image)?;
        let format = match header.goal {
            1 => DataFormat::Mono8,
            2 => DataFormat::Rgb8,
            3 => DataFormat::Jpeg,
            4 => DataFormat::Png,
            _ => return Err(WireError::Image),
        };
        let (robot, rest) = header.robot(datagram)?;
        let (&sensor_len, rest) = rest.split_first().ok_or(WireError::Short(datagram.len()))?;
        let (sensor, bytes) =
            rest.split_at_checked(usize::from(sensor_len)).ok_or(WireError::Short(datagram.len()))?;
        let sensor = str::from_utf8(sensor).ok().and_then(|name| SensorId::new(name).ok());
        let (length, offset) = (header.nonce as u32, header.waypoint);
        let [width, height] = [header.nonce >> 32, header.nonce >> 48].map(|pixels| pixels as u16);
        let pixels = usize::from(width) * usize::from(height);
        let is_whole = match format {
            DataFormat::Mono8 => length as usize == pixels,
            DataFormat::Rgb8 => length as usize == 3 * pixels,
            _ => true,
        };
        let left = (length as usize).saturating_sub(offset as usize);
        let fits = length as usize <= LARGEST_IMAGE && left > 0 && bytes.len() == left.min(FRAGMENT);
        if !is_whole || !fits || !(offset as usize).is_multiple_of(FRAGMENT) {
            return Err(WireError::Image);
        }
        Ok(Self {
            robot,
            sensor: sensor.ok_or(WireError::Sensor)?,
            sequence: header.sequence,
            measured: header.emitted,
            format,
            width,
            height,
            length,
            offset,
            bytes,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::wire::{HEADER_LEN, PositionPacket};

    fn whole(name: &str, width: u16, height: u16) -> ImagePacket<'static> {
        ImagePacket {
            robot: NodeId::new(name).unwrap(),
            sensor: SensorId::new("front").unwrap(),
            sequence: 7,
            measured: Timestamp::from_nanos(1_400_000_123),
            format: DataFormat::Mono8,
            width,
            height,
            length: 0,
            offset: 0,
            bytes: &[],
        }
    }

    fn encoded(packet: &ImagePacket<'_>) -> Vec<u8> {
        let mut bytes = Vec::new();
        packet.encode(&mut bytes);
        bytes
    }

    #[test]
    fn a_fragment_has_the_documented_layout() {
        let image = vec![9; 1600];
        let last = ImagePacket::fragments(&whole("robot1", 40, 40), &image).last().unwrap();
        let bytes = encoded(&last);
        assert_eq!(bytes[..8], *b"ctra\x03\x05\x06\x01");
        assert_eq!(bytes[8..16], [7, 0, 0, 0, 0, 5, 0, 0]);
        assert_eq!(bytes[16..24], 1_400_000_123u64.to_le_bytes());
        assert_eq!(bytes[24..32], [64, 6, 0, 0, 40, 0, 40, 0]);
        assert_eq!(bytes[32..44], *b"robot1\x05front");
        assert_eq!(bytes[44..], [9; 320]);
        assert_eq!(ImagePacket::decode(&bytes).unwrap(), last);
    }

    #[test]
    fn the_largest_fragment_fits_into_a_frame() {
        let name = "n".repeat(63);
        let packet = ImagePacket { sensor: SensorId::new(&name).unwrap(), ..whole(&name, 40, 40) };
        let image = [0; 1600];
        let bytes = encoded(&ImagePacket::fragments(&packet, &image).next().unwrap());
        assert_eq!(bytes.len(), HEADER_LEN + 63 + 1 + 63 + FRAGMENT);
        assert!(bytes.len() <= 1500 - 28);
    }

    #[test]
    fn invalid_fragments_are_rejected() {
        let image = [1; 1600];
        let bytes = encoded(&ImagePacket::fragments(&whole("r", 40, 40), &image).nth(1).unwrap());
        let with = |at: usize, values: &[u8]| {
            let mut changed = bytes.clone();
            changed[at..at + values.len()].copy_from_slice(values);
            ImagePacket::decode(&changed).map(|_| ())
        };
        assert!(with(0, b"c").is_ok());
        assert!(matches!(PositionPacket::decode(&bytes), Err(WireError::Kind { found: 5, expected: 1 })));
        assert!(matches!(ImagePacket::decode(&bytes[..33]), Err(WireError::Short(33))));
        assert!(matches!(ImagePacket::decode(&bytes[..bytes.len() - 1]), Err(WireError::Image)));
        for (what, at, values) in [
            ("no format", 7, &[0][..]),
            ("three bytes a pixel", 7, &[2]),
            ("an offset within a fragment", 12, &[1]),
            ("an offset behind the image", 12, &[0, 10]),
            ("another length", 24, &[65]),
            ("more rows", 30, &[41]),
        ] {
            assert!(matches!(with(at, values), Err(WireError::Image)), "{what}");
        }
        assert!(matches!(with(34, b"/"), Err(WireError::Sensor)));
        // A compressed image has any length, up to the largest.
        assert!(with(7, &[3]).is_ok());
        let large = (LARGEST_IMAGE as u32 + 1).to_le_bytes();
        assert!(matches!(with(7, &[[3].as_slice(), &bytes[8..24], &large].concat()), Err(WireError::Image)));
    }

    proptest! {
        #[test]
        fn decoding_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = ImagePacket::decode(&bytes);
        }

        #[test]
        fn fragments_make_up_the_image(width in 1u16..90, height in 1u16..90, seed: u8) {
            let pixels = u32::from(width) * u32::from(height);
            let image: Vec<_> = (0..pixels).map(|i| (i as u8).wrapping_mul(31) ^ seed).collect();
            let mut again = Vec::new();
            for fragment in ImagePacket::fragments(&whole("robot1", width, height), &image) {
                let bytes = encoded(&fragment);
                let read = ImagePacket::decode(&bytes).unwrap();
                prop_assert_eq!(&read, &fragment);
                prop_assert_eq!((read.offset as usize, read.length), (again.len(), pixels));
                again.extend_from_slice(read.bytes);
            }
            prop_assert_eq!(again, image);
        }
    }
}
