//! Keeps cores from falling asleep. A packet that wakes a sleeping core waits for that, some ten to a hundred
//! microseconds each time; so while a datapath runs, cores that have nothing to do are given something, at a priority
//! at which it takes nothing from anyone else.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use crate::sys;

/// Packets go from thread to thread of a few; more cores than this need not be awake for them.
const CORES: usize = 4;

/// Cores that are kept awake until this is dropped.
#[derive(Debug)]
pub(crate) struct Awake {
    done: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Awake {
    /// Keeps the cores awake that this process may use, up to a few; none where the kernel forbids it.
    pub(crate) fn keep() -> Self {
        let done = Arc::new(AtomicBool::new(false));
        let spawn = |core| {
            let done = Arc::clone(&done);
            thread::Builder::new().name(format!("awake-{core}")).spawn(move || stay(core, &done)).ok()
        };
        let threads =
            sys::allowed_cores().unwrap_or_default().into_iter().take(CORES).filter_map(spawn).collect();
        Self { done, threads }
    }
}

impl Drop for Awake {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // It cannot panic.
            let _ = thread.join();
        }
    }
}

fn stay(core: usize, done: &AtomicBool) {
    if let Err(error) = sys::set_idle().and_then(|()| sys::pin(core)) {
        return tracing::debug!("core {core} may fall asleep: {error}");
    }
    // No pause instruction: a hypervisor takes many of them for a reason to put the core to sleep.
    while !done.load(Ordering::Relaxed) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_are_kept_awake_at_idle_priority_and_let_go() {
        let awake = Awake::keep();
        assert!((1..=CORES).contains(&awake.threads.len()));
        drop(awake);
    }
}
