//! Keeps cores from falling asleep. Waking a core delays a packet by some ten to a hundred microseconds. While a
//! datapath runs, idle cores are therefore kept busy at idle priority, which takes no time from other programs.

use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use crate::sys;

/// Number of cores kept awake. Packets pass between a few threads, so more would not help.
const CORES: usize = 4;

/// Names the kernel's clock.
const CLOCK: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

/// Threads that keep cores awake until this is dropped.
#[derive(Debug)]
pub(crate) struct Awake {
    done: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Awake {
    /// Keeps cores that this process may use awake, up to a limit; none if the kernel forbids it, or if its time stands
    /// still while a thread spins.
    pub(crate) fn keep() -> Self {
        let done = Arc::new(AtomicBool::new(false));
        if is_virtual(&fs::read_to_string(CLOCK).unwrap_or_default()) {
            return Self { done, threads: Vec::new() };
        }
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

/// Whether a clock is that of user-mode-linux's time travel.
fn is_virtual(clock: &str) -> bool {
    clock.starts_with("time-travel-clock")
}

fn stay(core: usize, done: &AtomicBool) {
    if let Err(error) = sys::set_idle().and_then(|()| sys::pin(core)) {
        return tracing::debug!("core {core} may fall asleep: {error}");
    }
    // No pause instruction: hypervisors put a core to sleep after many of them.
    while !done.load(Ordering::Relaxed) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_of_time_travel_is_virtual() {
        assert!(is_virtual("time-travel-clock\n"));
        assert!(!is_virtual("tsc\n"));
    }

    #[test]
    fn cores_are_kept_awake_at_idle_priority_until_dropped() {
        let awake = Awake::keep();
        assert!((1..=CORES).contains(&awake.threads.len()));
        drop(awake);
    }
}
