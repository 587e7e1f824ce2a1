//! Reads files whose size has a bound.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

/// Bytes of a text: a testbed file, a map's description, a trace. A graph of as many hosts as have addresses fits.
pub(crate) const MAX_TEXT: usize = 32 << 20;

/// Reads a regular file of at most this many bytes. A device or a pipe is refused: it might never end, or never begin.
pub(crate) fn read(path: &Path, most: usize) -> io::Result<Vec<u8>> {
    // Asked before it is opened, which waits for a pipe's other end.
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file"));
    }
    read_at_most(File::open(path)?, most)
}

/// As [`read`], of a text.
pub(crate) fn read_text(path: &Path) -> io::Result<String> {
    read_text_of(path, MAX_TEXT)
}

/// As [`read`], of a text of at most this many bytes.
pub(crate) fn read_text_of(path: &Path, most: usize) -> io::Result<String> {
    text(read(path, most)?)
}

/// As [`read_text`], of what may also be a pipe.
pub(crate) fn read_text_or_pipe(path: &Path) -> io::Result<String> {
    text(read_at_most(File::open(path)?, MAX_TEXT)?)
}

fn read_at_most(file: File, most: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(most as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > most {
        let reason = format!("it has more than {most} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, reason));
    }
    Ok(bytes)
}

/// Returns a text without its byte order mark.
fn text(mut bytes: Vec<u8>) -> io::Result<String> {
    if bytes.starts_with("\u{feff}".as_bytes()) {
        bytes.drain(..'\u{feff}'.len_utf8());
    }
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_within_the_bound_is_read_and_a_longer_one_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, [7; 100]).unwrap();
        assert_eq!(read(&path, 100).unwrap(), [7; 100]);
        assert_eq!(read(&path, 99).unwrap_err().to_string(), "it has more than 99 bytes");
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_a_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "\u{feff}name: x\u{feff}").unwrap();
        assert_eq!(read_text(&path).unwrap(), "name: x\u{feff}");
    }

    #[test]
    fn a_device_and_a_folder_are_rejected_before_they_are_read() {
        for path in ["/dev/zero", "/"] {
            assert_eq!(read(Path::new(path), 100).unwrap_err().to_string(), "it is not a regular file");
        }
    }

    #[test]
    fn an_endless_testbed_file_is_rejected() {
        let error = read_text_or_pipe(Path::new("/dev/zero")).unwrap_err();
        assert_eq!(error.to_string(), format!("it has more than {MAX_TEXT} bytes"));
    }
}
