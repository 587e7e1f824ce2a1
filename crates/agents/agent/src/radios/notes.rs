//! Notes of how Wi-Fi interfaces were found, which survive a kill of the agent.

use std::{
    fs::{self, DirBuilder, OpenOptions},
    io::{self, Write},
    os::unix::fs::{DirBuilderExt, OpenOptionsExt},
    path::{Path, PathBuf},
};

use cotorra_wifi::{InterfaceName, Owner};

/// Name of a note in the folder of its interface.
const NOTE: &str = "owner.json";

/// A folder with one folder for each interface: for its note, and for its own program.
#[derive(Debug, Clone)]
pub(super) struct Notes(PathBuf);

impl Notes {
    pub(super) fn new(state: &Path) -> Self {
        Self(state.join("wifi"))
    }

    /// Makes the folder of an interface.
    pub(super) fn folder(&self, interface: &InterfaceName) -> io::Result<PathBuf> {
        let folder = self.0.join(interface.as_str());
        // hostapd may have another user, who has to reach the sockets in it.
        DirBuilder::new().recursive(true).mode(0o711).create(&folder)?;
        Ok(folder)
    }

    /// Saves a note, and waits until it is on the disk.
    pub(super) fn save(&self, owner: &Owner) -> io::Result<()> {
        let folder = self.folder(owner.interface())?;
        let new = folder.join("owner.new");
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
        file.write_all(&serde_json::to_vec(owner).map_err(io::Error::other)?)?;
        file.sync_all()?;
        fs::rename(new, folder.join(NOTE))
    }

    /// Removes a note, after the interface was put back.
    pub(super) fn remove(&self, interface: &InterfaceName) {
        let path = self.0.join(interface.as_str()).join(NOTE);
        if let Err(error) = fs::remove_file(&path)
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!("cannot remove {}: {error}", path.display());
        }
    }

    /// Returns all notes that can be read.
    pub(super) fn all(&self) -> Vec<Owner> {
        let mut notes = Vec::new();
        for entry in fs::read_dir(&self.0).into_iter().flatten().flatten() {
            let path = entry.path().join(NOTE);
            let Ok(text) = fs::read(&path) else { continue };
            match serde_json::from_slice(&text) {
                Ok(owner) => notes.push(owner),
                Err(error) => tracing::warn!("ignoring {}: {error}", path.display()),
            }
        }
        notes
    }

    /// Puts an interface back as its note says, if there is one.
    ///
    /// # Errors
    /// The reason, for people. The note stays then.
    pub(super) fn put_back(&self, interface: &InterfaceName) -> Result<(), String> {
        let Some(owner) = self.all().into_iter().find(|owner| owner.interface() == interface) else {
            return Ok(());
        };
        let folder = self.folder(interface).map_err(|error| error.to_string())?;
        owner.put_back(&folder).map_err(|error| error.to_string())?;
        self.remove(interface);
        Ok(())
    }

    /// Puts back all interfaces that a killed agent left.
    pub(super) fn put_back_all(&self) {
        for interface in self.all().iter().map(Owner::interface) {
            match self.put_back(interface) {
                Ok(()) => tracing::info!("put {interface} back, which a killed agent left"),
                Err(reason) => tracing::error!("cannot put {interface} back: {reason}"),
            }
        }
    }
}
