//! What the kernel does not tell and must not be forgotten: the shapes of jitters, and the discipline that NetEm took the
//! place of. Kept under /run, which is as short-lived as the conditions are.

use std::{
    fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use cotorra_netem::{Device, Distribution, Network, Replaced, Rule, Side};
use serde::{Deserialize, Serialize};

const FOLDER: &str = "/run/cotorra/netem";

/// What is remembered of one interface.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Record {
    /// Whose place NetEm took.
    pub replaced: Option<Replaced>,
    shapes: Vec<(Side, Option<Network>, Distribution)>,
}

/// An interface is known by its network namespace, its number and its name.
fn path(device: &Device) -> io::Result<PathBuf> {
    let namespace = fs::metadata("/proc/thread-self/ns/net")?.ino();
    let interface = device.interface();
    // A name has no slash in it.
    Ok(Path::new(FOLDER).join(format!("{namespace}-{}-{}.json", interface.index, interface.name)))
}

impl Record {
    /// Remembers. What was remembered of an interface without rules is of another time.
    pub fn load(device: &Device) -> Self {
        if device.rules().next().is_none() {
            return Self::default();
        }
        let read = || serde_json::from_slice(&fs::read(path(device).ok()?).ok()?).ok();
        read().unwrap_or_default()
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

    /// Keeps it; a discipline that was replaced is what matters.
    ///
    /// # Errors
    /// As files have them.
    pub fn save(&self, device: &Device) -> io::Result<()> {
        fs::create_dir_all(FOLDER)?;
        fs::write(path(device)?, serde_json::to_vec(self)?)
    }

    /// Forgets it.
    pub fn forget(device: &Device) {
        if let Ok(path) = path(device) {
            // There may be none.
            let _ = fs::remove_file(path);
        }
    }
}
