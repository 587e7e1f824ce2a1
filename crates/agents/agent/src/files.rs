//! Files of a run, fetched from the core.

use std::{
    fs, io,
    os::unix::fs::PermissionsExt,
    path::{Component, Path, PathBuf},
};

use cotorra_agent_protocol::{Run, Shipped};

/// The testbed file in a run's folder.
pub(crate) const TESTBED: &str = "testbed.yaml";
/// Folder of the logs of VNFs in a run's folder.
pub(crate) const LOGS: &str = "logs";
/// Folder of the VNFs' logs.
pub(crate) const VNF_LOGS: &str = "logs/vnfs";
/// Most that the files of a run take on the disk, bytes.
const MOST: u64 = 256 << 20;

/// Error of fetching files.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FilesError {
    #[error("`{0}` is not a path inside the run's folder")]
    Path(String),
    #[error("the run's files have {0} bytes, of at most {MOST}")]
    TooLarge(u64),
    #[error("`{0}` arrived with other bytes than announced")]
    Damaged(String),
    #[error("{0}")]
    Fetch(String),
    #[error("cannot write {}: {source}", path.display())]
    Write {
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}

/// Returns the folder of a run.
pub(crate) fn folder(state: &Path, run: Run) -> PathBuf {
    state.join("runs").join(run.0.to_string())
}

/// Makes a run's files in its folder, with what `fetch` returns for each. Files that are there already are not fetched.
pub(crate) fn complete(
    folder: &Path,
    files: &[Shipped],
    mut fetch: impl FnMut(&Shipped) -> Result<Vec<u8>, String>,
) -> Result<(), FilesError> {
    let total = files.iter().fold(0_u64, |sum, file| sum.saturating_add(file.bytes));
    if total > MOST {
        return Err(FilesError::TooLarge(total));
    }
    for file in files {
        let path = folder.join(inside(&file.path)?);
        if fs::read(&path).is_ok_and(|contents| file.has(&contents)) {
            continue;
        }
        let bytes = fetch(file).map_err(FilesError::Fetch)?;
        if !file.has(&bytes) {
            return Err(FilesError::Damaged(file.path.clone()));
        }
        let write = |path: &Path| -> io::Result<()> {
            fs::create_dir_all(path.parent().unwrap_or(folder))?;
            fs::write(path, &bytes)?;
            let mode = if file.executable { 0o755 } else { 0o644 };
            fs::set_permissions(path, fs::Permissions::from_mode(mode))
        };
        write(&path).map_err(|source| FilesError::Write { path, source })?;
    }
    Ok(())
}

/// Removes the folders of all other runs.
pub(crate) fn remove_others(state: &Path, run: Run) {
    let kept = folder(state, run);
    for other in fs::read_dir(state.join("runs")).into_iter().flatten().flatten() {
        if other.path() != kept
            && let Err(error) = fs::remove_dir_all(other.path())
        {
            tracing::warn!("cannot remove {}: {error}", other.path().display());
        }
    }
}

/// Returns a path if it stays inside its folder.
fn inside(path: &str) -> Result<&Path, FilesError> {
    let parts = Path::new(path);
    let is_inside = !path.is_empty() && parts.components().all(|part| matches!(part, Component::Normal(_)));
    if is_inside { Ok(parts) } else { Err(FilesError::Path(path.to_owned())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped(path: &str, bytes: &[u8]) -> Shipped {
        Shipped::new(path.to_owned(), bytes, true)
    }

    #[test]
    fn files_are_fetched_once() {
        let folder = tempfile::tempdir().unwrap();
        let files = [shipped("a/b.sh", b"x")];
        let mut fetched = 0;
        for _ in 0..2 {
            complete(folder.path(), &files, |_| {
                fetched += 1;
                Ok(b"x".to_vec())
            })
            .unwrap();
        }
        assert_eq!(fetched, 1);
        let path = folder.path().join("a/b.sh");
        assert_eq!(fs::read(&path).unwrap(), b"x");
        assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o755);
    }

    #[test]
    fn paths_outside_the_folder_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        for path in ["", "/etc/passwd", "../x", "a/../../x", "."] {
            let done = complete(folder.path(), &[shipped(path, b"x")], |_| Ok(b"x".to_vec()));
            assert!(matches!(done, Err(FilesError::Path(_))), "{path}");
        }
    }

    #[test]
    fn damaged_and_oversized_files_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let done = complete(folder.path(), &[shipped("a", b"x")], |_| Ok(b"y".to_vec()));
        assert!(matches!(done, Err(FilesError::Damaged(_))));
        let large = Shipped { bytes: MOST + 1, ..shipped("a", b"x") };
        let done = complete(folder.path(), &[large], |_| unreachable!());
        assert!(matches!(done, Err(FilesError::TooLarge(_))));
        assert!(!folder.path().join("a").exists());
    }

    #[test]
    fn only_the_current_run_keeps_its_files() {
        let state = tempfile::tempdir().unwrap();
        for run in [1, 2] {
            fs::create_dir_all(folder(state.path(), Run(run))).unwrap();
        }
        remove_others(state.path(), Run(2));
        assert!(!folder(state.path(), Run(1)).exists() && folder(state.path(), Run(2)).exists());
    }
}
