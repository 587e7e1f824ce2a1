//! Replaces a file as a whole, also in a folder that other users can write to.
//!
//! Whoever can write to a folder can exchange any name in it at any moment. Owner and mode are therefore set on open files,
//! never by a path, and the folder is opened once and checked.

use std::{
    ffi::OsStr,
    fs::{File, Metadata},
    io::{self, Write as _},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use rustix::fs::{AtFlags, Mode, OFlags, ResolveFlags};

/// Replaces a file as a whole, with its permissions and its owner.
///
/// The path has no symbolic links: resolve it once, when the user names it, and not again, because it may lead elsewhere by
/// then.
///
/// # Errors
/// The system's, also if there is a link in the path by now; `Unsupported` if it is no regular file. The file is then as
/// before.
pub fn replace(path: &Path, content: &[u8]) -> io::Result<()> {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    let folder = Folder::open(folder)?;
    let before = folder.metadata(name)?;
    let (draft, mut file) = folder.draft()?;
    let written = file
        .write_all(content)
        .and_then(|()| own(&file, &before))
        .and_then(|()| file.sync_all())
        .and_then(|()| Ok(rustix::fs::renameat(&folder.opened, &draft, &folder.opened, name)?));
    if written.is_err() {
        // The error that is returned is the first one.
        let _ = rustix::fs::unlinkat(&folder.opened, &draft, AtFlags::empty());
    }
    written
}

/// Gives an open file the owner and the permissions of another, without the right to run it as its owner.
fn own(file: &File, like: &Metadata) -> io::Result<()> {
    std::os::unix::fs::fchown(file, Some(like.uid()), Some(like.gid()))?;
    // After the owner, whose change may clear permissions.
    Ok(rustix::fs::fchmod(file, Mode::from_raw_mode(like.mode() & 0o777))?)
}

/// An open folder.
struct Folder {
    opened: File,
}

impl Folder {
    /// Opens a folder whose path has no symbolic links.
    fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::DIRECTORY | OFlags::RDONLY | OFlags::CLOEXEC;
        let resolve = ResolveFlags::NO_SYMLINKS | ResolveFlags::NO_MAGICLINKS;
        let opened = rustix::fs::openat2(rustix::fs::CWD, path, flags, Mode::empty(), resolve)?;
        Ok(Self { opened: opened.into() })
    }

    /// Returns what is known about a regular file.
    fn metadata(&self, name: &OsStr) -> io::Result<Metadata> {
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = File::from(rustix::fs::openat(&self.opened, name, flags, Mode::empty())?);
        let metadata = file.metadata()?;
        if metadata.is_file() { Ok(metadata) } else { Err(io::ErrorKind::Unsupported.into()) }
    }

    /// Makes a new file that only this user can read.
    fn draft(&self) -> io::Result<(PathBuf, File)> {
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let mut attempt = 0;
        loop {
            let name = PathBuf::from(format!(".cotorra-edit-{}-{attempt}", std::process::id()));
            match rustix::fs::openat(&self.opened, &name, flags, Mode::RUSR | Mode::WUSR) {
                Ok(file) => return Ok((name, file.into())),
                Err(rustix::io::Errno::EXIST) if attempt < 100 => attempt += 1,
                Err(error) => return Err(error.into()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        fs,
        os::unix::fs::{PermissionsExt, chown, symlink},
        sync::atomic::{AtomicBool, Ordering},
        thread,
    };

    use super::*;

    #[test]
    fn a_replaced_file_keeps_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().canonicalize().unwrap().join("a.yaml");
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o4640)).unwrap();
        replace(&file, b"new").unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o7777, 0o640);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no draft is left");
    }

    #[test]
    fn a_file_or_folder_that_became_a_link_is_not_followed() {
        let place = tempfile::tempdir().unwrap();
        let place = place.path().canonicalize().unwrap();
        let (secret, folder) = (place.join("secret"), place.join("folder"));
        fs::write(&secret, "secret").unwrap();
        fs::create_dir(&folder).unwrap();
        symlink(&secret, folder.join("a.yaml")).unwrap();
        symlink(&place, place.join("around")).unwrap();
        for path in [folder.join("a.yaml"), place.join("around/secret")] {
            let error = replace(&path, b"new").unwrap_err();
            let is_loop = error.raw_os_error() == Some(rustix::io::Errno::LOOP.raw_os_error());
            assert!(is_loop, "{}: {error}", path.display());
        }
        assert_eq!(fs::read_to_string(&secret).unwrap(), "secret");
    }

    #[test]
    fn a_name_that_another_user_exchanges_gives_nobody_a_file() {
        if !rustix::process::geteuid().is_root() {
            return;
        }
        let place = tempfile::tempdir().unwrap();
        let place = place.path().canonicalize().unwrap();
        let (folder, secret) = (place.join("shared"), place.join("secret"));
        fs::create_dir(&folder).unwrap();
        fs::write(&secret, "of root").unwrap();
        let file = folder.join("a.yaml");
        fs::write(&file, "old").unwrap();
        chown(&file, Some(1234), Some(1234)).unwrap();
        // Another user exchanges whatever appears in the folder for a link to the secret, as fast as it can.
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    for entry in fs::read_dir(&folder).unwrap().flatten() {
                        if entry.file_name().to_string_lossy().starts_with('.') {
                            let _ = fs::remove_file(entry.path());
                            let _ = symlink(&secret, entry.path());
                        }
                    }
                }
            });
            for _ in 0..2000 {
                let _ = replace(&file, b"new");
                if fs::symlink_metadata(&file).is_ok_and(|file| file.is_symlink()) {
                    fs::remove_file(&file).unwrap();
                    fs::write(&file, "old").unwrap();
                    chown(&file, Some(1234), Some(1234)).unwrap();
                }
            }
            over.store(true, Ordering::Relaxed);
        });
        assert_eq!(fs::metadata(&secret).unwrap().uid(), 0);
        assert_eq!(fs::read_to_string(&secret).unwrap(), "of root");
    }
}
