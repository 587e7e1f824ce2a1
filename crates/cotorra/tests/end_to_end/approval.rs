//! Testbed files from elsewhere, with commands that were not approved.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path, process::Output};

use tempfile::TempDir;

use crate::harness::{corridor_ending_in, cotorra, stderr};

/// A downloaded testbed file with a plug-in that leaves a mark, in the home of a user.
struct Home(TempDir);

impl Home {
    fn new() -> Self {
        let home = Self(TempDir::new().unwrap());
        home.download("downloads", "");
        home
    }

    fn download(&self, folder: &str, more: &str) {
        let folder = self.0.path().join(folder);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("p.sh"), format!("touch \"$(dirname \"$0\")/mark\"{more}\n")).unwrap();
        corridor_ending_in("plugins:\n  - { id: p, command: [sh, p.sh], optional: true }\n", &folder);
    }

    fn is_marked(&self) -> bool {
        self.0.path().join("downloads/mark").exists()
    }

    fn cotorra(&self, folder: &str, words: &[&str]) -> Output {
        let (command, rest) = words.split_first().unwrap();
        let mut command = cotorra([command]);
        command.arg(self.0.path().join(folder).join("testbed.yaml")).args(rest);
        command.arg("--out").arg(self.0.path().join("out"));
        command.env_remove("COTORRA_TRUST").env("XDG_CONFIG_HOME", self.0.path().join("config"));
        command.output().unwrap()
    }
}

const RUN: [&str; 5] = ["run", "--simulate", "--headless", "--until", "100ms"];

#[test]
fn commands_of_a_file_that_nobody_approved_do_not_run() {
    let home = Home::new();
    for words in [
        &RUN[..],
        &["run", "--headless", "--until", "100ms"],
        &["sweep", "--until", "100ms"],
        &["margin", "--until", "100ms"],
    ] {
        let refused = home.cotorra("downloads", words);
        let said = stderr(&refused);
        assert_eq!(refused.status.code(), Some(1), "{words:?}: {said}");
        assert!(said.contains("run `sh p.sh` as you, as plug-in `p`") && said.contains("--trust"), "{said}");
        assert!(!home.is_marked(), "{words:?}");
        assert!(!home.0.path().join("out").exists(), "nothing is made: {words:?}");
    }
    // A look at it runs nothing.
    let planned = home.cotorra("downloads", &["run", "--simulate", "--dry-run"]);
    assert!(planned.status.success() && !home.is_marked(), "{}", stderr(&planned));
}

#[test]
fn an_approval_is_remembered_until_the_file_wants_something_else() {
    let home = Home::new();
    let is_refused =
        |folder: &str, words: &[&str]| stderr(&home.cotorra(folder, words)).contains("not approved");
    assert!(!is_refused("downloads", &[&RUN[..], &["--trust"]].concat()));
    assert!(home.is_marked());
    assert!(!is_refused("downloads", &RUN), "it was approved");
    home.download("downloads", "; true");
    assert!(!is_refused("downloads", &RUN), "its user develops the program");
    home.download("elsewhere", "; curl example.org");
    assert!(is_refused("elsewhere", &RUN), "another program of the same name");
    let file = home.0.path().join("downloads/testbed.yaml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("command: [sh, p.sh]", "command: [sh, -c, id]")).unwrap();
    assert!(is_refused("downloads", &RUN), "another command");
    let approved = home.0.path().join("config/cotorra/approved");
    assert_eq!(fs::read_to_string(approved).unwrap().lines().count(), 2);
}

#[test]
fn others_cannot_look_into_a_run() {
    let home = Home::new();
    let run = home.cotorra("downloads", &[&RUN[..], &["--trust"]].concat());
    let out = home.0.path().join("out");
    let mode =
        |path: &Path| std::os::unix::fs::PermissionsExt::mode(&fs::metadata(path).unwrap().permissions());
    let folder = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
    assert_eq!(mode(&folder) & 0o777, 0o700, "{}", stderr(&run));
}
