//! `cotorra bench image` with the real podman and Docker.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead as _, BufReader},
    os::unix::fs::PermissionsExt as _,
    path::Path,
    process::{Command, Stdio},
};

use cotorra_graph::EngineKind;
use cotorra_testing::containers::{BUSYBOX, Containers};
use tempfile::TempDir;

use crate::harness::{corridor_ending_in, cotorra, kill, stderr, stdout, wait_until};

/// Shell script of a web server with one page.
const SERVER: &str = "echo hello > /tmp/plan; exec httpd -f -p 8080 -h /tmp";

fn bench(engine: &Containers, arguments: &[&str]) -> Command {
    let (name, value) = engine.variable();
    let mut command = cotorra(["bench", "image"].iter().chain(arguments));
    command.env(name, value);
    command
}

fn times_are_measured_and_written(kind: EngineKind) {
    let Some(engine) = Containers::start(kind) else { return };
    let folder = TempDir::new().unwrap();
    let file = corridor_ending_in("", folder.path());
    let role = "program: navigation, image: localhost/busybox:cotorra";
    let text = fs::read_to_string(&file).unwrap().replace("program: navigation", role);
    fs::write(&file, &text).unwrap();
    let arguments =
        [BUSYBOX, "--engine", kind.name(), "--runs", "2", "--http", "8080/plan", "--vnf", "navigation"];
    let measured =
        bench(&engine, &arguments).arg("--write").arg(&file).args(["--", "sh", "-c", SERVER]).output();
    let measured = measured.unwrap();
    assert!(measured.status.success(), "{}", stderr(&measured));
    let shown = stdout(&measured);
    for part in [
        "2 starts",
        "until it listens at 8080/tcp",
        "run -d` alone",
        "answer to GET /plan at 8080/tcp, 100 times",
    ] {
        assert!(shown.contains(part), "{part} is not in:\n{shown}");
    }
    let written = fs::read_to_string(&file).unwrap();
    assert!(written.contains(&format!("{role}, start_time: ")), "{written}");
    assert!(written.contains(" ms, processing_delay: "), "{written}");
    assert_eq!(written.lines().count(), text.lines().count());
    let checked = cotorra(["check"]).arg(&file).output().unwrap();
    assert!(checked.status.success(), "{}", stderr(&checked));
    // Only that this machine may have too few CPUs.
    assert!(stderr(&checked).lines().all(|hint| hint.contains("this machine has")), "{}", stderr(&checked));
    assert_eq!(engine.names(), Vec::<String>::new());
}

#[test]
fn times_of_podman_are_measured_and_written() {
    times_are_measured_and_written(EngineKind::Podman);
}

#[test]
fn times_of_docker_are_measured_and_written() {
    times_are_measured_and_written(EngineKind::Docker);
}

#[test]
fn an_image_that_cannot_serve_is_reported_and_nothing_is_written() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let folder = TempDir::new().unwrap();
    let file = corridor_ending_in("", folder.path());
    let text = fs::read_to_string(&file).unwrap();
    let text = text.replace("program: navigation", "program: navigation, image: localhost/busybox:cotorra");
    fs::write(&file, &text).unwrap();
    let failed = |arguments: &[&str], script: &str| {
        let mut command = bench(&engine, arguments);
        command.args(["--vnf", "navigation", "--write"]).arg(&file).args(["--", "sh", "-c", script]);
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stdout(&output));
        assert_eq!(fs::read_to_string(&file).unwrap(), text);
        assert_eq!(engine.names(), Vec::<String>::new());
        // Lines may be wrapped anywhere.
        stderr(&output).split_whitespace().collect::<Vec<_>>().join(" ").replace(" │ ", " ")
    };
    let missing = failed(&["localhost/missing:1"], "true");
    assert!(missing.contains("there is no image"), "{missing}");
    let ended = failed(&[BUSYBOX, "--port", "8080"], "echo no plan; exit 3");
    assert!(ended.contains("exited with status 3") && ended.contains("no plan"), "{ended}");
    let no_page = failed(&[BUSYBOX, "--http", "8080/none", "--runs", "1"], SERVER);
    assert!(no_page.contains("404"), "{no_page}");
}

#[test]
fn ctrl_c_ends_the_wait_for_a_port_and_leaves_no_container() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let mut command = bench(&engine, &[BUSYBOX, "--port", "9000/udp", "--", "sleep", "1000000"]);
    // Served by the benchmark's own guard, as without a podman service.
    command.env_remove(engine.variable().0).envs(engine.settings());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    let waits = lines.find(|line| line.contains("waits for a listener at 9000/udp")).unwrap();
    assert!(waits.contains("Ctrl-C"), "{waits}");
    assert_ne!(engine.names(), Vec::<String>::new());
    kill("INT", &child.id().to_string());
    assert!(lines.any(|line| line == "stopped; no container is left"));
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(engine.names(), Vec::<String>::new());
}

/// Runs the benchmark with a program `podman` that does this, in a shell, when it is to start a container for comparison.
fn killed_in_the_comparison(bench: &mut Command, folder: &Path, script: &str) {
    let program = folder.join("podman");
    let script = format!(
        "#!/bin/sh\nPATH=${{PATH#*:}}\ncase \" $* \" in\n*\" run \"*) {script} ;;\n*) exec podman \"$@\" ;;\nesac\n"
    );
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let ended = bench.env("PATH", path).env("XDG_RUNTIME_DIR", folder).current_dir(folder).status().unwrap();
    assert!(!ended.success());
}

#[test]
fn the_guard_removes_what_a_killed_comparison_starts() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let folder = TempDir::new().unwrap();
    let mut command = bench(&engine, &[BUSYBOX, "--runs", "1", "--", "sleep", "1000000"]);
    command.env_remove(engine.variable().0).envs(engine.settings());
    // The container comes after the benchmark is dead.
    let script = r#"kill -KILL $PPID; podman "$@" && touch started"#;
    killed_in_the_comparison(&mut command, folder.path(), script);
    wait_until(|| folder.path().join("started").exists() && engine.names().is_empty());
    let records = folder.path().join("cotorra-containers");
    wait_until(|| fs::read_dir(&records).unwrap().next().is_none());
}

#[test]
fn a_comparison_that_was_killed_with_its_guard_is_cleaned_up_later() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let folder = TempDir::new().unwrap();
    let mut command = bench(&engine, &[BUSYBOX, "--runs", "1", "--", "sleep", "1000000"]);
    let guards =
        "for child in $(cat /proc/$PPID/task/*/children); do [ $child = $$ ] || kill -KILL $child; done";
    let script = format!(r#"podman "$@"; {guards}; kill -KILL $PPID"#);
    killed_in_the_comparison(&mut command, folder.path(), &script);
    let names = engine.names();
    assert!(names.len() == 1 && names[0].starts_with("cotorra-bench-"), "{names:?}");
    let cleaned = cotorra(["clean"]).env("XDG_RUNTIME_DIR", folder.path()).output().unwrap();
    assert!(cleaned.status.success(), "{}", stderr(&cleaned));
    assert_eq!(engine.names(), Vec::<String>::new());
}
