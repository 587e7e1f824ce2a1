//! The folder of an experiment, and of its runs.

use std::{fs, path::Path};

use cotorra::note_origin;
use cotorra_testbed::{Finished, FolderError, Made, ManyInputs, Repeat, Void};
use miette::IntoDiagnostic;

use super::args::WalkArgs;

/// Carries the testbed file and what it names into an experiment's folder, and notes there how the experiment came to be.
/// `others` carries further files, and returns the words that name them.
pub fn begin(
    folder: &Path,
    testbed: &Path,
    walks: &WalkArgs,
    made: &Made,
    others: impl FnOnce(&mut ManyInputs) -> Result<Repeat, FolderError>,
) -> miette::Result<()> {
    let note = || {
        let text = cotorra_testbed_file::read(testbed).into_diagnostic()?;
        let base = testbed.parent().unwrap_or(Path::new(""));
        let mut carried = ManyInputs::carry(folder, &text, base, &walks.settings).into_diagnostic()?;
        let repeat = match others(&mut carried).into_diagnostic()? {
            Repeat::Words(others) => {
                let mut words = walks.given.clone();
                words.push(format!("--testbed={}", ManyInputs::TESTBED));
                words.extend(carried.settings.iter().map(|setting| format!("--set={setting}")));
                words.extend(others);
                Repeat::Words(words)
            }
            not => not,
        };
        note_origin(folder, repeat, made, &carried).into_diagnostic()
    };
    note().inspect_err(|_| withdraw(folder))
}

/// A run whose figures are not those of its testbed. An experiment compares none with others.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("the run in {folder} is {void}")]
#[diagnostic(help("the folder's logs/ has the output of plug-ins; run the experiment again when they work"))]
pub struct VoidRun {
    folder: String,
    void: Void,
}

/// Returns a run unless it is void. One that was only too late in real time stays: it is shown as not valid.
///
/// # Errors
/// [`VoidRun`].
pub fn sound(finished: Finished) -> Result<Finished, VoidRun> {
    let summary = &finished.summary;
    match summary.void.void().filter(|_| summary.fidelity.valid || !summary.plugin_faults.is_empty()) {
        None => Ok(finished),
        Some(void) => Err(VoidRun { folder: finished.folder.display().to_string(), void }),
    }
}

/// Removes an experiment's folder, and the folder around it, if they are empty but for what [`begin`] wrote: an experiment that
/// cannot begin leaves nothing.
pub fn withdraw(folder: &Path) {
    let is_own = |entry: fs::DirEntry| ManyInputs::NAMES.iter().any(|name| entry.file_name() == *name);
    let is_new = fs::read_dir(folder).is_ok_and(|mut all| all.all(|entry| entry.is_ok_and(is_own)));
    if is_new {
        // A folder that cannot be removed does no harm.
        let removed = fs::remove_dir_all(folder);
        let _ = removed.and_then(|()| folder.parent().map_or(Ok(()), fs::remove_dir));
    }
}
