//! Captures into files, in virtual time. The fabric's thread writes them, so that no packet is missed.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use cotorra_graph::{InvalidId, LinkId};
use parking_lot::Mutex;

use super::{
    WHOLE, Wiretap,
    pcapng::{Captured, Writer},
};

/// Most bytes of a file.
const MOST_BYTES: u64 = 10_000_000_000;

/// A capture from the beginning of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CapturePlan {
    /// The link, or the node whose links are captured.
    pub of: LinkId,
    /// The file, which must not exist.
    pub file: PathBuf,
}

/// Error of a capture into a file.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// There is no such link or node, or another reason.
    #[error("cannot capture: {0}")]
    Refused(String),
    /// The file exists.
    #[error("{} exists already, and is not overwritten: choose another file, or remove it first", .0.display())]
    Exists(PathBuf),
    /// The file cannot be created.
    #[error("cannot write {}: {source}", path.display())]
    File {
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// Error of a text that is not a capture's plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidCapturePlan {
    /// The file is missing.
    #[error("write it like lan-cloud=cloud.pcapng")]
    NoFile,
    /// The link's or node's name.
    #[error(transparent)]
    Name(#[from] InvalidId),
}

impl FromStr for CapturePlan {
    type Err = InvalidCapturePlan;

    fn from_str(text: &str) -> Result<Self, InvalidCapturePlan> {
        let (of, file) = text.split_once('=').ok_or(InvalidCapturePlan::NoFile)?;
        if file.is_empty() {
            return Err(InvalidCapturePlan::NoFile);
        }
        Ok(Self { of: of.parse()?, file: file.into() })
    }
}

/// Creates the file of a capture.
///
/// # Errors
/// [`CaptureError`], also if it exists.
pub fn create_capture(path: &Path) -> Result<File, CaptureError> {
    File::create_new(path).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => CaptureError::Exists(path.to_owned()),
        _ => CaptureError::File { path: path.to_owned(), source },
    })
}

/// A file that packets are written to.
#[derive(Debug)]
pub(crate) struct CaptureFile {
    path: PathBuf,
    output: Arc<Mutex<Output>>,
}

#[derive(Debug)]
struct Output {
    file: BufWriter<File>,
    /// Bytes that may still be written.
    room: u64,
    writer: Writer,
    buffer: Vec<u8>,
    failed: Option<io::Error>,
}

impl Output {
    fn write_out(&mut self) {
        let room = self.room.checked_sub(self.buffer.len() as u64);
        let written = match room {
            Some(room) => {
                self.room = room;
                self.file.write_all(&self.buffer)
            }
            None => {
                Err(io::Error::other("it ends before it is too large: capture a link with fewer packets"))
            }
        };
        self.failed = written.err();
        self.buffer.clear();
    }
}

impl CaptureFile {
    /// Begins captures. If one cannot begin, no file is left.
    ///
    /// # Errors
    /// [`CaptureError`].
    pub(crate) fn begin_all(plans: &[CapturePlan], wiretap: &Wiretap) -> Result<Vec<Self>, CaptureError> {
        let mut begun: Vec<Self> = Vec::new();
        for plan in plans {
            match Self::begin(plan, wiretap) {
                Ok(capture) => begun.push(capture),
                Err(error) => {
                    begun.iter().for_each(|capture| drop(std::fs::remove_file(&capture.path)));
                    return Err(error);
                }
            }
        }
        Ok(begun)
    }

    fn begin(plan: &CapturePlan, wiretap: &Wiretap) -> Result<Self, CaptureError> {
        Self::within(MOST_BYTES, plan, wiretap)
    }

    /// Begins a capture of at most this many bytes.
    fn within(room: u64, plan: &CapturePlan, wiretap: &Wiretap) -> Result<Self, CaptureError> {
        let mut buffer = Vec::new();
        let writer = Writer::new(WHOLE, &mut buffer);
        let file = BufWriter::new(create_capture(&plan.file)?);
        let mut output = Output { file, room, writer, buffer, failed: None };
        output.write_out();
        let output = Arc::new(Mutex::new(output));
        let filled = Arc::clone(&output);
        let begun = wiretap(
            plan.of.as_str(),
            Box::new(move |passage| {
                let mut output = filled.lock();
                let Output { writer, buffer, failed, .. } = &mut *output;
                if let (Some(passage), None) = (passage, failed) {
                    writer.write(Captured::new(passage, 0), buffer);
                    output.write_out();
                }
                output.failed.is_none()
            }),
        );
        if let Err(error) = begun {
            // It has no packets, and was created just now.
            let _ = std::fs::remove_file(&plan.file);
            return Err(CaptureError::Refused(error.to_string()));
        }
        Ok(Self { path: plan.file.clone(), output })
    }

    /// Ends a capture. Returns what is missing in its file, if anything.
    pub(crate) fn finish(self) -> Option<String> {
        let Output { file, failed, .. } = &mut *self.output.lock();
        let failed = failed.take().or_else(|| file.flush().err());
        failed.map(|error| format!("{} is not complete: {error}", self.path.display()))
    }
}
