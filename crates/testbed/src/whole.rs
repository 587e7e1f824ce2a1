//! Folders of runs that are whole: with everything that the testbed file names, so that a run can be replayed, exported and
//! repeated from its folder alone.

#[cfg(any(feature = "agents", feature = "containers"))]
use std::path::PathBuf;
use std::{fs, io, path::Path};

use cotorra_graph::Testbed;
use cotorra_testbed_file::{Carried, CarriedFile, Contents, Setting, annotated, carry};

use crate::{
    error::RunError,
    report::{FolderError, Place, RunFolder, write_file},
    script,
};

/// Creates the folder of a run with this seed. Returns it with the text of the testbed file in it.
pub(crate) fn create(
    place: &Place,
    testbed: &Testbed,
    seed: u64,
    text: &str,
) -> Result<(RunFolder, String), RunError> {
    let seed = (seed != testbed.seed).then(|| Setting::new("seed", &seed.to_string()).expect("it is one"));
    let text = annotated(text, seed.as_slice());
    let taken: Vec<_> = RunFolder::NAMES.into_iter().chain([RunFolder::TESTBED]).collect();
    let Carried { text, files } = carry(&text, &testbed.folder, &taken);
    let folder = RunFolder::create(place, &testbed.name, &text)?;
    put_all(&files, folder.path())?;
    Ok((folder, text))
}

/// Writes the files that a carried testbed file names into its new folder. A file that is there already stays.
///
/// # Errors
/// [`RunError`] with the first file that cannot be written.
pub fn put_all(files: &[CarriedFile], folder: &Path) -> Result<(), RunError> {
    files.iter().try_for_each(|file| put(file, folder))
}

#[cfg(any(feature = "agents", feature = "containers"))]
/// Returns the files of a new run's folder, before the run writes its results there: the testbed file, and what it names. Their
/// paths start at the folder.
pub(crate) fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next)? {
            let path = entry?.path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    let of_folder = |path: PathBuf| path.strip_prefix(folder).map(Path::to_owned).unwrap_or(path);
    let is_result = |path: &PathBuf| RunFolder::NAMES.iter().any(|name| path.starts_with(name));
    let mut found: Vec<_> = found.into_iter().map(of_folder).filter(|path| !is_result(path)).collect();
    found.sort();
    Ok(found)
}

fn put(file: &CarriedFile, folder: &Path) -> Result<(), RunError> {
    let to = folder.join(&file.to);
    let fail = |source: io::Error| FolderError::new(&to, source);
    let parent = to.parent().unwrap_or(folder);
    fs::create_dir_all(parent).map_err(fail)?;
    match &file.contents {
        // It may be here already, with a readable folder.
        Contents::Copy(_) if to.exists() => {}
        Contents::Copy(from) => drop(fs::copy(from, &to).map_err(fail)?),
        Contents::Folder(from, files) => {
            fs::create_dir_all(&to).map_err(fail)?;
            for name in files {
                let contents = Contents::Copy(from.join(name));
                put(&CarriedFile { to: name.clone(), contents }, &to)?;
            }
        }
        Contents::Text(text) => {
            let name = to.file_name().unwrap_or_default().to_string_lossy();
            write_file(parent, &name, text)?;
        }
        Contents::Conditions(of) => script::copy_conditions(of, &to)?,
    }
    Ok(())
}
