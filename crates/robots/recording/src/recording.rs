//! The thread behind a run that records it and serves it to viewers. What happens is put in a bounded queue; the thread
//! encodes it once, for all sinks. In real time the run never waits for it: what finds no room is dropped and counted.
//! In virtual time the run waits, so that the same run gives the same bytes.

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

/// Events and scans that wait, at most; a scan has 1.5 kB.
const QUEUE: usize = 8192;
/// The thread is woken when so many more are there. Below that, telling it makes no system call.
const WAKE_EVERY: u64 = 1024;
/// How often the thread looks.
const PERIOD: Duration = Duration::from_millis(20);

/// Where a run's recording is made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordingPlace {
    /// `recording.mcap` in the run's folder.
    Folder,
    /// This file, which is not there yet.
    File(PathBuf),
}

impl RecordingPlace {
    /// The file, for a run that leaves that folder.
    pub fn path(&self, folder: &Path) -> PathBuf {
        match self {
            Self::Folder => folder.join("recording.mcap"),
            Self::File(path) => path.clone(),
        }
    }
}

/// What is to become of what happens.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// Record it.
    pub file: Option<RecordingPlace>,
    /// Serve it to Foxglove there.
    pub foxglove: Option<SocketAddr>,
}

/// What happens when the queue is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// What comes is dropped and counted: real time goes on.
    Live,
    /// Whoever tells waits: virtual time stands still.
    Waiting,
}

/// What a recording came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingSummary {
    /// The file, if one was wanted.
    pub file: Option<PathBuf>,
    /// Messages that the sinks took.
    pub messages: u64,
    /// Events and scans that were lost because the thread could not keep up.
    pub dropped: u64,
    /// Why something is not complete.
    pub failed: Option<String>,
}

/// A run that is recorded or watched.
#[derive(Debug)]
pub struct Recording {
    tap: Tap,
    closing: Arc<AtomicBool>,
    thread: Option<JoinHandle<(u64, Option<RecordingError>)>>,
    file: Option<PathBuf>,
    foxglove: Option<SocketAddr>,
}

/// What a recording is told through. Clones may be used from any thread.
#[derive(Debug, Clone)]
pub struct Tap {
    sender: SyncSender<Told>,
    thread: Thread,
    pace: Pace,
    told: Arc<AtomicU64>,
    dropped: Arc<AtomicU64>,
}

#[derive(Debug)]
enum Told {
    Event(Arc<Stamped>),
    Scan(SensedScan),
}

impl Recording {
    /// Begins what is wanted; `None` if nothing is. A file in `folder` is named `recording.mcap`.
    ///
    /// # Errors
    /// [`RecordingError`] if a file or a server cannot be.
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

    /// Begins with those sinks.
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
        let (told, dropped) = Default::default();
        let tap = Tap { sender, thread: thread.thread().clone(), pace, told, dropped };
        Ok(Self { tap, closing, thread: Some(thread), file: None, foxglove: None })
    }

    /// What to tell it through.
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// Where it serves Foxglove, if it does.
    pub fn foxglove(&self) -> Option<SocketAddr> {
        self.foxglove
    }

    /// Writes what was told, ends the file and the server, and says what it came to.
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
    /// Something happened.
    pub fn event(&self, event: Arc<Stamped>) {
        self.tell(Told::Event(event));
    }

    /// A robot completed a turn of its lidar.
    pub fn scan(&self, scan: SensedScan) {
        self.tell(Told::Scan(scan));
    }

    fn tell(&self, told: Told) {
        if self.told.fetch_add(1, Ordering::Relaxed) % WAKE_EVERY == WAKE_EVERY - 1 {
            self.thread.unpark();
        }
        let is_lost = match (self.sender.try_send(told), self.pace) {
            (Ok(()), _) => false,
            (Err(TrySendError::Full(told)), Pace::Waiting) => {
                self.thread.unpark();
                self.sender.send(told).is_err()
            }
            (Err(_), _) => true,
        };
        self.dropped.fetch_add(u64::from(is_lost), Ordering::Relaxed);
    }
}

/// The thread's side.
struct Worker {
    encoder: Encoder,
    sinks: Vec<Box<dyn Sink>>,
    messages: u64,
    failed: Option<RecordingError>,
    inbox: Receiver<Told>,
}

impl Worker {
    fn work(mut self, closing: &AtomicBool) -> (u64, Option<RecordingError>) {
        self.encode(|encoder, out| encoder.begin(out));
        loop {
            // Asked before the queue is emptied: what was told before is in it.
            let is_last = closing.load(Ordering::Acquire);
            while let Ok(told) = self.inbox.try_recv() {
                self.encode(|encoder, out| match &told {
                    Told::Event(event) => encoder.event(event, out),
                    Told::Scan(scan) => encoder.scan(scan, out),
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
                    tracing::error!("the run goes on, but is not recorded any more: {error}");
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
