//! Files and folders that are the user's alone, written completely or not at all.

use std::{
    ffi::OsString,
    fs::{self, DirBuilder, File, Metadata, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
};

use crate::EnrolmentError;

fn system(path: &Path) -> impl Fn(io::Error) -> EnrolmentError + use<> {
    let path = path.to_owned();
    move |source| EnrolmentError::System { path: path.clone(), source }
}

/// Creates a folder with its parents, unless it exists.
pub fn create_folder(path: &Path) -> Result<(), EnrolmentError> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(system(path))
}

/// Opens a folder that must be this user's alone; `None` if there is none.
pub fn open_folder(path: &Path) -> Result<Option<File>, EnrolmentError> {
    let Some(file) = found(File::open(path), path)? else { return Ok(None) };
    let metadata = file.metadata().map_err(system(path))?;
    if !metadata.is_dir() {
        return Err(system(path)(io::ErrorKind::NotADirectory.into()));
    }
    check_private(path, &metadata)?;
    Ok(Some(file))
}

/// Has a folder for this process alone until the result is dropped. Waits for other processes.
pub fn lock(folder: File, path: &Path) -> Result<File, EnrolmentError> {
    folder.lock().map_err(system(path))?;
    Ok(folder)
}

/// Reads a file of at most `bound` bytes that must be this user's alone; `None` if there is none.
pub fn read(path: &Path, bound: u64) -> Result<Option<String>, EnrolmentError> {
    // First, because opening a pipe waits.
    let Some(metadata) = found(fs::symlink_metadata(path), path)? else { return Ok(None) };
    let damaged = |reason: String| EnrolmentError::Damaged { path: path.to_owned(), reason };
    if !metadata.is_file() {
        return Err(damaged("it is not a regular file".to_owned()));
    }
    check_private(path, &metadata)?;
    let mut bytes = Vec::new();
    let opened = File::open(path).map_err(system(path))?;
    opened.take(bound + 1).read_to_end(&mut bytes).map_err(system(path))?;
    if bytes.len() as u64 > bound {
        return Err(damaged(format!("it has more than {bound} bytes")));
    }
    String::from_utf8(bytes).map(Some).map_err(|_| damaged("it is not text".to_owned()))
}

fn found<T>(result: io::Result<T>, path: &Path) -> Result<Option<T>, EnrolmentError> {
    match result {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(system(path)(error)),
    }
}

/// Rejects what others than this user may use.
fn check_private(path: &Path, metadata: &Metadata) -> Result<(), EnrolmentError> {
    let own = fs::metadata("/proc/self").map_err(system(Path::new("/proc/self")))?.uid();
    let reason = if metadata.uid() != own {
        format!("it belongs to the user {}", metadata.uid())
    } else if metadata.mode() & 0o077 != 0 {
        format!("others may use it (mode {:04o})", metadata.mode() & 0o7777)
    } else {
        return Ok(());
    };
    Err(EnrolmentError::NotPrivate { path: path.to_owned(), reason })
}

/// Writes a file of the user's alone, in place of what is there. A reader sees the old text or the new one, also after a
/// crash. The caller keeps other writers of the file away.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    let draft = draft_of(path)?;
    // One that a killed process left.
    match fs::remove_file(&draft) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let write = || {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&draft)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&draft, path)
    };
    write().inspect_err(|_| _ = fs::remove_file(&draft))?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// As [`write()`], in an authority's folder.
pub fn save(path: &Path, text: &str) -> Result<(), EnrolmentError> {
    write(path, text).map_err(system(path))
}

/// Returns the path under which a file is written before it replaces the file.
pub fn draft_of(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or(io::ErrorKind::InvalidFilename)?;
    let mut draft = OsString::from(".");
    draft.push(name);
    draft.push(".part");
    Ok(path.with_file_name(draft))
}
