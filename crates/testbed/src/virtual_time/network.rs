//! The emulated network in virtual time: direct access to the fabric.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use cotorra_fabric::Fabric;
use cotorra_graph::{Stamped, Timestamp};
use cotorra_network_control::{Network, NetworkGone};
use parking_lot::{Mutex, MutexGuard};

use crate::capture::Wiretap;

/// The emulated network in virtual time. One thread at a time uses it.
#[derive(Clone)]
pub(crate) struct VirtualNetwork {
    fabric: Arc<Mutex<Fabric>>,
    now_ns: Arc<AtomicU64>,
}

impl VirtualNetwork {
    /// Creates the network at time zero.
    pub(crate) fn new(fabric: Fabric) -> Self {
        Self { fabric: Arc::new(Mutex::new(fabric)), now_ns: Arc::default() }
    }

    pub(super) fn fabric(&self) -> MutexGuard<'_, Fabric> {
        self.fabric.lock()
    }

    pub(super) fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.now_ns.load(Ordering::Relaxed))
    }

    pub(crate) fn set_now(&self, now: Timestamp) {
        self.now_ns.store(now.as_nanos(), Ordering::Relaxed);
    }

    /// Returns access to its packets.
    pub(super) fn wiretap(&self) -> Wiretap {
        let fabric = Arc::clone(&self.fabric);
        Arc::new(move |name, reader| Ok(fabric.lock().tap(name, reader)?))
    }

    pub(super) fn next_event(&self) -> Option<Stamped> {
        self.fabric().next_event()
    }
}

impl Network for VirtualNetwork {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        Ok(action(&mut self.fabric(), self.now()))
    }
}
