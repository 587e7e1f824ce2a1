//! Decoding of PNG pictures (ISO/IEC 15948) to greyscale, as PGM.

use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;

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
    Damaged(&'static str),
    #[error("a PNG picture of {0} × {1} pixels is too large; scale it down to {MAX_PIXELS} pixels or fewer")]
    Size(u32, u32),
    #[error("the PNG picture is interlaced; save it without interlacing")]
    Interlaced,
}

/// Header of a picture.
struct Header {
    width: usize,
    height: usize,
    bits: usize,
    /// Bit 0: palette; bit 1: colour; bit 2: alpha.
    kind: u8,
}

impl Header {
    fn parse(data: &[u8]) -> Result<Self, PngError> {
        let damaged = PngError::Damaged("its header is not valid");
        let &[a, b, c, d, e, f, g, h, bits, kind, compression, filter, interlace] = data else {
            return Err(damaged);
        };
        let (width, height) = (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h]));
        let depths: &[u8] = match kind {
            0 => &[1, 2, 4, 8, 16],
            3 => &[1, 2, 4, 8],
            2 | 4 | 6 => &[8, 16],
            _ => return Err(damaged),
        };
        if !depths.contains(&bits) || (compression, filter) != (0, 0) || width == 0 || height == 0 {
            return Err(damaged);
        }
        if interlace != 0 {
            return Err(PngError::Interlaced);
        }
        let header = Self { width: width as usize, height: height as usize, bits: bits.into(), kind };
        let pixels = header.width.checked_mul(header.height).filter(|&pixels| pixels <= MAX_PIXELS);
        let raw = pixels.and_then(|_| header.height.checked_mul(1 + header.row()));
        match raw {
            Some(raw) if raw <= MAX_RAW => Ok(header),
            _ => Err(PngError::Size(width, height)),
        }
    }

    fn channels(&self) -> usize {
        match self.kind {
            2 => 3,
            4 => 2,
            6 => 4,
            _ => 1,
        }
    }

    /// Bytes of a row without its filter.
    fn row(&self) -> usize {
        (self.width * self.channels() * self.bits).div_ceil(8)
    }

    /// Bytes from a byte to the one of the pixel before, for filters.
    fn step(&self) -> usize {
        (self.channels() * self.bits).div_ceil(8)
    }
}

/// Decodes a PNG picture to a PGM picture. Transparent pixels become white.
///
/// # Errors
/// [`PngError`] if it is damaged, too large or interlaced.
pub fn to_pgm(bytes: &[u8]) -> Result<Vec<u8>, PngError> {
    let mut rest = bytes.strip_prefix(SIGNATURE).ok_or(PngError::Damaged("its signature is missing"))?;
    let (mut header, mut palette, mut alphas, mut packed) = (None, &[][..], &[][..], Vec::new());
    loop {
        let (kind, data) = chunk(&mut rest).ok_or(PngError::Damaged("it ends before its last chunk"))?;
        match (kind, &header) {
            (b"IHDR", None) => header = Some(Header::parse(data)?),
            (_, None) => return Err(PngError::Damaged("it does not begin with a header")),
            (b"PLTE", _) => palette = data,
            // Of greyscale and colour it names one transparent colour, which plans do not use.
            (b"tRNS", Some(Header { kind: 3, .. })) => alphas = data,
            (b"IDAT", _) => packed.extend_from_slice(data),
            (b"IEND", Some(header)) => return decode(header, palette, alphas, &packed),
            _ => {}
        }
    }
}

/// Takes a chunk off the front: its kind and its data. The checksum of the pixels is checked when they are unpacked.
fn chunk<'a>(rest: &mut &'a [u8]) -> Option<(&'a [u8; 4], &'a [u8])> {
    let (length, behind) = rest.split_first_chunk::<4>()?;
    let (kind, behind) = behind.split_first_chunk::<4>()?;
    let (data, behind) = behind.split_at_checked(u32::from_be_bytes(*length) as usize)?;
    *rest = behind.get(4..)?;
    Some((kind, data))
}

fn decode(header: &Header, palette: &[u8], alphas: &[u8], packed: &[u8]) -> Result<Vec<u8>, PngError> {
    let row = header.row();
    let wanted = header.height * (1 + row);
    let raw = decompress_to_vec_zlib_with_limit(packed, wanted)
        .map_err(|_| PngError::Damaged("its pixels cannot be unpacked"))?;
    if raw.len() < wanted {
        return Err(PngError::Damaged("it has too few pixels"));
    }
    let mut pgm = format!("P5\n{} {}\n255\n", header.width, header.height).into_bytes();
    let mut above = vec![0; row];
    for line in raw.chunks_exact(1 + row) {
        let mut line = line.to_vec();
        unfilter(line[0], &mut line[1..], &above, header.step())?;
        let pixels = &line[1..];
        let sample = |index: usize| match header.bits {
            16 => pixels[2 * index],
            8 => pixels[index],
            bits => {
                let in_byte = 8 / bits;
                let shift = 8 - bits * (index % in_byte + 1);
                pixels[index / in_byte] >> shift & (0xff >> (8 - bits))
            }
        };
        for x in 0..header.width {
            let at = |channel: usize| sample(x * header.channels() + channel);
            pgm.push(match header.kind {
                0 if header.bits < 8 => (usize::from(at(0)) * 255 / ((1 << header.bits) - 1)) as u8,
                0 => at(0),
                2 => grey(at(0), at(1), at(2)),
                3 => {
                    let index = usize::from(at(0));
                    let Some(&[red, green, blue]) = palette.get(3 * index..3 * index + 3) else {
                        return Err(PngError::Damaged("it uses a colour that its palette lacks"));
                    };
                    on_white(grey(red, green, blue), alphas.get(index).copied().unwrap_or(255))
                }
                4 => on_white(at(0), at(1)),
                _ => on_white(grey(at(0), at(1), at(2)), at(3)),
            });
        }
        above.copy_from_slice(pixels);
    }
    Ok(pgm)
}

/// Undoes the filter of a row, in place.
fn unfilter(filter: u8, line: &mut [u8], above: &[u8], step: usize) -> Result<(), PngError> {
    for i in 0..line.len() {
        let left = if i < step { 0 } else { line[i - step] };
        let above_left = if i < step { 0 } else { above[i - step] };
        let predicted = match filter {
            0 => 0,
            1 => left,
            2 => above[i],
            3 => ((u16::from(left) + u16::from(above[i])) / 2) as u8,
            4 => paeth(left, above[i], above_left),
            _ => return Err(PngError::Damaged("a row has an unknown filter")),
        };
        line[i] = line[i].wrapping_add(predicted);
    }
    Ok(())
}

/// Returns the neighbour that is nearest to their linear prediction (section 9.4 of the standard).
fn paeth(left: u8, above: u8, above_left: u8) -> u8 {
    let [a, b, c] = [left, above, above_left].map(i16::from);
    let (da, db, dc) = ((b - c).abs(), (a - c).abs(), (a + b - 2 * c).abs());
    if da <= db && da <= dc {
        left
    } else if db <= dc {
        above
    } else {
        above_left
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
        let damaged = |reason| Err(PngError::Damaged(reason));
        assert_eq!(to_pgm(&png((2, 2), 8, 0, &[], &[0, 1, 2])), damaged("it has too few pixels"));
        assert_eq!(to_pgm(&png((2, 1), 8, 0, &[], &[9, 1, 2])), damaged("a row has an unknown filter"));
        assert_eq!(to_pgm(&png((2, 1), 3, 0, &[], &[0, 1])), damaged("its header is not valid"));
        let no_palette = png((2, 1), 8, 3, &[], &[0, 1, 2]);
        assert_eq!(to_pgm(&no_palette), damaged("it uses a colour that its palette lacks"));
        assert_eq!(to_pgm(&png((99_999, 99_999), 1, 0, &[], &[])), Err(PngError::Size(99_999, 99_999)));
        let mut interlaced = good.clone();
        interlaced[SIGNATURE.len() + 8 + 12] = 1;
        assert_eq!(to_pgm(&interlaced), Err(PngError::Interlaced));
        // One wrong bit of a pixel, which the checksum of the packed pixels shows.
        let mut flipped = good;
        let place = flipped.windows(4).rposition(|w| w == b"IDAT").unwrap() + 4;
        flipped[place] ^= 1;
        assert_eq!(to_pgm(&flipped), damaged("its pixels cannot be unpacked"));
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
