//! A run whose disk is full: a small file system in memory, in its own mount namespace.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    env,
    ffi::OsStr,
    fs,
    os::unix::fs::MetadataExt,
    process::{Command, Stdio},
};

use tempfile::TempDir;

use crate::{
    harness::Run,
    one_robot::{NAVIGATED, testbed},
};

/// Script that mounts a small disk on the folder `$0`, and runs a command.
const MOUNT: &str = "mount -t tmpfs -o size=8M tmpfs \"$0\"; exec \"$@\"";

/// Changes a command to see a small disk in a folder.
fn on_a_small_disk(command: &mut Command, folder: &OsStr) {
    let mut inside = Command::new("unshare");
    if fs::metadata("/proc/self").unwrap().uid() != 0 {
        inside.arg("--map-root-user");
    }
    inside
        .args(["--mount", "sh", "-euc", MOUNT])
        .arg(folder)
        .arg(command.get_program())
        .args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => inside.env(name, value),
            None => inside.env_remove(name),
        };
    }
    *command = inside;
}

#[test]
fn a_run_on_a_full_disk_ends_with_its_summary_and_says_what_is_not_recorded() {
    let place = TempDir::new().unwrap();
    let mut probe = Command::new("true");
    on_a_small_disk(&mut probe, place.path().as_os_str());
    if !probe.stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
        assert!(env::var_os("CI").is_none(), "the kernel lets nobody make a mount namespace");
        return eprintln!("skipped: the kernel lets nobody make a mount namespace");
    }
    // The plug-in's log is on the disk of the run, and fills it as soon as the run is up: the test then makes a file in the
    // plug-in's working folder.
    let plugin = "plugins:\n  - id: full\n    \
                  command: [sh, -c, 'until [ -e fill ]; do sleep 0.1; done; cat /dev/zero; exec sleep 1000']\n";
    let file = testbed(
        place.path(),
        "full",
        "{ kind: robot, sensors: { front: { kind: lidar } } }",
        &format!("{NAVIGATED}{plugin}"),
    );
    let mut run = Run::start_with(&file, &[], |command| {
        let out = command.get_args().skip_while(|word| *word != "--out").nth(1).unwrap().to_owned();
        on_a_small_disk(command, &out);
    });
    fs::write(place.path().join("fill"), "").unwrap();
    run.wait_for_lines(["the history cannot be written", "not all large data of sensors is kept"]);
    run.signal("INT");
    let (status, printed, said) = run.wait();
    assert_eq!(status.code(), Some(1), "{printed}{said}");
    let lines: Vec<_> = printed.lines().collect();
    assert!(lines[0].starts_with("full: ") && lines[0].ends_with("it was stopped"), "{printed}");
    for what in ["readings of sensors with large data are not kept: ", "events are not in the history: "] {
        let told =
            |text: &str| text.lines().any(|line| line.contains("not recorded: ") && line.contains(what));
        assert!(told(&printed) && told(&said), "{what}\n{printed}\n{said}");
    }
    assert!(printed.contains("fidelity"), "{printed}");
    // It is listed because it is there, whole: its place was reserved.
    let is_listed = |line: &str| line.trim_start().starts_with("summary.json ");
    assert!(printed.lines().any(is_listed), "{printed}");
}
