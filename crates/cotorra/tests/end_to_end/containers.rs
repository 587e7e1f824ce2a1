//! VNFs and nodes in containers of the real podman and Docker.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    collections::BTreeSet,
    env, fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use cotorra_graph::EngineKind;
use cotorra_testing::containers::{BUSYBOX, Containers, archive, busybox};
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor, corridor_ending_in, cotorra, kill, stderr, stdout, wait_until};

/// Writes a testbed with an image as a whole node, and a web server in a container on another.
fn two_boxes(engine: EngineKind, folder: &Path) -> PathBuf {
    let file = folder.join("testbed.yaml");
    let text = format!(
        r#"
name: boxes
engine: {engine}
nodes:
  left:
    kind: server
    tier: fog
    cpus: 1
    memory: 256 MB
    image: {BUSYBOX}
    capabilities: [net_raw]
    command:
      - sh
      - -c
      - |
        until wget -qO /tmp/page http://right:8080/etc/page; do sleep 1; done
        cat /tmp/page
        ping -c 1 right | grep -c "1 packets received"
        echo interfaces: $(ls /sys/class/net | sort)
        grep CapEff /proc/self/status
        wget -qO- http://127.0.0.1:7700/ || echo no API here
        touch /shown/file || echo read-only
        echo done
        exec sleep 1000000
    volumes: [".:/shown"]
  lan: {{ kind: switch }}
  right: {{ kind: server, tier: edge, cpus: 1, memory: 256 MB }}
  robot: {{ kind: robot, position: [0, 0] }}
  R1: {{ kind: radio_unit, position: [1, 0], channel: 1 }}
wireless: {{ w: {{}} }}
links:
  - {{ ends: [left, lan], delay: 1 ms }}
  - {{ ends: [lan, right], delay: 1 ms }}
  - {{ ends: [lan, R1], delay: 1 ms }}
services:
  web:
    robot: robot
    kpis: {{ service_time: 15 ms }}
    vnfs:
      web:
        image: {BUSYBOX}
        command: [sh, -c, 'echo "$GREETING from $COTORRA_NODE" > /etc/page; exec httpd -f -p 8080']
        env: [GREETING=hello]
        ports: [8080]
        node: right
"#,
        engine = engine.name()
    );
    fs::write(&file, text).unwrap();
    file
}

fn log(run: &Run, vnf: &str) -> String {
    fs::read_to_string(run.folder.join("logs/vnfs").join(format!("{vnf}.log"))).unwrap_or_default()
}

/// Starts a run whose records of containers are beside its testbed file.
fn start(engine: &Containers, testbed: &Path) -> Run {
    Run::start_with(testbed, &["--until", "10min"], |command| {
        command.envs([engine.variable()]).env("XDG_RUNTIME_DIR", testbed.parent().unwrap());
    })
}

fn a_container_is_in_its_node_and_nowhere_else(kind: EngineKind) {
    let Some(engine) = Containers::start(kind) else { return };
    let folder = TempDir::new().unwrap();
    let mut run = start(&engine, &two_boxes(kind, folder.path()));
    wait_until(|| log(&run, "left").lines().any(|line| line == "done"));
    let said = log(&run, "left");
    for line in ["hello from right", "1", "interfaces: eth0 lo", "no API here", "read-only"] {
        assert!(said.lines().any(|said| said == line), "{line} is not in:\n{said}");
    }
    assert!(said.contains("CapEff:\t0000000000002000"), "net_raw alone:\n{said}");
    run.signal("INT");
    run.report();
    assert_eq!(engine.names(), Vec::<String>::new());
}

#[test]
fn a_container_of_podman_is_in_its_node_and_nowhere_else() {
    a_container_is_in_its_node_and_nowhere_else(EngineKind::Podman);
}

#[test]
fn a_container_of_docker_is_in_its_node_and_nowhere_else() {
    a_container_is_in_its_node_and_nowhere_else(EngineKind::Docker);
}

/// Returns the guard of a run.
fn guard(run: &Run) -> u32 {
    let is_guard = |pid: &u32| {
        let words = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        words.split(|byte| *byte == 0).any(|word| word == b"guard")
    };
    run.processes().into_iter().find(is_guard).unwrap()
}

fn nothing_is_left_of_a_killed_run(kind: EngineKind) {
    let Some(engine) = Containers::start(kind) else { return };
    let folder = TempDir::new().unwrap();
    let testbed = two_boxes(kind, folder.path());
    let mut run = start(&engine, &testbed);
    wait_until(|| log(&run, "left").lines().any(|line| line == "done"));
    run.signal("KILL");
    run.wait();
    wait_until(|| engine.names().is_empty());
    drop(run);
    // Without the guard, too.
    let mut run = start(&engine, &testbed);
    wait_until(|| log(&run, "left").lines().any(|line| line == "done"));
    kill("KILL", &guard(&run).to_string());
    run.signal("KILL");
    run.wait();
    assert_ne!(engine.names(), Vec::<String>::new());
    let clean = |arguments: &[&str]| {
        let mut command = cotorra(["clean"]);
        command.args(arguments).env("XDG_RUNTIME_DIR", folder.path()).output().unwrap()
    };
    let shown = stdout(&clean(&["--dry-run"]));
    assert!(shown.contains("the containers of a killed run would be removed"), "{shown}");
    let cleaned = clean(&[]);
    assert!(cleaned.status.success(), "{}", stderr(&cleaned));
    assert!(stdout(&cleaned).contains("the containers of a killed run removed"), "{}", stdout(&cleaned));
    assert_eq!(engine.names(), Vec::<String>::new());
}

#[test]
fn nothing_is_left_of_a_killed_run_with_podman() {
    nothing_is_left_of_a_killed_run(EngineKind::Podman);
}

#[test]
fn nothing_is_left_of_a_killed_run_with_docker() {
    nothing_is_left_of_a_killed_run(EngineKind::Docker);
}

/// Makes an image that navigates: busybox, with cotorra's own program and its libraries.
fn navigation_image(engine: &Containers, folder: &Path) {
    let archived = busybox(folder);
    let root = archived.with_extension("");
    for place in ["lib", "lib64"] {
        fs::create_dir_all(root.join(place)).unwrap();
    }
    let program = cotorra::<&str>([]).get_program().to_owned();
    fs::hard_link(&program, root.join("bin/cotorra"))
        .or_else(|_| fs::copy(&program, root.join("bin/cotorra")).map(drop))
        .unwrap();
    let needed = Command::new("ldd").arg(&program).output().unwrap();
    let needed = String::from_utf8(needed.stdout).unwrap();
    for library in needed.split_whitespace().filter(|word| word.starts_with('/')) {
        let name = Path::new(library).file_name().unwrap();
        // The linker has a path of its own; the others are found in /lib.
        fs::copy(library, root.join("lib").join(name)).unwrap();
        let _ = symlink(Path::new("../lib").join(name), root.join("lib64").join(name));
    }
    let archived = archive(&root, &folder.join("navigation.tar"));
    let command = r#"CMD ["/bin/cotorra", "vnf", "navigation"]"#;
    engine.import("localhost/navigation:cotorra", &archived, &[command, "ENV LD_LIBRARY_PATH=/lib"]);
}

/// Writes the corridor, with these plug-ins and with its navigation in a container.
fn corridor_navigated_by_an_image(engine: &Containers, folder: &Path, plugins: &str) -> PathBuf {
    navigation_image(engine, folder);
    let file = corridor_ending_in(plugins, folder);
    let text = fs::read_to_string(&file).unwrap();
    let navigation = "program: navigation, image: localhost/navigation:cotorra";
    assert!(text.contains("program: navigation"));
    fs::write(&file, text.replace("program: navigation", navigation)).unwrap();
    file
}

/// A service time of navigation: the server, and whether the position packet was answered.
fn served(event: &Value) -> Option<(String, bool)> {
    let is_one = event["event"] == "service_time" && event["service"] == "navigation";
    is_one.then(|| (event["server"].as_str().unwrap().to_owned(), event["service_time_ms"].is_number()))
}

#[test]
fn an_image_navigates_the_robot_and_moves_between_servers() {
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let folder = TempDir::new().unwrap();
    let file = corridor_navigated_by_an_image(&engine, folder.path(), "");
    // Served by the run's own guard, as without a podman service.
    let settings = engine.settings();
    let mut run = Run::start_with(&file, &["--until", "10min"], |command| {
        command.envs(settings);
    });
    let mut samples = run.follow_only("?kinds=service_time").filter_map(|event| served(&event));
    let mut unanswered = 0;
    for server in ["cloud", "edge", "fog"] {
        if server != "cloud" {
            let place = r#"{"instruction":{"instruction":"place","vnf":"navigation","node":"NODE"}}"#;
            let (status, answer) = run.post("/api/v1/instructions", &place.replace("NODE", server));
            assert_eq!(status, 200, "{answer}");
        }
        let mut answered = 0;
        for (at, is_answered) in samples.by_ref() {
            answered += usize::from(is_answered && at == server);
            // Before the first instance is ready, there is none to answer.
            unanswered += usize::from(!is_answered && (server, answered) != ("cloud", 0));
            if answered == 20 {
                break;
            }
        }
        assert_eq!(answered, 20, "{server}");
        assert!(engine.names().iter().any(|name| name.starts_with("cotorra-")));
    }
    run.signal("INT");
    let (summary, _) = run.report();
    assert_eq!(engine.names(), Vec::<String>::new());
    // A machine that stood still answers nothing in time.
    assert!(unanswered == 0 || summary["fidelity"]["valid"] == false, "{unanswered} unanswered: {summary}");
}

/// Returns the stretches of navigation with at least 200 samples, in order: radio unit and server, and the median service time
/// in ms. Shorter ones lie between a handover and a migration.
fn regions(summary: &Value) -> Vec<([String; 2], f64)> {
    let regions = summary["regions"].as_array().unwrap().iter();
    let long = regions.filter(|its| its["service"] == "navigation" && its["samples"].as_u64() >= Some(200));
    let text = |its: &Value, key| its[key].as_str().unwrap().to_owned();
    let place = |its| [text(its, "attachment"), text(its, "server")];
    long.map(|its| (place(its), its["service_time_p50_ms"].as_f64().unwrap())).collect()
}

/// Walks the whole corridor twice at the same time, so that both walks meet the same machine: with `COTORRA_FULL` alone.
#[test]
fn navigation_in_a_container_has_the_service_times_of_the_plain_walk() {
    if env::var_os("COTORRA_FULL").is_none() {
        return eprintln!("skipped: the whole walk is part of scripts/test --full");
    }
    let Some(engine) = Containers::start(EngineKind::Podman) else { return };
    let (plain, contained) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let text = fs::read_to_string(corridor()).unwrap();
    let (_, plugins) = text.split_once("\nplugins:").unwrap();
    let plugins = format!("plugins:{plugins}");
    let images = corridor_navigated_by_an_image(&engine, contained.path(), &plugins);
    let options = ["--set", "plugin=okpi", "--seed", "1"];
    let mut first = Run::start(&corridor_ending_in(&plugins, plain.path()), &options);
    let mut second = first.another_with(&images, &options, |command| {
        command.envs([engine.variable()]).env("XDG_RUNTIME_DIR", contained.path());
    });
    let samples = second.follow_only("?kinds=service_time").filter_map(|event| served(&event));
    let samples: Vec<_> = samples.skip_while(|(_, is_answered)| !is_answered).collect();
    let unanswered = samples.iter().filter(|(_, is_answered)| !is_answered).count();
    let (plain, contained) = (first.report().0, second.report().0);
    for (name, summary) in [("plain", &plain), ("container", &contained)] {
        println!("{name}: lateness in µs {}", summary["fidelity"]["lateness_us"]);
    }
    println!("{} position packets, {unanswered} unanswered", samples.len());
    println!("unit server    plain  container  difference, ms");
    let (plain, contained) = (regions(&plain), regions(&contained));
    assert_eq!(plain.len(), contained.len(), "{plain:?} {contained:?}");
    for ((place, median), (other_place, other)) in plain.iter().zip(contained) {
        assert_eq!(*place, other_place);
        println!("{:<11} {median:>8.2} {other:>10.2} {:>+11.2}", place.join(" "), other - median);
        assert!((other - median).abs() <= 0.3, "{place:?}");
    }
    let servers: BTreeSet<_> = plain.iter().map(|([_, server], _)| server.as_str()).collect();
    assert_eq!(Vec::from_iter(servers), ["cloud", "edge", "fog"]);
    assert_eq!(unanswered, 0);
}

#[test]
fn an_engine_that_is_missing_is_reported_before_the_run_begins() {
    let folder = TempDir::new().unwrap();
    let testbed = two_boxes(EngineKind::Podman, folder.path());
    let out = folder.path().join("runs");
    let run = |engine: &str, variables: &[(&str, &str)]| {
        let mut command = cotorra(["run", "--headless", "--out"]);
        command.arg(&out).arg(&testbed).args(["--set", &format!("engine={engine}")]);
        command.env("PATH", folder.path()).envs(variables.iter().copied());
        for name in ["CONTAINER_HOST", "DOCKER_HOST"] {
            if !variables.iter().any(|(variable, _)| *variable == name) {
                command.env_remove(name);
            }
        }
        let rejected = command.output().unwrap();
        assert!(!rejected.status.success());
        assert!(!out.exists(), "nothing has happened");
        stderr(&rejected).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let missing = run("podman", &[]);
    assert!(missing.contains("podman is not installed"), "{missing}");
    let remote = run("docker", &[("DOCKER_HOST", "tcp://127.0.0.1:2375")]);
    assert!(remote.contains("is no socket of this machine"), "{remote}");
}
