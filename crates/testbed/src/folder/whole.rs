//! Folders of runs that are whole: with everything that the testbed file names, so that a run can be replayed, exported and
//! repeated from its folder alone.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use cotorra_graph::Testbed;
use cotorra_testbed_file::{
    Carried, CarriedFile, Contents, Setting, annotated, carry, carry_all, dependencies,
};

use crate::{
    core::script,
    error::RunError,
    folder::manifest::{Inputs, Made, Manifest, Time},
    options::Options,
    plugins,
    report::{FolderError, RunFolder, write_file},
};

/// Folder of the inputs in a folder of many runs.
const INPUTS: &str = "inputs";

/// Creates the folder of a run in this kind of time. Returns it with the text of the testbed file in it.
pub(crate) fn create(
    options: &Options,
    testbed: &Testbed,
    time: Time,
    text: &str,
) -> Result<(RunFolder, String), RunError> {
    let seed = options.seed.unwrap_or(testbed.seed);
    let other = (seed != testbed.seed).then(|| Setting::new("seed", &seed.to_string()).expect("it is one"));
    let text = annotated(text, other.as_slice());
    let taken: Vec<_> = RunFolder::NAMES.into_iter().chain([RunFolder::TESTBED]).collect();
    let Carried { text, files } = carry(&text, &testbed.folder, &taken);
    let folder = RunFolder::create(&options.folder, &testbed.name, &text)?;
    let path = folder.path();
    put_all(&files, path)?;
    let carried = files_in(path).map_err(|source| FolderError::new(path, source))?;
    let inputs = Inputs { files: carried, outside: outside(&text, path) };
    let inexact = plugins::inexact(testbed).filter(|_| time == Time::Virtual);
    let made = Made { time, inexact, seeds: vec![seed], until: options.until };
    Manifest::begin(path, &options.origin, &made, &inputs)?;
    Ok((folder, text))
}

/// Inputs of many runs of a testbed file, in their folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManyInputs {
    /// The files, for their manifest.
    pub inputs: Inputs,
    /// The settings, whose relative paths start at the copy of the testbed file.
    pub settings: Vec<Setting>,
}

impl ManyInputs {
    /// Names in the folder that the inputs and their manifest use.
    pub const NAMES: [&str; 2] = [INPUTS, Manifest::NAME];
    /// Path of the testbed file from the folder.
    pub const TESTBED: &str = "inputs/testbed.yaml";

    /// Carries a testbed file that stands in `base`, what it names, and what `settings` of its runs name into the folder of
    /// the runs. What was carried there before is removed.
    ///
    /// # Errors
    /// [`RunError`] with the first file that cannot be written.
    pub fn carry(folder: &Path, text: &str, base: &Path, settings: &[Setting]) -> Result<Self, RunError> {
        let to = folder.join(INPUTS);
        match fs::remove_dir_all(&to) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(FolderError::new(&to, error).into());
            }
            _ => fs::create_dir_all(&to).map_err(|source| FolderError::new(&to, source))?,
        }
        let with = settings.iter().map(|setting| annotated(text, std::slice::from_ref(setting)));
        let texts: Vec<_> = std::iter::once(text.to_owned()).chain(with).collect();
        let texts: Vec<_> = texts.iter().map(String::as_str).collect();
        let (texts, files) = carry_all(&texts, base, &[RunFolder::TESTBED]);
        put_all(&files, &to)?;
        write_file(&to, RunFolder::TESTBED, &texts[0])?;
        let files = files_in(&to).map_err(|source| FolderError::new(&to, source))?;
        let mut outside: Vec<_> = texts.iter().flat_map(|text| self::outside(text, &to)).collect();
        outside.sort();
        outside.dedup();
        let files = files.into_iter().map(|file| Path::new(INPUTS).join(file)).collect();
        let noted = |text: &String| dependencies(text, &to).settings.pop()?.parse().ok();
        let settings = texts[1..].iter().filter_map(noted).collect();
        Ok(Self { inputs: Inputs { files, outside }, settings })
    }

    /// Carries another file that the runs read. Returns its path from the folder.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn add(&mut self, folder: &Path, file: &Path, name: &str) -> Result<PathBuf, FolderError> {
        let to = Path::new(INPUTS).join("files").join(name);
        let path = folder.join(&to);
        let parent = path.parent().unwrap_or(folder);
        let copied = fs::create_dir_all(parent).and_then(|()| fs::copy(file, &path));
        copied.map_err(|source| FolderError::new(&path, source))?;
        self.inputs.files.push(to.clone());
        Ok(to)
    }
}

/// Returns what a testbed file needs that is not in its folder.
fn outside(text: &str, folder: &Path) -> Vec<PathBuf> {
    let needed = dependencies(text, folder).files.into_iter().map(|dependency| dependency.path);
    needed.filter(|path| path.is_absolute() && path.exists()).collect()
}

/// Writes the files that a carried testbed file names into its new folder. A file that is there already stays.
///
/// # Errors
/// [`RunError`] with the first file that cannot be written.
pub fn put_all(files: &[CarriedFile], folder: &Path) -> Result<(), RunError> {
    files.iter().try_for_each(|file| put(file, folder))
}

/// Returns the files of a new run's folder, before the run writes its results there: the testbed file, and what it names. Their
/// paths start at the folder.
pub(crate) fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let is_result = |path: &PathBuf| RunFolder::NAMES.iter().any(|name| path.starts_with(name));
    Ok(files_in(folder)?.into_iter().filter(|path| !is_result(path)).collect())
}

/// Returns the files in a folder and below it but those that runs reserve for their summaries, by their sorted paths from there.
fn files_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.file_name().is_none_or(|name| name != RunFolder::RESERVED) {
                found.push(path);
            }
        }
    }
    let of_folder = |path: PathBuf| path.strip_prefix(folder).map(Path::to_owned).unwrap_or(path);
    let mut found: Vec<_> = found.into_iter().map(of_folder).collect();
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
