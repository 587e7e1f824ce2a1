//! Files of a template, and the folder that they are written to.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use cotorra_graph::NodeId;

/// File of a template.
pub struct NewFile {
    /// Path in the new folder.
    pub path: &'static str,
    pub contents: Vec<u8>,
}

impl NewFile {
    pub fn new(path: &'static str, contents: impl Into<Vec<u8>>) -> Self {
        Self { path, contents: contents.into() }
    }
}

/// Error of writing a template.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum FilesError {
    #[error("{} exists already, and nothing was written", path.display())]
    #[diagnostic(help("choose another folder, or move the file away: no file is overwritten"))]
    Exists { path: PathBuf },
    #[error("cannot write {}: {reason}", path.display())]
    Unwritable { path: PathBuf, reason: io::Error },
}

/// Folder of a new testbed or plug-in.
pub struct Destination<'a> {
    folder: &'a Path,
}

impl<'a> Destination<'a> {
    pub fn new(folder: &'a Path) -> Self {
        Self { folder }
    }

    /// Returns a name for a testbed after the folder: what no name may hold becomes `-`.
    pub fn name(&self) -> String {
        let whole = std::path::absolute(self.folder).unwrap_or_else(|_| self.folder.to_owned());
        let last = whole.file_name().unwrap_or_default().to_string_lossy();
        let allowed = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '-' };
        let name: String = last.chars().map(allowed).collect();
        let name = name.trim_start_matches(['_', '-', '.']);
        let name = &name[..name.len().min(NodeId::LONGEST)];
        if name.is_empty() { "testbed".to_owned() } else { name.to_owned() }
    }

    /// Checks that no file exists.
    pub fn check(&self, files: &[NewFile]) -> Result<(), FilesError> {
        let paths = files.iter().map(|file| self.folder.join(file.path));
        // A link to nowhere exists, too.
        let mut existing = paths.filter(|path| path.symlink_metadata().is_ok());
        existing.next().map_or(Ok(()), |path| Err(FilesError::Exists { path }))
    }

    /// Writes the files, none of which may exist.
    pub fn write(&self, files: &[NewFile]) -> Result<(), FilesError> {
        self.check(files)?;
        for file in files {
            let path = self.folder.join(file.path);
            let write = || {
                path.parent().map_or(Ok(()), fs::create_dir_all)?;
                File::create_new(&path)?.write_all(&file.contents)
            };
            write().map_err(|reason| FilesError::Unwritable { path: path.clone(), reason })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_from_the_folder() {
        let name = |folder: &str| Destination::new(Path::new(folder)).name();
        assert_eq!(name("labs/office"), "office");
        assert_eq!(name("/labs/second floor/"), "second-floor");
        assert_eq!(name(".hidden"), "hidden");
        assert_eq!(name("/"), "testbed");
        assert_eq!(name(&"ä".repeat(90)), "testbed");
        assert_eq!(name(&"a".repeat(90)).len(), 63);
        assert!(!name(".").is_empty());
    }

    #[test]
    fn no_file_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let destination = Destination::new(folder.path());
        let files = [NewFile::new("first", "1"), NewFile::new("sub/second", "2")];
        fs::create_dir(folder.path().join("sub")).unwrap();
        fs::write(folder.path().join("sub/second"), "mine").unwrap();
        assert!(matches!(destination.write(&files), Err(FilesError::Exists { .. })));
        assert!(!folder.path().join("first").exists(), "nothing was written");
        assert_eq!(fs::read(folder.path().join("sub/second")).unwrap(), b"mine");

        fs::remove_file(folder.path().join("sub/second")).unwrap();
        std::os::unix::fs::symlink("nowhere", folder.path().join("sub/second")).unwrap();
        assert!(destination.check(&files).is_err(), "a link to nowhere is there, too");
    }
}
