//! Folders of this process in the folder for temporary files, and those that killed processes left.

use std::{
    env,
    fs::{self, DirBuilder},
    os::unix::fs::{DirBuilderExt, MetadataExt},
    path::{Path, PathBuf},
    process,
};

use cotorra_testbed::{FolderError, WIFI_FOLDERS};

/// Beginning of the folders' names. The process's id follows, and a number.
const STEM: &str = "cotorra-testbeds-";
/// Maximum number of folders of processes with one id.
const MOST: usize = 100;

/// A folder that only this user can open. It is removed on drop.
#[derive(Debug)]
pub struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    /// Creates a folder in the folder for temporary files.
    pub fn new() -> Result<Self, FolderError> {
        Self::within(&env::temp_dir())
    }

    pub fn within(base: &Path) -> Result<Self, FolderError> {
        // New and for this user alone, so that no other user has put a file there.
        let make = |folder: &PathBuf| DirBuilder::new().mode(0o700).create(folder);
        let mut refused = None;
        let mut names = (0..MOST).map(|n| base.join(format!("{STEM}{}-{n}", process::id())));
        let made = names.find(|folder| match make(folder) {
            Ok(()) => true,
            Err(error) => {
                refused = Some(FolderError::new(folder, error));
                false
            }
        });
        made.map(Self).ok_or_else(|| refused.expect("at least one name was tried"))
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Leaves it to `cotorra clean`.
    pub fn keep(self) {
        std::mem::forget(self);
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // A file that stays in the folder for temporary files does no harm.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Returns this user's folders whose process is gone.
pub fn leftovers() -> Vec<PathBuf> {
    leftovers_in(&env::temp_dir())
}

fn leftovers_in(base: &Path) -> Vec<PathBuf> {
    let Ok(own) = fs::metadata("/proc/self").map(|own| own.uid()) else { return Vec::new() };
    let entries = fs::read_dir(base).into_iter().flatten().flatten();
    let left = |name: &str| {
        let rest = [STEM, WIFI_FOLDERS].iter().find_map(|stem| name.strip_prefix(stem))?;
        let (process, number) = rest.split_once('-')?;
        let (process, _) = (process.parse::<u32>().ok()?, number.parse::<usize>().ok()?);
        Some(!Path::new(&format!("/proc/{process}")).exists())
    };
    let is_leftover = |entry: &fs::DirEntry| {
        let is_own = |found: fs::Metadata| found.is_dir() && found.uid() == own;
        entry.file_name().to_str().and_then(left) == Some(true) && entry.metadata().is_ok_and(is_own)
    };
    let mut found: Vec<_> = entries.filter(is_leftover).map(|entry| entry.path()).collect();
    found.sort();
    found
}

/// Removes [`leftovers`]. Returns the removed ones, and the error of each other one.
pub fn clean() -> (Vec<PathBuf>, Vec<FolderError>) {
    clean_in(&env::temp_dir())
}

fn clean_in(base: &Path) -> (Vec<PathBuf>, Vec<FolderError>) {
    let mut kept = Vec::new();
    let remove = |path: &PathBuf| match fs::remove_dir_all(path) {
        Ok(()) => true,
        Err(error) => {
            kept.push(FolderError::new(path, error));
            false
        }
    };
    (leftovers_in(base).into_iter().filter(remove).collect(), kept)
}

#[cfg(test)]
mod tests {
    use std::{os::unix::fs::symlink, process::Command};

    use super::*;

    #[test]
    fn folders_are_new_and_removed_on_drop() {
        let base = tempfile::tempdir().unwrap();
        let [one, other] = [(); 2].map(|()| TemporaryFolder::within(base.path()).unwrap());
        assert!(one.path() != other.path() && one.path().is_dir());
        drop((one, other));
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[test]
    fn only_folders_whose_process_is_gone_are_left_over() {
        let base = tempfile::tempdir().unwrap();
        let used = TemporaryFolder::within(base.path()).unwrap();
        let mut ended = Command::new("true").spawn().unwrap();
        ended.wait().unwrap();
        let gone = base.path().join(format!("{STEM}{}-0", ended.id()));
        fs::create_dir_all(gone.join("maps")).unwrap();
        // Names and kinds of others.
        for other in ["cotorra-testbeds-x-0", "cotorra-testbeds-", "cotorra-notes-1-0"] {
            fs::create_dir(base.path().join(other)).unwrap();
        }
        fs::write(base.path().join(format!("{STEM}{}-1", ended.id())), "a file").unwrap();
        symlink(used.path(), base.path().join(format!("{STEM}{}-2", ended.id()))).unwrap();
        let before = fs::read_dir(base.path()).unwrap().count();

        assert_eq!(leftovers_in(base.path()), std::slice::from_ref(&gone));
        let (removed, kept) = clean_in(base.path());
        assert_eq!((removed, kept.len()), (vec![gone], 0));
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), before - 1);
        assert!(used.path().is_dir() && leftovers_in(base.path()).is_empty());
    }
}
