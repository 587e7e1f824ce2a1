//! The samples of a sweep's runs: a table for each run, in a folder beside the sweep's own tables.

use std::{
    collections::BTreeSet,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use cotorra_testbed::{FolderError, Report, write_samples};

use super::{Axis, Point};
use crate::batch::{SamplesFile, plain_name};

/// The folder in that of the sweep.
const FOLDER: &str = "samples";
const ENDING: &str = ".csv";

/// Returns the place of a run's table in the folder of a sweep.
pub(super) fn place(run: &str) -> PathBuf {
    Path::new(FOLDER).join(plain_name(run, run) + ENDING)
}

/// Writes the draft of a run's table. It reaches the disk before this returns.
pub(super) fn write(
    file: &SamplesFile,
    axes: &[Axis],
    point: &Point,
    report: &Report,
) -> Result<(), FolderError> {
    let heads: Vec<_> = axes.iter().map(Axis::path).chain(["seed"]).map(str::to_owned).collect();
    let values: Vec<_> = point.values.iter().cloned().chain([point.seed.to_string()]).collect();
    let draft = file.draft();
    let write = || {
        create_folder(&draft)?;
        let mut file = File::create(&draft)?;
        write_samples(report, [&heads, &values], &mut file)?;
        file.sync_data()
    };
    write().map_err(|source| FolderError::new(&draft, source))
}

/// Takes the table of a run over from another folder.
pub(super) fn copy(from: &Path, file: &SamplesFile) -> Result<(), FolderError> {
    let draft = file.draft();
    let copied = create_folder(&draft).and_then(|()| fs::copy(from, &draft));
    copied.map_err(|source| FolderError::new(&draft, source))?;
    file.finish()
}

fn create_folder(draft: &Path) -> io::Result<()> {
    draft.parent().map_or(Ok(()), fs::create_dir_all)
}

/// Removes the tables of all other runs from the folder of a sweep.
pub(super) fn retain(sweep: &Path, runs: &BTreeSet<&Path>) -> Result<(), FolderError> {
    let folder = sweep.join(FOLDER);
    let fail = |source| FolderError::new(&folder, source);
    let entries = match fs::read_dir(&folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(fail)?,
    };
    for entry in entries {
        let name = entry.map_err(fail)?.file_name();
        if is_table(&name.to_string_lossy()) && !runs.contains(&*Path::new(FOLDER).join(&name)) {
            fs::remove_file(folder.join(name)).map_err(fail)?;
        }
    }
    Ok(())
}

/// Whether a file is a run's table or a draft of one: its name ends with a hash.
fn is_table(name: &str) -> bool {
    let stem = name.strip_suffix(ENDING).or_else(|| name.strip_suffix(".part"));
    let hash = stem.and_then(|stem| stem.rsplit_once('-')).map(|(_, hash)| hash);
    hash.is_some_and(|hash| hash.len() == 8 && hash.bytes().all(|byte| byte.is_ascii_hexdigit()))
}
