//! The head of a message, gathered.

/// The bytes are not HTTP/1, or exceed a bound.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NotHttp;

/// So long a head is at most.
const MOST: usize = 32 << 10;
/// So many headers it has at most.
pub(super) const MOST_HEADERS: usize = 128;

/// A head as far as it has come.
#[derive(Debug, Default)]
pub(crate) struct Head {
    bytes: Vec<u8>,
    /// Bytes of the last line but carriage returns.
    line: usize,
}

impl Head {
    /// Takes what belongs to it off the front of `bytes`; gives whether it is whole.
    pub fn take(&mut self, bytes: &mut &[u8]) -> Result<bool, NotHttp> {
        for (place, byte) in bytes.iter().enumerate() {
            // RFC 9112, 2.2: empty lines in front of a request are ignored.
            if self.bytes.is_empty() && matches!(byte, b'\r' | b'\n') {
                continue;
            }
            if self.bytes.len() == MOST {
                return Err(NotHttp);
            }
            self.bytes.push(*byte);
            match byte {
                b'\r' => {}
                b'\n' if self.line == 0 => {
                    *bytes = &bytes[place + 1..];
                    return Ok(true);
                }
                b'\n' => self.line = 0,
                _ => self.line += 1,
            }
        }
        *bytes = &[];
        Ok(false)
    }

    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}
