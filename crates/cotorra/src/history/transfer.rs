//! `cotorra history export` and `import`: writes a run as tables or as MCAP, and reads tables.

use std::{
    fs,
    path::Path,
    sync::{Arc, mpsc},
};

use cotorra_measurements::{History, PageRequest, export::ExportError};
use cotorra_recording::{Export, RecordingError};
use cotorra_testbed::about;
use indicatif::ProgressBar;

use super::{
    args::{ExportArgs, ExportFormat, ImportArgs},
    place::{HISTORY_VARIABLE, location},
    source::{Error, Source},
};
use crate::{
    output, signals,
    testbed_file::{FileError, recorded},
};

/// Events that are read from the history at a time.
const PAGE: usize = 1000;

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub(super) enum TransferError {
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("an import needs a history")]
    #[diagnostic(help("name one with --history or in {HISTORY_VARIABLE}, as in --history runs/all.sqlite"))]
    Nowhere,
    #[error(transparent)]
    Signals(#[from] signals::SignalsError),
}

/// Writes a run as tables, or as MCAP.
pub fn export(args: &ExportArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let format = match args.format {
        ExportFormat::Tables(format) => format,
        ExportFormat::Mcap => return mcap(&source, args),
    };
    let progress = Progress::begin()?;
    let events = source.history.export(source.run.id, format, &args.out, |events| progress.show(events));
    progress.bar.finish_and_clear();
    let events = events.map_err(TransferError::from)?;
    output::print(&format!("{events} events in {}\n", place(&args.out)))
}

/// Writes a run as MCAP. An incomplete file is removed.
fn mcap(source: &Source, args: &ExportArgs) -> miette::Result<()> {
    let info = &source.run.info;
    let testbed = recorded(&info.testbed, &args.run, &source.base(args.base.as_deref()), None)
        .map_err(FileError::from)?;
    let export = Export::create(&args.out, Arc::new(testbed), about(info)).map_err(TransferError::from)?;
    let progress = Progress::begin()?;
    let written = write(source, export, &progress);
    progress.bar.finish_and_clear();
    let events = written.inspect_err(|_| {
        // The first error is reported; one of the removal would only hide it.
        let _ = fs::remove_file(&args.out);
    })?;
    output::print(&format!("{events} events in {}\n", args.out.display()))
}

fn write(source: &Source, mut export: Export, progress: &Progress) -> Result<u64, TransferError> {
    let (mut request, mut events) = (PageRequest::first(PAGE), 0);
    loop {
        let page = source.history.events(source.run.id, &[], .., request).map_err(ExportError::from)?;
        for event in &page.items {
            export.event(event)?;
        }
        events += page.items.len() as u64;
        if !progress.show(events) {
            return Err(ExportError::Stopped(events).into());
        }
        match page.next {
            Some(next) => request = PageRequest::after(next, PAGE),
            None => break,
        }
    }
    export.finish()?;
    Ok(events)
}

/// Reads a run from tables into a history.
pub fn import(args: &ImportArgs) -> miette::Result<()> {
    let location = location(args.place.history.as_ref()).map_err(Error::from)?;
    let location = location.ok_or(TransferError::Nowhere)?;
    let history = History::connect(&location).map_err(Error::from)?;
    let progress = Progress::begin()?;
    let imported = history.import(&args.folder, |events| progress.show(events));
    progress.bar.finish_and_clear();
    let (run, events) = imported.map_err(TransferError::from)?;
    output::print(&format!("{events} events are run {run} in {location}\n"))
}

fn place(folder: &Path) -> String {
    format!("{}/", folder.display())
}

struct Progress {
    bar: ProgressBar,
    interrupts: mpsc::Receiver<()>,
}

impl Progress {
    fn begin() -> Result<Self, TransferError> {
        let interrupts = signals::listen()?;
        Ok(Self { bar: ProgressBar::new_spinner(), interrupts })
    }

    /// Shows the progress. Returns whether to continue.
    fn show(&self, events: u64) -> bool {
        self.bar.set_message(format!("{events} events"));
        self.bar.tick();
        self.interrupts.try_recv().is_err()
    }
}
