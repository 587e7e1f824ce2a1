//! Files that the core sends to machines.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// A file of the run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shipped {
    /// Path from the run's folder, with `/` between names.
    pub path: String,
    /// Its size, bytes.
    pub bytes: u64,
    /// Its SHA-256 in hexadecimal digits, by which it is asked for.
    pub sha256: String,
    /// Whether it can be executed.
    pub executable: bool,
}

impl Shipped {
    /// Describes a file with these contents.
    pub fn new(path: String, contents: &[u8], executable: bool) -> Self {
        Self { path, bytes: contents.len() as u64, sha256: sha256(contents), executable }
    }

    /// Whether these are the file's contents.
    pub fn has(&self, contents: &[u8]) -> bool {
        contents.len() as u64 == self.bytes && sha256(contents) == self.sha256
    }
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_its_contents_and_no_others() {
        let file = Shipped::new("a".to_owned(), b"abc", false);
        // FIPS 180-2, appendix B.1.
        assert_eq!(file.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert!(file.has(b"abc") && !file.has(b"abd") && !file.has(b"ab"));
    }
}
