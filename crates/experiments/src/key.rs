//! Keys of runs: what a result depends on beside the run's name. A kept result counts only if its key is that of the run
//! that would be made now.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    fmt, fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::Duration,
};

use cotorra_engine::Variable;
use cotorra_graph::Testbed;
use cotorra_testbed::replayed_conditions;
use cotorra_testbed_file::{Dependency, dependencies};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Parts of the names of variables whose values are secrets.
const SECRET: [&str; 5] = ["TOKEN", "SECRET", "PASSW", "KEY", "CREDENTIAL"];

/// The inputs on which the result of a run depends, beside its settings, its changes and its seed, which are in its name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Key {
    /// Version of cotorra.
    version: String,
    /// Limit of the run that the user gave, nanoseconds.
    until_ns: Option<u64>,
    /// Digest of the testbed file's values, with the settings.
    values: String,
    /// The settings.
    settings: Vec<String>,
    /// Digests of the files that it names, by their paths, and of variables that programs get, by `$NAME`.
    depends: BTreeMap<String, String>,
}

impl Key {
    /// Returns the names of what is otherwise in another key. Empty if the keys are equal. `file` is the testbed file's name.
    pub(crate) fn changes(&self, other: &Self, file: &str) -> Vec<String> {
        let mut changed = Vec::new();
        if self.version != other.version {
            changed.push("cotorra".to_owned());
        }
        if self.until_ns != other.until_ns {
            changed.push("--until".to_owned());
        }
        if self.settings != other.settings {
            changed.push("--set".to_owned());
        } else if self.values != other.values {
            changed.push(file.to_owned());
        }
        let names: BTreeSet<_> = self.depends.keys().chain(other.depends.keys()).collect();
        let differs = |name: &&String| self.depends.get(*name) != other.depends.get(*name);
        changed.extend(names.into_iter().filter(differs).cloned());
        changed
    }
}

/// A list of names, as in `a, b and c`.
pub(crate) struct Listed<'a>(pub(crate) &'a [String]);

impl fmt::Display for Listed<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            [] => Ok(()),
            [one] => f.write_str(one),
            [first @ .., last] => write!(f, "{} and {last}", first.join(", ")),
        }
    }
}

/// Makes keys of the runs of a testbed file. Remembers the digests of files until these change.
#[derive(Debug)]
pub(crate) struct Keys {
    /// Name of the testbed file.
    file: String,
    digests: Mutex<HashMap<PathBuf, (Stamp, String)>>,
}

/// Distinguishes a file from a later version of it without reading it: its number, its length and its time.
type Stamp = (u64, u64, i64, i64);

impl Keys {
    /// Makes keys for a testbed file with this path.
    pub(crate) fn new(path: &str) -> Self {
        let name = Path::new(path).file_name().map_or(path.into(), |name| name.to_string_lossy());
        Self { file: name.into_owned(), digests: Mutex::default() }
    }

    /// Returns the name of the testbed file.
    pub(crate) fn file(&self) -> &str {
        &self.file
    }

    /// Returns the key of runs of a testbed, from the text of its file with settings, in this version of the program.
    pub(crate) fn key(&self, version: &str, testbed: &Testbed, text: &str, until: Option<Duration>) -> Key {
        let found = dependencies(text, &testbed.folder);
        let file = |Dependency { path, .. }: &Dependency| {
            (path.display().to_string(), self.digest_of(testbed, &testbed.folder.join(path)))
        };
        let depends = found.files.iter().map(file).chain(variables(testbed)).collect();
        Key {
            version: version.to_owned(),
            until_ns: until.map(|until| u64::try_from(until.as_nanos()).unwrap_or(u64::MAX)),
            values: digest(found.values.as_bytes()),
            settings: found.settings,
            depends,
        }
    }

    /// Returns the files of a key that are no longer what they were. Arguments of programs, which these may write to, do not
    /// count.
    pub(crate) fn changed_since(&self, key: &Key, testbed: &Testbed, text: &str) -> Vec<String> {
        let files = dependencies(text, &testbed.folder).files.into_iter().filter(|file| !file.is_argument);
        let names = files.filter_map(|Dependency { path, .. }| {
            let (name, now) =
                (path.display().to_string(), self.digest_of(testbed, &testbed.folder.join(&path)));
            (key.depends.get(&name) != Some(&now)).then_some(name)
        });
        names.collect()
    }

    fn digest_of(&self, testbed: &Testbed, path: &Path) -> String {
        let read = || -> io::Result<String> {
            let metadata = fs::metadata(path)?;
            if metadata.is_dir() {
                let changes = replayed_conditions(testbed).map_err(io::Error::other)?;
                return Ok(digest(changes.as_bytes()));
            }
            let stamp = (metadata.ino(), metadata.len(), metadata.mtime(), metadata.mtime_nsec());
            let mut digests = self.digests.lock();
            if let Some((before, digest)) = digests.get(path)
                && *before == stamp
            {
                return Ok(digest.clone());
            }
            let mut hasher = Sha256::new();
            io::copy(&mut fs::File::open(path)?, &mut hasher)?;
            let digest = hex(&hasher.finalize());
            digests.insert(path.to_owned(), (stamp, digest.clone()));
            Ok(digest)
        };
        // A file that cannot be read any more counts as changed.
        read().unwrap_or_else(|error| error.to_string())
    }
}

/// Returns digests of the variables that the testbed file lets programs of plug-ins have from here, but for secrets.
fn variables(testbed: &Testbed) -> impl Iterator<Item = (String, String)> + '_ {
    let named = testbed.plugins.iter().flat_map(|plugin| &plugin.env).map(|text| Variable::parse(text));
    let is_secret = |name: &str| SECRET.iter().any(|part| name.to_ascii_uppercase().contains(part));
    let from_here = named.filter(move |variable| variable.given.is_none() && !is_secret(variable.name));
    from_here
        .filter_map(|variable| Some((format!("${}", variable.name), digest(variable.value()?.as_bytes()))))
}

fn digest(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Returns the first half of a digest as text, which is enough to distinguish versions.
fn hex(digest: &[u8]) -> String {
    digest[..digest.len() / 2].iter().map(|byte| format!("{byte:02x}")).collect()
}
