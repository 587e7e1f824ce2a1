//! Logs of a run: all of them in its folder, warnings on the terminal too, around the live view.

use std::{
    fs::File,
    io::{self, Write},
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use indicatif::MultiProgress;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::{EnvFilter, Layer, fmt, layer::SubscriberExt, util::SubscriberInitExt};

/// Filters both logs, in `tracing_subscriber`'s syntax: `info,cotorra_fabric=trace`.
const VARIABLE: &str = "COTORRA_LOG";

/// Begins to log: warnings (more if `verbose`) to standard error, around what `view` shows, and more of them into a
/// file that [`LogFile::open`] names later.
pub fn begin(verbose: u8, view: &MultiProgress) -> LogFile {
    let (shown, kept) = match verbose {
        0 => (LevelFilter::WARN, LevelFilter::INFO),
        1 => (LevelFilter::INFO, LevelFilter::DEBUG),
        _ => (LevelFilter::DEBUG, LevelFilter::TRACE),
    };
    let filter = |level: LevelFilter| {
        EnvFilter::builder().with_default_directive(level.into()).with_env_var(VARIABLE).from_env_lossy()
    };
    let file = LogFile::default();
    let (to_file, view) = (file.clone(), view.clone());
    let terminal = fmt::layer()
        .compact()
        .without_time()
        .with_target(false)
        .with_ansi(console::colors_enabled_stderr())
        .with_writer(move || Terminal(view.clone()));
    let kept_log =
        fmt::layer().with_ansi(false).with_timer(fmt::time::uptime()).with_writer(move || to_file.clone());
    tracing_subscriber::registry()
        .with(terminal.with_filter(filter(shown)))
        .with(kept_log.with_filter(filter(kept)))
        .init();
    file
}

/// Standard error, with the live view out of the way.
struct Terminal(MultiProgress);

impl Write for Terminal {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.suspend(|| io::stderr().write_all(bytes))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A log that begins before its file exists, because the file lies in a folder that the run makes.
#[derive(Debug, Clone, Default)]
pub struct LogFile(Arc<Mutex<Destination>>);

#[derive(Debug)]
enum Destination {
    /// What came before there was a file.
    Memory(Vec<u8>),
    File(File),
}

impl Default for Destination {
    fn default() -> Self {
        Self::Memory(Vec::new())
    }
}

impl LogFile {
    /// Goes on in a file, which begins with all that was logged so far.
    pub fn open(&self, path: &Path) -> io::Result<()> {
        let mut file = File::create(path)?;
        let mut destination = self.lock();
        if let Destination::Memory(earlier) = &*destination {
            file.write_all(earlier)?;
        }
        *destination = Destination::File(file);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Destination> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut *self.lock() {
            Destination::Memory(text) => text.write(bytes),
            Destination::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_logged_before_the_file_existed_stands_at_its_beginning() {
        let path = tempfile::tempdir().unwrap().keep().join("cotorra.log");
        let mut log = LogFile::default();
        log.write_all(b"before\n").unwrap();
        log.open(&path).unwrap();
        log.write_all(b"after\n").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "before\nafter\n");
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
    }
}
