//! Files that the core sends, part by part, when nothing else waits.

use std::{collections::VecDeque, fs::File, io::Read, path::Path};

use crate::frame::{Frame, Kind, numbered};

/// Length of a part, bytes: more urgent frames wait for one at most.
const PART: usize = 32 << 10;
/// Most files that wait at a connection.
const MOST: usize = 16;

/// The files that one agent fetches at the moment.
#[derive(Debug, Default)]
pub(crate) struct Transfers(VecDeque<(u32, File)>);

impl Transfers {
    /// Begins to send a file, as the answer to the fetch with this number. Returns whether that can be done.
    pub(crate) fn begin(&mut self, number: u32, path: &Path) -> bool {
        if self.0.len() >= MOST {
            return false;
        }
        match File::open(path) {
            Ok(file) => self.0.push_back((number, file)),
            Err(error) => {
                tracing::warn!("an agent needs {}: {error}", path.display());
                return false;
            }
        }
        true
    }

    /// Returns the next part.
    pub(crate) fn poll(&mut self) -> Option<Frame> {
        let (number, file) = self.0.front_mut()?;
        let number = *number;
        let mut part = Vec::with_capacity(PART);
        let read = file.take(PART as u64).read_to_end(&mut part);
        if part.is_empty() || read.is_err() {
            self.0.pop_front();
        }
        Some(match read {
            Ok(_) => Frame { kind: Kind::Part, message: numbered(number, &part) },
            Err(error) => {
                tracing::warn!("cannot send a file to an agent: {error}");
                Frame { kind: Kind::Missing, message: numbered(number, &[]) }
            }
        })
    }
}
