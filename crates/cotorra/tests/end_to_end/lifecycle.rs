//! VNFs that come and go during a live run: by instruction, and by a script of fog05.

use std::{
    fs,
    io::{BufRead as _, BufReader, Write as _},
    process::{Command, Stdio},
};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    harness::{Run, project_file, wait_until},
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

#[test]
fn an_added_vnf_runs_until_it_is_removed_and_is_confined() {
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "lifecycle", "{ kind: robot }", NAVIGATED);
    let run = Run::start_with(&file, &["--until", "5min"], |command| {
        command.env("AWS_SECRET_ACCESS_KEY", "secret-of-the-machine");
    });
    run.wait_for_service();
    let body = |program: Value| {
        json!({ "vnf": { "id": "extra", "node": "cloud", "cpus": 0.5, "memory_bytes": 100_000_000,
            "program": program, "env": ["MINE=1"] } })
        .to_string()
    };
    let print = json!({ "command": ["sh", "-c", "env; echo done; exec sleep 4321"] });
    let (status, answer) = run.post("/api/v1/vnfs", &body(print.clone()));
    assert_eq!(status, 200, "{answer}");
    let log = || fs::read_to_string(run.folder.join("logs/extra.log")).unwrap_or_default();
    wait_until(|| log().contains("\ndone\n"));
    assert!(log().contains("MINE=1") && !log().contains("secret-of-the-machine"), "{}", log());
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
    let run = Run::start(&file, &["--until", "5min"]);
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
    let mut python = Command::new("python3");
    python.arg(project_file("crates/cotorra/tests/end_to_end/fog05_deploy.py")).arg(&descriptor).arg("cloud");
    python.env("PYTHONPATH", project_file("clients/python")).env("COTORRA_API", &run.api);
    let mut python = python.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(python.stdout.take().unwrap()).lines().map_while(Result::ok);
    let mut line = || lines.next().unwrap_or_default();
    assert_eq!((line().as_str(), line().as_str()), ("memory 8000.0", "onboarded helloworld"));
    let status = line();
    let vnf = status.strip_prefix("status RUN ").unwrap_or_else(|| panic!("{status}"));
    let log = run.folder.join(format!("logs/{vnf}.log"));
    wait_until(|| fs::read_to_string(&log).is_ok_and(|log| log.contains("Hello World! 3")));
    assert_eq!(with_word(&run, "4322"), 1);
    python.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
    assert_eq!(line(), "status CONFIGURE");
    let refused = line();
    assert!(refused.contains("`hypervisor` is `KVM`: only BARE and DOCKER"), "{refused}");
    assert_eq!((line().as_str(), line().as_str()), ("no logs", "left []"));
    assert!(python.wait().unwrap().success());
    wait_until(|| with_word(&run, "4322") == 0);
}
