//! Collects the head of a message.

use crate::http::NotHttp;

/// Longest head, bytes.
const MOST: usize = 32 << 10;
/// Most headers of a message.
pub(crate) const MOST_HEADERS: usize = 128;

/// A partly received head.
#[derive(Debug, Default)]
pub(crate) struct Head {
    bytes: Vec<u8>,
    /// Length of the last line, without carriage returns.
    line: usize,
}

impl Head {
    /// Takes its part off the front of `bytes`. Returns whether the head is complete.
    pub fn take(&mut self, bytes: &mut &[u8]) -> Result<bool, NotHttp> {
        for (place, byte) in bytes.iter().enumerate() {
            // RFC 9112, 2.2: empty lines before a request are ignored.
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
