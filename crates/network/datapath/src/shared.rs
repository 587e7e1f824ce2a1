//! State that the fabric's thread shares with others.

use std::{
    io,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
};

use cotorra_fabric::Fabric;
use cotorra_graph::Timestamp;
use parking_lot::Mutex;

use crate::{presence::PortWaits, sys::Waker};

/// Work for the fabric's thread.
pub(crate) type Command = Box<dyn FnOnce(&mut Fabric, Timestamp) + Send>;

/// State shared with [`Handle`](crate::Handle)s.
pub(crate) struct Shared {
    /// `None` once the thread ends.
    pub(crate) commands: Mutex<Option<Vec<Command>>>,
    pub(crate) waker: Waker,
    /// Set to end the thread. Frames that are due are no longer sent, however many there are.
    pub(crate) stopping: AtomicBool,
    /// Frames that a port could not send or receive, and bursts of them that the medium missed.
    dropped: AtomicU64,
    /// Locked for a moment only, and never waited for by the fabric's thread.
    pub(crate) waits: Mutex<PortWaits>,
}

impl Shared {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self {
            commands: Mutex::new(Some(Vec::new())),
            waker: Waker::new()?,
            stopping: AtomicBool::new(false),
            dropped: AtomicU64::new(0),
            waits: Mutex::default(),
        })
    }

    /// Ends the thread after its current step. Commands that have not begun are dropped.
    pub(crate) fn stop(&self) {
        *self.commands.lock() = None;
        self.stopping.store(true, Ordering::Relaxed);
        self.waker.wake();
    }

    pub(crate) fn count_drop(&self) {
        self.count_drops(1);
    }

    pub(crate) fn count_drops(&self, count: u64) {
        if count > 0 {
            self.dropped.fetch_add(count, Ordering::Relaxed);
        }
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Publishes figures, unless somebody reads the former ones just now.
    pub(crate) fn publish(&self, waits: PortWaits) {
        if let Some(mut published) = self.waits.try_lock() {
            *published = waits;
        }
    }
}
