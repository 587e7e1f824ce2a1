//! Ctrl-C and its kin: the first asks for an orderly end, the second ends the process.

use std::{
    process,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
};

/// Exit status of a program that was ended by Ctrl-C, as shells have it.
pub const INTERRUPTED: u8 = 130;

/// Listens to SIGINT, SIGTERM and SIGHUP from here on; the first one is received, the second ends the process.
/// What can be left behind by that, control groups and conditions of interfaces of this machine, the next run removes.
pub fn listen() -> Result<mpsc::Receiver<()>, ctrlc::Error> {
    let (tell, told) = mpsc::channel();
    let asked = AtomicBool::new(false);
    ctrlc::set_handler(move || {
        if asked.swap(true, Ordering::Relaxed) || tell.send(()).is_err() {
            process::exit(INTERRUPTED.into());
        }
    })?;
    Ok(told)
}
