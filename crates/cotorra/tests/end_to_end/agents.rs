//! Agents on real servers: machines behind a bridge, each in a network namespace of its own.

use std::{
    collections::{BTreeMap, BTreeSet},
    env,
    process::Output,
};

use serde_json::Value;

use crate::{
    harness::{agent_program, corridor, project_file, stderr},
    netem_links::lines,
    real_servers::{behind_a_bridge, has_bridges, json},
};

/// A robot whose navigation runs on the real server `edge`. `ticking` prints numbers there, and goes on without the core.
const TESTBED: &str = "\
name: agents
wireless: { lab: { rate: 8 Mbit/s } }
nodes:
  robot: { kind: robot }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  lan: { kind: switch }
  fog: { kind: server, tier: fog, cpus: 5, memory: 4 GB, agent: fog1, interface: br0, address: 10.9.1.2 }
  edge: { kind: server, tier: edge, cpus: 5, memory: 4 GB, agent: edge1, interface: br0, address: 10.9.1.3 }
  cloud: { kind: server, tier: cloud, cpus: 5, memory: 4 GB, agent: cloud1, interface: br0, address: 10.9.1.4 }
links:
  - { ends: [lan, R1] }
  - { ends: [lan, fog], delay: 1 ms }
  - { ends: [lan, edge], delay: 2 ms }
  - { ends: [lan, cloud], delay: 10 ms }
services:
  navigation:
    robot: robot
    kpis: { service_time: 100 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge }
    virtual_links:
      - { from: robot-driver, to: navigation, rate: 1 Mbit/s }
  ticks:
    robot: robot
    kpis: { service_time: 100 ms }
    vnfs:
      ticking: { command: [sh, -c, 'echo $COTORRA_NODE; exec sleep 6001'], node: fog, keep: true }
walks:
  robot: { waypoints: WALK, speed_limit: 0.5 m/s }
";

/// Kills of each kind in a row.
fn kills() -> u32 {
    if env::var_os("COTORRA_FULL").is_some() { 50 } else { 2 }
}

/// Runs a script with an enrolled agent on each server, none of which is started yet.
///
/// - `agent NAME` starts one in the background, and sets `agent_NAME`. Root is the only user of the script's namespace.
/// - `count NAME PROGRAM` prints the number of processes of a program on a server; `NAVIGATION` and `TICKING` are VNFs.
/// - `until_count NAME PROGRAM NUMBER` waits, `event PATTERN NUMBER` waits for so many events of the run, `serves NODE` for a
///   sample of navigation there, and `serves_again` for one after its last start.
fn with_agents(script: &str) -> Output {
    // To and fro for longer than any test takes.
    let walk = "[0, 0], [1, 0], ".repeat(500);
    with_agents_in(&TESTBED.replace("WALK", &format!("[{walk}]")), script)
}

/// Does so in another testbed. `$OPTIONS` are those of agents that start.
pub fn with_agents_in(testbed: &str, script: &str) -> Output {
    let set_up = format!(
        r#"ip address add 10.9.1.1/24 dev br0
        AGENT={} OPTIONS=
        NAVIGATION='/proc/self/exe vnf navigation' TICKING='sleep 6001'
        for name in fog edge cloud; do
            $COTORRA agent enrol ${{name}}1 --core 10.9.1.1:7448 --authority authority >/dev/null
        done
        agent() {{
            it=$(eval echo \$pid_$1)
            nsenter --net=/proc/$it/ns/net $AGENT run ${{1}}1.agent --state $PWD/state_$1 --vnf-user 0:0 $OPTIONS >>agent_$1.txt 2>&1 &
            eval agent_$1=$!
        }}
        count() {{
            n=0; space=$(readlink /proc/$(eval echo \$pid_$1)/ns/net)
            for p in $(pgrep -fx "$2"); do
                if [ "$(readlink /proc/$p/ns/net)" = "$space" ]; then n=$((n + 1)); fi
            done
            echo $n
        }}
        until_count() {{ until [ $(count $1 "$2") = $3 ]; do sleep 0.1; done; }}
        events() {{ $COTORRA history events $(ls -d runs/* | tail -1) --kinds vnf,notice,machine --limit 10000 --json; }}
        event() {{ until [ $(events | grep -c "$1") -ge $2 ]; do kill -0 $run; sleep 0.2; done; }}
        samples() {{ $COTORRA history events $(ls -d runs/* | tail -1) --kinds service_time --limit 10000 --json "$@"; }}
        serves() {{ until samples | grep -q "\"server\":\"$1\""; do kill -0 $run; sleep 0.2; done; }}
        serves_again() {{
            at=$(events | grep '"vnf":"navigation".*"state":"started"' | tail -1 | sed 's/.*"at_ns":\([0-9]*\)[0-9]\{{9\}},.*/\1/')
            until samples --from $((at + 1))s | grep -q '"server":"edge"'; do kill -0 $run; sleep 0.2; done
        }}
        place() {{ python3 -c "import json, urllib.request as r
body = json.dumps({{'instruction': {{'instruction': 'place', 'vnf': 'navigation', 'node': '$1'}}}}).encode()
r.urlopen(r.Request('http://$api/api/v1/instructions', body, {{'Content-Type': 'application/json'}}))"; }}
        {script}"#,
        agent_program().display()
    );
    behind_a_bridge(testbed, &set_up)
}

#[test]
fn vnfs_on_real_servers_run_at_their_agents_and_move_between_them() {
    if !has_bridges() {
        return;
    }
    let done = with_agents(
        r#"for name in fog edge cloud; do agent $name; done
        start --authority authority
        serves edge
        echo $(count edge "$NAVIGATION") $(count fog "$NAVIGATION") $(count fog "$TICKING")
        place fog; serves fog; until_count edge "$NAVIGATION" 0
        place cloud; serves cloud; until_count fog "$NAVIGATION" 0
        echo $(count cloud "$NAVIGATION")
        event '"event":"machine"' 6
        kill -INT $run; ends
        echo $(count cloud "$NAVIGATION") $(count fog "$TICKING")
        cat state_fog/runs/*/logs/vnfs/ticking.log | tail -1
        $COTORRA history state $(ls -d runs/*) | sed -n '/^Machines/,$p' | grep -o 'cloud\|edge\|fog'"#,
    );
    assert_eq!(lines(&done), ["1 0 1", "1", "0 0", "fog", "cloud", "edge", "fog"]);
}

/// With `COTORRA_FULL`, it also walks past emulated servers, and prints the medians of both.
#[test]
fn corridor_is_served_by_agents_on_its_fog_edge_and_cloud() {
    if !has_bridges() {
        return;
    }
    let full = env::var_os("COTORRA_FULL").is_some();
    let testbed = format!(
        r#"FILE={}; SERVERS='fog edge cloud' LOCALIZATION='/proc/self/exe vnf localization'
        number=2; real=
        for name in $SERVERS; do
            agent $name
            real="$real --set nodes.$name.agent=${{name}}1 --set nodes.$name.interface=br0"
            real="$real --set nodes.$name.address=10.9.1.$number"; number=$((number + 1))
        done
        walk() {{
            at_agents=$1; shift
            start --seed 1 "$@"
            for server in cloud edge fog; do
                [ $server = cloud ] || place $server
                until [ $(samples | grep -c "\"navigation\".*\"server\":\"$server\"") -ge 20 ]; do
                    kill -0 $run; sleep 0.2
                done
                for name in $SERVERS; do
                    if [ $name = $server ]; then until_count $name "$NAVIGATION" $at_agents
                    else until_count $name "$NAVIGATION" 0; fi
                done
            done
            until samples | grep -q '"localization".*"server":"edge"'; do kill -0 $run; sleep 0.2; done
            until_count edge "$LOCALIZATION" $at_agents
            kill -INT $run; ends
            cat $(ls -d runs/* | tail -1)/summary.json | tr -d '\n'; echo
        }}
        walk 1 --authority authority $real
        {}"#,
        corridor().display(),
        if full { "walk 0" } else { "" }
    );
    let runs: Vec<_> = lines(&with_agents(&testbed)).iter().map(|line| json(line)).collect();
    for run in &runs {
        let placements = run["placements"].as_array().unwrap().iter();
        let servers = placements.filter(|its| its["vnf"] == "navigation").map(|its| &its["node"]);
        assert_eq!(servers.collect::<Vec<_>>(), ["cloud", "edge", "fog"]);
        let answered: BTreeSet<_> = medians(run).into_keys().map(|(_, server)| server).collect();
        assert_eq!(Vec::from_iter(answered), ["cloud", "edge", "fog"]);
    }
    let ports = runs[0]["gateways"].as_array().unwrap();
    assert_eq!(ports.len(), 3);
    for port in ports {
        assert!(port["received_frames"].as_u64().unwrap() > 0, "{port}");
    }
    if let [real, emulated] = &runs[..] {
        let others = medians(emulated);
        println!("unit server   agents  emulated  difference, ms");
        for ((unit, server), median) in medians(real) {
            if let Some(other) = others.get(&(unit.clone(), server.clone())) {
                println!("{unit:<4} {server:<6} {median:>8.2} {other:>9.2} {:>+11.2}", median - other);
            }
        }
        for (name, run) in [("agents", real), ("emulated", emulated)] {
            println!(
                "{name}: valid {}, lateness in µs {}",
                run["fidelity"]["valid"], run["fidelity"]["lateness_us"]
            );
        }
    }
}

/// Returns a run's median service times in ms, by radio unit and server.
fn medians(summary: &Value) -> BTreeMap<(String, String), f64> {
    let regions = summary["regions"].as_array().expect("a list").iter();
    let measured = regions.filter_map(|region| {
        let text = |key| region[key].as_str().expect("a text").to_owned();
        let (unit, server) = (text("attachment"), text("server"));
        Some(((unit, server), region["service_time_p50_ms"].as_f64()?))
    });
    measured.collect()
}

#[test]
fn machines_and_radio_units_with_agents_have_the_contexts_of_their_machines() {
    if !has_bridges() {
        return;
    }
    let testbed = "\
name: contexts
wireless: { lab: {} }
nodes:
  R1: { kind: radio_unit, position: [0, 0], channel: 1, agent: fog1 }
  lan: { kind: switch }
  near: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  arm: { kind: machine, interface: br0, address: 10.9.1.4, agent: cloud1 }
  leg: { kind: machine, interface: br0, address: 10.9.1.3, agent: edge1 }
links:
  - { ends: [lan, [R1, near]] }
";
    let script = r#"$COTORRA run $FILE --dry-run | sed -n '/^Agents/,/^$/p'
        on fog ip link set eth0 mtu 1400
        on cloud ip link set eth0 mtu 1300
        $COTORRA agent revoke edge1 --authority authority >/dev/null
        for name in fog edge cloud; do agent $name; done
        start --authority authority
        for node in R1 arm; do
            until read network/nodes/$node/machine >machine.txt 2>/dev/null; do kill -0 $run; sleep 0.2; done
            grep -o '"name":"eth0"[^}]*"mtu_bytes":[0-9]*' machine.txt | sed 's/.*://'
        done
        event '"node":"arm"' 2
        read measurements/machines/arm | grep -c '"mtu_bytes":1300'
        event '"node":"arm".*"reading":{"measured_ns":' 1
        events | python3 -c 'import json, sys
events = [json.loads(line) for line in sys.stdin]
timed = [event for event in events if event.get("node") == "arm" and event["reading"]]
of = [(event["at_ns"], event["reading"]["measured_ns"], event["reading"]["time_error_ms"] * 1e6) for event in timed]
print(all(0 < error and measured - error <= at for at, measured, error in of))'
        COTORRA_API=$api PYTHONPATH=CLIENT PYTHONDONTWRITEBYTECODE=1 python3 -c 'from cotorra import Client
print(*Client().machine("arm")["reading"])'
        ! read network/nodes/leg/machine 2>/dev/null
        kill -INT $run; ends
        grep -o 'agent .edge1. of .leg. is not enrolled' run.txt
        $COTORRA history state $(ls -d runs/*) | sed -n '/^Machines/,$p' | grep -o 'R1\|arm\|leg'"#;
    let done =
        with_agents_in(testbed, &script.replace("CLIENT", project_file("clients/python").to_str().unwrap()));
    let said = lines(&done);
    let planned: Vec<_> =
        said[..4].iter().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(
        planned,
        [
            "Agents that report the contexts of machines:",
            "R1 radio unit agent fog1",
            "arm real machine agent cloud1",
            "leg real machine agent edge1"
        ]
    );
    let expected = [
        "",
        "1400",
        "1300",
        "1",
        "True",
        "measured_ns time_error_ms",
        "agent `edge1` of `leg` is not enrolled",
        "R1",
        "arm",
    ];
    assert_eq!(said[4..], expected);
}

#[test]
fn vnfs_end_with_their_agent_and_start_again_with_it() {
    if !has_bridges() {
        return;
    }
    let script = format!(
        r#"agent edge; agent fog
        start --authority authority
        serves edge
        for n in $(seq {}); do
            kill -9 $agent_edge
            until_count edge "$NAVIGATION" 0
            event 'edge1. is lost' $n
            agent edge
            event '"vnf":"navigation".*"state":"started"' $((n + 1))
        done
        serves_again
        echo $(count edge "$NAVIGATION") $(count fog "$TICKING")
        kill -INT $run; ends"#,
        kills()
    );
    assert_eq!(lines(&with_agents(&script)), ["1 1"]);
}

#[test]
fn vnfs_of_a_killed_core_stop_unless_they_go_on_and_the_next_run_replaces_them() {
    if !has_bridges() {
        return;
    }
    let script = format!(
        r#"agent edge; agent fog
        for n in $(seq {}); do
            start --authority authority
            serves edge; until_count fog "$TICKING" 1
            kill -9 $run; wait $run || true
            until_count edge "$NAVIGATION" 0
            count fog "$TICKING"
        done
        start --authority authority
        serves edge; until_count fog "$TICKING" 1
        kill -INT $run; ends
        echo $(count edge "$NAVIGATION") $(count fog "$TICKING")"#,
        kills()
    );
    let done = with_agents(&script);
    let mut expected = vec!["1".to_owned(); kills() as usize];
    expected.push("0 0".to_owned());
    assert_eq!(lines(&done), expected);
}

#[test]
fn an_agent_that_was_cut_off_stops_and_comes_back_by_itself() {
    if !has_bridges() {
        return;
    }
    let done = with_agents(
        r#"agent edge; agent fog
        start --authority authority
        serves edge
        ip link set p_edge down
        event 'edge1. is lost' 1
        until_count edge "$NAVIGATION" 0
        ip link set p_edge up
        event '"vnf":"navigation".*"state":"started"' 2
        echo $(count edge "$NAVIGATION")
        kill -INT $run; ends"#,
    );
    assert_eq!(lines(&done), ["1"]);
}

#[test]
fn agents_are_revoked_and_enrolled_again_while_a_run_goes_on() {
    if !has_bridges() {
        return;
    }
    let done = with_agents(
        r#"agent edge; agent fog
        start --authority authority
        serves edge
        $COTORRA agent revoke edge1 --authority authority >/dev/null
        event 'edge1. is lost' 1
        until_count edge "$NAVIGATION" 0
        until grep -q 'is revoked' agent_edge.txt; do sleep 0.2; done
        $COTORRA agent enrol edge1 --core 10.9.1.1:7448 --authority authority --force >/dev/null
        event '"vnf":"navigation".*"state":"started"' 2
        $COTORRA agent renew edge1 --authority authority --force --overlap 0s >/dev/null
        until [ $(grep -c 'new credentials' agent_edge.txt) = 2 ]; do sleep 0.2; done
        serves_again
        kill -INT $run; ends
        until_count edge "$NAVIGATION" 0
        count edge "$NAVIGATION""#,
    );
    assert_eq!(lines(&done), ["0"]);
}

#[test]
fn an_agent_of_another_authority_is_refused_and_both_ends_say_why() {
    if !has_bridges() {
        return;
    }
    let done = with_agents(
        r#"$COTORRA agent enrol fog1 --core 10.9.1.1:7448 --authority another --force >/dev/null
        agent edge; agent fog
        start --authority authority
        event 'edge1. is connected' 1
        until grep -q 'waits for .ticking. on fog' run.txt; do kill -0 $run; sleep 0.1; done
        until grep -q 'not the core that enrolled this agent' agent_fog.txt; do kill -0 $run; sleep 0.1; done
        until grep -q 'refused a connection' run.txt; do kill -0 $run; sleep 0.1; done
        kill -INT $run; ends
        grep -c 'refused a connection of an agent: .*`cotorra-agent check`' run.txt
        ! grep -h 'open file limit' run.txt runs/*/logs/cotorra.log"#,
    );
    assert_eq!(lines(&done), ["1"], "each reason is reported once");
}

#[test]
fn a_run_without_enrolled_agents_is_rejected_before_it_has_a_folder() {
    if !has_bridges() {
        return;
    }
    let done = with_agents(
        r#"$COTORRA agent revoke edge1 --authority authority >/dev/null
        ! $COTORRA run $FILE --headless --authority authority
        ! $COTORRA run $FILE --headless --authority nowhere
        ls runs 2>/dev/null || true"#,
    );
    assert_eq!(lines(&done), [""; 0]);
    let said = stderr(&done).replace('│', " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("agent `edge1` is not enrolled, or is revoked"), "{said}");
    assert!(said.contains("nowhere"), "{said}");
}
