//! Decoding of PNG pictures (ISO/IEC 15948) to greyscale, as PGM.

use std::io::Cursor;

use png::{ColorType, DecodeOptions, Decoder, DecodingError, Info};

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
    fn of_grey(grey: u8, alpha: Option<u8>) -> Self {
        Self { colour: [grey; 3], alpha }
    }

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
    check(decoder.read_header_info()?)?;
    let mut reader = decoder.read_info()?;
    let Info { width, height, color_type, bit_depth, palette, trns, .. } = reader.info().clone();
    let (palette, alphas) = (palette.unwrap_or_default(), trns.unwrap_or_default());
    let size = reader.output_buffer_size().ok_or(PngError::Size(width, height))?;
    let mut samples = vec![0; size];
    let line = reader.next_frame(&mut samples)?.line_size;
    reader.finish()?;
    let channels = color_type.samples();
    let mut pgm = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in samples.chunks_exact(line) {
        let sample = |index: usize| match bit_depth as usize {
            16 => row[2 * index],
            8 => row[index],
            bits => {
                let in_byte = 8 / bits;
                let shift = 8 - bits * (index % in_byte + 1);
                row[index / in_byte] >> shift & (0xff >> (8 - bits))
            }
        };
        for x in 0..width as usize {
            let at = |channel: usize| sample(x * channels + channel);
            let pixel = match color_type {
                ColorType::Grayscale if (bit_depth as u8) < 8 => {
                    Pixel::of_grey((usize::from(at(0)) * 255 / ((1 << bit_depth as usize) - 1)) as u8, None)
                }
                // One transparent colour can be named here, which plans and maps do not use.
                ColorType::Grayscale => Pixel::of_grey(at(0), None),
                ColorType::Rgb => Pixel { colour: [0, 1, 2].map(at), alpha: None },
                ColorType::Indexed => {
                    let index = usize::from(at(0));
                    let Some(&[red, green, blue]) = palette.get(3 * index..3 * index + 3) else {
                        return Err(PngError::Damaged("it uses a colour that its palette lacks".to_owned()));
                    };
                    let alpha = (!alphas.is_empty()).then(|| alphas.get(index).copied().unwrap_or(255));
                    Pixel { colour: [red, green, blue], alpha }
                }
                ColorType::GrayscaleAlpha => Pixel::of_grey(at(0), Some(at(1))),
                ColorType::Rgba => Pixel { colour: [0, 1, 2].map(at), alpha: Some(at(3)) },
            };
            pgm.push(grey(pixel));
        }
    }
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
        assert_eq!(reason(&no_palette), "it uses a colour that its palette lacks");
        // A palette that ends within a colour.
        for length in [4, 5] {
            let palette: [(&[u8; 4], &[u8]); 1] = [(b"PLTE", &vec![9; length])];
            let lacks = reason(&picture((2, 1), 8, 3, &palette, &[0, 0, 1]));
            assert_eq!(lacks, "it uses a colour that its palette lacks", "{length}");
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
