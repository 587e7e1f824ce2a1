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
    #[error("the PNG picture is cut off or damaged: {0}")]
    Damaged(String),
    #[error("a PNG picture of {0} × {1} pixels is too large; scale it down to {MAX_PIXELS} pixels or fewer")]
    Size(u32, u32),
    #[error("the PNG picture is interlaced; save it without interlacing")]
    Interlaced,
}

impl From<DecodingError> for PngError {
    fn from(error: DecodingError) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// Decodes a PNG picture to a PGM picture. Transparent pixels become white.
///
/// # Errors
/// [`PngError`] if it is damaged, too large or interlaced.
pub fn to_pgm(bytes: &[u8]) -> Result<Vec<u8>, PngError> {
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
    let channels = color_type.samples();
    let mut pgm = format!("P5\n{width} {height}\n255\n").into_bytes();
    while let Some(row) = reader.next_row()? {
        let sample = |index: usize| match bit_depth as usize {
            16 => row.data()[2 * index],
            8 => row.data()[index],
            bits => {
                let in_byte = 8 / bits;
                let shift = 8 - bits * (index % in_byte + 1);
                row.data()[index / in_byte] >> shift & (0xff >> (8 - bits))
            }
        };
        for x in 0..width as usize {
            let at = |channel: usize| sample(x * channels + channel);
            pgm.push(match color_type {
                ColorType::Grayscale if (bit_depth as u8) < 8 => {
                    (usize::from(at(0)) * 255 / ((1 << bit_depth as usize) - 1)) as u8
                }
                // One transparent colour can be named here, which plans do not use.
                ColorType::Grayscale => at(0),
                ColorType::Rgb => grey(at(0), at(1), at(2)),
                ColorType::Indexed => {
                    let index = usize::from(at(0));
                    let Some(&[red, green, blue]) = palette.get(3 * index..3 * index + 3) else {
                        return Err(PngError::Damaged("it uses a colour that its palette lacks".to_owned()));
                    };
                    on_white(grey(red, green, blue), alphas.get(index).copied().unwrap_or(255))
                }
                ColorType::GrayscaleAlpha => on_white(at(0), at(1)),
                ColorType::Rgba => on_white(grey(at(0), at(1), at(2)), at(3)),
            });
        }
    }
    reader.finish()?;
    Ok(pgm)
}

/// Checks that a picture is one that is read.
fn check(header: &Info<'_>) -> Result<(), PngError> {
    if header.interlaced {
        return Err(PngError::Interlaced);
    }
    let (width, height) = (header.width as usize, header.height as usize);
    let pixels = width.checked_mul(height).filter(|&pixels| pixels <= MAX_PIXELS);
    let raw = pixels.and_then(|_| height.checked_mul(header.raw_row_length()));
    match raw {
        Some(raw) if raw <= MAX_RAW => Ok(()),
        _ => Err(PngError::Size(header.width, header.height)),
    }
}

/// Returns the luma of a colour (ITU-R BT.601).
fn grey(red: u8, green: u8, blue: u8) -> u8 {
    ((299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue)) / 1000) as u8
}

fn on_white(grey: u8, alpha: u8) -> u8 {
    255 - (u16::from(255 - grey) * u16::from(alpha) / 255) as u8
}

#[cfg(test)]
pub mod tests {
    use miniz_oxide::deflate::compress_to_vec_zlib;
    use proptest::prelude::*;

    use super::*;

    /// Encodes a picture from its rows, each of which begins with its filter.
    pub fn png(size: (u32, u32), bits: u8, kind: u8, more: &[(&[u8; 4], &[u8])], rows: &[u8]) -> Vec<u8> {
        let header = [&size.0.to_be_bytes()[..], &size.1.to_be_bytes(), &[bits, kind, 0, 0, 0]].concat();
        let packed = compress_to_vec_zlib(rows, 6);
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

    fn pixels(png: &[u8]) -> Vec<u8> {
        let pgm = to_pgm(png).unwrap();
        let start = pgm.windows(5).position(|w| w == b"\n255\n").unwrap() + 5;
        pgm[start..].to_vec()
    }

    #[test]
    fn every_kind_of_pixel_becomes_grey() {
        // Black, white and something between, in each kind.
        assert_eq!(pixels(&png((3, 1), 8, 0, &[], &[0, 0, 255, 100])), [0, 255, 100]);
        assert_eq!(pixels(&png((3, 1), 16, 0, &[], &[0, 0, 0, 255, 255, 100, 7])), [0, 255, 100]);
        assert_eq!(pixels(&png((3, 1), 1, 0, &[], &[0, 0b0100_0000])), [0, 255, 0]);
        assert_eq!(pixels(&png((3, 1), 2, 0, &[], &[0, 0b0011_0100])), [0, 255, 85]);
        assert_eq!(pixels(&png((3, 1), 4, 0, &[], &[0, 0x0f, 0x50])), [0, 255, 85]);
        assert_eq!(pixels(&png((3, 1), 8, 2, &[], &[0, 0, 0, 0, 255, 255, 255, 255, 0, 0])), [0, 255, 76]);
        assert_eq!(pixels(&png((3, 1), 8, 4, &[], &[0, 0, 255, 0, 0, 100, 255])), [0, 255, 100]);
        let with_alpha = [0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 0, 0, 51];
        assert_eq!(pixels(&png((3, 1), 8, 6, &[], &with_alpha)), [0, 255, 204]);
        let palette: [(&[u8; 4], &[u8]); 2] =
            [(b"PLTE", &[9, 9, 9, 0, 0, 0, 0, 0, 0]), (b"tRNS", &[255, 255, 0])];
        assert_eq!(pixels(&png((3, 1), 2, 3, &palette, &[0, 0b0001_1000])), [9, 0, 255]);
    }

    #[test]
    fn filters_are_undone() {
        // 10 20 30 on 1 2 3, by each filter in turn; the row above the first is 0.
        let first = [0, 1, 2, 3];
        for second in [[0, 10, 20, 30], [1, 10, 10, 10], [2, 9, 18, 27], [3, 10, 14, 19], [4, 9, 10, 10]] {
            let rows = [first, second].concat();
            assert_eq!(pixels(&png((3, 2), 8, 0, &[], &rows)), [1, 2, 3, 10, 20, 30], "{second:?}");
        }
    }

    #[test]
    fn invalid_pictures_are_rejected() {
        let good = png((2, 1), 8, 0, &[], &[0, 1, 2]);
        assert!(to_pgm(&good).is_ok());
        for length in 0..good.len() {
            assert!(matches!(to_pgm(&good[..length]), Err(PngError::Damaged(_))), "{length}");
        }
        let reason = |picture: &[u8]| match to_pgm(picture) {
            Err(PngError::Damaged(reason)) => reason,
            other => panic!("{other:?}"),
        };
        assert_eq!(
            reason(&png((2, 2), 8, 0, &[], &[0, 1, 2])),
            "IDAT or fDAT chunk does not have enough data for image."
        );
        assert_eq!(reason(&png((2, 1), 8, 0, &[], &[9, 1, 2])), "Unknown filter method 9.");
        assert_eq!(reason(&png((2, 1), 3, 0, &[], &[0, 1])), "Invalid bit depth 3.");
        let no_palette = png((2, 1), 8, 3, &[], &[0, 1, 2]);
        assert_eq!(reason(&no_palette), "it uses a colour that its palette lacks");
        assert_eq!(to_pgm(&png((99_999, 99_999), 1, 0, &[], &[])), Err(PngError::Size(99_999, 99_999)));
        let mut interlaced = good.clone();
        interlaced[SIGNATURE.len() + 8 + 12] = 1;
        assert_eq!(to_pgm(&interlaced), Err(PngError::Interlaced));
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
            _ = to_pgm(&png(size, bits, kind, &[(b"PLTE", &palette)], &rows));
            _ = to_pgm(&[SIGNATURE, &rows].concat());
        }
    }
}
