//! Origin of a folder of results, for people and for `cotorra reproduce`: `manifest.json`.

use std::{
    collections::BTreeMap,
    fmt, fs, io,
    os::unix::fs::PermissionsExt as _,
    path::{Component, Path, PathBuf},
    thread,
    time::Duration,
};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::report::{FolderError, read_file, write_file};

/// Files at the top of a folder of results that differ from run to run, or that reading may change.
const UNSTABLE: [&str; 7] = [
    Manifest::NAME,
    "history.json",
    "history.sqlite-journal",
    "history.sqlite-shm",
    "history.sqlite-wal",
    "journal.jsonl",
    "samples",
];
/// Folders in a folder of results with files of their own.
const BELOW: [&str; 2] = ["samples", "sensors"];
/// Maximum bytes of a manifest.
const LONGEST: u64 = 16 << 20;
/// Maximum bytes of a file outside of the folder whose digest is taken.
const MAX_OUTSIDE: u64 = 64 << 20;

/// Origin of a folder of results. It is written when the first run begins, and completed when the results are there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The command line, without secrets; empty if there was none.
    pub command: Vec<String>,
    /// Way to make the results again.
    pub repeat: Repeat,
    /// Version of cotorra.
    pub version: String,
    /// Commit that cotorra was built from, with `+changes` if files differed from it; `unknown` outside of a checkout.
    pub commit: String,
    pub machine: Machine,
    pub time: Time,
    /// Why results in virtual time do not repeat to the byte, if they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inexact: Option<String>,
    /// Seeds of all runs.
    pub seeds: Vec<u64>,
    /// End of each run that did not end before, seconds.
    pub until_s: Option<f64>,
    /// Calendar time of the beginning (RFC 3339).
    pub started_at: String,
    /// Digests of the files that the runs need, by their path in the folder.
    pub carried: BTreeMap<PathBuf, Digest>,
    /// Inputs of the runs that the folder does not have: programs of the machine, and files too large to be carried. Folders,
    /// large files, and those that not everybody can read have no digest. Keys and passwords are not listed.
    pub outside: BTreeMap<PathBuf, Option<Digest>>,
    /// Digests of the results, by their path in the folder; empty until they are there.
    pub produced: BTreeMap<PathBuf, Digest>,
}

/// Way to make results again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Repeat {
    /// By these words of a command line, after the name of the program and before `--out`. Paths start at the folder.
    Words(Vec<String>),
    /// Not from the folder alone, for this reason.
    Not(String),
}

/// Kind of time that runs went on in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// Results repeat to the byte.
    Virtual,
    /// That of the machine, at least in some runs. Results repeat within chance.
    Real,
}

/// The machine that runs went on on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Model of the CPU, as the kernel names it.
    pub cpu: String,
    /// Number of CPUs that the process could use.
    pub cores: usize,
    /// Release of the kernel.
    pub kernel: String,
    /// The congestion control of its TCP: with BBR and with CUBIC, a packet waits differently in the same queue. Manifests of
    /// older versions have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tcp_congestion_control: Option<String>,
}

/// The SHA-256 digest of a file, in hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Digest(String);

/// Origin of runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// The command line, without secrets.
    pub command: Vec<String>,
    /// The commit that the program was built from.
    pub commit: String,
    /// Way to make the results again.
    pub repeat: Repeat,
}

/// Runs that a manifest describes.
#[derive(Debug, Clone)]
pub struct Made {
    pub time: Time,
    /// Why results in virtual time do not repeat to the byte, if they do not.
    pub inexact: Option<String>,
    pub seeds: Vec<u64>,
    pub until: Option<Duration>,
}

/// Inputs of runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Files in the folder, by their path there.
    pub files: Vec<PathBuf>,
    /// Absolute paths of what is not in the folder.
    pub outside: Vec<PathBuf>,
}

/// Error of reading a manifest, or of what it names.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The folder has no manifest.
    #[error(
        "{} has no {}: it is not a folder of results, or an older cotorra made it", .0.display(), Manifest::NAME
    )]
    None(PathBuf),
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: io::Error },
    /// A path leads out of the folder.
    #[error("the manifest names {}, which is not in the folder", .0.display())]
    NotInside(PathBuf),
    /// A file is not there.
    #[error("{} is missing, and the runs need it", .0.display())]
    Missing(PathBuf),
    /// A file has other contents.
    #[error("{} was changed after the runs: its digest is not that in the manifest", .0.display())]
    Changed(PathBuf),
}

impl Default for Origin {
    fn default() -> Self {
        let repeat = Repeat::Not("no command line started it".to_owned());
        Self { command: Vec::new(), commit: "unknown".to_owned(), repeat }
    }
}

impl Digest {
    /// Returns the digest of a file's contents.
    ///
    /// # Errors
    /// Those of reading the file.
    pub fn of_file(path: &Path) -> io::Result<Self> {
        struct Hashing(Sha256);
        impl io::Write for Hashing {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                self.0.update(bytes);
                Ok(bytes.len())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut hashing = Hashing(Sha256::new());
        io::copy(&mut fs::File::open(path)?, &mut hashing)?;
        Ok(Self(hashing.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()))
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Machine {
    /// Describes the machine that this process is on.
    pub fn this() -> Self {
        let read = |path| fs::read_to_string(path).unwrap_or_default();
        let known = |text: &str| if text.is_empty() { "unknown".to_owned() } else { text.to_owned() };
        let information = read("/proc/cpuinfo");
        let model = |line: &str| {
            let (key, value) = line.split_once(':')?;
            matches!(key.trim(), "model name" | "Model" | "cpu model").then(|| value.trim().to_owned())
        };
        Self {
            cpu: known(&information.lines().find_map(model).unwrap_or_default()),
            cores: thread::available_parallelism().map_or(1, Into::into),
            kernel: known(read("/proc/sys/kernel/osrelease").trim()),
            tcp_congestion_control: Some(read("/proc/sys/net/ipv4/tcp_congestion_control").trim().to_owned())
                .filter(|name| !name.is_empty()),
        }
    }
}

impl Manifest {
    /// Name of the file.
    pub const NAME: &str = "manifest.json";

    /// Describes runs that begin now, and writes the manifest into their folder.
    ///
    /// # Errors
    /// [`FolderError`] if an input cannot be read, or the manifest cannot be written.
    pub fn begin(folder: &Path, origin: &Origin, made: &Made, inputs: &Inputs) -> Result<Self, FolderError> {
        let with_digest = |file: &PathBuf| Ok((file.clone(), digest(&folder.join(file))?));
        let carried: Result<_, FolderError> = inputs.files.iter().map(with_digest).collect();
        let outside = inputs.outside.iter().map(|path| {
            // A digest of a private file may reveal a password.
            let is_public = |about: &fs::Metadata| about.permissions().mode() & 0o004 != 0;
            let is_known =
                |about: fs::Metadata| about.is_file() && about.len() <= MAX_OUTSIDE && is_public(&about);
            let digest = fs::metadata(path).is_ok_and(is_known).then(|| Digest::of_file(path).ok());
            (path.clone(), digest.flatten())
        });
        let Origin { command, commit, repeat } = origin.clone();
        // A repeat in virtual time is compared to the byte.
        let repeat = made.inexact.clone().map_or(repeat, Repeat::Not);
        let manifest = Self {
            command,
            repeat,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit,
            machine: Machine::this(),
            time: made.time,
            inexact: made.inexact.clone(),
            seeds: made.seeds.clone(),
            until_s: made.until.map(|until| until.as_secs_f64()),
            started_at: chrono::Local::now().to_rfc3339_opts(chrono::SecondsFormat::Secs, false),
            carried: carried?,
            outside: outside.collect(),
            produced: BTreeMap::new(),
        };
        manifest.write(folder)?;
        Ok(manifest)
    }

    /// Adds the results that are in the folder now.
    ///
    /// # Errors
    /// [`FolderError`] if the manifest or a result cannot be read, or the manifest cannot be written.
    pub fn complete(folder: &Path) -> Result<(), FolderError> {
        let failed = |error| FolderError::new(&folder.join(Self::NAME), io::Error::other(error));
        let mut manifest = Self::read(folder).map_err(failed)?;
        manifest.produced = BTreeMap::new();
        let top = names(folder).map_err(|source| FolderError::new(folder, source))?;
        let below = BELOW.into_iter().flat_map(|below| {
            names(&folder.join(below)).unwrap_or_default().into_iter().map(|name| Path::new(below).join(name))
        });
        for name in top.into_iter().chain(below) {
            let is_unstable = UNSTABLE.iter().any(|unstable| name == Path::new(unstable));
            if !is_unstable && !manifest.carried.contains_key(&name) {
                let digest = digest(&folder.join(&name))?;
                manifest.produced.insert(name, digest);
            }
        }
        manifest.write(folder)
    }

    /// Writes the manifest into a folder.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, folder: &Path) -> Result<(), FolderError> {
        let path = folder.join(Self::NAME);
        // A path that is not UTF-8 is no JSON.
        let json = serde_json::to_string_pretty(self).map_err(|e| FolderError::new(&path, e.into()))?;
        write_file(folder, Self::NAME, json + "\n")
    }

    /// Reads the manifest of a folder.
    ///
    /// # Errors
    /// [`ManifestError::None`], [`ManifestError::Unreadable`] or [`ManifestError::NotInside`].
    pub fn read(folder: &Path) -> Result<Self, ManifestError> {
        let path = folder.join(Self::NAME);
        let text = match read_file(&path, LONGEST) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(ManifestError::None(folder.to_owned()));
            }
            Err(source) => return Err(ManifestError::Unreadable { path, source }),
        };
        let manifest: Self = serde_json::from_slice(&text)
            .map_err(|error| ManifestError::Unreadable { path, source: error.into() })?;
        let is_inside = |path: &&PathBuf| path.components().all(|part| matches!(part, Component::Normal(_)));
        match manifest.carried.keys().chain(manifest.produced.keys()).find(|path| !is_inside(path)) {
            Some(path) => Err(ManifestError::NotInside(path.clone())),
            None => Ok(manifest),
        }
    }

    /// Copies what the runs need to another folder. Returns what is outside of the folder and has changed.
    ///
    /// # Errors
    /// [`ManifestError::Missing`] or [`ManifestError::Changed`] for the first file that is not as the runs had it.
    pub fn copy(&self, folder: &Path, to: &Path) -> Result<Vec<&Path>, ManifestError> {
        let unreadable = |path: &Path, source: io::Error| match source.kind() {
            io::ErrorKind::NotFound => ManifestError::Missing(path.to_owned()),
            _ => ManifestError::Unreadable { path: path.to_owned(), source },
        };
        for (name, expected) in &self.carried {
            let (from, to) = (folder.join(name), to.join(name));
            if let Some(parent) = to.parent() {
                fs::create_dir_all(parent).map_err(|e| unreadable(parent, e))?;
            }
            fs::copy(&from, &to).map_err(|e| unreadable(&from, e))?;
            // Of the copy, which is what runs.
            if Digest::of_file(&to).map_err(|e| unreadable(&to, e))? != *expected {
                return Err(ManifestError::Changed(from));
            }
        }
        let mut changed = Vec::new();
        for (path, expected) in &self.outside {
            if !path.exists() {
                return Err(ManifestError::Missing(path.clone()));
            }
            if expected.is_some() && Digest::of_file(path).ok() != *expected {
                changed.push(path.as_path());
            }
        }
        Ok(changed)
    }

    /// Returns the results in the folder that are no longer as the runs left them.
    pub fn changed_results(&self, folder: &Path) -> Vec<&Path> {
        changed(&self.produced, folder)
    }

    /// Returns the files in the folder that are no longer as the runs read them.
    pub fn changed_inputs(&self, folder: &Path) -> Vec<&Path> {
        changed(&self.carried, folder)
    }
}

fn changed<'a>(files: &'a BTreeMap<PathBuf, Digest>, folder: &Path) -> Vec<&'a Path> {
    let is_same = |name: &Path, expected: &Digest| {
        Digest::of_file(&folder.join(name)).is_ok_and(|now| now == *expected)
    };
    let changed = files.iter().filter(|(name, expected)| !is_same(name, expected));
    changed.map(|(name, _)| name.as_path()).collect()
}

fn digest(path: &Path) -> Result<Digest, FolderError> {
    Digest::of_file(path).map_err(|source| FolderError::new(path, source))
}

/// Returns the names of the files in a folder that are not hidden.
fn names(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_file() && !entry.file_name().as_encoded_bytes().starts_with(b".") {
            names.push(PathBuf::from(entry.file_name()));
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begun(folder: &Path, inputs: &Inputs) -> Manifest {
        let (time, inexact, until) = (Time::Virtual, None, Some(Duration::from_millis(1500)));
        let made = Made { time, inexact, seeds: vec![1], until };
        Manifest::begin(folder, &Origin::default(), &made, inputs).unwrap()
    }

    #[test]
    fn a_digest_is_that_of_sha256() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "abc").unwrap();
        let digest = Digest::of_file(&file).unwrap().to_string();
        assert_eq!(digest, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn a_manifest_tells_inputs_from_results() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("lib")).unwrap();
        for name in ["testbed.yaml", "lib/a.py"] {
            fs::write(at(name), name).unwrap();
        }
        let files = ["testbed.yaml", "lib/a.py"].map(PathBuf::from).into();
        let inputs = Inputs { files, outside: vec![at("lib"), at("lib/a.py"), at("secret")] };
        fs::write(at("secret"), "a").unwrap();
        fs::set_permissions(at("secret"), fs::Permissions::from_mode(0o600)).unwrap();
        let manifest = begun(folder.path(), &inputs);
        assert_eq!((manifest.until_s, manifest.produced.len(), manifest.carried.len()), (Some(1.5), 0, 2));
        let known: Vec<_> = manifest.outside.values().map(Option::is_some).collect();
        assert_eq!(known, [false, true, false], "neither a folder nor a secret has a digest");
        fs::remove_file(at("secret")).unwrap();
        assert!(manifest.machine.cores > 0 && manifest.machine.kernel != "unknown");
        let tcp = fs::read_to_string("/proc/sys/net/ipv4/tcp_congestion_control").ok();
        assert_eq!(manifest.machine.tcp_congestion_control.as_deref(), tcp.as_deref().map(str::trim));

        fs::create_dir_all(at("sensors")).unwrap();
        for name in ["summary.json", "history.json", "journal.jsonl", ".draft", "sensors/1"] {
            fs::write(at(name), name).unwrap();
        }
        Manifest::complete(folder.path()).unwrap();
        let complete = Manifest::read(folder.path()).unwrap();
        let produced: Vec<_> = complete.produced.keys().map(PathBuf::as_path).collect();
        assert_eq!(produced, ["sensors/1", "summary.json"].map(Path::new));
        assert_eq!(complete.changed_results(folder.path()), [""; 0].map(Path::new));
        fs::write(at("summary.json"), "edited").unwrap();
        assert_eq!(complete.changed_results(folder.path()), ["summary.json"].map(Path::new));
    }

    #[test]
    fn only_what_is_as_it_was_is_copied() {
        let (place, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let at = |name: &str| place.path().join(name);
        fs::create_dir_all(at("run/lib")).unwrap();
        for name in ["run/testbed.yaml", "run/lib/a.py", "tool"] {
            fs::write(at(name), name).unwrap();
        }
        let files = ["testbed.yaml", "lib/a.py"].map(PathBuf::from).into();
        let manifest = begun(&at("run"), &Inputs { files, outside: vec![at("tool")] });
        let copy = || manifest.copy(&at("run"), to.path()).map_err(|error| error.to_string());
        assert_eq!(copy(), Ok(Vec::new()));
        assert_eq!(fs::read_to_string(to.path().join("lib/a.py")).unwrap(), "run/lib/a.py");

        fs::write(at("tool"), "another").unwrap();
        assert_eq!(copy(), Ok(vec![&*at("tool")]));
        fs::remove_file(at("tool")).unwrap();
        assert!(copy().unwrap_err().starts_with(&format!("{} is missing", at("tool").display())));
        fs::write(at("run/lib/a.py"), "edited").unwrap();
        let changed = copy().unwrap_err();
        assert!(changed.starts_with(&format!("{} was changed", at("run/lib/a.py").display())), "{changed}");
        fs::remove_file(at("run/lib/a.py")).unwrap();
        assert!(copy().unwrap_err().starts_with(&format!("{} is missing", at("run/lib/a.py").display())));
    }

    #[test]
    fn a_manifest_names_nothing_out_of_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(Manifest::read(folder.path()), Err(ManifestError::None(_))));
        let mut manifest = begun(folder.path(), &Inputs::default());
        for name in ["../x", "/etc/passwd"] {
            manifest.carried = BTreeMap::from([(PathBuf::from(name), Digest(String::new()))]);
            manifest.write(folder.path()).unwrap();
            assert!(matches!(Manifest::read(folder.path()), Err(ManifestError::NotInside(_))), "{name}");
        }
    }

    #[test]
    fn no_manifest_of_somebody_else_makes_its_reader_panic_or_hang() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(Manifest::NAME);
        begun(folder.path(), &Inputs::default()).write(folder.path()).unwrap();
        let text = fs::read(&path).unwrap();
        for bytes in cotorra_testing::mutations(&text).take(500) {
            fs::write(&path, bytes).unwrap();
            let _ = Manifest::read(folder.path());
        }
        fs::write(&path, vec![b' '; 17 << 20]).unwrap();
        assert!(Manifest::read(folder.path()).unwrap_err().to_string().contains("more than"));
        fs::remove_file(&path).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        assert!(Manifest::read(folder.path()).unwrap_err().to_string().contains("not a file"));
    }
}
