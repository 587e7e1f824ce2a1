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

#[cfg(test)]
mod tests {
    use cotorra_fabric::{Fabric, Frame, PortId};
    use cotorra_graph::{HostAddress, Timestamp};

    use super::*;

    fn fabric() -> Arc<Mutex<Fabric>> {
        let text = "
name: captured
nodes:
  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  right: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links: [{ ends: [left, right] }]
";
        let testbed = cotorra_testbed_file::parse("captured.yaml", text, Path::new("")).unwrap();
        Arc::new(Mutex::new(Fabric::new(&testbed.graph, 1).unwrap()))
    }

    fn wiretap(fabric: &Arc<Mutex<Fabric>>) -> Wiretap {
        let fabric = Arc::clone(fabric);
        Arc::new(move |name, reader| Ok(fabric.lock().tap(name, reader)?))
    }

    /// Sends a broadcast.
    fn send(fabric: &Mutex<Fabric>, at_s: f64, length: usize) {
        let mut fabric = fabric.lock();
        let mut frame = vec![0xff; length];
        frame[6..12].copy_from_slice(&HostAddress::of(0).mac);
        fabric.push(Timestamp::from_secs_f64(at_s), PortId(0), Frame::new(frame));
        fabric.poll(Timestamp::from_secs_f64(at_s + 1.0), &mut |_, _| {});
    }

    #[test]
    fn a_file_ends_after_a_whole_packet_before_it_is_too_large() {
        let (fabric, folder) = (fabric(), tempfile::tempdir().unwrap());
        let plan = |name| CapturePlan { of: "right".parse().unwrap(), file: folder.path().join(name) };
        let [whole, cut] = ["whole.pcapng", "cut.pcapng"].map(plan);
        let captures = [(1000, &cut), (MOST_BYTES, &whole)]
            .map(|(room, plan)| CaptureFile::within(room, plan, &wiretap(&fabric)));
        send(&fabric, 0.0, 100);
        send(&fabric, 2.0, 1000);
        let [cut_end, whole_end] = captures.map(|capture| capture.unwrap().finish());
        assert!(cut_end.is_some_and(|reason| reason.contains("cut.pcapng is not complete: it ends before")));
        assert_eq!(whole_end, None);
        let [cut, whole] = [cut, whole].map(|plan| std::fs::read(plan.file).unwrap());
        assert!(whole.starts_with(&cut) && cut.len() > 200 && whole.len() > cut.len() + 1000);
    }

    #[test]
    fn nothing_is_left_of_a_capture_that_cannot_begin() {
        let (fabric, folder) = (fabric(), tempfile::tempdir().unwrap());
        let plan = |of: &str| format!("{of}={}", folder.path().join(of).display()).parse().unwrap();
        let plans: [CapturePlan; 3] = ["left", "right", "nothing"].map(plan);
        let error = CaptureFile::begin_all(&plans, &wiretap(&fabric)).unwrap_err().to_string();
        assert_eq!(error, "cannot capture: there is no link or node `nothing`");
        assert!(plans.iter().all(|plan| !plan.file.exists()));
        // Files of others stay.
        std::fs::write(&plans[1].file, "others").unwrap();
        let error = CaptureFile::begin_all(&plans, &wiretap(&fabric)).unwrap_err().to_string();
        assert!(error.contains("right exists already"), "{error}");
        assert!(!plans[0].file.exists() && plans[1].file.exists());
    }

    #[test]
    fn texts_that_are_no_plans_are_rejected() {
        for text in ["lan-cloud", "lan-cloud=", "=file"] {
            assert!(text.parse::<CapturePlan>().is_err(), "{text}");
        }
    }
}
