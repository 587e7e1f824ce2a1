//! Logs of a run: all of them in its folder, warnings on the terminal too, around the live view.

use std::{
    env,
    fs::File,
    io::{self, Write},
    path::Path,
    sync::Arc,
};

use indicatif::MultiProgress;
use parking_lot::Mutex;
use tracing_subscriber::{Layer, filter::Targets, fmt, layer::SubscriberExt, util::SubscriberInitExt};

/// Filters both logs: a level, and other levels for targets, as in `info,cotorra_fabric=trace`.
const VARIABLE: &str = "COTORRA_LOG";

/// Begins to log: cotorra's warnings (more if `verbose`) to standard error, around what `view` shows, and more of them into a
/// file that [`LogFile::open`] names later.
pub fn begin(verbose: u8, view: &MultiProgress) -> LogFile {
    let (shown, kept) = usual(verbose);
    let filter = |usual: &str| {
        let said = env::var(VARIABLE).ok().filter(|said| !said.is_empty());
        targets(said.as_deref().unwrap_or(usual))
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

/// Reads a filter, without what is none in it.
fn targets(filter: &str) -> Targets {
    let mut read = Targets::new();
    for part in filter.split(',').filter(|part| !part.is_empty()) {
        match part.parse::<Targets>() {
            Ok(parsed) => {
                if let Some(level) = parsed.default_level() {
                    read = read.with_default(level);
                }
                read = read.with_targets(parsed);
            }
            Err(error) => note!("warning: {VARIABLE}: ignored `{part}`: {error}"),
        }
    }
    read
}

/// What is shown, and what is kept.
fn usual(verbose: u8) -> (&'static str, &'static str) {
    match verbose {
        // What libraries warn of is for who looks for a fault: RustDDS does for each datagram that finds no way.
        0 => ("error,cotorra=warn", "info,rustdds=error"),
        1 => ("info", "debug"),
        _ => ("debug", "trace"),
    }
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
        let mut destination = self.0.lock();
        if let Destination::Memory(earlier) = &*destination {
            file.write_all(earlier)?;
        }
        *destination = Destination::File(file);
        Ok(())
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut *self.0.lock() {
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
    fn what_libraries_warn_of_is_shown_to_who_asks() {
        let shown = |verbose| {
            let log = LogFile::default();
            let writer = log.clone();
            let layer = fmt::layer().with_writer(move || writer.clone());
            let filter = targets(usual(verbose).0);
            tracing::subscriber::with_default(
                tracing_subscriber::registry().with(layer.with_filter(filter)),
                || {
                    tracing::warn!(target: "rustdds::rtps", "theirs");
                    tracing::error!(target: "rustdds::rtps", "their error");
                    tracing::warn!(target: "cotorra_ros2::dds", "ours");
                },
            );
            let Destination::Memory(text) = &*log.0.lock() else { panic!("no file was opened") };
            ["theirs", "their error", "ours"].map(|what| String::from_utf8_lossy(text).contains(what))
        };
        assert_eq!(shown(0), [false, true, true]);
        assert_eq!(shown(1), [true, true, true]);
    }

    #[test]
    fn what_is_wrong_in_a_filter_is_left_out() {
        assert_eq!(
            targets("info,rustdds=loud,,cotorra_fabric=trace"),
            "info,cotorra_fabric=trace".parse().unwrap()
        );
    }

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
