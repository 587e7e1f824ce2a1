//! Folders of results: where they are made, and how files are written there.

use std::{
    fs::{self, DirBuilder, File},
    io::{self, Read as _},
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
};

/// Name of the file with a run's [`Summary`](super::Summary).
pub(super) const SUMMARY: &str = "summary.json";

/// A file of a results folder cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {}", path.display(), reason(path, source))]
pub struct FolderError {
    path: PathBuf,
    source: io::Error,
}

/// Returns the system's reason, or that a file is where a folder must be.
fn reason(path: &Path, source: &io::Error) -> String {
    match path.ancestors().find(|above| above.exists()) {
        Some(file) if !file.is_dir() && (file != path || source.kind() == io::ErrorKind::AlreadyExists) => {
            format!("{} is a file; name a folder", file.display())
        }
        _ => source.to_string(),
    }
}

impl FolderError {
    /// Creates an error on a path.
    pub fn new(path: &Path, source: io::Error) -> Self {
        Self { path: path.to_owned(), source }
    }
}

/// Place of a results folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// Inside this folder, named after the testbed and the time.
    In(PathBuf),
    /// Exactly this folder, which must not exist yet.
    At(PathBuf),
}

impl Default for Place {
    fn default() -> Self {
        Self::In(PathBuf::from("runs"))
    }
}

impl Place {
    /// Creates the folder and its parents. Returns its absolute path. Only this user can look into the folder: it has copies of
    /// what the testbed file names, and what programs said.
    ///
    /// # Errors
    /// [`FolderError`] if that fails, or [`Place::At`] exists.
    pub fn create(&self, name: &str) -> Result<PathBuf, FolderError> {
        let fail = |path: &Path| {
            let path = path.to_owned();
            move |source| FolderError { path, source }
        };
        let (parent, names): (_, Vec<_>) = match self {
            Self::At(path) => (path.parent().unwrap_or(Path::new("")), vec![path.clone()]),
            Self::In(parent) => {
                let time = chrono::Local::now().format("%Y%m%d-%H%M%S");
                let stem = format!("{name}-{time}");
                // Runs that start within the same second have different names.
                let names = std::iter::once(stem.clone()).chain((2..1000).map(|i| format!("{stem}-{i}")));
                (&**parent, names.map(|name| parent.join(name)).collect())
            }
        };
        if !parent.as_os_str().is_empty() {
            fs::create_dir_all(parent).map_err(fail(parent))?;
        }
        let mut taken = None;
        for path in names {
            match DirBuilder::new().mode(0o700).create(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    taken = Some(fail(&path)(error));
                }
                made => return made.and_then(|()| path.canonicalize()).map_err(fail(&path)),
            }
        }
        Err(taken.expect("at least one name was tried"))
    }
}

/// Reads a file of bounded length. A folder may be of somebody else: a pipe in it, which nobody writes to, is not waited for.
///
/// # Errors
/// Those of the system; `InvalidData` if it is no file, or longer than `most` bytes.
pub(crate) fn read_file(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let invalid = |reason: String| io::Error::new(io::ErrorKind::InvalidData, reason);
    if !fs::metadata(path)?.is_file() {
        return Err(invalid("it is not a file".to_owned()));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(invalid(format!("it has more than {most} bytes"))) } else { Ok(bytes) }
}

/// Writes a file completely or not at all: a reader never sees half of one.
pub fn write_file(folder: &Path, name: &str, content: impl AsRef<[u8]>) -> Result<(), FolderError> {
    let path = folder.join(name);
    let draft = folder.join(format!(".{name}.part"));
    fs::write(&draft, content)
        .and_then(|()| fs::rename(&draft, &path))
        // The draft may not exist.
        .inspect_err(|_| drop(fs::remove_file(&draft)))
        .map_err(|source| FolderError { path, source })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn others_cannot_look_into_a_results_folder() {
        let folder = tempfile::tempdir().unwrap();
        let made = Place::In(folder.path().join("runs")).create("x").unwrap();
        assert_eq!(fs::metadata(made).unwrap().permissions().mode() & 0o777, 0o700);
    }

    #[test]
    fn a_file_in_place_of_a_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        for place in [file.clone(), file.join("below"), file.join("far/below")] {
            let error = Place::In(place).create("run").unwrap_err().to_string();
            assert!(error.ends_with(&format!("{} is a file; name a folder", file.display())), "{error}");
        }
        let existing = Place::At(folder.path().to_owned()).create("run").unwrap_err().to_string();
        assert!(existing.contains("exists") && !existing.contains("is a file"), "{existing}");
    }
}
