//! Decoding of PNG pictures (ISO/IEC 15948) to greyscale, as PGM.

use std::io::Cursor;

use png::{ColorType, DecodeOptions, Decoder, DecodingError, Info, Transformations};

/// First bytes of every PNG picture.
pub const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Pixels of the largest picture.
const MAX_PIXELS: usize = 32 << 20;
/// Raw bytes of the largest picture.
const MAX_RAW: usize = 128 << 20;

/// Error of a PNG picture.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum PngError {
    /// Its bytes are wrong, or some are missing.
    #[error("the PNG picture is cut off or damaged: {0}")]
    Damaged(String),
    /// It has too many pixels.
    #[error("a PNG picture of {0} × {1} pixels is too large; scale it down to {MAX_PIXELS} pixels or fewer")]
    Size(u32, u32),
}

impl From<DecodingError> for PngError {
    fn from(error: DecodingError) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// A pixel, each channel from 0 to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pixel {
    /// Red, green and blue; grey is one of all.
    pub colour: [u8; 3],
    /// How opaque it is, if the picture says so.
    pub alpha: Option<u8>,
}

impl Pixel {
    /// Returns its luma (ITU-R BT.601) on white, as people see it.
    pub fn on_white(self) -> u8 {
        let [red, green, blue] = self.colour.map(u32::from);
        let dark = 255 - (299 * red + 587 * green + 114 * blue) / 1000;
        255 - (dark * u32::from(self.alpha.unwrap_or(255)) / 255) as u8
    }

    /// Returns the mean of its channels, its alpha among them, as ROS's map_server reads a map.
    pub fn mean(self) -> u8 {
        let channels = self.colour.into_iter().chain(self.alpha);
        let (sum, count) =
            channels.fold((0, 0), |(sum, count), channel| (sum + u32::from(channel), count + 1));
        (sum / count) as u8
    }
}

/// Decodes a PNG picture to a PGM picture, whose pixels `grey` gives.
///
/// # Errors
/// [`PngError`] if it is damaged or too large.
pub fn to_pgm(bytes: &[u8], grey: impl Fn(Pixel) -> u8) -> Result<Vec<u8>, PngError> {
    let mut options = DecodeOptions::default();
    // The checksum of the pixels is enough.
    options.set_ignore_crc(true);
    options.set_ignore_adler32(false);
    options.set_ignore_text_chunk(true);
    options.set_ignore_iccp_chunk(true);
    let mut decoder = Decoder::new_with_options(Cursor::new(bytes), options);
    decoder.set_transformations(Transformations::normalize_to_color8());
    check(decoder.read_header_info()?)?;
    let mut reader = decoder.read_info()?;
    // The library trusts the palette.
    if reader.info().palette.as_ref().is_some_and(|its| its.len() % 3 != 0) {
        return Err(PngError::Damaged("its palette ends within a colour".to_owned()));
    }
    let size =
        reader.output_buffer_size().ok_or(PngError::Size(reader.info().width, reader.info().height))?;
    let mut pixels = vec![0; size];
    let frame = reader.next_frame(&mut pixels)?;
    reader.finish()?;
    let pixel = |channels: &[u8]| match (frame.color_type, channels) {
        (ColorType::Grayscale, &[grey]) => Pixel { colour: [grey; 3], alpha: None },
        (ColorType::GrayscaleAlpha, &[grey, alpha]) => Pixel { colour: [grey; 3], alpha: Some(alpha) },
        (_, &[red, green, blue]) => Pixel { colour: [red, green, blue], alpha: None },
        (_, &[red, green, blue, alpha]) => Pixel { colour: [red, green, blue], alpha: Some(alpha) },
        _ => unreachable!("a palette becomes colours"),
    };
    let mut pgm = format!("P5\n{} {}\n255\n", frame.width, frame.height).into_bytes();
    pgm.extend(pixels.chunks_exact(frame.color_type.samples()).map(|channels| grey(pixel(channels))));
    Ok(pgm)
}

/// Checks that a picture is one that is read.
fn check(header: &Info<'_>) -> Result<(), PngError> {
    let (width, height) = (header.width as usize, header.height as usize);
    let pixels = width.checked_mul(height).filter(|&pixels| pixels <= MAX_PIXELS);
    let raw = pixels.and_then(|_| height.checked_mul(header.raw_row_length()));
    match raw {
        Some(raw) if raw <= MAX_RAW => Ok(()),
        _ => Err(PngError::Size(header.width, header.height)),
    }
}

/// Encodes a picture from its rows, each of which begins with its filter.
#[cfg(test)]
pub(crate) fn picture(
    size: (u32, u32),
    bits: u8,
    kind: u8,
    more: &[(&[u8; 4], &[u8])],
    rows: &[u8],
) -> Vec<u8> {
    let header = [&size.0.to_be_bytes()[..], &size.1.to_be_bytes(), &[bits, kind, 0, 0, 0]].concat();
    let packed = miniz_oxide::deflate::compress_to_vec_zlib(rows, 6);
    // In two chunks, as larger pictures have it.
    let (first, second) = packed.split_at(packed.len() / 2);
    let mut chunks: Vec<(&[u8; 4], &[u8])> = vec![(b"IHDR", &header)];
    chunks.extend(more);
    chunks.extend([(b"IDAT", first), (b"IDAT", second), (b"IEND", &[])]);
    let mut bytes = SIGNATURE.to_vec();
    for (kind, data) in chunks {
        bytes.extend((data.len() as u32).to_be_bytes());
        bytes.extend([&kind[..], data, &[0; 4]].concat());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pixels(png: &[u8]) -> Vec<u8> {
        let pgm = to_pgm(png, Pixel::on_white).unwrap();
        let start = pgm.windows(5).position(|w| w == b"\n255\n").unwrap() + 5;
        pgm[start..].to_vec()
    }

    #[test]
    fn every_kind_of_pixel_becomes_grey() {
        // Black, white and something between, in each kind.
        assert_eq!(pixels(&picture((3, 1), 8, 0, &[], &[0, 0, 255, 100])), [0, 255, 100]);
        assert_eq!(pixels(&picture((3, 1), 16, 0, &[], &[0, 0, 0, 255, 255, 100, 7])), [0, 255, 100]);
        assert_eq!(pixels(&picture((3, 1), 1, 0, &[], &[0, 0b0100_0000])), [0, 255, 0]);
        assert_eq!(pixels(&picture((3, 1), 2, 0, &[], &[0, 0b0011_0100])), [0, 255, 85]);
        assert_eq!(pixels(&picture((3, 1), 4, 0, &[], &[0, 0x0f, 0x50])), [0, 255, 85]);
        assert_eq!(
            pixels(&picture((3, 1), 8, 2, &[], &[0, 0, 0, 0, 255, 255, 255, 255, 0, 0])),
            [0, 255, 76]
        );
        assert_eq!(pixels(&picture((3, 1), 8, 4, &[], &[0, 0, 255, 0, 0, 100, 255])), [0, 255, 100]);
        let with_alpha = [0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 0, 0, 51];
        assert_eq!(pixels(&picture((3, 1), 8, 6, &[], &with_alpha)), [0, 255, 204]);
        let palette: [(&[u8; 4], &[u8]); 2] =
            [(b"PLTE", &[9, 9, 9, 0, 0, 0, 0, 0, 0]), (b"tRNS", &[255, 255, 0])];
        assert_eq!(pixels(&picture((3, 1), 2, 3, &palette, &[0, 0b0001_1000])), [9, 0, 255]);
    }

    #[test]
    fn map_server_takes_the_mean_of_all_channels() {
        let pixel = |alpha| Pixel { colour: [0, 60, 120], alpha };
        assert_eq!(pixel(None).mean(), 60);
        // An opaque pixel is brighter with alpha than without.
        assert_eq!((pixel(Some(255)).mean(), pixel(Some(0)).mean()), (108, 45));
    }

    #[test]
    fn interlaced_pictures_are_read() {
        // 2 × 2 by Adam7: the first pixel in pass 1, the second in pass 6, the second row in pass 7.
        let mut interlaced = picture((2, 2), 8, 0, &[], &[0, 10, 0, 20, 0, 30, 40]);
        interlaced[SIGNATURE.len() + 8 + 12] = 1;
        assert_eq!(pixels(&interlaced), [10, 20, 30, 40]);
    }

    #[test]
    fn filters_are_undone() {
        // 10 20 30 on 1 2 3, by each filter in turn; the row above the first is 0.
        let first = [0, 1, 2, 3];
        for second in [[0, 10, 20, 30], [1, 10, 10, 10], [2, 9, 18, 27], [3, 10, 14, 19], [4, 9, 10, 10]] {
            let rows = [first, second].concat();
            assert_eq!(pixels(&picture((3, 2), 8, 0, &[], &rows)), [1, 2, 3, 10, 20, 30], "{second:?}");
        }
    }

    #[test]
    fn invalid_pictures_are_rejected() {
        let good = picture((2, 1), 8, 0, &[], &[0, 1, 2]);
        assert!(to_pgm(&good, Pixel::mean).is_ok());
        for length in 0..good.len() {
            assert!(matches!(to_pgm(&good[..length], Pixel::mean), Err(PngError::Damaged(_))), "{length}");
        }
        let reason = |picture: &[u8]| match to_pgm(picture, Pixel::mean) {
            Err(PngError::Damaged(reason)) => reason,
            other => panic!("{other:?}"),
        };
        assert_eq!(
            reason(&picture((2, 2), 8, 0, &[], &[0, 1, 2])),
            "IDAT or fDAT chunk does not have enough data for image."
        );
        assert_eq!(reason(&picture((2, 1), 8, 0, &[], &[9, 1, 2])), "Unknown filter method 9.");
        assert_eq!(reason(&picture((2, 1), 3, 0, &[], &[0, 1])), "Invalid bit depth 3.");
        let no_palette = picture((2, 1), 8, 3, &[], &[0, 1, 2]);
        assert_eq!(reason(&no_palette), "Missing palette of indexed image.");
        for length in [4, 5] {
            let palette: [(&[u8; 4], &[u8]); 1] = [(b"PLTE", &vec![9; length])];
            let wrong = reason(&picture((2, 1), 8, 3, &palette, &[0, 1, 2]));
            assert_eq!(wrong, "its palette ends within a colour", "{length}");
        }
        for length in [2, 771] {
            let palette: [(&[u8; 4], &[u8]); 1] = [(b"PLTE", &vec![9; length])];
            let wrong = reason(&picture((2, 1), 8, 3, &palette, &[0, 1, 2]));
            assert!(wrong.starts_with("Chunk length wrong"), "{length}: {wrong}");
        }
        let large = to_pgm(&picture((99_999, 99_999), 1, 0, &[], &[]), Pixel::mean);
        assert_eq!(large, Err(PngError::Size(99_999, 99_999)));
        // One wrong bit of a pixel, which the checksum of the packed pixels shows.
        let mut flipped = good;
        let place = flipped.windows(4).rposition(|w| w == b"IDAT").unwrap() + 4;
        flipped[place] ^= 1;
        assert!(reason(&flipped).starts_with("Corrupt deflate stream."));
    }

    proptest! {
        #[test]
        fn no_picture_panics(
            size in (1_u32..9, 1_u32..9),
            bits in prop::sample::select(&[1_u8, 2, 4, 8, 16][..]),
            kind in 0_u8..7,
            rows in prop::collection::vec(any::<u8>(), 0..600),
            palette in prop::collection::vec(any::<u8>(), 0..30),
        ) {
            _ = to_pgm(&picture(size, bits, kind, &[(b"PLTE", &palette)], &rows), Pixel::on_white);
            _ = to_pgm(&[SIGNATURE, &rows].concat(), Pixel::mean);
        }
    }
}
