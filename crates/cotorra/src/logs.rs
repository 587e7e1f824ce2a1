//! Logs of a run: complete in its folder, and warnings also on the terminal, around the live view.

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

use crate::output;

/// The environment variable that filters both logs: a level, and levels of targets, as in `info,cotorra_fabric=trace`.
const VARIABLE: &str = "COTORRA_LOG";

/// Starts logging to standard error, around the lines of `view`, and to a file that [`LogFile::open`] names later.
///
/// Standard error gets cotorra's warnings, or more if `verbose`. The file gets more than that.
pub fn begin(verbose: u8, view: &MultiProgress) -> LogFile {
    let (shown, kept) = usual(verbose);
    let filter = |usual: &str| {
        let value = env::var(VARIABLE).ok().filter(|value| !value.is_empty());
        targets(value.as_deref().unwrap_or(usual))
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

/// Parses a filter. Parts that are not valid are ignored with a warning.
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

/// Returns the default filters of the terminal and of the file.
fn usual(verbose: u8) -> (&'static str, &'static str) {
    match verbose {
        // Warnings of libraries help only to debug: RustDDS warns of each datagram that cannot be sent.
        0 => ("error,cotorra=warn", "info,rustdds=error"),
        1 => ("info", "debug"),
        _ => ("debug", "trace"),
    }
}

/// Standard error. The live view is hidden while it is written to.
struct Terminal(MultiProgress);

impl Write for Terminal {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        let shown = output::escaped(&text, console::colors_enabled_stderr());
        self.0.suspend(|| io::stderr().write_all(shown.as_bytes()))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A log that begins before its file exists, because the run creates the folder of the file.
#[derive(Debug, Clone, Default)]
pub struct LogFile(Arc<Mutex<Destination>>);

#[derive(Debug)]
enum Destination {
    /// The log until the file is opened.
    Memory(Vec<u8>),
    File(File),
}

impl Default for Destination {
    fn default() -> Self {
        Self::Memory(Vec::new())
    }
}

impl LogFile {
    /// Continues the log in a file, which begins with everything logged so far.
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
        // People read it on a terminal, too.
        let text = String::from_utf8_lossy(bytes);
        let shown = output::escaped(&text, false);
        match &mut *self.0.lock() {
            Destination::Memory(text) => text.write_all(shown.as_bytes())?,
            Destination::File(file) => file.write_all(shown.as_bytes())?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_controls_a_terminal_is_escaped_in_the_log() {
        let mut log = LogFile::default();
        let text = "the VNF said \u{1b}]0;title\u{7}\n";
        assert_eq!(log.write(text.as_bytes()).unwrap(), text.len());
        let Destination::Memory(kept) = &*log.0.lock() else { panic!("no file is open") };
        assert_eq!(std::str::from_utf8(kept).unwrap(), "the VNF said \\u{1b}]0;title\\u{7}\n");
    }

    #[test]
    fn warnings_of_libraries_are_shown_only_if_verbose() {
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
    fn invalid_parts_of_a_filter_are_ignored() {
        assert_eq!(
            targets("info,rustdds=loud,,cotorra_fabric=trace"),
            "info,cotorra_fabric=trace".parse().unwrap()
        );
    }

    #[test]
    fn the_file_begins_with_what_was_logged_before_it_existed() {
        let path = tempfile::tempdir().unwrap().keep().join("cotorra.log");
        let mut log = LogFile::default();
        log.write_all(b"before\n").unwrap();
        log.open(&path).unwrap();
        log.write_all(b"after\n").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "before\nafter\n");
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
    }
}
