//! `cotorra history export` and `import`: a run as tables, and back.

use std::{path::Path, sync::mpsc};

use cotorra_measurements::{History, export::ExportError};
use indicatif::ProgressBar;

use super::{
    Error, Source,
    place::{HISTORY_VARIABLE, location},
};
use crate::{
    cli::{ExportArgs, ImportArgs},
    output, signals,
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum TransferError {
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error("import into which history?")]
    #[diagnostic(help("name it with --history or in {HISTORY_VARIABLE}, as in --history runs/all.sqlite"))]
    Nowhere,
    #[error("cannot listen to Ctrl-C: {0}")]
    Signals(ctrlc::Error),
}

/// Writes a run as tables.
pub fn export(args: &ExportArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let progress = Progress::begin()?;
    let events = source.history.export(source.run.id, args.format, &args.out, |events| progress.show(events));
    progress.bar.finish_and_clear();
    let events = events.map_err(TransferError::from)?;
    output::print(&format!("{events} events in {}\n", place(&args.out)))
}

/// Reads a run from tables.
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
        let interrupts = signals::listen().map_err(TransferError::Signals)?;
        Ok(Self { bar: ProgressBar::new_spinner(), interrupts })
    }

    /// Shows how far it is; gives whether to go on.
    fn show(&self, events: u64) -> bool {
        self.bar.set_message(format!("{events} events"));
        self.bar.tick();
        self.interrupts.try_recv().is_err()
    }
}
