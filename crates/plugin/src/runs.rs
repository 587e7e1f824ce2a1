//! The runs of this user on this machine, and the socket on which each serves its API beside its TCP address.
//!
//! Any user can listen on a TCP port, and a run whose port is taken moves to another. So a run also listens on a Unix
//! socket in a folder that only its user may enter, and writes its address into an entry beside it. No other user can put a
//! socket there: a tool that finds a run ([`Runs::find`]) and connects to its socket
//! ([`Client::of`](crate::client::Client::of)) talks to that run. No nonce is needed: the kernel decides who listens there.
//!
//! A run holds a lock on its entry. The kernel releases it when the process ends, also by SIGKILL: an entry without a lock
//! is that of a dead process, and the next run removes it.
//!
//! A folder is opened once, checked, and then used through `/proc/self/fd`. So no other user can exchange it after the check, and
//! a socket's path is never too long.

use std::{
    collections::BTreeSet,
    env, fmt,
    fs::{self, DirBuilder, File, Metadata, OpenOptions, Permissions, TryLockError},
    io::{self, Read, Write},
    net::{Ipv4Addr, SocketAddr},
    os::{
        fd::AsRawFd,
        unix::{
            fs::{DirBuilderExt, FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt},
            net::{UnixListener, UnixStream},
        },
    },
    path::{Path, PathBuf},
    process,
    sync::Arc,
};

use serde::{Deserialize, Serialize};

/// Longest entry that is read, in bytes.
const LONGEST_ENTRY: u64 = 64 << 10;
/// Endings of an entry's name and of its socket's.
const ENTRY: &str = "json";
const SOCKET: &str = "sock";

/// Registry of a user's runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Runs {
    /// New ones are put into the first.
    folders: Vec<PathBuf>,
}

/// A run that goes on.
#[derive(Debug, Clone)]
pub struct RunEntry {
    /// Address of its API over TCP.
    pub api: SocketAddr,
    /// Name of its testbed.
    pub name: String,
    /// Its folder, or for people what it is.
    pub what: String,
    /// Process ID.
    pub process: u32,
    folder: Folder,
    stem: String,
    entry: Arc<File>,
}

/// Content of an entry's file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    api: SocketAddr,
    name: String,
    what: String,
    process: u32,
}

/// Error of finding or registering a run.
#[derive(Debug, thiserror::Error)]
pub enum RunsError {
    /// The system does not let this user use a file.
    #[error("cannot use {}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Another user may have written it.
    #[error("{} is not trusted: {why}; see where it comes from, and remove it", path.display())]
    NotPrivate {
        /// The file or folder.
        path: PathBuf,
        /// Reason.
        why: NotPrivate,
    },
    /// Another version may have written it.
    #[error("{} is not an entry of a run: {reason}; use the version of cotorra that runs, or remove it", path.display())]
    Malformed {
        /// The entry.
        path: PathBuf,
        /// Mistake in the file.
        reason: serde_json::Error,
    },
    /// Nothing runs.
    #[error(
        "no testbed of this user runs on this machine (none is in {})",
        list(folders.iter().map(|path| path.display()))
    )]
    None {
        /// Searched folders.
        folders: Vec<PathBuf>,
    },
    /// Several go on, and nothing says which is meant.
    #[error("several testbeds run: {}", list(.0))]
    Several(Vec<RunEntry>),
    /// No run of this user is meant.
    #[error("no testbed of this user has the name, the folder or the address {wanted}{}", others(running))]
    NotThere {
        /// Its name, its folder, or the address of its API.
        wanted: String,
        /// Those that run.
        running: Vec<RunEntry>,
    },
}

/// Reason why a file or folder is not this user's alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotPrivate {
    /// The file is of another kind, such as a symbolic link.
    Kind {
        /// Expected kind.
        wanted: &'static str,
    },
    /// The file belongs to another user.
    Owner {
        /// The user's ID.
        uid: u32,
    },
    /// Others may use it.
    Mode {
        /// Permissions of the file.
        mode: u32,
    },
}

impl fmt::Display for NotPrivate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kind { wanted } => write!(f, "it is no {wanted}"),
            Self::Owner { uid } => write!(f, "it belongs to another user ({uid})"),
            Self::Mode { mode } => write!(f, "others may use it (mode {mode:04o})"),
        }
    }
}

impl fmt::Display for RunEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} on {} ({})", self.name, self.api, self.what)
    }
}

/// Parses `127.0.0.1:7700` or `http://localhost:7700/`. Looks up no other name of a host.
fn address(text: &str) -> Option<SocketAddr> {
    let host = text.strip_prefix("http://").unwrap_or(text).trim_end_matches('/');
    match host.strip_prefix("localhost:") {
        Some(port) => Some(SocketAddr::from((Ipv4Addr::LOCALHOST, port.parse().ok()?))),
        None => host.parse().ok(),
    }
}

fn list<T: fmt::Display>(all: impl IntoIterator<Item = T>) -> String {
    all.into_iter().map(|one| one.to_string()).collect::<Vec<_>>().join(", ")
}

fn others(running: &[RunEntry]) -> String {
    if running.is_empty() { ", and none runs".to_owned() } else { format!("; there are {}", list(running)) }
}

fn system(path: &Path) -> impl Fn(io::Error) -> RunsError + use<> {
    let path = path.to_owned();
    move |source| RunsError::System { path: path.clone(), source }
}

impl RunEntry {
    /// Connects to its socket.
    ///
    /// # Errors
    /// Error of the system, as when the run ended.
    pub fn connect(&self) -> io::Result<UnixStream> {
        UnixStream::connect(self.folder.file(&self.stem, SOCKET))
    }

    /// Returns the path of its socket, as it was when the run was found.
    pub fn socket(&self) -> PathBuf {
        self.folder.path.join(format!("{}.{SOCKET}", self.stem))
    }

    /// Whether a text means it: its testbed's name, its folder or that folder's name, or the address or URL of its API.
    pub fn is(&self, wanted: &str) -> bool {
        let folder = Path::new(&self.what);
        let is_folder = folder.is_absolute()
            && (folder.file_name().is_some_and(|name| name == wanted)
                || fs::canonicalize(wanted)
                    .is_ok_and(|wanted| fs::canonicalize(folder).is_ok_and(|own| own == wanted)));
        self.name == wanted || is_folder || address(wanted).is_some_and(|api| self.serves(api))
    }

    /// Whether an address leads to its API: its own, or one of loopback where it listens on all.
    fn serves(&self, api: SocketAddr) -> bool {
        let Self { api: own, .. } = self;
        *own == api || own.ip().is_unspecified() && api.ip().is_loopback() && own.port() == api.port()
    }

    /// Whether a path is that of a file that its process holds open, such as `/proc/4242/fd/17` for process 4242.
    pub fn holds(&self, path: &Path) -> bool {
        let open = format!("/proc/{}/fd/", self.process);
        let number = path.to_str().and_then(|path| path.strip_prefix(&open));
        number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
    }

    /// Whether the process of that number holds its entry open. It does not if the run ended and another process got the
    /// number, or if the run has another PID namespace.
    pub fn is_its_process(&self) -> bool {
        let Ok(entry) = self.entry.metadata() else { return false };
        let is_entry = |found: Metadata| (found.dev(), found.ino()) == (entry.dev(), entry.ino());
        let open = fs::read_dir(format!("/proc/{}/fd", self.process)).into_iter().flatten().flatten();
        open.map(|file| file.path()).any(|path| fs::metadata(path).is_ok_and(is_entry))
    }
}

impl Runs {
    /// Those of this process's user. New ones are put into the first of these folders: `cotorra` in `XDG_RUNTIME_DIR`, or
    /// in `/run/user/UID`, where that is there and the user's; or else `cotorra-UID` in the folder for temporary files. All
    /// are searched, because a run and a tool may be started in different environments, as by `sudo`.
    ///
    /// Call it before the process enters a user namespace, in which its user has another number.
    pub fn of_user() -> Self {
        let uid = user();
        let is_own = |path: &PathBuf| {
            path.is_absolute() && fs::metadata(path).is_ok_and(|found| Some(found.uid()) == uid)
        };
        let uid = uid.map_or("unknown".to_owned(), |uid| uid.to_string());
        let named = env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
        let of_session = PathBuf::from(format!("/run/user/{uid}"));
        let own = named.into_iter().chain([of_session]).filter(is_own);
        let mut folders: Vec<_> = own.map(|folder| folder.join("cotorra")).collect();
        folders.dedup();
        folders.push(env::temp_dir().join(format!("cotorra-{uid}")));
        Self { folders }
    }

    /// Those in one folder, which is made when a run is put there.
    pub fn in_folder(path: impl Into<PathBuf>) -> Self {
        Self { folders: vec![path.into()] }
    }

    /// Folders in which they are, now or later.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Returns the run that a text means: the name of its testbed, its folder or that folder's name, or the address or URL
    /// of its API. Without a text, returns the only run.
    ///
    /// # Errors
    /// [`RunsError::None`], [`RunsError::Several`] or [`RunsError::NotThere`]; others where a file is not read or trusted.
    pub fn find(&self, wanted: Option<&str>) -> Result<RunEntry, RunsError> {
        let (mut running, refused) = self.running();
        if let Some(wanted) = wanted {
            let meant: Vec<_> = running.iter().filter(|run| run.is(wanted)).cloned().collect();
            if meant.is_empty() {
                let wanted = wanted.to_owned();
                return Err(refused.unwrap_or(RunsError::NotThere { wanted, running }));
            }
            running = meant;
        }
        match running.len() {
            0 => Err(refused.unwrap_or_else(|| RunsError::None { folders: self.folders.clone() })),
            1 => Ok(running.remove(0)),
            _ => Err(RunsError::Several(running)),
        }
    }

    /// Returns all that go on, by address, and the first error. An error in one folder does not hide the runs in another:
    /// any user can make a folder in that for temporary files.
    pub fn running(&self) -> (Vec<RunEntry>, Option<RunsError>) {
        let (mut running, mut refused) = (Vec::new(), None);
        for path in &self.folders {
            let entries = Folder::open(path).and_then(|folder| match folder {
                Some(folder) => Ok(folder.stems()?.iter().map(|stem| folder.read(stem)).collect()),
                None => Ok(Vec::new()),
            });
            for entry in entries.unwrap_or_else(|error| vec![Err(error)]) {
                match entry {
                    Ok(entry) => running.extend(entry),
                    Err(error) => _ = refused.get_or_insert(error),
                }
            }
        }
        running.sort_by_key(|run| run.api);
        (running, refused)
    }

    /// Puts a run of this process there, until the result is dropped: the testbed of that name, and what it is, such as
    /// its folder. Removes what dead processes left there.
    ///
    /// # Errors
    /// [`RunsError`] where nothing can be put, or others might read or replace it.
    pub fn announce(&self, api: SocketAddr, name: &str, what: &str) -> Result<Announced, RunsError> {
        let folder = Folder::make(self.folders.first().expect("there is one"))?;
        // So no process takes the entry for that of a dead one before it is locked.
        let _alone = folder.lock()?;
        folder.remove_dead()?;
        let process = process::id();
        let stem = format!("{process}-{}", api.port());
        let [entry, socket] = [ENTRY, SOCKET].map(|ending| folder.file(&stem, ending));
        let [failed, socket_failed] =
            [ENTRY, SOCKET].map(|ending| system(&folder.path.join(format!("{stem}.{ending}"))));
        let listener = UnixListener::bind(&socket).map_err(&socket_failed)?;
        let mut announced = Announced { listener: Some(listener), _entry: None, folder, stem };
        fs::set_permissions(&socket, Permissions::from_mode(0o600)).map_err(socket_failed)?;
        let written = Written { api, name: name.to_owned(), what: what.to_owned(), process };
        let text = serde_json::to_vec(&written).expect("text and numbers become JSON");
        let mut file = OpenOptions::new();
        let mut file = file.write(true).create_new(true).mode(0o600).open(entry).map_err(&failed)?;
        file.write_all(&text).and_then(|()| file.lock()).map_err(failed)?;
        announced._entry = Some(file);
        Ok(announced)
    }

    /// Returns the entries that dead processes left, and the errors of folders that cannot be searched.
    pub fn leftovers(&self) -> (Vec<PathBuf>, Vec<RunsError>) {
        self.each_folder(Folder::dead)
    }

    /// Removes the entries that dead processes left, and returns the same.
    pub fn clean(&self) -> (Vec<PathBuf>, Vec<RunsError>) {
        self.each_folder(|folder| {
            let _alone = folder.lock()?;
            folder.remove_dead()
        })
    }

    fn each_folder(
        &self,
        entries: impl Fn(&Folder) -> Result<Vec<String>, RunsError>,
    ) -> (Vec<PathBuf>, Vec<RunsError>) {
        let (mut all, mut refused) = (Vec::new(), Vec::new());
        for path in &self.folders {
            match Folder::open(path).and_then(|folder| folder.as_ref().map_or(Ok(Vec::new()), &entries)) {
                Ok(stems) => all.extend(stems.iter().map(|stem| path.join(format!("{stem}.{ENTRY}")))),
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
    /// Locked while this process lives.
    _entry: Option<File>,
    folder: Folder,
    stem: String,
}

impl Announced {
    /// Takes the socket on which the API is to be served; `None` the second time.
    pub fn listener(&mut self) -> Option<UnixListener> {
        self.listener.take()
    }
}

impl Drop for Announced {
    fn drop(&mut self) {
        // The next run removes what stays.
        let _ = self.folder.remove(&self.stem);
    }
}

/// Returns the user as whom this process acts, by its number in the process's user namespace.
fn user() -> Option<u32> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let ids = status.lines().find_map(|line| line.strip_prefix("Uid:"))?;
    // Real, effective, saved, of files.
    ids.split_whitespace().nth(1)?.parse().ok()
}

/// Refuses what others than the user `own` may use.
fn private(uid: u32, mode: u32, own: Option<u32>) -> Result<(), NotPrivate> {
    if Some(uid) != own {
        return Err(NotPrivate::Owner { uid });
    }
    if mode & 0o077 != 0 {
        return Err(NotPrivate::Mode { mode: mode & 0o7777 });
    }
    Ok(())
}

/// Opens a file or folder that must be this user's alone; `None` if there is none. Errors name it as `shown`.
fn open(
    path: &Path,
    shown: &Path,
    wanted: &'static str,
    is_wanted: fn(&Metadata) -> bool,
) -> Result<Option<File>, RunsError> {
    let not_private = |why| RunsError::NotPrivate { path: shown.to_owned(), why };
    // First, because opening follows links and waits for pipes.
    let opened = fs::symlink_metadata(path).and_then(|seen| match is_wanted(&seen) {
        true => File::open(path).and_then(|file| Ok(Some((file.metadata()?, file)))),
        false => Ok(None),
    });
    match opened {
        Ok(Some((found, file))) if is_wanted(&found) => {
            private(found.uid(), found.mode(), user()).map_err(not_private)?;
            Ok(Some(file))
        }
        Ok(_) => Err(not_private(NotPrivate::Kind { wanted })),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(system(shown)(error)),
    }
}

/// A folder that is this user's alone, held open. Each run has two files there: the entry and the socket, of one stem.
#[derive(Debug, Clone)]
struct Folder {
    /// Path for messages; it may lead elsewhere by now.
    path: PathBuf,
    opened: Arc<File>,
}

impl Folder {
    /// Opens a folder; `None` if there is none.
    fn open(path: &Path) -> Result<Option<Self>, RunsError> {
        let opened = open(path, path, "folder", Metadata::is_dir)?;
        Ok(opened.map(|opened| Self { path: path.to_owned(), opened: Arc::new(opened) }))
    }

    /// Opens a folder, which it makes if there is none.
    fn make(path: &Path) -> Result<Self, RunsError> {
        match DirBuilder::new().mode(0o700).create(path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(system(path)(error)),
            _ => {}
        }
        Self::open(path)?.ok_or_else(|| system(path)(io::ErrorKind::NotFound.into()))
    }

    /// Has its files for this process alone until the result is dropped.
    fn lock(&self) -> Result<File, RunsError> {
        let file = File::open(self.inside()).map_err(system(&self.path))?;
        file.lock().map_err(system(&self.path))?;
        Ok(file)
    }

    /// The way into it, whatever its name leads to by now.
    fn inside(&self) -> PathBuf {
        PathBuf::from(format!("/proc/self/fd/{}/", self.opened.as_raw_fd()))
    }

    fn file(&self, stem: &str, ending: &str) -> PathBuf {
        self.inside().join(format!("{stem}.{ending}"))
    }

    /// Stems of all runs that are or were there; nothing else in the folder is touched.
    fn stems(&self) -> Result<BTreeSet<String>, RunsError> {
        let mut stems = BTreeSet::new();
        for file in fs::read_dir(self.inside()).map_err(system(&self.path))? {
            let name = file.map_err(system(&self.path))?.file_name();
            let parts = name.to_str().and_then(|name| name.rsplit_once('.'));
            if let Some((stem, ENTRY | SOCKET)) = parts
                && stem.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-')
            {
                stems.insert(stem.to_owned());
            }
        }
        Ok(stems)
    }

    /// Opens the entry of a process that lives; `None` if it is gone.
    fn living(&self, stem: &str) -> Result<Option<File>, RunsError> {
        let shown = self.path.join(format!("{stem}.{ENTRY}"));
        let file = open(&self.file(stem, ENTRY), &shown, "regular file", Metadata::is_file)?;
        let Some(file) = file else { return Ok(None) };
        match file.try_lock_shared() {
            Ok(()) => Ok(None),
            Err(TryLockError::WouldBlock) => Ok(Some(file)),
            Err(TryLockError::Error(error)) => Err(system(&shown)(error)),
        }
    }

    /// Reads an entry; `None` if its process is gone.
    fn read(&self, stem: &str) -> Result<Option<RunEntry>, RunsError> {
        let Some(file) = self.living(stem)? else { return Ok(None) };
        let shown = |ending| self.path.join(format!("{stem}.{ending}"));
        let mut text = Vec::new();
        (&file).take(LONGEST_ENTRY).read_to_end(&mut text).map_err(system(&shown(ENTRY)))?;
        let Written { api, name, what, process } = serde_json::from_slice(&text)
            .map_err(|reason| RunsError::Malformed { path: shown(ENTRY), reason })?;
        let socket = match fs::symlink_metadata(self.file(stem, SOCKET)) {
            Ok(socket) => socket,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(system(&shown(SOCKET))(error)),
        };
        match socket.file_type().is_socket() {
            true => private(socket.uid(), socket.mode(), user()),
            false => Err(NotPrivate::Kind { wanted: "socket" }),
        }
        .map_err(|why| RunsError::NotPrivate { path: shown(SOCKET), why })?;
        let (folder, stem) = (self.clone(), stem.to_owned());
        Ok(Some(RunEntry { api, name, what, process, folder, stem, entry: Arc::new(file) }))
    }

    /// Stems of runs whose process is gone.
    fn dead(&self) -> Result<Vec<String>, RunsError> {
        // A refused entry stays; `Runs::find` says why.
        Ok(self.stems()?.into_iter().filter(|stem| matches!(self.living(stem), Ok(None))).collect())
    }

    fn remove_dead(&self) -> Result<Vec<String>, RunsError> {
        let dead = self.dead()?;
        dead.iter().try_for_each(|stem| self.remove(stem))?;
        Ok(dead)
    }

    /// Removes the files of a run; one that just ended may do the same.
    fn remove(&self, stem: &str) -> Result<(), RunsError> {
        for ending in [ENTRY, SOCKET] {
            match fs::remove_file(self.file(stem, ending)) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(system(&self.path.join(format!("{stem}.{ending}")))(error));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
