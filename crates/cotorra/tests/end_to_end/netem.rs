//! `cotorra netem` in its own network namespace. Tests that need NetEm run in the kernel of `scripts/uml`.

use std::{
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::{Value, json};

use crate::harness::{Run, cotorra, project_file, stderr, stdout, wait_until};

/// Runs a script in its own network namespace and process group. `$COTORRA` is the program.
pub fn script(lines: &str) -> Output {
    let program = cotorra([""; 0]).get_program().to_owned();
    Command::new("unshare")
        .args(["--map-root-user", "--net", "sh", "-ec", lines])
        .env("COTORRA", program)
        .env("NO_COLOR", "1")
        .process_group(0)
        .output()
        .expect("unshare is part of util-linux")
}

/// Returns whether this kernel has NetEm, and this user may use it in a namespace.
pub fn has_netem() -> bool {
    let tried = script("$COTORRA netem set lo --delay 1ms");
    let has = tried.status.success();
    if !has {
        let errors = stderr(&tried);
        assert!(std::env::var_os("COTORRA_KERNEL").is_none(), "the rig's kernel has no NetEm: {errors}");
        eprintln!("skipped: {errors}");
        let reasons = ["this kernel has no sch_netem", "unshare", "/run"];
        assert!(reasons.iter().any(|reason| errors.contains(reason)), "{errors}");
    }
    has
}

#[test]
fn a_dry_run_prints_the_commands_of_tc() {
    let done = script(
        "$COTORRA netem set lo --to 10.0.0.0/8 --delay 10ms --jitter 1ms --rate 8Mbit/s --loss 1% --dry-run
                       $COTORRA netem show lo",
    );
    if stderr(&done).contains("unshare") {
        return;
    }
    assert!(done.status.success(), "{}", stderr(&done));
    let expected = "\
tc qdisc add dev lo root handle c070: htb
tc class add dev lo parent c070: classid c070:1 htb rate 1tbit
tc qdisc add dev lo parent c070:1 handle c071: netem limit 1010 delay 10ms 1ms distribution normal loss 1% rate 8000000bit
tc filter add dev lo parent c070: protocol ip pref 9601 u32 match ip dst 10.0.0.0/8 flowid c070:1
no conditions
";
    assert_eq!(stdout(&done), expected);
    let wide = script("$COTORRA netem set lo --delay 10ms --jitter 20ms --dry-run");
    assert!(stderr(&wide).contains("the mean delay is 13.956ms"), "{}", stderr(&wide));
}

#[test]
fn invalid_arguments_are_rejected_with_a_remedy() {
    for (arguments, part) in [
        (vec!["set", "lo"], "--delay <DURATION>"),
        (vec!["set", "lo", "--delay", "10"], "write it like 10ms"),
        (vec!["set", "lo", "--loss", "1"], "write it like 1%"),
        (
            vec!["set", "lo", "--loss", "90%", "--burst", "2"],
            "bursts at that share are 9.000 packets or longer",
        ),
        (vec!["set", "lo", "--delay", "1ms", "--to", "nowhere"], "neither an address nor a network"),
        (vec!["set", "lo", "--delay", "1ms", "--from", "10.0.0.1"], "--ingress"),
        (vec!["show", "no-such-interface"], "there is no interface `no-such-interface` here: there are lo"),
    ] {
        let refused = cotorra(["netem"].into_iter().chain(arguments.clone())).output().unwrap();
        assert!(!refused.status.success(), "{arguments:?}");
        // Joined words, because long lines are broken.
        let errors =
            stderr(&refused).replace(['│', '\n'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(errors.contains(part), "{arguments:?}: {errors}");
    }
}

#[test]
fn conditions_are_set_shown_and_cleared() {
    if !has_netem() {
        return;
    }
    let done = script(
        "ip link add va type veth peer name vb; ip link set va up
         tc qdisc add dev va root handle 9: pfifo limit 50
         ! $COTORRA netem set va --delay 10ms
         $COTORRA netem set va --delay 10ms --jitter 2ms --distribution pareto --replace >/dev/null
         $COTORRA netem set va --to 10.0.0.2 --loss 1% --burst 5 --rate 10Mbit/s --delay 100ms >/dev/null
         $COTORRA netem set va --ingress --from fd00::/8 --delay 7ms >/dev/null
         $COTORRA netem show va --json
         $COTORRA netem clear va
         $COTORRA netem show
         tc qdisc show dev va",
    );
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(stderr(&done).contains("--replace"), "{}", stderr(&done));
    let text = stdout(&done);
    let (json, rest) = text.split_once("\n]\n").unwrap();
    let rules: Value = serde_json::from_str(&format!("{json}]")).unwrap();
    assert_eq!(rules[0]["delay_ms"], 10.0);
    assert_eq!(rules[0]["jitter"]["distribution"], "pareto", "the kernel does not tell it: it is remembered");
    assert_eq!(rules[1]["network"], "10.0.0.2");
    assert_eq!(rules[1]["rate_bps"], 10_000_000);
    assert_eq!(rules[1]["limit"], 1083);
    assert!((rules[1]["loss"]["rate"].as_f64().unwrap() - 0.01).abs() < 1e-6);
    assert_eq!(rules[2]["side"], "ingress");
    assert_eq!(rules[2]["network"], "fd00::/8");
    assert!(rest.starts_with("va: cleared; pfifo is back\nno conditions\nqdisc pfifo 9: root"), "{rest}");
}

/// Two hosts that are 2 ms apart each way, without radio: NetEm emulates them if the kernel has it.
#[test]
fn a_testbed_runs_on_netem_or_else_on_the_fabric() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kernel.yaml");
    let text = std::fs::read_to_string(project_file("testbeds/two-hosts.yaml")).unwrap();
    std::fs::write(&file, text.replace("name: two-hosts", "name: kernel\nemulation: netem")).unwrap();
    let run = Run::start(&file, &["--until", "600s"]);
    let right = cotorra_graph::HostAddress::of(1).ipv4.to_string();
    let ping = || {
        let ping = ["ping", "-q", "-c", "3", "-i", "0.2", &right];
        let exec = ["exec", "--api", run.address(), "left", "--"];
        let done = cotorra(exec.into_iter().chain(ping)).output().unwrap();
        assert!(done.status.success(), "{}{}", stdout(&done), stderr(&done));
        let text = stdout(&done);
        let fastest = text.split("min/avg/max/mdev = ").nth(1).unwrap().split('/').next().unwrap();
        fastest.parse::<f64>().unwrap()
    };
    let change = |change: Value| {
        let instruction = json!({ "instruction": "condition", "link": "left-lan", "change": change });
        run.post("/api/v1/instructions", &json!({ "instruction": instruction }).to_string())
    };
    assert!(ping() >= 4.0);
    let (status, body) = change(json!({ "delay_ms": 5.0, "delay_scale": 4.0 }));
    assert_eq!(status, 200, "{body}");
    // Twice 20 ms and twice 1 ms.
    assert!(ping() >= 42.0);
    let trace = json!({ "rate": { "kind": "trace", "trace_ms": [1] } });
    let (status, body) = change(trace);
    if !has_netem() {
        assert_eq!(status, 200, "the fabric carries it: {body}");
        return;
    }
    assert_eq!(status, 409, "{body}");
    assert!(body["refused"].as_str().unwrap().contains("NetEm plays no packet-delivery traces"), "{body}");
    assert!(ping() >= 42.0, "what was refused changed nothing");
    // Counters are updated once a second.
    wait_until(|| {
        let links = run.get("/api/v1/network/links");
        links[0]["counters"]["packets"].as_u64().is_some_and(|packets| packets > 0)
    });
    let test = ["link", "test", "left-lan", "--rate-limit", "8Mbit/s", "--duration", "500ms"];
    let tested = cotorra(test.into_iter().chain(["--api", run.address()])).output().unwrap();
    assert!(tested.status.success(), "{}", stderr(&tested));
    assert!(stdout(&tested).starts_with("left-lan forward: "), "{}", stdout(&tested));
}

/// Writes a testbed of two hosts that NetEm emulates if it can, with `more` in its file.
fn on_the_kernel(folder: &Path, name: &str, more: &str) -> PathBuf {
    let file = folder.join(format!("{name}.yaml"));
    let text = std::fs::read_to_string(project_file("testbeds/two-hosts.yaml")).expect("it is the project's");
    let head = format!("name: {name}\nemulation: netem\nprobes: {{ interval: 20 ms, window: 2 s }}\n{more}");
    std::fs::write(&file, text.replace("name: two-hosts", &head)).expect("the folder is the test's own");
    file
}

/// A mapping with a rate of its own slows its packets: HTB does that if the kernel has NetEm, and the fabric otherwise.
#[test]
fn a_limited_mapping_slows_its_packets() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::start(&on_the_kernel(folder.path(), "limited", ""), &["--until", "600s"]);
    let map = |links: Value| {
        let reservation = json!({ "kept": "limited", "rate_bps": 20_000 });
        let map = json!({ "instruction": "map", "from": "left", "to": "right", "links": links, "reservation": reservation });
        run.post("/api/v1/instructions", &json!({ "instruction": map }).to_string())
    };
    let (status, body) = map(json!(["left-lan", "lan-right"]));
    assert_eq!(status, 200, "{body}");
    let right = cotorra_graph::HostAddress::of(1).ipv4.to_string();
    // Until the eighth answer comes.
    let ping = ["ping", "-q", "-c", "8", "-w", "60", "-i", "0.2", "-s", "1400", &right];
    let done =
        cotorra(["exec", "--api", run.address(), "left", "--"].into_iter().chain(ping)).output().unwrap();
    assert!(done.status.success(), "{}{}", stdout(&done), stderr(&done));
    let text = stdout(&done);
    let slowest = text.split("min/avg/max/mdev = ").nth(1).unwrap().split('/').nth(2).unwrap();
    // Each packet takes 577 ms, but the first ones, which find tokens.
    assert!(slowest.parse::<f64>().unwrap() >= 1_000.0, "{text}");
    let (status, body) = map(json!([]));
    assert_eq!(status, 200, "{body}");
}

/// NetEm or the fabric carries packets in real time. In either case, probes measure the scripted delay, and the verdict
/// says how much is known.
#[test]
fn a_schedule_and_its_replay_change_links_in_real_time() {
    let folder = tempfile::tempdir().unwrap();
    let slow = "schedule:\n  - { at: 1500 ms, links: left-lan, direction: forward, set: { delay: 60 ms } }\n";
    let scripted = on_the_kernel(folder.path(), "scripted", slow);
    let until_slow = |file: &Path| {
        let mut run = Run::start(file, &["--until", "600s"]);
        let context = |direction: &str| {
            let links = run.get("/api/v1/network/links");
            let is_it = |link: &&Value| link["link"] == "left-lan" && link["direction"] == direction;
            links.as_array().unwrap().iter().find(is_it).cloned().unwrap_or_default()
        };
        // No packet is early, so that the mean reaches the delay once the window has passed.
        wait_until(|| context("forward")["probed"]["delay_ms"].as_f64().is_some_and(|delay| delay >= 60.0));
        let backward = context("backward");
        assert_eq!(backward["effective"]["delay_ms"], 1.0, "{backward}");
        run.signal("INT");
        let (summary, _) = run.report();
        let events = ["history", "events", run.folder.to_str().unwrap(), "--kinds", "decision", "--json"];
        let events = cotorra(events).output().unwrap();
        let events: Vec<Value> =
            stdout(&events).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let changed: Vec<_> = events.iter().filter(|event| event["plugin"] == "schedule").collect();
        assert!(changed.iter().all(|event| event["refused"].is_null()), "{changed:?}");
        assert!(changed[0]["at_ns"].as_u64().unwrap() >= 1_500_000_000, "{changed:?}");
        (run, summary)
    };
    let (first, summary) = until_slow(&scripted);
    let reason = summary["fidelity"]["reason"].as_str().unwrap();
    // NetEm counts its probes as frames: well over 100.
    assert_eq!(reason.contains("only probes tell"), has_netem(), "{reason}");
    assert_eq!(summary["fidelity"]["frames"].as_u64().unwrap() >= 100, has_netem(), "{summary}");

    let export = folder.path().join("export");
    let out = ["--format", "csv", "--out", export.to_str().unwrap()];
    let exported = cotorra(["history", "export", first.folder.to_str().unwrap()].into_iter().chain(out))
        .output()
        .unwrap();
    assert!(exported.status.success(), "{}", stderr(&exported));
    drop(first);
    let replay = on_the_kernel(folder.path(), "replay", "conditions: { replay: export }\n");
    let (_, summary) = until_slow(&replay);
    assert!(summary["fidelity"]["valid"].is_boolean());
}
