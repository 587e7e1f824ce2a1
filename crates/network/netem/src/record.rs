//! State that the kernel does not report: jitter distributions, the replaced discipline and the owning process.
//! Records are kept under /run, because they must not outlive a reboot, as the conditions do not.

use std::{
    fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use cotorra_graph::IpNetwork;
use serde::{Deserialize, Serialize};

use crate::{
    device::{Device, Interface},
    distribution::Distribution,
    rule::{Replaced, Rule, Side},
};

const FOLDER: &str = "/run/cotorra/netem";

/// Record of one interface.
#[derive(Debug, Default, Clone, Serialize, Deserialize)]
pub struct Record {
    /// Discipline that NetEm replaced.
    pub replaced: Option<Replaced>,
    /// Process whose end removes the conditions; `None` if they are permanent.
    #[serde(default)]
    pub owner: Option<Owner>,
    shapes: Vec<(Side, Option<IpNetwork>, Distribution)>,
}

/// A process, distinct from later ones with the same ID.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    /// Process ID.
    pub pid: u32,
    /// Start time in ticks since boot.
    started: u64,
}

impl Owner {
    /// Returns the calling process.
    ///
    /// # Errors
    /// Without /proc.
    pub(crate) fn this() -> io::Result<Self> {
        let pid = std::process::id();
        let started = started(pid).ok_or_else(|| io::Error::other("/proc has no entry for this process"))?;
        Ok(Self { pid, started })
    }

    /// Whether the process is still running.
    pub fn is_alive(&self) -> bool {
        started(self.pid) == Some(self.started)
    }
}

/// Returns the start time of a process; `None` if it has ended (proc_pid_stat(5), fields 3 and 22).
fn started(pid: u32) -> Option<u64> {
    started_in(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

fn started_in(stat: &str) -> Option<u64> {
    // The second field, the program's name in parentheses, may contain any character.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?;
    // A zombie only waits for its parent to collect its status.
    (!matches!(state, "Z" | "X")).then(|| fields.nth(18)?.parse().ok())?
}

/// Returns the file name prefix of this network namespace's records.
fn namespace() -> io::Result<String> {
    Ok(format!("{}-", fs::metadata("/proc/thread-self/ns/net")?.ino()))
}

/// Returns the path of an interface's record. Network namespace, index and name identify the interface.
fn path(interface: &Interface) -> io::Result<PathBuf> {
    // Interface names contain no slash.
    Ok(Path::new(FOLDER).join(format!("{}{}-{}.json", namespace()?, interface.index, interface.name)))
}

impl Record {
    /// Creates an empty record owned by this process.
    ///
    /// # Errors
    /// Without /proc.
    pub(crate) fn of_this_process() -> io::Result<Self> {
        Ok(Self { owner: Some(Owner::this()?), ..Self::default() })
    }

    /// Reads the record of an interface. Without rules on it, the record is stale and ignored.
    pub fn load(device: &Device) -> Self {
        if device.rules().next().is_none() { Self::default() } else { Self::read(device.interface()) }
    }

    /// Reads the record of an interface, whatever its current rules.
    pub(crate) fn read(interface: &Interface) -> Self {
        let read = || serde_json::from_slice(&fs::read(path(interface).ok()?).ok()?).ok();
        read().unwrap_or_default()
    }

    /// Returns the recorded interfaces of this network namespace, whether they still exist or not.
    pub(crate) fn interfaces() -> Vec<Interface> {
        let Ok(namespace) = namespace() else { return Vec::new() };
        let entries = fs::read_dir(FOLDER).into_iter().flatten().flatten();
        let interface = |entry: fs::DirEntry| {
            let name = entry.file_name();
            let (index, name) =
                name.to_str()?.strip_prefix(&namespace)?.strip_suffix(".json")?.split_once('-')?;
            Some(Interface { index: index.parse().ok()?, name: name.to_owned(), loopback: false })
        };
        entries.filter_map(interface).collect()
    }

    /// Sets the recorded jitter distributions on the device.
    pub fn recall(&self, device: &mut Device) {
        for (side, network, shape) in &self.shapes {
            device.recall(*side, *network, *shape);
        }
    }

    /// Records a rule that is about to be set.
    pub fn note(&mut self, device: &Device, rule: &Rule) {
        self.shapes.retain(|(side, network, _)| (*side, *network) != (rule.side, rule.network));
        if let Some(shape) = rule.netem.jitter.and_then(|jitter| jitter.distribution) {
            self.shapes.push((rule.side, rule.network, shape));
        }
        if rule.side == Side::Egress
            && let Some(foreign) = device.foreign()
        {
            self.replaced = Some(foreign.clone());
        }
    }

    /// Writes the record.
    ///
    /// # Errors
    /// Any I/O error.
    pub fn save(&self, interface: &Interface) -> io::Result<()> {
        fs::create_dir_all(FOLDER)?;
        fs::write(path(interface)?, serde_json::to_vec(self)?)
    }

    /// Removes the record.
    pub fn forget(interface: &Interface) {
        if let Ok(path) = path(interface) {
            // There may be none.
            let _ = fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_are_identified_by_start_time() {
        let this = Owner::this().unwrap();
        assert!(this.is_alive());
        assert!(!Owner { started: this.started + 1, ..this }.is_alive(), "a later process with the same ID");
        let stat = "7 (a) Z b) S 1 7 7 0 -1 0 0 0 0 0 0 0 0 0 20 0 1 0 4711 0 0";
        assert_eq!(started_in(stat), Some(4711));
        assert_eq!(started_in(&stat.replace(") S", ") Z")), None, "a zombie");
        assert_eq!(started_in("7"), None);
    }
}
