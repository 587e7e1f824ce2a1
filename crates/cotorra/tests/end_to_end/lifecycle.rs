//! VNFs that come and go during a live run: by instruction, and by scripts of fog05.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead as _, BufReader, Lines, Write as _},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, events, project_file, stderr, wait_until},
    one_robot::{NAVIGATED, testbed},
};

/// Returns the processes of a run that have this word in their command.
fn with_word(run: &Run, word: &str) -> usize {
    let has_word = |pid: &u32| {
        let words = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        words.split(|byte| *byte == 0).any(|is| is == word.as_bytes())
    };
    run.processes().iter().filter(|pid| has_word(pid)).count()
}

/// A script of fog05 that talks to a run.
struct Script {
    python: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Script {
    fn start<'a>(run: &Run, name: &str, arguments: impl IntoIterator<Item = &'a Path>) -> Self {
        Self::start_with(run, name, arguments, |_| {})
    }

    /// Does the same as [`Self::start`] after `change` to the command.
    fn start_with<'a>(
        run: &Run,
        name: &str,
        arguments: impl IntoIterator<Item = &'a Path>,
        change: impl FnOnce(&mut Command),
    ) -> Self {
        let mut python = Command::new("python3");
        python.arg(project_file(&format!("crates/cotorra/tests/end_to_end/{name}"))).args(arguments);
        python.env("PYTHONPATH", project_file("clients/python")).env("COTORRA_API", &run.api);
        change(&mut python);
        let mut python = python.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(python.stdout.take().unwrap()).lines();
        Self { python, lines }
    }

    /// Returns what comes after this word in the script's next line.
    fn after(&mut self, word: &str) -> String {
        let line = self.lines.next().and_then(Result::ok).unwrap_or_default();
        let rest = line.strip_prefix(word).unwrap_or_else(|| panic!("not `{word}`: {line}"));
        rest.trim_start().to_owned()
    }

    fn press_enter(&mut self) {
        self.python.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
    }

    fn end(mut self) {
        assert!(self.python.wait().unwrap().success());
    }
}

#[test]
fn an_added_vnf_runs_until_it_is_removed_and_is_confined() {
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "lifecycle", "{ kind: robot }", NAVIGATED);
    let run = Run::start_beside_with(&file, &["--until", "5min"], |command| {
        command.env("AWS_SECRET_ACCESS_KEY", "secret-of-the-machine");
    });
    run.wait_for_service();
    let body = |program: Value| {
        json!({ "vnf": { "id": "extra", "node": "cloud", "cpus": 0.5, "memory_bytes": 100_000_000,
            "program": program, "env": ["MINE=1"] } })
        .to_string()
    };
    let script = format!(
        "env; pwd; cat {}; ls {}; echo done; exec sleep 4321",
        file.display(),
        folder.path().display()
    );
    let print = json!({ "command": ["sh", "-c", script] });
    let (status, answer) = run.post("/api/v1/vnfs", &body(print.clone()));
    assert_eq!(status, 200, "{answer}");
    let log = || fs::read_to_string(run.folder.join("logs/vnfs/extra.log")).unwrap_or_default();
    wait_until(|| log().contains("\ndone\n"));
    assert!(log().contains("MINE=1") && !log().contains("secret-of-the-machine"), "{}", log());
    // The testbed file may be another domain's: it starts in its own folder, and sees no other.
    assert!(log().contains("\n/") && log().contains("/vnfs/extra\n"), "{}", log());
    assert!(!log().contains("kind: robot") && !log().contains("lifecycle.yaml\n"), "{}", log());
    wait_until(|| run.get("/api/v1/vnfs")[0]["last"]["state"] == "started");
    assert_eq!(with_word(&run, "4321"), 1);
    let (status, answer) = run.post("/api/v1/vnfs", &body(print));
    assert_eq!((status, answer["refused"].as_str()), (409, Some("there is a VNF `extra` already")));
    let mut trusted: Value = serde_json::from_str(&body(json!({ "command": ["sh"] }))).unwrap();
    trusted["vnf"]["rights"] = "trusted".into();
    let (status, answer) = run.post("/api/v1/vnfs", &trusted.to_string());
    assert!(status == 409 && answer["refused"].as_str().unwrap().contains("`trusted`"), "{answer}");

    assert_eq!(run.delete("/api/v1/vnfs/extra"), 200);
    wait_until(|| with_word(&run, "4321") == 0);
    assert_eq!(run.get("/api/v1/vnfs"), json!([]));
    let placements = run.get("/api/v1/network/placements");
    assert!(placements.as_array().unwrap().iter().all(|placement| placement["vnf"] != "extra"));
}

#[test]
fn a_script_of_fog05_deploys_an_fdu_after_changing_one_import() {
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "fog", "{ kind: robot }", NAVIGATED);
    let run = Run::start_beside(&file, &["--until", "5min"]);
    run.wait_for_service();
    let fdu = json!({
        "id": "helloworld_fdu", "name": "helloworld",
        "computation_requirements": { "cpu_arch": "x86_64", "cpu_min_freq": 0, "cpu_min_count": 1,
            "ram_size_mb": 64.0, "storage_size_gb": 1.0 },
        "command": { "binary": "sh", "args": ["-c", "echo \"$GREETING $LEVEL\"; exec sleep 4322"] },
        "hypervisor": "BARE", "migration_kind": "COLD",
        "storage": [], "depends_on": [], "interfaces": [], "io_ports": [], "connection_points": [],
    });
    let descriptor = folder.path().join("fdu.json");
    fs::write(&descriptor, fdu.to_string()).unwrap();
    let mut script = Script::start(&run, "fog05_deploy.py", [&*descriptor, Path::new("cloud")]);
    assert_eq!((&*script.after("memory"), &*script.after("onboarded")), ("8000.0", "helloworld"));
    let vnf = script.after("status RUN");
    let log = run.folder.join(format!("logs/vnfs/{vnf}.log"));
    wait_until(|| fs::read_to_string(&log).is_ok_and(|log| log.contains("Hello World! 3")));
    assert_eq!(with_word(&run, "4322"), 1);
    script.press_enter();
    assert_eq!(script.after("log"), json!(fs::read_to_string(&log).unwrap()).to_string());
    assert_eq!(script.after("status"), "CONFIGURE");
    let refused = script.after("refused");
    assert!(refused.contains("`hypervisor` is `KVM`: only BARE and DOCKER"), "{refused}");
    let missing = script.after("missing");
    assert_eq!(missing, "fdu.pause of fog05 is not here: a VNF cannot be paused: stop it");
    assert_eq!(script.after("left"), "['navigation', 'robot-driver']", "the testbed file's VNFs stay");
    script.end();
    wait_until(|| with_word(&run, "4322") == 0);
}

/// Three servers, one of them too small for navigation, and a robot that moves between them by its VNF alone.
const SERVERS: &str = "
name: placed
wireless: { w: {} }
nodes:
  R1: { kind: radio_unit, position: [0, 0], channel: 1 }
  lan: { kind: switch }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
  fog: { kind: server, tier: fog, cpus: 4, memory: 8 GB }
  edge: { kind: server, tier: edge, cpus: 1, memory: 8 GB }
  tb: { kind: robot }
links:
  - { ends: [R1, lan] }
  - { ends: [lan, cloud], delay: 9 ms }
  - { ends: [lan, fog], delay: 1 ms }
  - { ends: [lan, edge], delay: 4 ms }
services:
  navigation:
    robot: tb
    kpis: { service_time: 50 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: tb }
      navigation: { program: navigation, node: cloud, cpus: 4, memory: 1 GB }
walks:
  tb: { waypoints: [[2, 3], [500, 3]], speed_limit: 0.5 m/s }
";

#[test]
fn one_placement_is_behind_the_interfaces_of_fog05_mec_and_plugins() {
    let folder = TempDir::new().unwrap();
    let script = project_file("crates/cotorra/tests/end_to_end/one_placement.py");
    let simulated = |interface: &str| {
        let file = folder.path().join(format!("{interface}.yaml"));
        let command = format!("[python3, {}, {interface}]", script.display());
        fs::write(&file, format!("{SERVERS}plugins:\n  - {{ id: mover, command: {command} }}\n")).unwrap();
        let out = folder.path().join(interface);
        let mut command = cotorra(["run", "--simulate", "--headless", "--until", "8s", "--out"]);
        command.arg(&out).arg(&file).env("PYTHONPATH", project_file("clients/python"));
        let done = command.env("PYTHONDONTWRITEBYTECODE", "1").output().unwrap();
        assert!(done.status.success(), "{interface}: {}", stderr(&done));
        let run = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
        let log = fs::read_to_string(run.join("logs/plugins/mover.log")).unwrap();
        assert!(log.contains("step 3"), "{interface}: {log}");
        let mut events = events(&run, "decision,placement,vnf,virtual_link,service_time");
        // The interface is the reason of a decision, and changes nothing else.
        events.iter_mut().filter_map(Value::as_object_mut).for_each(|event| _ = event.remove("reason"));
        events
    };
    for (interface, by_hand, rejected) in [("fog05", "moved", 3), ("mec", "copied", 2)] {
        let [events, expected] = [interface, by_hand].map(simulated);
        let refused = events.iter().filter(|event| event["refused"].is_string()).count();
        let servers = |server: &str| events.iter().any(|event| event["server"] == server);
        assert!(refused == rejected && servers("cloud") && servers("fog"), "{interface}: {refused}");
        assert!(events == expected, "{interface} and {by_hand} differ");
    }
}

#[test]
fn a_script_of_fog05_moves_the_navigation_of_a_robot() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("placed.yaml");
    fs::write(&file, SERVERS).unwrap();
    let run = Run::start_beside(&file, &["--until", "5min"]);
    run.wait_for_service();
    let mut events = run.follow();
    let mut answers_from =
        |server: &str| events.any(|event| event["server"] == server && event["service_time_ms"].is_number());
    assert!(answers_from("cloud"));
    let mut script = Script::start(&run, "fog05_move.py", [Path::new("navigation"), Path::new("fog")]);
    assert_eq!(script.after("status"), "RUN ['fog']");
    script.end();
    assert!(answers_from("fog"));
}

#[test]
fn a_domains_vnf_sees_no_file_of_the_testbed() {
    const TOKEN: &str = "token-of-the-other-domain";
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("domains.yaml");
    let nodes = "
name: domains
domains: [ours, theirs]
nodes:
  mine: { kind: server, domain: ours, tier: edge, cpus: 4, memory: 8 GB }
  edge: { kind: server, domain: theirs, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [mine, edge], delay: 1 ms }
";
    fs::write(&file, nodes).unwrap();
    fs::write(folder.path().join("plan-of-ours.txt"), "secret of ours").unwrap();
    let run = Run::start_beside_with(&file, &["--until", "5min"], |command| {
        command.env("COTORRA_TOKEN", "token-of-the-operator");
        command.env("COTORRA_DOMAIN_TOKENS", format!("theirs={TOKEN}"));
    });
    let place = folder.path().display();
    let script = format!(
        "pwd; for file in {place} {place}/* ./* ../*; do echo found $file; cat $file; done; echo done; exec sleep 4324"
    );
    let fdu = json!({
        "id": "curious_fdu", "name": "curious",
        "computation_requirements": { "cpu_arch": "x86_64", "cpu_min_freq": 0, "cpu_min_count": 1,
            "ram_size_mb": 64.0, "storage_size_gb": 1.0 },
        "command": { "binary": "sh", "args": ["-c", script] },
        "hypervisor": "BARE", "migration_kind": "COLD",
        "storage": [], "depends_on": [], "interfaces": [], "io_ports": [], "connection_points": [],
    });
    let outside = TempDir::new().unwrap();
    let descriptor = outside.path().join("fdu.json");
    fs::write(&descriptor, fdu.to_string()).unwrap();
    let arguments = [&*descriptor, Path::new("edge")];
    let mut script = Script::start_with(&run, "fog05_deploy.py", arguments, |python| {
        python.env("COTORRA_TOKEN", TOKEN);
    });
    script.after("memory");
    script.after("onboarded");
    let vnf = script.after("status RUN");
    let log = || fs::read_to_string(run.folder.join(format!("logs/vnfs/{vnf}.log"))).unwrap_or_default();
    wait_until(|| log().contains("\ndone\n"));
    assert!(log().contains(&format!("/vnfs/{vnf}\n")), "{}", log());
    assert!(!log().contains("plan-of-ours.txt") && !log().contains("domains.yaml"), "{}", log());
    assert!(!log().contains("secret of ours") && !log().contains("kind: server"), "{}", log());
}

/// Says to each client which address it has.
const SERVER: &str = "
import socket
with socket.create_server(('', 7000)) as server:
    while True:
        client, (address, _) = server.accept()
        with client:
            client.sendall(f'you are {address}'.encode())
";
/// Asks the server of another node, once it is there.
const CLIENT: &str = "
import socket, time
while True:
    try:
        with socket.create_connection(('edge', 7000), 5) as server:
            print(server.makefile().read(), flush=True)
            time.sleep(4323)
    except OSError:
        time.sleep(0.1)
";

#[test]
fn a_script_of_fog05_connects_two_fdus_by_a_network_after_changing_one_import() {
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "connected", "{ kind: robot }", NAVIGATED);
    let edge = "\n  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }\n  tb:";
    let link = "links:\n  - { ends: [R1, edge], delay: 1 ms }";
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replacen("\n  tb:", edge, 1).replacen("links:", link, 1)).unwrap();
    let run = Run::start_beside(&file, &["--until", "5min"]);
    run.wait_for_service();
    let network = "6cc2aa30-1dcf-4c93-a57e-433fd0bd498e";
    let fdu = |name: &str, program: &str| {
        json!({
            "id": name, "name": name,
            "computation_requirements": { "cpu_arch": "x86_64", "cpu_min_freq": 0, "cpu_min_count": 1,
                "ram_size_mb": 128.0, "storage_size_gb": 1.0 },
            "command": { "binary": "python3", "args": ["-c", program] },
            "hypervisor": "BARE", "migration_kind": "COLD",
            "interfaces": [{ "name": "eth0", "is_mgmt": false, "if_type": "INTERNAL", "cp_id": "cp1",
                "virtual_interface": { "intf_type": "VIRTIO", "vpci": "0:0:0", "bandwidth": 10 } }],
            "connection_points": [{ "id": "cp1", "name": "internal", "vld_ref": network }],
            "storage": [], "depends_on": [], "io_ports": [],
        })
    };
    let net = json!({ "uuid": network, "name": "net1", "net_type": "ELAN", "is_mgmt": false });
    let dhcp = json!({ "ip_version": "IPV4", "subnet": "192.168.234.0/24", "dhcp_enable": true });
    for (name, content) in [
        ("network.json", net),
        ("dhcp.json", dhcp),
        ("server.json", fdu("server", SERVER)),
        ("client.json", fdu("client", CLIENT)),
    ] {
        fs::write(folder.path().join(name), content.to_string()).unwrap();
    }
    let arguments = [folder.path(), Path::new("edge"), Path::new("cloud")];
    let mut script = Script::start(&run, "fog05_network.py", arguments);
    let refused = script.after("refused");
    assert!(refused.contains("`ip_configuration.subnet` is `192.168.234.0/24`"), "{refused}");
    assert_eq!(script.after("network"), "net1 10.77.0.0/16");
    let running = script.after("running");
    let (server, client) = running.split_once(' ').unwrap();
    let log =
        |vnf: &str| fs::read_to_string(run.folder.join(format!("logs/vnfs/{vnf}.log"))).unwrap_or_default();
    wait_until(|| log(client).contains("you are"));
    // It has the interface of its node, and reaches the other FDU over the emulated network.
    let cloud = run.get("/api/v1/network/nodes/cloud");
    let said = format!("\nyou are {}\n", cloud["address"]["ipv4"].as_str().unwrap());
    script.press_enter();
    let printed = script.after("log");
    assert_eq!(printed, json!(log(client)).to_string());
    assert!(log(client).ends_with(&said), "{printed}");
    assert!(!log(server).contains("you are"));
    let refused = script.after("refused");
    assert!(refused.starts_with(&format!("the network `{network}` has the instance ")), "{refused}");
    assert_eq!(script.after("left"), "[] ['navigation', 'robot-driver']");
    assert_eq!(
        script.after("missing"),
        "network.add_router of fog05 is not here: docs/use/lifecycle.md has what is"
    );
    script.end();
    wait_until(|| run.get("/api/v1/vnfs") == json!([]));
}
