//! Access of others' VNFs to files of this machine. Hidden from them are histories, sockets of runs, and files named in
//! plug-ins' settings, which may hold keys.

use std::{
    collections::BTreeSet,
    env, fs, io,
    os::unix::fs::{DirBuilderExt, MetadataExt},
    path::{Path, PathBuf},
};

use cotorra_datapath::Confinement;
use cotorra_engine::replica_name;
use cotorra_graph::{Granted, Program, Rights, Testbed, Vnf, VnfId};
use cotorra_measurements::Location;

use crate::{
    options::Options,
    report::{Place, RunFolder},
};

/// Maximum number of processes and threads of all confined programs together, where no control group limits them.
const PROCESSES: u64 = 1024;

/// The common confinement of a run's VNFs.
#[derive(Debug)]
pub(crate) struct Confined {
    /// The testbed file's folder, which all VNFs of the testbed file can read.
    folder: PathBuf,
    /// The VNFs of the testbed file. Others were added over the API, perhaps by a domain, and the folder is not theirs.
    of_file: BTreeSet<VnfId>,
    /// Folder of the VNFs' home folders.
    homes: PathBuf,
    hidden: Vec<PathBuf>,
    /// Reason for which no VNF can be shown the folder.
    unfit: Option<String>,
}

impl Confined {
    /// # Errors
    /// An error if the testbed file's folder holds more than a testbed's files, and a VNF would be shown it.
    pub(crate) fn new(testbed: &Testbed, options: &Options, run: &RunFolder) -> io::Result<Self> {
        let folder = testbed.folder.canonicalize()?;
        let fit = check(&folder);
        // VNFs may be added later. They are rejected then, and not the run.
        let unfit = fit.as_ref().err().map(ToString::to_string);
        if testbed.services.iter().flat_map(|service| &service.vnfs).any(|vnf| granted(vnf).is_some()) {
            fit?;
        }
        let mut hidden = vec![run.path().to_owned()];
        hidden.extend(other_runs(&options.folder, &folder));
        // A run's testbed file is among its results.
        hidden
            .extend(RunFolder::NAMES.map(|name| folder.join(name)).into_iter().filter(|path| path.exists()));
        // A socket can be used even in a read-only folder, and whoever reaches a run's socket may control the run.
        hidden.extend(options.runs.iter().flat_map(|runs| runs.folders()).cloned());
        if let Some(Location::File(path)) = &options.history {
            let path = std::path::absolute(path)?;
            let beside = ["", "-wal", "-shm", "-journal"].map(|end| {
                let mut name = path.clone().into_os_string();
                name.push(end);
                PathBuf::from(name)
            });
            hidden.extend(beside);
        }
        for plugin in &testbed.plugins {
            plugin.settings.values().for_each(|value| named_files(value, &folder, &mut hidden));
        }
        let hidden = hidden.iter().filter_map(|path| real(path)).collect();
        let of_file = testbed.vnfs().map(|vnf| vnf.id.clone()).collect();
        Ok(Self { folder, of_file, homes: run.path().join("vnfs"), hidden, unfit })
    }

    /// Returns the working folder of a VNF's command; `None` if that is its own.
    pub(crate) fn folder(&self, vnf: &Vnf) -> Option<&Path> {
        self.of_file.contains(&vnf.id).then_some(&*self.folder)
    }

    /// Returns the confinement of a VNF's instance, if it is confined. Each replica has its own home folder.
    pub(crate) fn of(&self, vnf: &Vnf, replica: u32) -> io::Result<Option<Confinement>> {
        let Some(Granted { capabilities, readable }) = granted(vnf) else { return Ok(None) };
        let shown = self.folder(vnf);
        if let Some(reason) = self.unfit.as_ref().filter(|_| shown.is_some()) {
            return Err(io::Error::other(reason.clone()));
        }
        let home = self.homes.join(replica_name(&vnf.id, replica));
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&home)?;
        let readable = readable.iter().map(|path| self.folder.join(path));
        Ok(Some(Confinement {
            home: home.canonicalize()?,
            readable: shown.map(Path::to_owned).into_iter().chain(readable).collect(),
            hidden: self.hidden.clone(),
            capabilities: capabilities.clone(),
            processes: PROCESSES,
            memory_bytes: vnf.memory_bytes,
        }))
    }
}

/// Returns the rights of a VNF that is confined here. Containers are confined by their engine.
fn granted(vnf: &Vnf) -> Option<&Granted> {
    match (&vnf.program, &vnf.rights, &vnf.image) {
        (Program::Command(_), Rights::Confined(granted), None) => Some(granted),
        _ => None,
    }
}

/// Resolves symbolic links in a path. Its last part may not exist yet, as with a journal of SQLite.
fn real(path: &Path) -> Option<PathBuf> {
    let beside = || Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
    path.canonicalize().ok().or_else(beside)
}

/// Checks that a folder can be shown to programs of others. Shared folders and users' home folders cannot.
fn check(folder: &Path) -> io::Result<()> {
    const OTHERS_WRITE: u32 = 0o2;
    let is_home = env::var_os("HOME")
        .is_some_and(|home| Path::new(&home).canonicalize().is_ok_and(|home| home == folder));
    if is_home || folder == Path::new("/") || fs::metadata(folder)?.mode() & OTHERS_WRITE != 0 {
        return Err(io::Error::other(format!(
            "{} holds more than this testbed's: put the testbed file into a folder of its own, or set `trusted: true` on \
             its VNFs",
            folder.display()
        )));
    }
    Ok(())
}

/// Returns the folders of other runs. That is their common folder, unless the testbed file is inside it.
fn other_runs(place: &Place, testbed: &Path) -> Vec<PathBuf> {
    let Place::In(parent) = place else { return Vec::new() };
    let Ok(parent) = parent.canonicalize() else { return Vec::new() };
    if !testbed.starts_with(&parent) {
        return vec![parent];
    }
    let has_history =
        |folder: &PathBuf| ["history.sqlite", "history.json"].iter().any(|name| folder.join(name).exists());
    let folders = fs::read_dir(parent).into_iter().flatten().flatten().map(|entry| entry.path());
    folders.filter(|folder| has_history(folder) && !testbed.starts_with(folder)).collect()
}

/// Collects the files that settings name, by paths that start at a folder.
fn named_files(settings: &serde_json::Value, folder: &Path, found: &mut Vec<PathBuf>) {
    match settings {
        serde_json::Value::String(text) => {
            found.extend(Some(folder.join(text)).filter(|path| path.is_file()))
        }
        serde_json::Value::Array(all) => all.iter().for_each(|value| named_files(value, folder, found)),
        serde_json::Value::Object(all) => all.values().for_each(|value| named_files(value, folder, found)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn earlier_runs_are_hidden_one_by_one_if_the_testbed_file_is_among_them() {
        let place = tempfile::tempdir().unwrap();
        let parent = place.path().canonicalize().unwrap();
        let [run, testbed] = ["run", "testbed"].map(|name| parent.join(name));
        fs::create_dir(&run).unwrap();
        fs::create_dir(&testbed).unwrap();
        fs::write(run.join("history.sqlite"), "").unwrap();
        let runs = Place::In(parent.clone());
        assert_eq!(other_runs(&runs, &testbed), std::slice::from_ref(&run));
        // A run's own testbed file would be hidden with its folder.
        assert!(other_runs(&runs, &run).is_empty());
        assert_eq!(other_runs(&runs, Path::new("/elsewhere")), [parent]);
    }

    #[test]
    fn only_commands_outside_containers_are_confined() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds");
        let corridor = fs::read_to_string(folder.join("corridor.yaml")).unwrap();
        for (keys, is_confined) in [
            ("command: [x],", true),
            ("command: [x], trusted: true,", false),
            ("command: [x], image: y,", false),
            ("program: navigation,", false),
        ] {
            let text = corridor.replace("program: navigation,", keys);
            let testbed = cotorra_testbed_file::parse("corridor.yaml", &text, &folder)
                .unwrap_or_else(|wrong| panic!("{wrong}"));
            assert_eq!(testbed.vnfs().any(|vnf| granted(vnf).is_some()), is_confined, "{keys}");
        }
    }

    #[test]
    fn files_named_in_settings_are_hidden() {
        let place = tempfile::tempdir().unwrap();
        let [file, key] = ["password", "key.json"].map(|name| place.path().join(name));
        fs::write(&file, "").unwrap();
        fs::write(&key, "").unwrap();
        let settings = serde_json::json!({ "ledgers": [{ "password_file": file, "url": "ws://127.0.0.1:1" }],
            "store": "key.json" });
        let mut found = Vec::new();
        named_files(&settings, place.path(), &mut found);
        assert_eq!(found, [file, key]);
    }

    #[test]
    fn a_journal_is_hidden_before_it_exists() {
        let place = tempfile::tempdir().unwrap();
        let link = place.path().join("link");
        std::os::unix::fs::symlink(place.path(), &link).unwrap();
        let journal = place.path().canonicalize().unwrap().join("history.sqlite-wal");
        assert_eq!(real(&link.join("history.sqlite-wal")), Some(journal));
    }

    #[test]
    fn folders_with_more_than_a_testbed_are_not_shown() {
        let place = tempfile::tempdir().unwrap();
        check(place.path()).unwrap();
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o777)).unwrap();
        let refused = check(place.path()).unwrap_err().to_string();
        assert!(refused.contains("a folder of its own"), "{refused}");
        assert!(check(Path::new("/")).is_err());
    }
}
