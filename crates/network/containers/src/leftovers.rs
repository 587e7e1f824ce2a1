//! Records of runs with containers, by which those of killed runs are found and removed.
//!
//! A run holds a lock on its record. The kernel releases it when the process ends, however it ends: a record without a lock is
//! that of a dead process. A new record has another name until it is locked and complete.

use std::{
    env,
    fs::{self, DirBuilder, File, TryLockError},
    hash::{BuildHasher as _, RandomState},
    io::{self, Write as _},
    os::unix::fs::{DirBuilderExt as _, MetadataExt as _},
    path::{Path, PathBuf},
    process::{self, Stdio},
};

use cotorra_graph::EngineKind;
use rustix::process::geteuid;

use crate::{
    address::Address,
    daemon::{Daemon, Retries},
    daemon_error::DaemonError,
    service::Service,
};

/// Name of the folder of records.
const FOLDER: &str = "cotorra-containers";
/// Ending of the name of the folder beside a record, in which podman serves the process.
const SERVICE: &str = "service";
/// Ending of the name of a record that is not complete.
const NEW: &str = "new";
/// Attempts to connect to a service that was just started.
const ATTEMPTS: u32 = 16;

/// The record of a process that has containers.
#[derive(Debug)]
pub(crate) struct Marker {
    path: PathBuf,
    run: String,
    /// Locked while the process lives.
    _lock: File,
}

impl Marker {
    /// Creates and locks a record of containers of this process.
    pub(crate) fn create(kind: EngineKind, address: &Address) -> io::Result<Self> {
        Self::create_in(&folder()?, kind, address)
    }

    pub(crate) fn create_in(folder: &Path, kind: EngineKind, address: &Address) -> io::Result<Self> {
        // A later process with the same ID has other containers.
        let random = RandomState::new().hash_one(0) as u32;
        let run = format!("{}-{}-{random:08x}", kind.name(), process::id());
        let path = folder.join(&run);
        let new = path.with_extension(NEW);
        let address = match address {
            Address::Socket(socket) => socket.to_string_lossy().into_owned(),
            Address::Service => String::new(),
        };
        loop {
            let mut file = File::create_new(&new)?;
            file.lock()?;
            writeln!(file, "{run}\n{address}")?;
            match fs::rename(&new, &path) {
                // Somebody cleaned up before it was locked.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                renamed => return renamed.map(|()| Self { path, run, _lock: file }),
            }
        }
    }

    /// Returns the label of its containers.
    pub(crate) fn run(&self) -> &str {
        &self.run
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the record: nothing is left of the run.
    pub(crate) fn remove(&self) {
        remove(&self.path);
    }
}

/// The content of a record.
pub(crate) struct Record {
    pub(crate) run: String,
    pub(crate) address: Address,
}

impl Record {
    pub(crate) fn read(path: &Path) -> io::Result<Self> {
        let text = fs::read_to_string(path)?;
        let mut lines = text.lines();
        let (Some(run), Some(address)) = (lines.next(), lines.next()) else {
            return Err(io::Error::other(format!("{} is no record of containers", path.display())));
        };
        let address = if address.is_empty() { Address::Service } else { Address::Socket(address.into()) };
        Ok(Self { run: run.to_owned(), address })
    }
}

/// Returns the folders where this user's records can be. New ones are put into the first.
fn places() -> Vec<PathBuf> {
    let user = geteuid();
    let runtime = env::var_os("XDG_RUNTIME_DIR").map(|runtime| Path::new(&runtime).join(FOLDER));
    let of_root = user.is_root().then(|| Path::new("/run").join(FOLDER));
    let temporary = env::temp_dir().join(format!("{FOLDER}-{}", user.as_raw()));
    runtime.into_iter().chain(of_root).chain([temporary]).collect()
}

/// Creates the folder of new records, which only this user may enter.
fn folder() -> io::Result<PathBuf> {
    let folder = places().swap_remove(0);
    DirBuilder::new().recursive(true).mode(0o700).create(&folder)?;
    if is_ours(&folder) {
        Ok(folder)
    } else {
        Err(io::Error::other(format!("{} belongs to others, or is open to them", folder.display())))
    }
}

fn is_ours(folder: &Path) -> bool {
    fs::symlink_metadata(folder)
        .is_ok_and(|found| found.is_dir() && found.uid() == geteuid().as_raw() && found.mode() & 0o077 == 0)
}

fn remove(path: &Path) {
    for removed in [fs::remove_file(path), fs::remove_dir_all(service_folder(path))] {
        if let Err(error) = removed
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!("cannot remove {}: {error}", path.display());
        }
    }
}

/// Returns the folder in which podman serves the process of a record.
pub(crate) fn service_folder(record: &Path) -> PathBuf {
    record.with_extension(SERVICE)
}

/// Connects to the engine of a process. A service of podman may be starting.
pub(crate) async fn connect(address: &Address, marker: &Marker) -> Result<Daemon, DaemonError> {
    match address {
        Address::Socket(socket) => Daemon::connect(socket).await,
        Address::Service => connect_to_service(&Service::socket(&service_folder(&marker.path))).await,
    }
}

async fn connect_to_service(socket: &Path) -> Result<Daemon, DaemonError> {
    let mut retries = Retries::default();
    for _ in 1..ATTEMPTS {
        match Daemon::connect(socket).await {
            Err(DaemonError::Lost(_)) => retries.wait().await,
            done => return done,
        }
    }
    Daemon::connect(socket).await
}

/// Removes all containers of a run.
pub(crate) async fn remove_all(daemon: &Daemon, run: &str) -> Result<usize, DaemonError> {
    let containers = daemon.containers_of(run).await?;
    for container in &containers {
        // Otherwise podman waits ten seconds for an orderly end. It may have ended by itself.
        let _ = daemon.signal(container, "SIGKILL").await;
        daemon.remove(container).await?;
    }
    Ok(containers.len())
}

/// Removes what is left of a dead process: its containers, its record, and its service's socket. Returns the number of
/// containers.
pub(crate) fn remove_run(path: &Path) -> io::Result<usize> {
    let record = Record::read(path)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let removed = runtime.block_on(async {
        let (daemon, _service) = match &record.address {
            Address::Socket(socket) => (Daemon::connect(socket).await.map_err(io::Error::other)?, None),
            Address::Service => {
                let folder = service_folder(path);
                let service = Service::start(&folder, Stdio::inherit)?;
                (
                    connect_to_service(&Service::socket(&folder)).await.map_err(io::Error::other)?,
                    Some(service),
                )
            }
        };
        remove_all(&daemon, &record.run).await.map_err(io::Error::other)
    })?;
    remove(path);
    Ok(removed)
}

/// Returns the records of dead processes in these folders, the complete ones and the others.
fn stale(folders: &[PathBuf]) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let folders = folders.iter().filter(|folder| is_ours(folder));
    let paths = folders.flat_map(fs::read_dir).flatten().flatten().map(|entry| entry.path());
    let is_stale = |path: &PathBuf| {
        path.is_file()
            && File::open(path).is_ok_and(|file| !matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
    };
    let mut stale: Vec<_> = paths.filter(is_stale).collect();
    stale.sort();
    stale.into_iter().partition(|path| path.extension().is_none_or(|ending| ending != NEW))
}

/// Removed containers, and what could not be removed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cleaned {
    /// Killed runs, by the label `cotorra.run` of their containers, and the number of containers.
    pub runs: Vec<(String, usize)>,
    /// Leftovers that could not be removed, each with the error.
    pub kept: Vec<String>,
}

/// Returns the killed runs that may have containers left, by the label of these.
pub fn leftovers() -> Vec<String> {
    let (records, _) = stale(&places());
    records.iter().filter_map(|path| Some(Record::read(path).ok()?.run)).collect()
}

/// Removes the containers of killed runs.
pub fn clean() -> Cleaned {
    clean_in(&places())
}

fn clean_in(folders: &[PathBuf]) -> Cleaned {
    let mut cleaned = Cleaned::default();
    let (records, incomplete) = stale(folders);
    // Their processes had no containers yet.
    cleaned.kept.extend(incomplete.iter().filter_map(|path| {
        let error = fs::remove_file(path).err().filter(|error| error.kind() != io::ErrorKind::NotFound)?;
        Some(format!("{}: {error}", path.display()))
    }));
    for path in records {
        let run = Record::read(&path).map_or_else(|_| path.display().to_string(), |record| record.run);
        match remove_run(&path) {
            Ok(containers) => cleaned.runs.push((run, containers)),
            Err(error) => cleaned.kept.push(format!(
                "containers of {run}: {error} (remove {} if their engine is gone for good)",
                path.display()
            )),
        }
    }
    cleaned
}

#[cfg(test)]
mod tests {
    use rustix::fs::inotify::{self, CreateFlags, Reader, WatchFlags};

    use super::*;

    fn folder_of_records() -> tempfile::TempDir {
        let private = std::os::unix::fs::PermissionsExt::from_mode(0o700);
        tempfile::Builder::new().permissions(private).tempdir().unwrap()
    }

    #[test]
    fn a_record_has_its_lock_and_its_content_before_its_name() {
        let folder = folder_of_records();
        let watch = inotify::init(CreateFlags::NONBLOCK).unwrap();
        let seen = WatchFlags::CREATE | WatchFlags::MODIFY | WatchFlags::MOVED_TO;
        inotify::add_watch(&watch, folder.path(), seen).unwrap();
        let marker = Marker::create_in(folder.path(), EngineKind::Docker, &Address::Service).unwrap();
        let (mut buffer, mut steps) = ([std::mem::MaybeUninit::uninit(); 4096], Vec::new());
        let mut events = Reader::new(&watch, &mut buffer);
        while let Ok(event) = events.next() {
            if event.file_name().unwrap().to_str().unwrap() == marker.run {
                steps.push(event.events().bits());
            }
        }
        assert_eq!(steps, [inotify::ReadFlags::MOVED_TO.bits()]);
        assert_eq!(Record::read(&marker.path).unwrap().run, marker.run);
        let folders = [folder.path().to_owned()];
        assert_eq!(stale(&folders), (vec![], vec![]));
        let path = marker.path.clone();
        drop(marker);
        assert_eq!(stale(&folders), (vec![path], vec![]));
    }

    #[test]
    fn records_that_were_not_completed_are_removed_unless_their_process_lives() {
        let folder = folder_of_records();
        let [dead, alive] = ["dead", "alive"].map(|name| folder.path().join(name).with_extension(NEW));
        File::create(&dead).unwrap();
        let lock = File::create(&alive).unwrap();
        lock.lock().unwrap();
        let folders = [folder.path().to_owned()];
        assert_eq!(stale(&folders), (vec![], vec![dead.clone()]));
        assert_eq!(clean_in(&folders), Cleaned::default());
        assert_eq!((dead.exists(), alive.exists()), (false, true));
    }
}
