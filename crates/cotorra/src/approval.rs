//! Approval of testbed files: a file that came from elsewhere runs no command as its user, and reads nothing outside of its
//! folder, before that user agreed.
//!
//! An answer is remembered by two digests. One is of the file's place and what it wants, so that its user can go on to develop
//! the programs that it names. The other is of what it wants and the contents of those programs, so that copies, such as the
//! folder of a run, need no second answer.

use std::{
    env, fmt,
    fs::{self, DirBuilder, OpenOptions},
    io::{self, BufRead, IsTerminal, Read as _, Write as _},
    os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
};

use clap::{Args, builder::FalseyValueParser};
use cotorra_graph::{PluginProgram, Program, Rights, Testbed};
use cotorra_testbed_file::dependencies;
use sha2::{Digest, Sha256};

use crate::{output, testbed_file::Loaded};

/// The environment variable by which scripts trust all testbed files that they use.
pub const TRUST_VARIABLE: &str = "COTORRA_TRUST";
/// Size of the longest file of answers, bytes: some 15,000 of them.
const LONGEST: u64 = 1 << 20;
/// Length of the longest answer on a terminal, bytes.
const LONGEST_ANSWER: u64 = 64;

/// Whether the user trusts a testbed file.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct TrustArgs {
    /// Run the commands of a testbed file as you, and let it read what it names outside of its folder, without a question
    ///
    /// The answer is remembered in cotorra/approved in $XDG_CONFIG_HOME or ~/.config, until the file wants something else.
    /// COTORRA_TRUST=1 does the same for scripts, and nothing is remembered.
    #[arg(long, env = TRUST_VARIABLE, hide_env_values = true, value_parser = FalseyValueParser::new())]
    pub trust: bool,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{file} is not approved: it wants to\n{wishes}")]
#[diagnostic(help(
    "look at what it names; then run this again with --trust, or on a terminal, where it asks. COTORRA_TRUST=1 does the same \
     in scripts"
))]
pub struct NotApproved {
    file: String,
    wishes: Wishes,
}

/// Wishes of a testbed file beyond its emulated network and its folder.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Wishes(Vec<String>);

impl fmt::Display for Wishes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|wish| writeln!(f, "  {}", escaped(wish)))
    }
}

impl Wishes {
    fn of(testbed: &Testbed, text: &str) -> Self {
        let mut wishes = Vec::new();
        for plugin in &testbed.plugins {
            if let PluginProgram::Command(words) = &plugin.program {
                wishes.push(format!("run `{}` as you, as plug-in `{}`", words.join(" "), plugin.id));
                wishes.extend(variables(&plugin.env, &format!("plug-in `{}`", plugin.id)));
            }
        }
        for vnf in testbed.services.iter().flat_map(|service| &service.vnfs) {
            if let Program::Command(words) | Program::Host(words) = &vnf.program {
                if vnf.rights == Rights::Trusted && vnf.image.is_none() {
                    wishes.push(format!("run `{}` as you, as VNF `{}`", words.join(" "), vnf.id));
                }
                wishes.extend(variables(&vnf.env, &format!("VNF `{}`", vnf.id)));
            }
            if let Rights::Confined(granted) = &vnf.rights {
                let outside = granted.readable.iter().filter(|path| is_outside(path, &testbed.folder));
                wishes.extend(outside.map(|path| format!("let VNF `{}` read {}", vnf.id, path.display())));
            }
            if let Some(image) = &vnf.image {
                let volumes = image.volumes.iter().map(|volume| volume.source.as_path());
                let devices = image.devices.iter().map(PathBuf::as_path);
                let outside = volumes.chain(devices).filter(|path| is_outside(path, &testbed.folder));
                wishes.extend(outside.map(|path| format!("show {} to VNF `{}`", path.display(), vnf.id)));
            }
        }
        // Programs and their arguments are in the commands.
        let files = dependencies(text, &testbed.folder).files.into_iter();
        let outside = files.filter(|file| !file.is_argument && is_outside(&file.path, &testbed.folder));
        wishes.extend(outside.map(|file| format!("read {}", file.path.display())));
        wishes.sort();
        wishes.dedup();
        Self(wishes)
    }

    /// Returns the digest of these wishes of a testbed file at this place.
    fn at(&self, place: &Path) -> String {
        self.digest(&[place.as_os_str().as_encoded_bytes()])
    }

    /// Returns the digest of these wishes with the contents of the named files; `None` if one cannot be read.
    fn with_contents(&self, testbed: &Testbed, text: &str) -> Option<String> {
        let files = dependencies(text, &testbed.folder).files;
        let contents = files.iter().map(|file| {
            let path = testbed.folder.join(&file.path);
            if path.is_file() { fs::read(path).ok() } else { Some(Vec::new()) }
        });
        let contents: Vec<Vec<u8>> = contents.collect::<Option<_>>()?;
        Some(self.digest(&contents.iter().map(Vec::as_slice).collect::<Vec<_>>()))
    }

    fn digest(&self, parts: &[&[u8]]) -> String {
        let mut hash = Sha256::new();
        let mut add = |kind: u8, part: &[u8]| {
            hash.update([kind]);
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        };
        self.0.iter().for_each(|wish| add(0, wish.as_bytes()));
        parts.iter().for_each(|part| add(1, part));
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Returns a text as one line, without what controls a terminal.
fn escaped(text: &str) -> String {
    output::escaped(text, false).replace('\n', "\\n")
}

/// Returns the wishes of a program for variables of the user's environment.
fn variables(env: &[String], whose: &str) -> Vec<String> {
    let named = env.iter().filter(|variable| !variable.contains('='));
    named.map(|name| format!("give your variable {name} to {whose}")).collect()
}

/// Whether a path leads out of a testbed file's folder.
fn is_outside(path: &Path, folder: &Path) -> bool {
    let canonical = |path: &Path| path.canonicalize();
    match (
        canonical(&folder.join(path)),
        canonical(if folder == Path::new("") { Path::new(".") } else { folder }),
    ) {
        (Ok(path), Ok(folder)) => !path.starts_with(folder),
        // A missing file cannot be read either.
        _ => false,
    }
}

/// The answers of a user.
struct Answers(Option<PathBuf>);

impl Answers {
    fn of_user() -> Self {
        let config = env::var_os("XDG_CONFIG_HOME").map(PathBuf::from).filter(|folder| folder.is_absolute());
        let home = || env::var_os("HOME").map(|home| PathBuf::from(home).join(".config"));
        Self(config.or_else(home).map(|folder| folder.join("cotorra/approved")))
    }

    fn have(&self, digest: &str) -> bool {
        let text = self.0.as_ref().and_then(|path| fs::File::open(path).ok()).and_then(|file| {
            let mut text = String::new();
            file.take(LONGEST).read_to_string(&mut text).is_ok().then_some(text)
        });
        text.is_some_and(|text| text.lines().any(|line| line.split(' ').next() == Some(digest)))
    }

    fn add(&self, digests: impl Iterator<Item = String>, file: &str) -> io::Result<()> {
        let Some(path) = &self.0 else { return Ok(()) };
        if let Some(folder) = path.parent() {
            DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        }
        let mut answers = OpenOptions::new().append(true).create(true).mode(0o600).open(path)?;
        // The name is for people who look into the file.
        let lines: String = digests.map(|digest| format!("{digest} {}\n", escaped(file))).collect();
        answers.write_all(lines.as_bytes())
    }
}

/// Lets a testbed file be used if its user trusts it. Asks on a terminal.
///
/// # Errors
/// `NotApproved`.
pub fn demand(loaded: &Loaded, file: &Path, trust: TrustArgs) -> Result<(), NotApproved> {
    let wishes = Wishes::of(&loaded.testbed, &loaded.text);
    if wishes == Wishes::default() {
        return Ok(());
    }
    let (answers, name) = (Answers::of_user(), file.display().to_string());
    let place = file.canonicalize().unwrap_or_else(|_| file.to_owned());
    let digests = || {
        let contents = wishes.with_contents(&loaded.testbed, &loaded.text);
        [wishes.at(&place)].into_iter().chain(contents)
    };
    if digests().any(|digest| answers.have(&digest)) {
        return Ok(());
    }
    let is_terminal = io::stdin().is_terminal() && io::stderr().is_terminal();
    if trust.trust || is_terminal && agrees(&name, &wishes, &mut io::stdin().lock()) {
        let is_script = env::var_os(TRUST_VARIABLE).is_some();
        if !is_script && let Err(error) = answers.add(digests(), &name) {
            note!("warning: the answer is not remembered: {error}");
        }
        return Ok(());
    }
    Err(NotApproved { file: name, wishes })
}

/// Asks whether the user trusts a file.
fn agrees(name: &str, wishes: &Wishes, answers: &mut impl BufRead) -> bool {
    note!("{} wants to\n{wishes}Do you trust it? [y/N]", escaped(name));
    let mut answer = String::new();
    let _ = answers.take(LONGEST_ANSWER).read_line(&mut answer);
    matches!(answer.trim(), "y" | "Y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testbed_file;

    const TESTBED: &str = "\
name: x
wireless: { lab: {} }
nodes:
  robot: { kind: robot, cpus: 1, memory: 1 GB }
  unit: { kind: radio_unit, position: [0, 1], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 1 GB }
links: [{ ends: [unit, edge] }]
walks: { robot: { waypoints: [[0, 0], [2, 0]] } }
services:
  s:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge }
";

    fn wishes(folder: &Path, rest: &str) -> (Loaded, Wishes) {
        let file = folder.join("testbed.yaml");
        fs::write(&file, format!("{TESTBED}{rest}")).unwrap();
        let loaded = testbed_file::load(&file, &[]).unwrap();
        let wishes = Wishes::of(&loaded.testbed, &loaded.text);
        (loaded, wishes)
    }

    #[test]
    fn what_stays_in_the_network_and_the_folder_needs_no_approval() {
        let folder = tempfile::tempdir().unwrap();
        let vnfs = "      v: { command: [cat, x], node: edge, env: [A=b] }\n";
        assert_eq!(wishes(folder.path(), vnfs).1, Wishes::default());
    }

    #[test]
    fn commands_variables_and_files_elsewhere_are_wishes() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("bed");
        fs::create_dir(&folder).unwrap();
        fs::write(place.path().join("key"), "").unwrap();
        let rest = "      v: { command: [cat], node: edge, readable: [../key], env: [HOME] }\n      w: { command: [sh, -c, id], \
                    node: edge, trusted: true }\nplugins:\n  - { id: p, command: [python3, p.py] }\n";
        let (_, Wishes(wishes)) = wishes(&folder, rest);
        let expected = [
            "give your variable HOME to VNF `v`",
            "let VNF `v` read ",
            "read ",
            "run `python3 p.py` as you, as plug-in `p`",
            "run `sh -c id` as you, as VNF `w`",
        ];
        assert_eq!(wishes.len(), expected.len(), "{wishes:?}");
        assert!(wishes.iter().zip(expected).all(|(wish, like)| wish.starts_with(like)), "{wishes:?}");
    }

    #[test]
    fn an_answer_is_for_a_place_or_for_the_same_programs() {
        let place = tempfile::tempdir().unwrap();
        let [one, other] = ["one", "other"].map(|name| place.path().join(name));
        let digests = |folder: &Path, program: &str| {
            fs::create_dir_all(folder).unwrap();
            fs::write(folder.join("p.py"), program).unwrap();
            let (loaded, wishes) = wishes(folder, "plugins:\n  - { id: p, command: [python3, p.py] }\n");
            (wishes.at(folder), wishes.with_contents(&loaded.testbed, &loaded.text).unwrap())
        };
        let (own, copy, hostile) = (digests(&one, "1"), digests(&other, "1"), digests(&other, "2"));
        assert_eq!(own.1, copy.1, "a copy");
        assert!(own.0 != hostile.0 && own.1 != hostile.1, "another program of the same name");
        assert_eq!(digests(&one, "3").0, own.0, "the same file, whose program is developed");
        let answers = Answers(Some(place.path().join("config/cotorra/approved")));
        assert!(!answers.have(&own.0));
        answers.add([own.0.clone(), own.1].into_iter(), "a\nb").unwrap();
        assert!(answers.have(&own.0) && answers.have(&copy.1) && !answers.have(&hostile.0));
        assert!(!answers.have("b"), "a name adds no line");
    }
}
