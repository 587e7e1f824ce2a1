//! Ctrl-C and similar signals: the first one requests an orderly end, the second one ends the process.

use std::{
    process,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
};

use crate::exit::Status;

/// Signals cannot be listened to.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("cannot listen to Ctrl-C: {0}")]
pub struct SignalsError(ctrlc::Error);

/// Starts listening to SIGINT, SIGTERM and SIGHUP. The first signal is received; the second one ends the process.
///
/// The process can then leave control groups and conditions of interfaces behind, which the next run removes.
pub fn listen() -> Result<mpsc::Receiver<()>, SignalsError> {
    let (sender, interrupts) = mpsc::channel();
    let interrupted = AtomicBool::new(false);
    ctrlc::set_handler(move || {
        if interrupted.swap(true, Ordering::Relaxed) || sender.send(()).is_err() {
            process::exit(Status::Interrupted.number().into());
        }
    })
    .map_err(SignalsError)?;
    Ok(interrupts)
}
