//! The wanted state in a file, which survives a kill of the agent.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use cotorra_agent_protocol::Wanted;
use serde::{Deserialize, Serialize};

use crate::error::{AgentError, at};

/// The state of an agent, locked against a second one.
#[derive(Debug)]
pub(crate) struct Journal {
    folder: PathBuf,
    _lock: File,
}

/// Content of the journal.
#[derive(Serialize, Deserialize)]
struct Saved {
    /// The boot of the machine. After the next one, nothing of an old run is started again.
    boot: String,
    wanted: Wanted,
}

const NAME: &str = "wanted.json";

impl Journal {
    /// Opens the state in a folder, which is created if need be.
    pub(crate) fn open(folder: &Path) -> Result<Self, AgentError> {
        fs::create_dir_all(folder).map_err(at("create", folder))?;
        let path = folder.join("lock");
        let lock = File::create(&path).map_err(at("open", &path))?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { folder: folder.to_owned(), _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(AgentError::Busy(folder.to_owned())),
            Err(TryLockError::Error(source)) => Err(at("lock", &path)(source)),
        }
    }

    /// Saves the wanted state. Does not wait for the disk: a state is of no use after the machine's next start, and one that is
    /// torn by a loss of power is ignored. It can have passphrases, which only the agent's user may read.
    pub(crate) fn save(&self, wanted: &Wanted) -> io::Result<()> {
        let saved = Saved { boot: boot(), wanted: wanted.clone() };
        let (path, new) = (self.folder.join(NAME), self.folder.join("wanted.new"));
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
        file.write_all(&serde_json::to_vec(&saved).map_err(io::Error::other)?)?;
        fs::rename(&new, &path)
    }

    /// Returns what was saved last since the machine was started; `None` if nothing was, or if it cannot be read.
    pub(crate) fn load(&self) -> Option<Wanted> {
        let path = self.folder.join(NAME);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => {
                tracing::warn!("cannot read {}: {error}", path.display());
                return None;
            }
        };
        match serde_json::from_slice::<Saved>(&text) {
            Ok(saved) => (saved.boot == boot()).then_some(saved.wanted),
            // The core sends it again.
            Err(error) => {
                tracing::warn!("ignoring {}: {error}", path.display());
                None
            }
        }
    }
}

/// Returns the kernel's name for this boot of the machine.
fn boot() -> String {
    let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id");
    boot.map(|id| id.trim().to_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use cotorra_agent_protocol::Run;

    use super::*;

    fn wanted(generation: u64) -> Wanted {
        Wanted {
            run: Run(7),
            generation,
            lease_ms: 2000,
            files: Vec::new(),
            instances: BTreeMap::new(),
            robot: None,
            links: BTreeMap::new(),
            wifi: Default::default(),
        }
    }

    #[test]
    fn the_last_state_that_was_saved_is_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        assert_eq!(journal.load(), None);
        journal.save(&wanted(1)).unwrap();
        journal.save(&wanted(2)).unwrap();
        drop(journal);
        assert_eq!(Journal::open(folder.path()).unwrap().load(), Some(wanted(2)));
    }

    #[test]
    fn a_torn_or_foreign_state_is_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        journal.save(&wanted(1)).unwrap();
        let path = folder.path().join(NAME);
        let whole = fs::read(&path).unwrap();
        for end in 0..whole.len() {
            fs::write(&path, &whole[..end]).unwrap();
            assert_eq!(journal.load(), None);
        }
    }

    #[test]
    fn a_state_of_an_earlier_boot_is_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        let saved = Saved { boot: "earlier".to_owned(), wanted: wanted(1) };
        fs::write(folder.path().join(NAME), serde_json::to_vec(&saved).unwrap()).unwrap();
        assert_eq!(journal.load(), None);
    }

    #[test]
    fn a_second_agent_with_the_same_state_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let _first = Journal::open(folder.path()).unwrap();
        assert!(matches!(Journal::open(folder.path()), Err(AgentError::Busy(_))));
    }
}
