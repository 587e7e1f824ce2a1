//! Capsules of an express scan: 32 samples with one checksum.

use std::f64::consts::TAU;

/// Bytes of a capsule.
pub(super) const SIZE: usize = 84;
/// Samples of a capsule.
const SAMPLES: usize = 32;

/// One capsule. Its angles become known with the capsule that follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    /// Whether measuring begins anew.
    pub is_first: bool,
    /// Whether it came directly behind the capsule before, with nothing lost between.
    pub follows: bool,
    /// Angle at which it begins, radians clockwise from the lidar's front.
    pub(super) start: f64,
    /// Range of each sample, metres, 0 if none was measured; and the correction of its angle, radians.
    pub(super) samples: [(f32, f32); SAMPLES],
}

impl Capsule {
    /// Reads a capsule; `None` if its marks or its checksum are wrong.
    pub(super) fn decode(bytes: &[u8; SIZE], follows: bool) -> Option<Self> {
        let [first, second, rest @ ..] = bytes;
        let sum = rest.iter().fold(0, |sum, byte| sum ^ byte);
        if first >> 4 != 0xA || second >> 4 != 0x5 || sum != (first & 0xF | second << 4) {
            return None;
        }
        let [low, high, cabins @ ..] = rest;
        let start = u16::from_le_bytes([*low, *high]);
        let mut samples = [(0.0, 0.0); SAMPLES];
        for (two, cabin) in samples.as_chunks_mut::<2>().0.iter_mut().zip(cabins.as_chunks::<5>().0) {
            let corrections = [cabin[4] & 0xF, cabin[4] >> 4];
            for (i, correction) in corrections.into_iter().enumerate() {
                let distance = u16::from_le_bytes([cabin[2 * i], cabin[2 * i + 1]]);
                // Quarters of a millimetre, and eighths of a degree of which the upper two bits are in the distance.
                let correction = f32::from(correction | (distance as u8 & 0x3) << 4) / 8.0;
                two[i] = (f32::from(distance & 0xFFFC) / 4000.0, correction.to_radians());
            }
        }
        let angle = f64::from(start & 0x7FFF) / 64.0;
        Some(Self { is_first: start & 0x8000 != 0, follows, start: angle.to_radians(), samples })
    }

    /// Returns the angle, radians clockwise in [0, 2π), and the range, metres, of each sample, given the capsule that
    /// follows. Between the two starts, samples are evenly spaced; from these angles their corrections are subtracted
    /// (`UnpackerHandler_CapsuleNode` in `rplidar_sdk`).
    pub(super) fn samples(&self, next: &Self) -> impl Iterator<Item = (f64, f32)> {
        let step = (next.start - self.start).rem_euclid(TAU) / SAMPLES as f64;
        self.samples.iter().enumerate().map(move |(i, (range, correction))| {
            let angle = self.start + i as f64 * step - f64::from(*correction);
            (angle.rem_euclid(TAU), *range)
        })
    }
}
