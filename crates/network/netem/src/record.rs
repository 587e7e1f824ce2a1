//! What the kernel does not tell and must not be forgotten: the shapes of jitters, the discipline that NetEm took the
//! place of, and the process for which it did. Kept under /run, which is as short-lived as the conditions are.

use std::{
    fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::{
    device::{Device, Interface},
    distribution::Distribution,
    handle::Network,
    rule::{Replaced, Rule, Side},
};

const FOLDER: &str = "/run/cotorra/netem";

/// What is remembered of one interface.
#[derive(Debug, Default, Clone, Serialize, Deserialize)]
pub struct Record {
    /// Whose place NetEm took.
    pub replaced: Option<Replaced>,
    /// The process that holds the conditions, and whose end is to be theirs; `None` where they are to stay.
    #[serde(default)]
    pub owner: Option<Owner>,
    shapes: Vec<(Side, Option<Network>, Distribution)>,
}

/// A process, which no later one of the same number is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    /// Its number.
    pub pid: u32,
    /// When it was started, in ticks since the machine was.
    started: u64,
}

impl Owner {
    /// This process.
    ///
    /// # Errors
    /// Without /proc.
    pub(crate) fn this() -> io::Result<Self> {
        let pid = std::process::id();
        let started = started(pid).ok_or_else(|| io::Error::other("/proc does not tell of this process"))?;
        Ok(Self { pid, started })
    }

    /// Whether it goes on.
    pub fn lives(&self) -> bool {
        started(self.pid) == Some(self.started)
    }
}

/// When a process was started; `None` for one that has ended (proc_pid_stat(5), fields 3 and 22).
fn started(pid: u32) -> Option<u64> {
    started_in(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

fn started_in(stat: &str) -> Option<u64> {
    // The second field, the program's name in parentheses, may have anything in it.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?;
    // Of one that only waits for its parent to ask how it ended, nothing is left.
    (!matches!(state, "Z" | "X")).then(|| fields.nth(18)?.parse().ok())?
}

/// What the records of this network namespace begin with.
fn namespace() -> io::Result<String> {
    Ok(format!("{}-", fs::metadata("/proc/thread-self/ns/net")?.ino()))
}

/// An interface is known by its network namespace, its number and its name.
fn path(interface: &Interface) -> io::Result<PathBuf> {
    // A name has no slash in it.
    Ok(Path::new(FOLDER).join(format!("{}{}-{}.json", namespace()?, interface.index, interface.name)))
}

impl Record {
    /// Nothing yet, for as long as this process goes on.
    ///
    /// # Errors
    /// Without /proc.
    pub(crate) fn of_this_process() -> io::Result<Self> {
        Ok(Self { owner: Some(Owner::this()?), ..Self::default() })
    }

    /// Remembers. What was remembered of an interface without rules is of another time.
    pub fn load(device: &Device) -> Self {
        if device.rules().next().is_none() { Self::default() } else { Self::left(device.interface()) }
    }

    /// What was remembered of an interface, whatever is there now.
    pub(crate) fn left(interface: &Interface) -> Self {
        let read = || serde_json::from_slice(&fs::read(path(interface).ok()?).ok()?).ok();
        read().unwrap_or_default()
    }

    /// The interfaces of this network namespace of which something is remembered, be they there or not.
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

    /// Tells the device what the kernel does not.
    pub fn recall(&self, device: &mut Device) {
        for (side, network, shape) in &self.shapes {
            device.recall(*side, *network, *shape);
        }
    }

    /// Notes what is about to be set.
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

    /// Keeps it; a discipline that was replaced, and the owner, are what matters.
    ///
    /// # Errors
    /// As files have them.
    pub fn save(&self, interface: &Interface) -> io::Result<()> {
        fs::create_dir_all(FOLDER)?;
        fs::write(path(interface)?, serde_json::to_vec(self)?)
    }

    /// Forgets it.
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
    fn a_process_is_known_by_when_it_was_started() {
        let this = Owner::this().unwrap();
        assert!(this.lives());
        assert!(!Owner { started: this.started + 1, ..this }.lives(), "another one of its number");
        let stat = "7 (a) Z b) S 1 7 7 0 -1 0 0 0 0 0 0 0 0 0 20 0 1 0 4711 0 0";
        assert_eq!(started_in(stat), Some(4711));
        assert_eq!(started_in(&stat.replace(") S", ") Z")), None, "only its parent has not asked yet");
        assert_eq!(started_in("7"), None);
    }
}
