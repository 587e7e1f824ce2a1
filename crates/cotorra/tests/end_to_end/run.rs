//! Complete runs, and their files.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{ErrorKind, Read as _},
    net::TcpListener,
    process::{Command, Stdio},
};

use serde_json::Value;

use crate::harness::{Run, corridor, cotorra, project_file, stderr, stdout, wait_until};

/// Round trip between the robot at R1 and the cloud: twice 1 ms over the air and 4.5 ms over the wire (corridor.yaml).
const THEORY_MS: f64 = 11.0;

#[test]
fn the_corridor_is_walked_and_measured() {
    let mut run = Run::start(&corridor(), &["--until", "10s", "--seed", "7"]);
    let (summary, printed) = run.report();
    assert_eq!(summary["seed"], 7);
    assert_eq!(summary["service_time_target_ms"], 15.0);
    assert_eq!(summary["pose_source"], "localization");
    let localization = &summary["localization"][0];
    assert_eq!(localization["robot"], "robot");
    assert!(localization["samples"].as_u64().unwrap() > 50, "{localization:#}");
    assert!(localization["error_m"]["p95"].as_f64().unwrap() < 0.3, "{localization:#}");
    assert!(summary["samples"].as_u64().unwrap() > 50, "{summary:#}");
    assert!(summary["above_target"].as_f64().is_some());
    for figure in ["p50", "p95", "p99", "max"] {
        assert!(summary["service_time_ms"][figure].as_f64().unwrap() >= THEORY_MS, "{figure} of {summary:#}");
    }
    let regions = summary["regions"].as_array().unwrap();
    assert_eq!(regions[0]["attachment"], "R1");
    assert_eq!(regions[0]["server"], "cloud");
    assert_eq!(
        regions.iter().filter_map(|region| region["samples"].as_u64()).sum::<u64>(),
        summary["samples"]
    );
    // The model's part is exact. The rest is the machine's, which is not tested here.
    let median = regions[0]["service_time_p50_ms"].as_f64().unwrap();
    assert!((THEORY_MS..THEORY_MS + 50.0).contains(&median), "{median} ms");
    let placed = summary["placements"].as_array().unwrap();
    assert!(placed.iter().any(|p| p["vnf"] == "navigation" && p["node"] == "cloud"), "{placed:?}");
    assert!(summary["fidelity"]["valid"].is_boolean());
    assert!(summary["fidelity"]["frames"].as_u64().unwrap() > 100);
    for figure in ["p50", "p99", "max"] {
        assert!(summary["fidelity"]["lateness_us"][figure].as_f64().unwrap() >= 0.0);
    }
    assert!(printed.contains("fidelity") && printed.contains("summary.json"), "{printed}");

    let csv = fs::read_to_string(run.folder.join("service_time.csv")).unwrap();
    let rows =
        |service: &str| csv.lines().filter(|row| row.split(',').nth(2) == Some(service)).count() as u64;
    assert_eq!(rows("navigation"), summary["samples"].as_u64().unwrap());
    let of_localization = &summary["services"][1];
    assert_eq!(
        (&of_localization["service"], &of_localization["in_total"]),
        (&"localization".into(), &false.into())
    );
    assert!(rows("localization") > 4);
    assert_eq!(of_localization["samples"], rows("localization"));
    assert!(printed.contains("localization of robot kept 200 ms in "), "{printed}");
    assert!(csv.starts_with("emitted_ns,"), "{csv:.100}");
    assert!(fs::read_to_string(run.folder.join("service_time.svg")).unwrap().contains("<svg"));
    let as_run = fs::read_to_string(run.folder.join("testbed.yaml")).unwrap();
    assert_eq!(as_run, fs::read_to_string(corridor()).unwrap() + "# set: seed=7\n");
    for log in ["cotorra.log", "vnfs/navigation.log", "vnfs/localization.log"] {
        assert!(run.folder.join("logs").join(log).exists(), "{log}");
    }
}

/// Time for which runs are stopped, and what of it must be seen: one sleep of the fabric's thread may be left out.
const STOPPED_S: f64 = 3.0;
const SEEN_S: f64 = STOPPED_S - 0.1;

/// Stops a run's process for a while, as a laptop's lid does.
fn stop_for_a_while(run: &Run) {
    let uptime = || -> f64 {
        let uptime = fs::read_to_string("/proc/uptime").unwrap();
        uptime.split(' ').next().unwrap().parse().unwrap()
    };
    run.signal("STOP");
    let status = format!("/proc/{}/stat", run.pid());
    wait_until(|| fs::read_to_string(&status).unwrap().rsplit(')').next().unwrap().starts_with(" T"));
    let begin = uptime();
    wait_until(|| uptime() >= begin + STOPPED_S);
    run.signal("CONT");
}

/// Waits for the end of a run that is not valid. Returns the summary and standard output.
fn report_of_an_invalid(run: &mut Run) -> (Value, String) {
    let (ended, printed, errors) = run.wait();
    assert_eq!(ended.code(), Some(3), "{printed}{errors}");
    let summary = fs::read_to_string(run.folder.join("summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    let fidelity = &summary["fidelity"];
    assert!(fidelity["valid"] == false && printed.contains("NOT VALID"), "{fidelity:#}{printed}");
    assert!(fidelity["away"]["absence_max_ms"].as_f64().unwrap() >= SEEN_S * 1e3, "{fidelity:#}");
    (summary, printed)
}

#[test]
fn packets_that_a_stopped_run_did_not_send_are_samples_without_an_answer() {
    let mut run = Run::start(&corridor(), &["--until", "9s", "--seed", "7"]);
    run.wait_for_service();
    stop_for_a_while(&run);
    let (summary, printed) = report_of_an_invalid(&mut run);
    // The robot had a packet due every 200 ms, and the last of them was sent late.
    assert!(summary["unanswered"].as_u64().unwrap() >= 14, "{summary:#}");
    assert!(!printed.contains("navigation of robot kept 15 ms in all"), "{printed}");
}

#[test]
fn frames_that_wait_in_the_port_of_a_stopped_run_are_late() {
    let mut run = Run::start(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"]);
    let packets = || {
        let links = run.get("/api/v1/network/links");
        let is_it = |context: &&Value| context["link"] == "left-lan" && context["direction"] == "forward";
        links.as_array().unwrap().iter().find(is_it).unwrap()["counters"]["packets"].as_u64().unwrap()
    };
    // Nothing of cotorra's sends them, so that they come while it is stopped.
    let send = "while :; do echo > /dev/udp/right/9; sleep 0.02; done";
    let mut exec = cotorra(["exec", "left", "--api", run.address(), "--", "bash", "-c", send]);
    let mut sender = exec.stderr(Stdio::null()).spawn().unwrap();
    wait_until(|| packets() > 20);
    stop_for_a_while(&run);
    let before = packets();
    wait_until(|| packets() > before + 20);
    sender.kill().unwrap();
    sender.wait().unwrap();
    run.signal("INT");
    let (summary, _) = report_of_an_invalid(&mut run);
    let late_us = summary["fidelity"]["lateness_us"]["max"].as_f64().unwrap();
    assert!(late_us >= SEEN_S * 1e6, "{summary:#}");
}

#[test]
fn localization_moves_to_another_server_while_the_robot_walks() {
    let mut run = Run::start(&corridor(), &["--until", "10s", "--seed", "7"]);
    run.wait_for_service();
    let place = r#"{ "instruction": { "instruction": "place", "vnf": "localization", "node": "fog" } }"#;
    let (status, body) = run.post("/api/v1/instructions", place);
    assert_eq!(status, 200, "{body}");
    let (summary, printed) = run.report();
    let placed = summary["placements"].as_array().unwrap();
    let served: Vec<_> = placed.iter().filter(|p| p["vnf"] == "localization").map(|p| &p["node"]).collect();
    assert_eq!(served, ["edge", "fog"]);
    assert!(summary["localization"][0]["error_m"]["max"].as_f64().unwrap() < 0.5, "{summary:#}");
    let csv = fs::read_to_string(run.folder.join("service_time.csv")).unwrap();
    let scans: Vec<Vec<_>> = csv.lines().map(|row| row.split(',').collect()).collect();
    let scans: Vec<_> = scans.iter().filter(|row| row[2] == "localization").collect();
    // Each scan has one sample, in order of emission.
    let numbers: Vec<_> = scans.iter().map(|row| row[3].parse::<usize>().unwrap()).collect();
    assert!(numbers.len() > 5 && numbers.iter().copied().eq(0..numbers.len()), "{numbers:?}");
    let mut servers: Vec<_> = scans.iter().map(|row| row[6]).collect();
    servers.dedup();
    assert_eq!(servers, ["edge", "fog"]);
    assert!(printed.contains("off by a median of"), "{printed}");
    let log = fs::read_to_string(run.folder.join("logs/vnfs/localization.log")).unwrap();
    assert_eq!(log.matches("localizing `robot`").count(), 2, "{log}");
}

/// Each VNF has its own port.
#[test]
fn one_server_carries_the_vnfs_of_many_robots() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("many.yaml");
    let (robots, mut services, mut walks) = (["first", "second", "third"], String::new(), String::new());
    for (place, robot) in robots.iter().enumerate() {
        services += &format!(
            "  {robot}:
    robot: {robot}
    kpis: {{ service_time: 50 ms }}
    vnfs:
      {robot}-driver: {{ program: robot_driver, pinned_to: {robot} }}
      {robot}-navigation: {{ program: navigation, node: edge }}
    virtual_links: [{{ from: {robot}-driver, to: {robot}-navigation, rate: 0.1 Mbit/s }}]
  {robot}-place:
    robot: {robot}
    kpis: {{ service_time: 200 ms }}
    vnfs:
      {robot}-lidar: {{ program: robot_driver, pinned_to: {robot}, cpus: 0 }}
      {robot}-localization: {{ program: localization, node: edge }}
    virtual_links: [{{ from: {robot}-lidar, to: {robot}-localization, rate: 0.1 Mbit/s }}]
"
        );
        let x = 25.3 + 0.8 * place as f64;
        walks += &format!("  {robot}: {{ waypoints: [[{x}, -27], [{x}, -20]] }}\n");
    }
    let nodes: String = robots.map(|robot| format!("  {robot}: {{ kind: robot }}\n")).concat();
    let map = project_file("testbeds/maps/corridor.yaml");
    let text = format!(
        "name: many\nmap: {}\nwireless: {{ lab: {{ standard: n }} }}\nnodes:\n{nodes}
  unit: {{ kind: radio_unit, position: [26, -24], channel: 1 }}
  edge: {{ kind: server, tier: edge, cpus: 8, memory: 8 GB }}
links: [{{ ends: [unit, edge], delay: 1 ms }}]
services:\n{services}\nwalks:\n{walks}",
        map.display()
    );
    fs::write(&file, text).unwrap();
    let mut run = Run::start(&file, &["--until", "5min"]);
    for robot in robots {
        // Each robot has its own navigation and its own localization.
        let navigated = || {
            let times = run.get("/api/v1/measurements/service-times?limit=1000");
            times["items"].as_array().unwrap().iter().any(|sample| sample["service"] == robot)
        };
        wait_until(navigated);
        let itself = format!("/api/v1/robots/{robot}");
        wait_until(|| run.get(&itself)["sensors"]["pose"]["source"] == "localization");
    }
    run.signal("INT");
    let (summary, _) = run.report();
    assert_eq!(summary["localization"].as_array().unwrap().len(), robots.len(), "{summary:#}");
    let log = fs::read_to_string(run.folder.join("logs/cotorra.log")).unwrap();
    assert!(!log.contains("WARN") && !log.contains("ERROR"), "{log}");
}

#[test]
fn nodes_answer_a_ping_by_name_over_the_emulated_links() {
    let run = Run::start_beside(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    let exec = |node: &str, words: &[&str]| {
        cotorra(["exec", "--api", run.address(), node, "--"]).args(words).output().unwrap()
    };
    let ping = exec("robot", &["ping", "-c", "3", "-i", "0.2", "cloud"]);
    let text = String::from_utf8_lossy(&ping.stdout);
    assert!(ping.status.success(), "{text}{}", String::from_utf8_lossy(&ping.stderr));
    let least = text.split("min/avg/max").nth(1).and_then(|t| t.split(['=', '/']).nth(1 + 1)).map(str::trim);
    let least: f64 = least.unwrap_or_else(|| panic!("{text}")).parse().unwrap();
    assert!(least >= THEORY_MS, "{text}");

    let status = exec("edge", &["sh", "-c", "test $COTORRA_NODE = edge && exit 42"]);
    assert_eq!(status.status.code(), Some(42));
    let switch = exec("lan", &["true"]);
    assert!(String::from_utf8_lossy(&switch.stderr).contains("`lan` is a switch"));
    let nobody = exec("nobody", &["true"]);
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("no node `nobody`"));
}

#[test]
fn programs_in_nodes_are_in_them_as_a_whole_and_end_with_the_run() {
    let run = Run::start_beside(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"]);
    let exec = |script: &str| {
        let mut command = cotorra(["exec", "--api", run.address(), "left", "--", "sh", "-c", script]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let script = "uname -n; cat /sys/class/net/eth0/address 2> /dev/null || ls /sys/class/net";
    let done = exec(script).wait_with_output().unwrap();
    let mac = cotorra_graph::HostAddress::of(0).mac.map(|byte| format!("{byte:02x}")).join(":");
    let told = stdout(&done);
    assert!([format!("left\n{mac}\n"), "left\n".to_owned()].contains(&told), "{told}");

    // The pipe hangs up once the last process is gone.
    let mut lasting = exec("trap '' TERM HUP; (setsid sleep 1000 &) ; echo up; sleep 1000");
    let mut output = lasting.stdout.take().unwrap();
    output.read_exact(&mut [0; 3]).unwrap();
    assert_eq!(lasting.try_wait().unwrap(), None);
    run.signal("KILL");
    assert_eq!(output.read(&mut [0]).unwrap(), 0);
    let ended = lasting.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(128 + 9), "{}", stderr(&ended));
}

/// Sends a navigation packet that drives backwards, for each of the first sequence numbers, to all UDP ports of the robot.
/// Arguments: `ROBOT PORT…`.
const FORGER: &str = r#"
import socket, struct, sys
robot, ports = sys.argv[1], [int(port) for port in sys.argv[2:]]
forger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for sequence in range(2000):
    header = struct.pack("<4sBBBBIIQQ", b"ctra", 3, 2, 0, 0, sequence, 1, 0, sequence)
    twist = struct.pack("<4s6d", b"\0\1\0\0", -0.3, 0, 0, 0, 0, 0)
    for port in ports:
        forger.sendto(header + twist, (robot, port))
"#;

#[test]
fn a_robot_counts_forged_answers_and_follows_none() {
    let run = Run::start_beside(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    let exec = |node: &str, words: &[&str]| {
        let done = cotorra(["exec", "--api", run.address(), node, "--"]).args(words).output().unwrap();
        assert!(done.status.success(), "{done:?}");
        String::from_utf8(done.stdout).unwrap()
    };
    let sockets = exec("robot", &["cat", "/proc/net/udp"]);
    let port = |line: &str| u16::from_str_radix(line.split_whitespace().nth(1)?.rsplit(':').next()?, 16).ok();
    let ports: Vec<String> = sockets.lines().skip(1).filter_map(port).map(|port| port.to_string()).collect();
    let node = run.get("/api/v1/network/nodes/robot");
    let mut words = vec!["python3", "-c", FORGER, node["address"]["ipv4"].as_str().unwrap()];
    words.extend(ports.iter().map(String::as_str));
    let rejected = || {
        let told = run.get("/api/v1/measurements/events?kinds=answers_rejected&limit=10000");
        let last = told["items"].as_array().unwrap().last().cloned().unwrap_or_default();
        last["forged"].as_u64().unwrap_or(0) + last["unknown"].as_u64().unwrap_or(0)
    };
    exec("edge", &words);
    wait_until(|| rejected() > 1000);
    let series = run.get("/api/v1/measurements/series?figure=linear:robot&points=1000");
    for point in series["points"].as_array().unwrap() {
        assert!(point["min"].as_f64().unwrap() >= 0.0, "it drove backwards: {point}");
    }
}

#[test]
fn a_second_run_gets_its_own_folder_and_port() {
    let run = Run::start_beside(&corridor(), &["--until", "5min"]);
    let out = tempfile::tempdir().unwrap();
    let second = |api: &[&str]| {
        let mut command: Command = cotorra(["run", "--headless", "--until", "1s", "--out"]);
        command.arg(out.path()).arg(corridor()).args(api).output().unwrap()
    };
    let taken = second(&["--api", run.address()]);
    assert_eq!(taken.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&taken.stderr).contains(run.address()), "{taken:?}");
    let free = second(&[]);
    assert!(matches!(free.status.code(), Some(0 | 3)), "{free:?}");
}

#[test]
fn tools_talk_to_the_run_and_not_to_a_program_on_its_port() {
    const TOKEN: &str = "a-secret-of-some-length";
    let squatter = TcpListener::bind("127.0.0.1:0").unwrap();
    squatter.set_nonblocking(true).unwrap();
    let taken = squatter.local_addr().unwrap().to_string();
    let runtime = tempfile::tempdir().unwrap();
    let as_user = |command: &mut Command| {
        command
            .env("COTORRA_TOKEN", TOKEN)
            .envs(["XDG_RUNTIME_DIR", "TMPDIR"].map(|name| (name, runtime.path())));
    };
    let told = |words: &[&str]| {
        let mut command = cotorra(words);
        as_user(&mut command);
        command.output().unwrap()
    };
    let run = Run::start_beside_with(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"], as_user);
    for words in [&["exec", "left", "--api", &taken, "--", "true"][..], &["link", "show", "--api", &taken]] {
        let refused = told(words);
        assert_eq!(refused.status.code(), Some(1), "{words:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(run.address()), "{}", stderr(&refused));
    }
    for words in [
        &["exec", "left", "--", "true"][..],
        &["exec", "left", "--api", run.address(), "--", "true"],
        &["link", "show"],
    ] {
        let done = told(words);
        assert!(done.status.success(), "{words:?}: {}", stderr(&done));
    }
    let mut python = Command::new("python3");
    python.args(["-c", "from cotorra import Client; print(Client().testbed()['name'])"]);
    python.env("PYTHONPATH", project_file("clients/python")).env("PYTHONDONTWRITEBYTECODE", "1");
    as_user(&mut python);
    let asked = python.env_remove("COTORRA_API").output().unwrap();
    assert_eq!(stdout(&asked), "two-hosts\n", "{}", stderr(&asked));

    run.signal("KILL");
    wait_until(|| stderr(&told(&["exec", "left", "--", "true"])).contains("no testbed of this user runs"));
    let cleaned = told(&["clean"]);
    assert!(stdout(&cleaned).contains("the entry of a killed run removed"), "{cleaned:?}");
    assert_eq!(fs::read_dir(runtime.path().join("cotorra")).unwrap().count(), 0);
    let nobody = squatter.accept().map_err(|error| error.kind());
    assert!(matches!(nobody, Err(ErrorKind::WouldBlock)), "{nobody:?}");
}

#[test]
fn commands_change_and_stop_only_the_run_that_is_meant() {
    let file = project_file("testbeds/two-hosts.yaml");
    let runtime = tempfile::tempdir().unwrap();
    let as_user = |command: &mut Command| {
        command.envs(["XDG_RUNTIME_DIR", "TMPDIR"].map(|name| (name, runtime.path())));
    };
    let one = Run::start_beside_with(&file, &["--until", "600s"], as_user);
    let mut two = one.another_with(&file, &["--until", "600s"], as_user);
    let told = |words: &[&str], api: &str| {
        let mut command = cotorra(words);
        as_user(&mut command);
        command.env("COTORRA_API", api).stdin(Stdio::null()).output().unwrap()
    };
    let delays = || {
        [&one, &two].map(|run| {
            let links = run.get("/api/v1/network/links");
            let is_it = |link: &&Value| link["link"] == "left-lan";
            links.as_array().unwrap().iter().find(is_it).unwrap()["effective"]["delay_ms"].as_f64().unwrap()
        })
    };
    let folder = two.folder.to_str().unwrap().to_owned();
    for vague in
        [&["link", "set", "left-lan", "--delay", "9ms"][..], &["stop"], &["stop", "--run", "two-hosts"]]
    {
        let refused = told(vague, "");
        assert_eq!(refused.status.code(), Some(1), "{vague:?}");
        for run in [&one, &two] {
            assert!(stderr(&refused).contains(run.address()), "{vague:?}: {}", stderr(&refused));
        }
    }
    assert_eq!(delays(), [1.0, 1.0]);

    let set = |delay: &str, run: &[&str], api: &str| {
        let done = told(&[&["link", "set", "left-lan", "--delay", delay][..], run].concat(), api);
        assert!(done.status.success(), "{}", stderr(&done));
        stderr(&done)
    };
    let printed = set("2ms", &["--run", &folder], "");
    assert_eq!(printed.trim(), format!("changed left-lan of two-hosts on {} ({folder})", two.address()));
    assert_eq!(delays(), [1.0, 2.0]);
    set("3ms", &[], &two.api);
    assert_eq!(delays(), [1.0, 3.0]);
    set("4ms", &["--run", one.address()], &two.api);
    assert_eq!(delays(), [4.0, 3.0]);

    let listed = |words: &[&str]| stdout(&told(words, ""));
    let both = listed(&["ps"]);
    assert!(both.contains(&folder) && both.contains(one.folder.to_str().unwrap()), "{both}");
    let stopped = told(&["stop", "--run", &folder], "");
    assert!(stopped.status.success(), "{}", stderr(&stopped));
    assert!(stdout(&stopped).contains(two.address()), "{}", stdout(&stopped));
    // It has ended already, and left its report.
    assert!(two.folder.join("summary.json").exists());
    two.report();
    let left: Value = serde_json::from_str(&listed(&["ps", "--json"])).unwrap();
    assert_eq!(left.as_array().unwrap().len(), 1);
    assert_eq!(left[0]["api"], one.api);
}

#[test]
fn a_quadrotor_takes_off_with_real_packets() {
    let mut run = Run::start_beside(&project_file("testbeds/hall.yaml"), &["--seed", "7"]);
    run.wait_for_service();
    let height = || run.get("/api/v1/robots/uav")["sensors"]["pose"]["z"].as_f64();
    wait_until(|| height().is_some_and(|height| height > 1.0));
    run.signal("INT");
    let (summary, _) = run.report();
    assert!(summary["samples"].as_u64().unwrap() > 5, "{summary:#}");
    let series =
        cotorra(["history", "series"]).arg(&run.folder).args(["uav", "--figure", "z"]).output().unwrap();
    assert!(
        series.status.success() && stdout(&series).contains(" m"),
        "{}{}",
        stdout(&series),
        stderr(&series)
    );
}
