//! Folders of runs that are whole: with everything that the testbed file names, so that a run can be replayed, exported and
//! repeated from its folder alone.

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
    files.iter().try_for_each(|file| put(file, folder.path()))?;
    Ok((folder, text))
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
