//! Commands that start no testbed.

use std::{
    fs, io,
    process::{Command, Stdio},
};

use serde_json::Value;

use crate::harness::{corridor, cotorra, output, project_file, stderr, stdout};

#[test]
fn a_valid_file_is_summarised_in_one_line() {
    let checked = output(["check".as_ref(), corridor().as_os_str()]);
    assert!(checked.status.success(), "{}", stderr(&checked));
    let text = stdout(&checked);
    assert_eq!(text.lines().count(), 1, "{text}");
    for part in [
        "corridor.yaml: ",
        "1 robot",
        "6 radio units",
        "1 switch",
        "3 servers",
        "2 services of 4 VNFs",
        "plug-ins: probing",
    ] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
}

#[test]
fn all_mistakes_of_a_file_are_reported_with_lines_and_help() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.yaml");
    let text = "name: bad\nnodes:\n  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB, colour: red }\n  \
        right: { kind: server, tire: edge, cpus: -1, memory: 1 GB }\nlinks:\n  - { ends: [left, right], delay: 5 }\n";
    fs::write(&bad, text).unwrap();
    let checked = output(["check".as_ref(), bad.as_os_str(), corridor().as_os_str()]);
    assert_eq!(checked.status.code(), Some(1));
    let errors = stderr(&checked);
    for part in [
        "bad.yaml",
        ":3:",
        ":4:",
        ":6:",
        "colour",
        "did you mean `tier`?",
        "found `-1`",
        "`5` has no unit",
        "5 mistakes",
    ] {
        assert!(errors.contains(part), "{part} is not in {errors}");
    }
    assert!(stdout(&checked).contains("corridor.yaml: "), "the valid file is summarised, too");
}

#[test]
fn jitter_that_raises_the_mean_delay_is_warned_of_in_place() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.yaml");
    let text = "name: lab\nnodes:\n  a: { kind: server, tier: fog, cpus: 1, memory: 1 GB }\n  \
        b: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\nlinks:\n  - { ends: [a, b], delay: 10 ms, jitter: 20 ms }\n";
    fs::write(&file, text).unwrap();
    for arguments in [&["check"][..], &["run", "--simulate", "--dry-run"]] {
        let checked = cotorra(arguments).arg(&file).output().unwrap();
        assert!(checked.status.success(), "{}", stderr(&checked));
        let shown = stderr(&checked);
        for part in [
            "lab.yaml:6:43",
            "with this jitter, the mean delay is 13.956ms, not 10ms",
            "a delay of 40ms or more",
        ] {
            assert!(shown.contains(part), "{part} is not in {shown}");
        }
    }
}

#[test]
fn a_closed_standard_error_does_not_change_the_exit_status() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.yaml");
    fs::write(&bad, "name: bad\n").unwrap();
    let (reader, writer) = io::pipe().unwrap();
    drop(reader);
    let checked = cotorra(["check".as_ref(), bad.as_os_str()]).stderr(writer).stdout(Stdio::null()).status();
    assert_eq!(checked.unwrap().code(), Some(1));
}

#[test]
fn endless_and_huge_files_are_rejected_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let checked = output(["check", "/dev/zero"]);
    assert_eq!(checked.status.code(), Some(1));
    assert!(stderr(&checked).contains("more than 33554432 bytes"), "{}", stderr(&checked));

    let named = folder.path().join("named.yaml");
    fs::write(&named, format!("name: {}\n", "x".repeat(30 << 20))).unwrap();
    let checked = output(["check".as_ref(), named.as_os_str()]);
    assert_eq!(checked.status.code(), Some(1));
    let errors = stderr(&checked);
    assert!(errors.contains("named.yaml:1:7: this text has more than 65536 bytes"), "{errors}");
    assert!(errors.len() < 1000, "the name is repeated");
}

#[test]
fn a_missing_file_is_an_error_with_its_name() {
    for command in ["check", "run"] {
        let checked = output([command, "no-such-file.yaml"]);
        assert_eq!(checked.status.code(), Some(1));
        assert!(stderr(&checked).contains("no-such-file.yaml"), "{}", stderr(&checked));
    }
}

#[test]
fn schema_and_openapi_are_the_files_in_docs() {
    for (command, file) in [
        ("schema", "docs/testbed.schema.json"),
        ("openapi", "docs/openapi.json"),
        ("openapi --wais", "docs/wais.openapi.json"),
        ("openapi --location", "docs/location.openapi.json"),
        ("openapi --bwm", "docs/bwm.openapi.json"),
        ("openapi --app-lcm", "docs/app-lcm.openapi.json"),
    ] {
        let text = stdout(&output(command.split(' ')));
        let parsed: Value = serde_json::from_str(&text).unwrap();
        assert!(parsed.is_object());
        let checked_in = fs::read_to_string(project_file(file)).unwrap();
        assert!(text == checked_in, "{file} is not what `cotorra {command}` prints; write it anew");
    }
}

#[test]
fn the_doctor_gives_a_reason_and_a_remedy_for_each_missing_capability() {
    let printed = output(["doctor"]);
    assert!(printed.status.success(), "{}", stderr(&printed));
    let text = stdout(&printed);
    for name in ["network namespaces", "NetEm", "mac80211_hwsim", "hostapd", "container engine"] {
        assert!(text.contains(name), "{name} is not in {text}");
    }
    let count = |part: &str| text.matches(part).count();
    assert_eq!(count("✗"), count("why: "));
    assert_eq!(count("✗"), count("what to do: "));
}

#[test]
fn the_doctor_tries_container_engines_out() {
    let folder = tempfile::tempdir().unwrap();
    let socket = format!("unix://{}", folder.path().join("none").display());
    let mut doctor = cotorra(["doctor"]);
    doctor.env("CONTAINER_HOST", &socket).env("DOCKER_HOST", &socket).env("XDG_RUNTIME_DIR", folder.path());
    let text = stdout(&doctor.output().unwrap()).split_whitespace().collect::<Vec<_>>().join(" ");
    for engine in ["podman", "Docker"] {
        let row = text.split_once(&format!("✗ {engine} ")).expect(&text).1;
        let why = row.split_once("why: ").unwrap().1;
        assert!(why.starts_with("a container cannot start: the engine does not answer: "), "{text}");
    }
    // No record of the trial is left for `cotorra clean`.
    let records = fs::read_dir(folder.path().join("cotorra-containers")).unwrap();
    assert_eq!(records.count(), 0);
}

#[test]
fn completions_name_every_command() {
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&output(["completions", shell]));
        for command in ["run", "check", "schema", "openapi", "doctor", "clean", "exec", "ps", "stop", "bench"]
        {
            assert!(script.contains(command), "{command} is not in the script for {shell}");
        }
    }
}

#[test]
fn wrong_usage_is_explained() {
    let file = corridor();
    let until =
        |duration: &str| output(["run".as_ref(), file.as_os_str(), "--until".as_ref(), duration.as_ref()]);
    let bare = until("60");
    assert_eq!(bare.status.code(), Some(2));
    assert!(stderr(&bare).contains("write 60s or 60min"), "{}", stderr(&bare));
    assert_eq!(until("5 parsecs").status.code(), Some(2));
    assert_eq!(output(["frobnicate"]).status.code(), Some(2));
}

#[test]
fn a_dry_run_lists_its_plan_and_leaves_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let file = corridor();
    let out = folder.path().join("runs");
    let arguments =
        ["run".as_ref(), "--dry-run".as_ref(), "--out".as_ref(), out.as_os_str(), file.as_os_str()];
    let printed = output(arguments);
    assert!(printed.status.success(), "{}", stderr(&printed));
    let text = stdout(&printed);
    for part in
        ["robot-driver (robot driver)", "navigation (bundled brain)", "10.77.0.1", "server, cloud", "seed"]
    {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    assert!(!out.exists());
}

#[test]
fn clean_lists_leftovers_or_reports_none() {
    let printed = output(["clean", "--dry-run"]);
    assert!(printed.status.success(), "{}", stderr(&printed));
    assert!(
        stdout(&printed).ends_with("left of killed runs\n")
            || stdout(&printed).ends_with("would be removed\n")
    );
}

#[test]
fn clean_removes_temporary_folders_of_killed_commands() {
    let temporary = tempfile::tempdir().unwrap();
    let mut killed = Command::new("true").spawn().unwrap();
    killed.wait().unwrap();
    let [left, used] = [killed.id(), std::process::id()]
        .map(|process| temporary.path().join(format!("cotorra-testbeds-{process}-0")));
    for folder in [&left, &used] {
        fs::create_dir_all(folder.join("maps")).unwrap();
    }
    let clean = |dry: &[&str]| {
        let printed = cotorra(["clean"]).args(dry).env("TMPDIR", temporary.path()).output().unwrap();
        assert!(printed.status.success(), "{}", stderr(&printed));
        stdout(&printed)
    };
    let line = |done: &str| format!("{}: the temporary folder of a killed command {done}\n", left.display());
    let listed = clean(&["--dry-run"]);
    assert!(listed.contains(&line("would be removed")) && left.exists(), "{listed}");
    let removed = clean(&[]);
    assert!(removed.contains(&line("removed")) && !left.exists() && used.exists(), "{removed}");
}

#[test]
fn exec_without_a_run_says_how_to_start_one() {
    let printed = output(["exec", "robot", "--api", "127.0.0.1:9", "--", "true"]);
    assert_eq!(printed.status.code(), Some(1));
    let errors = stderr(&printed);
    assert!(errors.contains("127.0.0.1:9") && errors.contains("with sudo"), "{errors}");
}

#[test]
fn commands_that_moved_are_named_in_the_other_program() {
    for line in [
        "experiment okpi --emulate",
        "fault-test --runs 10",
        "bench",
        "bench round-trip",
        "bench --list",
        "experiment --help",
    ] {
        let refused = output(line.split(' '));
        assert_eq!(refused.status.code(), Some(1), "{line}");
        // Long lines are wrapped.
        let said = stderr(&refused).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.ends_with(&format!("cargo run --release -p cotorra-lab -- {line}")), "{said}");
    }
}
