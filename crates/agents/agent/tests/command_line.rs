//! The real program's command line.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
    time::Duration,
};

use cotorra_enrolment::Authority;
use cotorra_graph::AgentId;

fn agent(home: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cotorra-agent"));
    command.args(arguments).env("HOME", home).env_remove("XDG_STATE_HOME").output().unwrap()
}

#[test]
fn credentials_that_are_not_valid_are_rejected_before_anything_is_connected() {
    let home = tempfile::tempdir().unwrap();
    let file = home.path().join("edge1.agent");
    fs::write(&file, "not credentials").unwrap();
    let (file, state) = (file.to_str().unwrap(), home.path().join("state"));
    for arguments in [&["check", file][..], &["run", file, "--state", state.to_str().unwrap()]] {
        let output = agent(home.path(), arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains("holds no credentials of an agent"), "{said}");
    }
    let output = agent(home.path(), &["check", "nowhere.agent"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("cannot read nowhere.agent"), "{said}");
}

#[test]
#[allow(clippy::disallowed_methods, reason = "certificates begin at a time of the calendar")]
fn an_agent_that_waits_for_its_core_ends_when_it_is_terminated() {
    let home = tempfile::tempdir().unwrap();
    let (authority, today) = (home.path().join("authority"), chrono::Utc::now());
    let authority = Authority::create_or_open(authority, today).unwrap();
    // No program listens there.
    let (name, core) = (AgentId::new("edge1").unwrap(), "127.0.0.1:1".parse().unwrap());
    let credentials = home.path().join("edge1.agent");
    let bundle = authority.enrol(&name, &core, Duration::from_secs(86400), today).unwrap();
    bundle.write(&credentials).unwrap();
    let mut agent = Command::new(env!("CARGO_BIN_EXE_cotorra-agent"))
        .arg("run")
        .arg(credentials)
        .arg("--state")
        .arg(home.path().join("state"))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(agent.stderr.take().unwrap()).lines().map(Result::unwrap);
    // Its loop runs once it explains the silence.
    assert!(lines.any(|line| line.contains("no connection to 127.0.0.1:1")));
    Command::new("kill").arg(agent.id().to_string()).status().unwrap();
    assert!(lines.any(|line| line.contains("stopped")));
    assert!(agent.wait().unwrap().success());
}

/// Holds a program, and ends the holder's input, or sends it a signal.
fn hold_and_end(is_signalled: bool) {
    let home = tempfile::tempdir().unwrap();
    // The program answers once it has started another one, which then keeps the pipe of the output open.
    let script = "sleep 1000 & echo started; wait";
    let mut held = Command::new(env!("CARGO_BIN_EXE_cotorra-agent"))
        .args(["hold", "--", "sh", "-c", script])
        .env("HOME", home.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut output = std::io::BufReader::new(held.stdout.take().unwrap());
    let mut line = String::new();
    std::io::BufRead::read_line(&mut output, &mut line).unwrap();
    assert_eq!(line, "started\n");
    if is_signalled {
        Command::new("kill").arg(held.id().to_string()).status().unwrap();
    } else {
        drop(held.stdin.take());
    }
    assert_eq!(held.wait().unwrap().code(), Some(128 + 9));
    // The pipe ends only when the last program has ended.
    std::io::Read::read_to_string(&mut output, &mut line).unwrap();
    assert_eq!(line, "started\n");
}

#[test]
fn a_holder_starts_its_program_as_another_user() {
    let own = String::from_utf8(Command::new("id").arg("-u").output().unwrap().stdout).unwrap();
    let mut held = Command::new(env!("CARGO_BIN_EXE_cotorra-agent"))
        .args(["hold", "--user", "65534:65534", "--", "id", "-u"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Open until the program has ended.
    let input = held.stdin.take();
    let output = held.wait_with_output().unwrap();
    drop(input);
    if own.trim() == "0" {
        assert_eq!(String::from_utf8(output.stdout).unwrap(), "65534\n");
    } else {
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("cannot start id as user 65534:65534"), "{said}");
    }
}

#[test]
fn a_holder_ends_its_program_and_all_that_it_started_when_its_input_ends() {
    hold_and_end(false);
}

#[test]
fn a_holder_that_is_terminated_ends_its_program_and_all_that_it_started() {
    hold_and_end(true);
}
