//! `cotorra agent`: credentials of agents, from enrolment to revocation.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{cotorra, stderr, stdout};

/// A home without an authority. Commands start in it.
struct Home(TempDir);

impl Home {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, path: &str) -> PathBuf {
        self.0.path().join(path)
    }

    fn command(&self, arguments: &str) -> Command {
        let mut command = cotorra(["agent"].into_iter().chain(arguments.split(' ')));
        command.current_dir(self.0.path()).env("HOME", self.0.path()).env_remove("XDG_CONFIG_HOME");
        command
    }

    fn run(&self, arguments: &str) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs a command that must succeed, and returns its output.
    fn agent(&self, arguments: &str) -> String {
        let printed = self.run(arguments);
        assert!(printed.status.success(), "{arguments}: {}", stderr(&printed));
        stdout(&printed)
    }

    /// Runs a command that must fail, and returns its error in one line.
    fn refused(&self, arguments: &str, status: i32) -> String {
        let printed = self.run(arguments);
        assert_eq!(printed.status.code(), Some(status), "{arguments}: {}", stdout(&printed));
        stderr(&printed).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    }

    fn list(&self) -> Value {
        serde_json::from_str(&self.agent("list --json")).unwrap()
    }

    /// Writes the block of a bundle to a file of its own, and returns the file.
    fn block(&self, bundle: &str, key: &str) -> PathBuf {
        let text = fs::read_to_string(self.path(bundle)).unwrap();
        let (_, rest) = text.split_once(&format!("\n{key}:\n")).unwrap();
        let end = rest.find("-----END").unwrap();
        let end = end + rest[end..].find('\n').unwrap() + 1;
        let path = self.path(&format!("{bundle}.{key}.pem"));
        fs::write(&path, &rest[..end]).unwrap();
        path
    }
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o7777
}

fn openssl(arguments: &[&str], files: &[&Path]) -> Output {
    Command::new("openssl").args(arguments).args(files).output().expect("scripts/test installs openssl")
}

#[test]
fn an_agent_is_enrolled_renewed_and_revoked() {
    let home = Home::new();
    let enrolled = home.agent("enrol robot --core lab.local:7448");
    assert!(enrolled.starts_with("enrolled robot with lab.local:7448: generation 1, until "), "{enrolled}");
    assert!(enrolled.ends_with("robot.agent written; copy it to the agent's machine, and keep it secret\n"));
    let first = fs::read_to_string(home.path("robot.agent")).unwrap();
    assert!(first.contains("\ncore: lab.local:7448\n") && first.contains("\ngeneration: 1\n"), "{first}");
    home.agent("enrol edge --core 10.0.0.1:7448 --valid 30d --out e.agent");

    let renewed = home.agent("renew robot --force");
    assert!(renewed.starts_with("renewed robot: generation 2, until "), "{renewed}");
    let second = fs::read_to_string(home.path("robot.agent")).unwrap();
    assert!(second.contains("\ncore: lab.local:7448\n") && second.contains("\ngeneration: 2\n"), "{second}");
    let listed = home.list();
    assert_eq!(listed[0]["granted"], json!(["edge.1"]));
    assert_eq!(listed[1]["granted"], json!(["robot.1", "robot.2"]));
    assert_eq!((&listed[1]["state"], &listed[1]["generation"]), (&json!("enrolled"), &json!(2)));
    let expires = format!("\nexpires: {}\n", listed[1]["not_after"].as_str().unwrap());
    assert!(second.contains(&expires), "{expires} is not in {second}");
    home.agent("renew robot --force --overlap 0s --core 10.0.0.1:7448 --valid 1d");
    assert_eq!(home.list()[1]["granted"], json!(["robot.3"]));

    assert_eq!(home.agent("revoke robot"), "revoked robot: ended robot.3\n");
    assert_eq!(home.agent("revoke robot"), "robot was revoked before\n");
    let listed = home.list();
    assert_eq!((&listed[1]["state"], &listed[1]["granted"]), (&json!("revoked"), &json!([])));
    let table = home.agent("list");
    assert!(table.lines().nth(2).unwrap().starts_with("robot  revoked "), "{table}");
    home.agent("enrol robot --core lab.local:7448 --force");
    assert_eq!(home.list()[1]["granted"], json!(["robot.4"]));
}

#[test]
fn secrets_are_readable_for_their_user_only() {
    let home = Home::new();
    // Files are private whatever new files usually are.
    let mut command = Command::new("sh");
    let enrol = home.command("enrol robot --core lab:7448");
    command.args(["-c", "umask 000; exec \"$@\"", "sh"]).arg(enrol.get_program()).args(enrol.get_args());
    command.current_dir(home.0.path()).env("HOME", home.0.path()).env_remove("XDG_CONFIG_HOME");
    assert!(command.status().unwrap().success());
    let authority = home.path(".config/cotorra/agents");
    assert_eq!((mode(&authority), mode(&home.path("robot.agent"))), (0o700, 0o600));
    let mut files: Vec<_> = fs::read_dir(&authority).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    assert_eq!(files, ["agents.json", "authority.pem"].map(|name| authority.join(name)));
    assert!(files.iter().all(|file| mode(file) == 0o600));

    fs::set_permissions(&authority, fs::Permissions::from_mode(0o750)).unwrap();
    let error = home.refused("list", 1);
    assert!(error.contains("others may use it (mode 0750)") && error.contains("chmod go= "), "{error}");
}

#[test]
fn mistakes_are_explained_and_change_nothing() {
    let home = Home::new();
    let no_authority = home.refused("list", 1);
    assert!(no_authority.contains("there is no authority in") && no_authority.contains("agent enrol NAME"));
    assert!(home.refused("renew robot", 1).contains("there is no authority in"));
    home.agent("enrol robot --core lab:7448");
    let state = || (home.list(), fs::read_to_string(home.path("robot.agent")).unwrap());
    let before = state();
    for (arguments, status, part) in [
        ("enrol robot --core lab:7448", 1, "robot.agent exists help: --force replaces it"),
        (
            "enrol robot --core lab:7448 --out 2.agent",
            1,
            "enrolled already, in generation 1 help: `cotorra agent renew robot`",
        ),
        ("renew robot", 1, "robot.agent exists"),
        ("renew robot --out no/2.agent", 1, "no/2.agent cannot be written: no is not a folder"),
        ("renew robot --out . --force", 1, ". exists"),
        (
            "renew rob",
            1,
            "no agent `rob` is enrolled; there are robot help: `cotorra agent enrol rob --core HOST:PORT`",
        ),
        ("revoke rob", 1, "there are robot"),
        ("enrol edge --core lab:7448 --valid 4000d", 1, "ends with that of the authority, 20"),
        ("enrol edge --core lab", 2, "it has no port: write a host and a port"),
        ("enrol edge --core fe80::1:7448", 2, "brackets"),
        ("enrol edge", 2, "--core <HOST:PORT>"),
        ("enrol edge.1 --core lab:7448", 2, "`edge.1` is not a name: use 1 to 53 letters"),
        ("enrol ../edge --core lab:7448", 2, "`../edge` is not a name"),
        ("renew robot --overlap 5m --force", 2, "write 5min"),
    ] {
        let error = home.refused(arguments, status);
        assert!(error.contains(part), "{arguments}: `{part}` is not in `{error}`");
    }
    assert_eq!(state(), before);
    assert_eq!(fs::read_dir(home.0.path()).unwrap().count(), 2, "the authority and one file");

    let registry = home.path(".config/cotorra/agents/agents.json");
    let text = fs::read_to_string(&registry).unwrap();
    fs::write(&registry, &text[..text.len() / 2]).unwrap();
    let error = home.refused("renew robot --force", 1);
    assert!(error.contains("agents.json is damaged: EOF") && error.contains("from a backup"), "{error}");
    fs::write(&registry, text).unwrap();
    assert_eq!(state(), before);
}

#[test]
fn an_authority_can_be_anywhere() {
    let home = Home::new();
    home.agent("enrol robot --core lab:7448 --authority lab-1");
    home.agent("enrol robot --core lab:7448 --authority lab-2 --force");
    assert!(home.path("lab-1/authority.pem").exists() && !home.path(".config").exists());
    let config = home.path("config");
    let enrol = home.command("enrol robot --core lab:7448 --force").env("XDG_CONFIG_HOME", &config).status();
    assert!(enrol.unwrap().success() && config.join("cotorra/agents/authority.pem").exists());
    let nowhere = home.command("list").env_remove("HOME").output().unwrap();
    assert!(stderr(&nowhere).contains("name one with --authority"), "{}", stderr(&nowhere));
}

#[test]
fn openssl_verifies_the_certificate_for_clients_only() {
    let home = Home::new();
    home.agent("enrol robot --core lab:7448");
    home.agent("enrol robot --core lab:7448 --authority other --out other.agent");
    let [authority, certificate, key] =
        ["authority", "certificate", "key"].map(|key| home.block("robot.agent", key));
    let verify = |purpose: &str, authority: &Path| {
        let arguments =
            ["verify", "-x509_strict", "-purpose", purpose, "-CAfile", authority.to_str().unwrap()];
        openssl(&arguments, &[&certificate])
    };
    let valid = verify("sslclient", &authority);
    assert!(valid.status.success(), "{}", stderr(&valid));
    let server = verify("sslserver", &authority);
    assert!(!server.status.success() && stderr(&server).contains("unsuitable certificate purpose"));
    let foreign = verify("sslclient", &home.block("other.agent", "authority"));
    assert!(!foreign.status.success(), "{}", stdout(&foreign));

    let arguments = ["x509", "-noout", "-subject", "-nameopt", "multiline,-align", "-ext", "keyUsage", "-in"];
    let text = stdout(&openssl(&arguments, &[&certificate]));
    assert!(text.contains("commonName = robot.1\n") && text.contains("Digital Signature\n"), "{text}");
    let public = stdout(&openssl(&["x509", "-noout", "-pubkey", "-in"], &[&certificate]));
    assert_eq!(stdout(&openssl(&["pkey", "-pubout", "-in"], &[&key])), public);
    assert!(public.starts_with("-----BEGIN PUBLIC KEY-----"), "{public}");
}

/// A command is killed later if it did not finish, and else earlier, so that kills meet its writes.
#[test]
fn commands_that_are_killed_leave_whole_files() {
    const ROUNDS: usize = 60;
    let home = Home::new();
    let authority = home.path(".config/cotorra/agents");
    let (mut enrolled, mut work) = (Vec::new(), 1000);
    for n in 0..ROUNDS {
        let mut command = home.command(&format!("enrol robot-{n} --core lab:7448"));
        let mut child = command.stdout(Stdio::null()).spawn().unwrap();
        (0..work).for_each(|_| _ = authority.join("agents.json").metadata());
        child.kill().unwrap();
        child.wait().unwrap();
        let file = home.path(&format!("robot-{n}.agent"));
        work = if file.exists() { work / 10 * 9 } else { work / 10 * 12 };
        work = work.max(10);
        if !authority.join("authority.pem").exists() {
            continue;
        }
        let listed = home.list();
        let names: Vec<_> = listed.as_array().unwrap().iter().map(|agent| agent["name"].clone()).collect();
        assert!(enrolled.iter().all(|name| names.contains(name)), "{enrolled:?} became {names:?}");
        if let Ok(text) = fs::read_to_string(&file) {
            assert!(names.contains(&json!(format!("robot-{n}"))), "the file is older than the registry");
            assert!(text.ends_with("-----END PRIVATE KEY-----\n"), "{text}");
        }
        enrolled = names;
    }
    assert!(!enrolled.is_empty() && enrolled.len() < ROUNDS, "no kill came too early, or all did");
    for n in 0..ROUNDS {
        let name = format!("robot-{n}");
        let command = if enrolled.contains(&json!(name)) { "renew" } else { "enrol --core lab:7448" };
        home.agent(&format!("{command} {name} --force"));
    }
    assert_eq!(home.list().as_array().unwrap().len(), ROUNDS);
}
