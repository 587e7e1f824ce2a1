//! Skips the body of a message.

use httparse::Header;

use crate::http::NotHttp;

/// Longest chunk-size or trailer line, bytes.
const MOST_LINE: usize = 4096;

/// The rest of a body.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Body {
    Length(u64),
    Chunked(Chunked),
    UntilClose,
}

/// The position in a chunked body (RFC 9112, 7.1).
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Chunked {
    /// In the size line of a chunk, with the part received.
    Size(Vec<u8>),
    /// In a chunk, with the bytes left, including its line end.
    Data(u64),
    /// Behind the last chunk, with the length of the current line.
    Trailer(usize),
}

impl Body {
    /// Returns the body that headers describe; `None` for an empty one.
    pub fn of(headers: &[Header<'_>]) -> Result<Option<Self>, NotHttp> {
        let its = |name: &'static str| {
            let is = move |header: &&Header<'_>| header.name.eq_ignore_ascii_case(name);
            headers.iter().filter(is).map(|header| header.value)
        };
        if let Some(coding) = its("transfer-encoding").next_back() {
            let last = coding.rsplit(|byte| *byte == b',').next().unwrap_or_default();
            let is_chunked = last.trim_ascii().eq_ignore_ascii_case(b"chunked");
            return Ok(Some(if is_chunked {
                Self::Chunked(Chunked::Size(Vec::new()))
            } else {
                Self::UntilClose
            }));
        }
        let mut lengths = its("content-length");
        let Some(length) = lengths.next() else { return Ok(Some(Self::UntilClose)) };
        if lengths.any(|other| other != length) {
            return Err(NotHttp);
        }
        let length = std::str::from_utf8(length.trim_ascii()).ok().and_then(|text| text.parse().ok());
        let length: u64 = length.ok_or(NotHttp)?;
        Ok((length > 0).then_some(Self::Length(length)))
    }

    /// Takes its part off the front of `bytes`. Returns whether the body is over.
    pub fn take(&mut self, bytes: &mut &[u8]) -> Result<bool, NotHttp> {
        match self {
            Self::UntilClose => *bytes = &[],
            Self::Length(left) => {
                skip(left, bytes);
                return Ok(*left == 0);
            }
            Self::Chunked(chunked) => {
                while !bytes.is_empty() {
                    if chunked.take(bytes)? {
                        return Ok(true);
                    }
                }
            }
        }
        Ok(false)
    }
}

impl Chunked {
    fn take(&mut self, bytes: &mut &[u8]) -> Result<bool, NotHttp> {
        match self {
            Self::Data(left) => {
                skip(left, bytes);
                if *left == 0 {
                    *self = Self::Size(Vec::new());
                }
            }
            Self::Size(line) => {
                let end = bytes.iter().position(|byte| *byte == b'\n');
                let (more, rest) = bytes.split_at(end.unwrap_or(bytes.len()));
                if line.len() + more.len() > MOST_LINE {
                    return Err(NotHttp);
                }
                line.extend_from_slice(more);
                *bytes = rest;
                if end.is_some() {
                    *bytes = &bytes[1..];
                    *self = match size(line)? {
                        0 => Self::Trailer(0),
                        size => Self::Data(size.checked_add(2).ok_or(NotHttp)?),
                    };
                }
            }
            Self::Trailer(line) => {
                for (place, byte) in bytes.iter().enumerate() {
                    match byte {
                        b'\n' if *line == 0 => {
                            *bytes = &bytes[place + 1..];
                            return Ok(true);
                        }
                        b'\n' => *line = 0,
                        b'\r' => {}
                        _ if *line == MOST_LINE => return Err(NotHttp),
                        _ => *line += 1,
                    }
                }
                *bytes = &[];
            }
        }
        Ok(false)
    }
}

/// Parses a chunk-size line. Ignores extensions.
fn size(line: &[u8]) -> Result<u64, NotHttp> {
    let digits = line.split(|byte| *byte == b';').next().unwrap_or_default().trim_ascii();
    let digits = std::str::from_utf8(digits).map_err(|_| NotHttp)?;
    // `from_str_radix` would accept a sign.
    let is_hex = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    u64::from_str_radix(digits, 16).ok().filter(|_| is_hex).ok_or(NotHttp)
}

fn skip(left: &mut u64, bytes: &mut &[u8]) {
    let skipped = usize::try_from(*left).unwrap_or(usize::MAX).min(bytes.len());
    *left -= skipped as u64;
    *bytes = &bytes[skipped..];
}
