//! The runs of this user on this machine, and the socket on which each serves its API beside its TCP address.
//!
//! Anyone on a machine can listen on a TCP port, and a run whose port is taken moves to another. So a run also listens on a
//! Unix socket in a folder that only its user may enter, with an entry beside it that says whose it is. Nobody else can put a
//! socket there: whoever finds a run here ([`Runs::find`]) and talks to it over that socket
//! ([`Client::of`](crate::client::Client::of)) talks to that run, and to nobody who took its port.
//!
//! A run holds a lock on its entry, which the kernel takes away when the process ends, however it ends: the entry of a dead
//! process is known by that, and the next run removes it.

use std::{
    env, fmt,
    fs::{self, DirBuilder, File, Metadata, OpenOptions, Permissions, TryLockError},
    io::{self, Read, Write},
    net::SocketAddr,
    os::unix::{
        fs::{DirBuilderExt, FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt},
        net::UnixListener,
    },
    path::{Path, PathBuf},
    process,
};

use serde::{Deserialize, Serialize};

/// An entry is no longer than this, bytes: a path and a few numbers.
const LONGEST_ENTRY: u64 = 16 << 10;
/// How an entry's name ends, and that of its socket.
const ENTRY: &str = "json";
const SOCKET: &str = "sock";

/// Where the runs of a user are found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Runs {
    /// New ones are put into the first.
    folders: Vec<PathBuf>,
}

/// A run that goes on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunEntry {
    /// Where it serves its API over TCP.
    pub api: SocketAddr,
    /// Its folder, or what else it is.
    pub run: PathBuf,
    /// Its process.
    pub process: u32,
    /// Where it serves its API to this user alone.
    pub socket: PathBuf,
}

/// What an entry's file holds.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    api: SocketAddr,
    run: PathBuf,
    process: u32,
}

/// Why a run is not found, or cannot be.
#[derive(Debug, thiserror::Error)]
pub enum RunsError {
    /// The system does not let this user use a file.
    #[error("cannot use {}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Somebody else may have written it.
    #[error("{} is not trusted: {why}; see where it comes from, and remove it", path.display())]
    NotPrivate {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        why: NotPrivate,
    },
    /// Another version may have written it.
    #[error("{} does not say which run it is of: {reason}; use the cotorra that runs, or remove it", path.display())]
    Malformed {
        /// The entry.
        path: PathBuf,
        /// What is wrong with it.
        reason: serde_json::Error,
    },
    /// Nothing runs.
    #[error("no testbed of this user runs on this machine (none is in {})", list(folders.iter().map(|folder| folder.display())))]
    None {
        /// Where one would be.
        folders: Vec<PathBuf>,
    },
    /// It was not said which.
    #[error("several testbeds run: {}", list(.0))]
    Several(Vec<RunEntry>),
    /// No run of this user serves its API there.
    #[error("no testbed of this user serves its API on {api}{}", others(running))]
    NotThere {
        /// The address.
        api: SocketAddr,
        /// Those that run.
        running: Vec<RunEntry>,
    },
}

/// What is wrong with a file or folder that is to be this user's alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotPrivate {
    /// It is of another kind, such as a symbolic link.
    Kind {
        /// What it should be.
        wanted: &'static str,
    },
    /// Another user's.
    Owner {
        /// That user.
        uid: u32,
    },
    /// Others may use it.
    Mode {
        /// Its permissions.
        mode: u32,
    },
    /// Others may put something else in its place.
    Parent,
}

impl fmt::Display for NotPrivate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kind { wanted } => write!(f, "it is no {wanted}"),
            Self::Owner { uid } => write!(f, "it belongs to another user ({uid})"),
            Self::Mode { mode } => write!(f, "others may use it (mode {mode:04o})"),
            Self::Parent => f.write_str("others may write to the folder that it is in"),
        }
    }
}

impl fmt::Display for RunEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.api, self.run.display())
    }
}

fn list<T: fmt::Display>(all: impl IntoIterator<Item = T>) -> String {
    all.into_iter().map(|one| one.to_string()).collect::<Vec<_>>().join(", ")
}

fn others(running: &[RunEntry]) -> String {
    if running.is_empty() { ", and none runs".to_owned() } else { format!("; there are {}", list(running)) }
}

fn system(path: &Path) -> impl FnOnce(io::Error) -> RunsError {
    let path = path.to_owned();
    move |source| RunsError::System { path, source }
}

impl RunEntry {
    /// Whether an address leads to its API: its own, or one of loopback where it listens on all.
    fn serves(&self, api: SocketAddr) -> bool {
        let Self { api: own, .. } = self;
        *own == api || own.ip().is_unspecified() && api.ip().is_loopback() && own.port() == api.port()
    }

    /// Whether a path leads to a file that its process holds open, as `/proc/4242/fd/17` does of process 4242.
    pub fn holds(&self, path: &Path) -> bool {
        let open = format!("/proc/{}/fd/", self.process);
        let number = path.to_str().and_then(|path| path.strip_prefix(&open));
        number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
    }
}

impl Runs {
    /// Those of this process's user. New ones are put into `cotorra` in `XDG_RUNTIME_DIR`; where that is not set, or another
    /// user's, into `cotorra-UID` in the folder for temporary files. One that was started from elsewhere, as by `sudo`, may have
    /// done the other: both are searched, and `/run/user/UID`.
    pub fn of_user() -> Self {
        let own = user();
        let is_own = |path: &PathBuf| {
            path.is_absolute() && fs::metadata(path).is_ok_and(|found| Some(found.uid()) == own)
        };
        let named = env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(is_own);
        let uid = own.map_or("unknown".to_owned(), |uid| uid.to_string());
        let of_session = Some(PathBuf::from(format!("/run/user/{uid}"))).filter(is_own);
        let mut folders: Vec<_> = named.iter().map(|folder| folder.join("cotorra")).collect();
        folders.push(env::temp_dir().join(format!("cotorra-{uid}")));
        folders.extend(of_session.filter(|folder| Some(folder) != named.as_ref()).map(|f| f.join("cotorra")));
        Self { folders }
    }

    /// Those in one folder, which is made when a run is put there.
    pub fn in_folder(path: impl Into<PathBuf>) -> Self {
        Self { folders: vec![path.into()] }
    }

    /// The run that serves its API on an address; without one, the only run.
    ///
    /// # Errors
    /// [`RunsError::None`], [`RunsError::Several`] or [`RunsError::NotThere`]; others where a file cannot be read or trusted.
    pub fn find(&self, api: Option<SocketAddr>) -> Result<RunEntry, RunsError> {
        let (mut running, refused) = self.running();
        if let Some(api) = api {
            let place = running.iter().position(|run| run.serves(api));
            return match place {
                Some(place) => Ok(running.swap_remove(place)),
                None => Err(refused.unwrap_or(RunsError::NotThere { api, running })),
            };
        }
        match running.len() {
            0 => Err(refused.unwrap_or_else(|| RunsError::None { folders: self.folders.clone() })),
            1 => Ok(running.remove(0)),
            _ => Err(RunsError::Several(running)),
        }
    }

    /// All that go on, by address; and why the first that was refused was. Others can make a folder for temporary files theirs,
    /// but not hide with that what is in another.
    fn running(&self) -> (Vec<RunEntry>, Option<RunsError>) {
        let (mut running, mut refused) = (Vec::new(), None);
        for folder in &self.folders {
            let entries = is_there(folder)
                .and_then(|there| if there { with_ending(folder, &[ENTRY]) } else { Ok(Vec::new()) });
            let entries = entries.unwrap_or_else(|error| {
                refused.get_or_insert(error);
                Vec::new()
            });
            for path in entries {
                match read(&path) {
                    Ok(entry) => running.extend(entry),
                    Err(error) => _ = refused.get_or_insert(error),
                }
            }
        }
        running.sort_by_key(|run| run.api);
        (running, refused)
    }

    /// Puts a run of this process there, until what it gives is dropped. What dead processes left there is removed.
    ///
    /// # Errors
    /// [`RunsError`] where nothing can be put, or others might read or replace it.
    pub fn announce(&self, api: SocketAddr, run: &Path) -> Result<Announced, RunsError> {
        let folder = self.folders.first().expect("there is one");
        if !is_there(folder)? {
            let parents = folder.parent().map_or(Ok(()), fs::create_dir_all);
            let made = parents.and_then(|()| match DirBuilder::new().mode(0o700).create(folder) {
                // Another run was faster; whether it is one of ours is looked at next.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
                made => made,
            });
            made.map_err(system(folder))?;
            is_there(folder)?;
        }
        // Nobody takes an entry for a dead one's before it has its lock.
        let _alone = locked(folder)?;
        remove_dead(folder)?;
        let process = process::id();
        let entry = folder.join(format!("{process}-{}.{ENTRY}", api.port()));
        let socket = entry.with_extension(SOCKET);
        let listener = UnixListener::bind(&socket).map_err(system(&socket))?;
        let mut announced = Announced { listener: Some(listener), files: vec![socket.clone()], _lock: None };
        fs::set_permissions(&socket, Permissions::from_mode(0o600)).map_err(system(&socket))?;
        let written = Written { api, run: run.to_owned(), process };
        let text = serde_json::to_string(&written)
            .map_err(|reason| RunsError::Malformed { path: entry.clone(), reason })?;
        let mut file = OpenOptions::new();
        let mut file = file.write(true).create_new(true).mode(0o600).open(&entry).map_err(system(&entry))?;
        announced.files.insert(0, entry.clone());
        file.write_all(text.as_bytes()).and_then(|()| file.lock()).map_err(system(&entry))?;
        announced._lock = Some(file);
        Ok(announced)
    }

    /// What dead processes left, and why others cannot be told.
    pub fn leftovers(&self) -> (Vec<PathBuf>, Vec<RunsError>) {
        self.each_folder(dead)
    }

    /// Removes what dead processes left: gives what it removed, and why others stay.
    pub fn clean(&self) -> (Vec<PathBuf>, Vec<RunsError>) {
        self.each_folder(|folder| {
            let _alone = locked(folder)?;
            remove_dead(folder)
        })
    }

    fn each_folder(
        &self,
        of: impl Fn(&Path) -> Result<Vec<PathBuf>, RunsError>,
    ) -> (Vec<PathBuf>, Vec<RunsError>) {
        let (mut all, mut refused) = (Vec::new(), Vec::new());
        for folder in &self.folders {
            match is_there(folder).and_then(|there| if there { of(folder) } else { Ok(Vec::new()) }) {
                Ok(paths) => all.extend(paths),
                Err(error) => refused.push(error),
            }
        }
        (all, refused)
    }
}

/// A run of this process that others of its user can find.
#[derive(Debug)]
pub struct Announced {
    listener: Option<UnixListener>,
    files: Vec<PathBuf>,
    /// Says that this process lives.
    _lock: Option<File>,
}

impl Announced {
    /// Takes the socket on which the API is to be served; `None` the second time.
    pub fn listener(&mut self) -> Option<UnixListener> {
        self.listener.take()
    }
}

impl Drop for Announced {
    fn drop(&mut self) {
        for file in &self.files {
            // What stays is removed by the next run.
            let _ = fs::remove_file(file);
        }
    }
}

/// The user as whom this process acts, as seen from its user namespace.
fn user() -> Option<u32> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let ids = status.lines().find_map(|line| line.strip_prefix("Uid:"))?;
    // Real, effective, saved, of files.
    ids.split_whitespace().nth(1)?.parse().ok()
}

/// What matters of a file for who may use it.
#[derive(Debug, Clone, Copy)]
struct Found {
    is_of_kind: bool,
    uid: u32,
    mode: u32,
}

/// Refuses what may be used by others than the user `own`.
fn private(found: Found, wanted: &'static str, own: Option<u32>) -> Result<(), NotPrivate> {
    let Found { is_of_kind, uid, mode } = found;
    if !is_of_kind {
        return Err(NotPrivate::Kind { wanted });
    }
    if Some(uid) != own {
        return Err(NotPrivate::Owner { uid });
    }
    if mode & 0o077 != 0 {
        return Err(NotPrivate::Mode { mode: mode & 0o7777 });
    }
    Ok(())
}

/// Refuses a folder in which others than the user `own` may put something in the place of what is there.
fn keeps(parent: Found, own: Option<u32>) -> Result<(), NotPrivate> {
    let is_sticky = parent.mode & 0o1000 != 0;
    let is_own = Some(parent.uid) == own && parent.mode & 0o022 == 0;
    if is_sticky || is_own { Ok(()) } else { Err(NotPrivate::Parent) }
}

/// Looks at a file, not at what a link leads to; `None` if there is none.
fn look(path: &Path, is_of_kind: impl Fn(&Metadata) -> bool) -> Result<Option<Found>, RunsError> {
    match fs::symlink_metadata(path) {
        Ok(found) => {
            let is_of_kind = is_of_kind(&found);
            Ok(Some(Found { is_of_kind, uid: found.uid(), mode: found.mode() }))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(system(path)(error)),
    }
}

/// Whether a folder for runs is there; refuses one that is not this user's alone.
fn is_there(folder: &Path) -> Result<bool, RunsError> {
    let not_private = |why| RunsError::NotPrivate { path: folder.to_owned(), why };
    let own = user();
    let Some(found) = look(folder, Metadata::is_dir)? else { return Ok(false) };
    private(found, "folder", own).map_err(not_private)?;
    // The user wrote this folder's name: what its parent's name leads to is meant.
    let parent = folder.parent().map_or(Path::new("/"), |parent| parent);
    let parent = parent.canonicalize().map_err(system(parent))?;
    match look(&parent, Metadata::is_dir)? {
        Some(parent) => keeps(parent, own).map_err(not_private)?,
        None => return Ok(false),
    }
    Ok(true)
}

/// Files of a folder by how their names end.
fn with_ending(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, RunsError> {
    let mut all = Vec::new();
    for file in fs::read_dir(folder).map_err(system(folder))? {
        let path = file.map_err(system(folder))?.path();
        if path.extension().is_some_and(|ending| endings.iter().any(|wanted| ending == *wanted)) {
            all.push(path);
        }
    }
    Ok(all)
}

/// Has a folder's files for itself until what it gives is dropped.
fn locked(folder: &Path) -> Result<File, RunsError> {
    let file = File::open(folder).map_err(system(folder))?;
    file.lock().map_err(system(folder))?;
    Ok(file)
}

/// Opens an entry whose process lives; `None` if it is gone.
fn open(path: &Path) -> Result<Option<File>, RunsError> {
    let not_private = |path: &Path| {
        let path = path.to_owned();
        |why| RunsError::NotPrivate { path, why }
    };
    let Some(found) = look(path, Metadata::is_file)? else { return Ok(None) };
    private(found, "regular file", user()).map_err(not_private(path))?;
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(system(path)(error)),
    };
    match file.try_lock_shared() {
        Ok(()) => Ok(None),
        Err(TryLockError::WouldBlock) => Ok(Some(file)),
        Err(TryLockError::Error(error)) => Err(system(path)(error)),
    }
}

/// Reads an entry; `None` if its process is gone.
fn read(path: &Path) -> Result<Option<RunEntry>, RunsError> {
    let Some(file) = open(path)? else { return Ok(None) };
    let mut text = Vec::new();
    file.take(LONGEST_ENTRY).read_to_end(&mut text).map_err(system(path))?;
    let Written { api, run, process } = serde_json::from_slice(&text)
        .map_err(|reason| RunsError::Malformed { path: path.to_owned(), reason })?;
    let socket = path.with_extension(SOCKET);
    let is_socket = |found: &Metadata| found.file_type().is_socket();
    let Some(found) = look(&socket, is_socket)? else { return Ok(None) };
    private(found, "socket", user()).map_err(|why| RunsError::NotPrivate { path: socket.clone(), why })?;
    Ok(Some(RunEntry { api, run, process, socket }))
}

/// What dead processes left in a folder.
fn dead(folder: &Path) -> Result<Vec<PathBuf>, RunsError> {
    let mut dead = Vec::new();
    for path in with_ending(folder, &[ENTRY, SOCKET])? {
        // An entry that is not trusted is told to whoever looks for runs, and kept.
        if matches!(open(&path.with_extension(ENTRY)), Ok(None)) {
            dead.push(path);
        }
    }
    Ok(dead)
}

fn remove_dead(folder: &Path) -> Result<Vec<PathBuf>, RunsError> {
    let dead = dead(folder)?;
    for path in &dead {
        fs::remove_file(path).map_err(system(path))?;
    }
    Ok(dead)
}

#[cfg(test)]
mod tests;
