//! The thread that records a run and serves it to viewers. Events go through a bounded queue, and are encoded once for
//! all sinks. In real time, the run never waits: if the queue is full, events are dropped and counted. In virtual time,
//! the run waits, so that the same run gives the same bytes.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle, Thread},
    time::Duration,
};

use cotorra_graph::{Stamped, Testbed};
use cotorra_robot_middleware::SensedScan;

use crate::{
    encoder::Encoder,
    mcap_file::{About, McapFile},
    sink::{RecordingError, Sink},
};

/// Length of the queue, events and scans. A scan has 1.5 kB.
const QUEUE: usize = 8192;
/// New entries that wake the thread. Fewer make no system call.
const WAKE_EVERY: u64 = 1024;
/// Interval at which the thread checks the queue.
const PERIOD: Duration = Duration::from_millis(20);

/// File of a run's recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordingPlace {
    /// `recording.mcap` in the run's folder.
    Folder,
    /// This file, which must not exist.
    File(PathBuf),
}

impl RecordingPlace {
    /// Returns the file, for a run with that folder.
    pub fn path(&self, folder: &Path) -> PathBuf {
        match self {
            Self::Folder => folder.join("recording.mcap"),
            Self::File(path) => path.clone(),
        }
    }
}

/// Destinations of a recording.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// File to record to.
    pub file: Option<RecordingPlace>,
    /// Address to serve Foxglove on.
    pub foxglove: Option<SocketAddr>,
}

/// Behaviour when the queue is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Drops and counts new entries: real time goes on.
    Live,
    /// Blocks the sender: virtual time stands still.
    Waiting,
}

/// Result of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingSummary {
    /// The file, if one was requested.
    pub file: Option<PathBuf>,
    /// Messages that the sinks took.
    pub messages: u64,
    /// Events and scans that were dropped because the thread is too slow.
    pub dropped: u64,
    /// Reason why something is incomplete.
    pub failed: Option<String>,
}

/// Records a run, or serves it to viewers.
#[derive(Debug)]
pub struct Recording {
    tap: Tap,
    closing: Arc<AtomicBool>,
    thread: Option<JoinHandle<(u64, Option<RecordingError>)>>,
    file: Option<PathBuf>,
    foxglove: Option<SocketAddr>,
}

/// Sender of events and scans to a recording. Clones may be used from any thread.
#[derive(Debug, Clone)]
pub struct Tap {
    sender: SyncSender<Entry>,
    thread: Thread,
    pace: Pace,
    sent: Arc<AtomicU64>,
    dropped: Arc<AtomicU64>,
}

#[derive(Debug)]
enum Entry {
    Event(Arc<Stamped>),
    Scan(SensedScan),
}

impl Recording {
    /// Starts the requested recording; `None` if there is none. A file in `folder` is named `recording.mcap`.
    ///
    /// # Errors
    /// [`RecordingError`] if the file cannot be created, or the server cannot start.
    pub fn begin(
        wanted: &Wanted,
        folder: &Path,
        testbed: &Arc<Testbed>,
        about: About<'_>,
        pace: Pace,
    ) -> Result<Option<Self>, RecordingError> {
        let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
        let mut foxglove = None;
        if let Some(address) = wanted.foxglove {
            let (sink, address) = serve(address, &testbed.name)?;
            sinks.push(sink);
            foxglove = Some(address);
        }
        let file = wanted.file.as_ref().map(|place| place.path(folder));
        if let Some(path) = &file {
            sinks.push(Box::new(McapFile::create(path, about)?));
        }
        if sinks.is_empty() {
            return Ok(None);
        }
        let mut recording = Self::into_sinks(sinks, testbed, pace)?;
        (recording.file, recording.foxglove) = (file, foxglove);
        Ok(Some(recording))
    }

    /// Starts with these sinks.
    fn into_sinks(
        sinks: Vec<Box<dyn Sink>>,
        testbed: &Arc<Testbed>,
        pace: Pace,
    ) -> Result<Self, RecordingError> {
        let (sender, inbox) = sync_channel(QUEUE);
        let closing = Arc::new(AtomicBool::new(false));
        let encoder = Encoder::new(Arc::clone(testbed));
        let worker = Worker { encoder, sinks, messages: 0, failed: None, inbox };
        let is_closing = Arc::clone(&closing);
        let thread = thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || worker.work(&is_closing))
            .map_err(RecordingError::Thread)?;
        let (sent, dropped) = Default::default();
        let tap = Tap { sender, thread: thread.thread().clone(), pace, sent, dropped };
        Ok(Self { tap, closing, thread: Some(thread), file: None, foxglove: None })
    }

    /// Returns a sender of events and scans.
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// Returns the address on which it serves Foxglove, if it does.
    pub fn foxglove(&self) -> Option<SocketAddr> {
        self.foxglove
    }

    /// Writes queued entries, ends the file and the server, and returns the result.
    pub fn finish(mut self) -> RecordingSummary {
        let (messages, failed) = self.join();
        let dropped = self.tap.dropped.load(Ordering::Relaxed);
        RecordingSummary { file: self.file.take(), messages, dropped, failed }
    }

    fn join(&mut self) -> (u64, Option<String>) {
        let Some(thread) = self.thread.take() else { return (0, None) };
        self.closing.store(true, Ordering::Release);
        thread.thread().unpark();
        match thread.join() {
            Ok((messages, failed)) => (messages, failed.map(|error| error.to_string())),
            Err(_) => (0, Some("the thread that records panicked; please report this as a bug".to_owned())),
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        let _ = self.join();
    }
}

impl Tap {
    /// Sends an event.
    pub fn event(&self, event: Arc<Stamped>) {
        self.send(Entry::Event(event));
    }

    /// Sends a turn of a robot's lidar.
    pub fn scan(&self, scan: SensedScan) {
        self.send(Entry::Scan(scan));
    }

    fn send(&self, entry: Entry) {
        if self.sent.fetch_add(1, Ordering::Relaxed) % WAKE_EVERY == WAKE_EVERY - 1 {
            self.thread.unpark();
        }
        let is_lost = match (self.sender.try_send(entry), self.pace) {
            (Ok(()), _) => false,
            (Err(TrySendError::Full(entry)), Pace::Waiting) => {
                self.thread.unpark();
                self.sender.send(entry).is_err()
            }
            (Err(_), _) => true,
        };
        self.dropped.fetch_add(u64::from(is_lost), Ordering::Relaxed);
    }
}

/// State of the thread.
struct Worker {
    encoder: Encoder,
    sinks: Vec<Box<dyn Sink>>,
    messages: u64,
    failed: Option<RecordingError>,
    inbox: Receiver<Entry>,
}

impl Worker {
    fn work(mut self, closing: &AtomicBool) -> (u64, Option<RecordingError>) {
        self.encode(|encoder, out| encoder.begin(out));
        loop {
            // Checked before the queue is emptied, so that earlier entries are not missed.
            let is_last = closing.load(Ordering::Acquire);
            while let Ok(entry) = self.inbox.try_recv() {
                self.encode(|encoder, out| match &entry {
                    Entry::Event(event) => encoder.event(event, out),
                    Entry::Scan(scan) => encoder.scan(scan, out),
                });
            }
            if is_last {
                break;
            }
            thread::park_timeout(PERIOD);
        }
        for sink in &mut self.sinks {
            if let Err(error) = sink.finish() {
                self.failed.get_or_insert(error);
            }
        }
        (self.messages, self.failed)
    }

    fn encode(&mut self, encode: impl FnOnce(&mut Encoder, &mut dyn FnMut(crate::Encoded<'_>))) {
        let Self { encoder, sinks, messages, failed, .. } = self;
        encode(encoder, &mut |message| {
            *messages += u64::from(!sinks.is_empty());
            sinks.retain_mut(|sink| match sink.write(&message) {
                Ok(()) => true,
                Err(error) => {
                    tracing::error!("the run goes on, but is no longer recorded: {error}");
                    failed.get_or_insert(error);
                    false
                }
            });
        });
    }
}

#[cfg(feature = "foxglove")]
fn serve(address: SocketAddr, name: &str) -> Result<(Box<dyn Sink>, SocketAddr), RecordingError> {
    let (server, address) = crate::foxglove::FoxgloveServer::start(address, name)?;
    Ok((Box::new(server), address))
}

#[cfg(not(feature = "foxglove"))]
fn serve(_: SocketAddr, _: &str) -> Result<(Box<dyn Sink>, SocketAddr), RecordingError> {
    Err(RecordingError::NoFoxglove)
}

#[cfg(test)]
mod tests;
