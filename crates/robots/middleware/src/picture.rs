//! Images of a robot's camera in ROS: pixels without padding, or JPEG and PNG files.

use std::sync::Arc;

use cotorra_graph::DataFormat;
use cotorra_ros_messages::Image;

/// An image.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Encoding of the bytes.
    pub format: DataFormat,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Encoded bytes.
    pub bytes: Arc<[u8]>,
}

/// The reason for which an image message cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NoPicture {
    /// The pixels have another encoding.
    #[error("its pixels are `{0}`, where `mono8`, `rgb8` and `bgr8` are read")]
    Encoding(String),
    /// The image is empty, or has too few bytes.
    #[error("an image of {width} x {height} pixels in rows of {step} bytes does not fit {bytes} bytes")]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes from one row to the next.
        step: u32,
        /// Bytes in the message.
        bytes: usize,
    },
    /// The file has another format.
    #[error("its image is neither a JPEG nor a PNG file, but `{0}`")]
    File(String),
}

/// Reads pixels row by row, without padding. Swaps blue and red of `bgr8`.
pub(crate) fn image(message: Image) -> Result<Picture, NoPicture> {
    let (format, pixel, is_bgr) = match message.encoding.as_str() {
        "mono8" | "8UC1" => (DataFormat::Mono8, 1, false),
        "rgb8" => (DataFormat::Rgb8, 3, false),
        "bgr8" => (DataFormat::Rgb8, 3, true),
        _ => return Err(NoPicture::Encoding(shortened(&message.encoding))),
    };
    let Image { width, height, step, .. } = message;
    let mut bytes = message.data;
    let (row, rows, stride) = (width as usize * pixel, height as usize, step as usize);
    // The last row needs no padding.
    let needed = rows.checked_sub(1).and_then(|rows| rows.checked_mul(stride)?.checked_add(row));
    if row == 0 || stride < row || needed.is_none_or(|needed| needed > bytes.len()) {
        return Err(NoPicture::Size { width, height, step, bytes: bytes.len() });
    }
    for number in 1..if stride == row { 0 } else { rows } {
        bytes.copy_within(number * stride..number * stride + row, number * row);
    }
    bytes.truncate(rows * row);
    if is_bgr {
        let (pixels, _) = bytes.as_chunks_mut::<3>();
        pixels.iter_mut().for_each(|pixel| pixel.swap(0, 2));
    }
    Ok(Picture { format, width, height, bytes: bytes.into() })
}

/// Reads a file. Format and size are those of its header; `called` is the format that the message names, for errors.
pub(crate) fn file(bytes: Vec<u8>, called: &str) -> Result<Picture, NoPicture> {
    let png = png(&bytes).map(|size| (DataFormat::Png, size));
    let known = png.or_else(|| jpeg(&bytes).map(|size| (DataFormat::Jpeg, size)));
    let (format, (width, height)) = known.ok_or_else(|| NoPicture::File(shortened(called)))?;
    Ok(Picture { format, width, height, bytes: bytes.into() })
}

/// Shortens the text of a message for a notice.
fn shortened(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(32).collect()
}

/// Returns columns and rows of a PNG file, from its first chunk.
fn png(bytes: &[u8]) -> Option<(u32, u32)> {
    let header = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR")?;
    let (width, rest) = header.split_first_chunk()?;
    Some((u32::from_be_bytes(*width), u32::from_be_bytes(*rest.first_chunk()?)))
}

/// Returns columns and rows of a JPEG file, from its frame header (ITU-T T.81, B.2.2).
fn jpeg(bytes: &[u8]) -> Option<(u32, u32)> {
    let mut rest = bytes.strip_prefix(b"\xff\xd8")?;
    loop {
        let [0xff, marker, segment @ ..] = rest else { return None };
        match marker {
            // Fill bytes may precede a marker.
            0xff => rest = &rest[1..],
            // These have no length.
            0x01 | 0xd0..=0xd7 => rest = segment,
            // The scan, or the end of the image.
            0xd9 | 0xda => return None,
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                let [_, _, _, high, low, wide, narrow, ..] = segment else { return None };
                let of = |bytes| u32::from(u16::from_be_bytes(bytes));
                return Some((of([*wide, *narrow]), of([*high, *low])));
            }
            _ => {
                let length = u16::from_be_bytes(*segment.first_chunk()?);
                rest = segment.get(usize::from(length)..)?;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn message(encoding: &str, (width, height, step): (u32, u32, u32), data: &[u8]) -> Image {
        let data = data.to_vec();
        Image { encoding: encoding.to_owned(), width, height, step, data, ..Image::default() }
    }

    #[test]
    fn padding_is_removed_and_bgr_is_converted_to_rgb() {
        let read = |encoding, size, data: &[u8]| {
            image(message(encoding, size, data)).map(|picture| (picture.format, picture.bytes.to_vec()))
        };
        let mono = Ok((DataFormat::Mono8, vec![1, 2, 3, 4]));
        assert_eq!(read("mono8", (2, 2, 2), &[1, 2, 3, 4, 9]), mono);
        assert_eq!(read("mono8", (2, 2, 3), &[1, 2, 0, 3, 4]), mono);
        let rgb = Ok((DataFormat::Rgb8, vec![1, 2, 3, 4, 5, 6]));
        assert_eq!(read("rgb8", (1, 2, 3), &[1, 2, 3, 4, 5, 6]), rgb);
        assert_eq!(read("bgr8", (1, 2, 4), &[3, 2, 1, 0, 6, 5, 4, 0]), rgb);
    }

    #[test]
    fn invalid_images_are_rejected() {
        let depth = image(message("16UC1", (1, 1, 2), &[0, 0])).unwrap_err();
        assert_eq!(depth.to_string(), "its pixels are `16UC1`, where `mono8`, `rgb8` and `bgr8` are read");
        for size in [(0, 1, 1), (1, 0, 1), (2, 1, 1), (2, 3, 2), (u32::MAX, u32::MAX, u32::MAX)] {
            let refused = image(message("mono8", size, &[0; 5]));
            assert!(matches!(refused, Err(NoPicture::Size { .. })), "{size:?}");
        }
        assert_eq!(file(b"MM".to_vec(), "tiff\n"), Err(NoPicture::File("tiff".to_owned())));
    }

    #[test]
    fn size_is_read_from_file_headers() {
        // The beginning of a JPEG with JFIF's segment, a filled marker and a frame of 320 x 240.
        let mut jpeg =
            b"\xff\xd8\xff\xe0\0\x04JF\xff\xff\xdb\0\x02\xff\xc2\0\x0b\x08\0\xf0\x01\x40\x01".to_vec();
        let picture = file(jpeg.clone(), "rgb8; jpeg compressed bgr8").unwrap();
        assert_eq!((picture.format, picture.width, picture.height), (DataFormat::Jpeg, 320, 240));
        assert_eq!(*picture.bytes, jpeg);
        jpeg[3] = 0xda;
        assert!(file(jpeg, "jpeg").is_err(), "pixels before the frame's header");
        let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02";
        let picture = file(png.to_vec(), "png").unwrap();
        assert_eq!((picture.format, picture.width, picture.height), (DataFormat::Png, 640, 480));
    }

    proptest! {
        #[test]
        fn arbitrary_files_never_panic(
            rest in any::<Vec<u8>>(),
            begin in prop::sample::select(vec![&b"\xff\xd8"[..], b"\xff\xd8\xff\xc0", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b""]),
        ) {
            let _ = file([begin, &rest].concat(), "");
        }

        #[test]
        fn images_have_as_many_bytes_as_pixels(
            encoding in prop::sample::select(vec!["mono8", "rgb8", "bgr8"]),
            size in (0u32..40, 0u32..40, 0u32..140),
            data in proptest::collection::vec(any::<u8>(), 0..6000),
        ) {
            if let Ok(picture) = image(message(encoding, size, &data)) {
                let pixel = if picture.format == DataFormat::Mono8 { 1 } else { 3 };
                prop_assert_eq!(picture.bytes.len() as u32, picture.width * picture.height * pixel);
            }
        }
    }
}
