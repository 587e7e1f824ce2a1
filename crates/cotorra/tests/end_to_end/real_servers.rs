//! Real servers: machines behind a bridge, each in a network namespace of its own.

use std::process::Output;

use serde_json::Value;

use crate::{
    harness::{project_file, stderr},
    netem::script,
    netem_links::{has_namespaces, lines, on_a_wire},
};

/// Hosts are 10.77.0.1 to 10.77.0.3, in this order. A program on `edge` answers the robot's requests.
const TESTBED: &str = "\
name: served
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0] }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  near: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB, agent: fog1, interface: br0, address: 10.9.1.2 }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB, agent: edge1, interface: br0, address: 10.9.1.3 }
  cloud: { kind: server, tier: cloud, cpus: 1, memory: 1 GB, agent: cloud1, interface: br0, address: 10.9.1.4 }
links:
  - { ends: [lan, [R1, near]], delay: 1 ms }
  - { ends: [lan, fog], delay: 5 ms }
  - { ends: [lan, edge], delay: 10 ms }
  - { ends: [lan, cloud], delay: 20 ms }
services:
  ask:
    robot: robot
    kpis: { service_time: 100 ms, flow: { protocol: udp, port: 7000, id: { offset: 0, length: 4 }, timeout: 10 s } }
    vnfs: {}
";

/// A program for all sides. `serve` answers each datagram with itself, also those to a group, and prints it. `ask ADDRESS`
/// sends five datagrams and reads the answers. `shout ADDRESS...` sends one to the group, and then one to each address.
const PEER: &str = r#"
import socket, struct, sys
job, rest = sys.argv[1], sys.argv[2:]
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
GROUP = socket.inet_aton('239.255.0.7')
if job == 'serve':
    s.bind(('', 7000))
    s.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, GROUP + socket.inet_aton(rest[0]))
    print('ready', flush=True)
    while True:
        part, peer = s.recvfrom(2000)
        print(part[4:].decode(), flush=True)
        s.sendto(part, peer)
elif job == 'ask':
    for number in range(5):
        s.sendto(struct.pack('>I', number) + b'asked', (rest[0], 7000))
        part, peer = s.recvfrom(2000)
        assert part == struct.pack('>I', number) + b'asked' and peer[0] == rest[0], (part, peer)
    print('answered')
else:
    s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton('10.77.0.1'))
    s.sendto(b'\0\0\1\0shouted', ('239.255.0.7', 7000))
    for number, address in enumerate(rest):
        s.sendto(struct.pack('>I', 512 + number) + b'last', (address, 7000))
        while s.recv(2000)[4:] != b'last':
            pass
    print('shouted')
"#;

/// Runs a script on a machine with the bridge `br0`, behind which are the servers, and `other`, a machine that the testbed
/// does not name. `on NAME` runs a program on one of them.
pub fn behind_a_bridge(testbed: &str, lines: &str) -> Output {
    let peer = format!("cat >peer.py <<'EOF'{PEER}EOF");
    on_a_wire(
        testbed,
        &format!(
            "{peer}
         ip link add br0 type bridge; ip link set br0 up
         machine() {{ unshare --net sleep 600 & eval pid_$1=$!
            until [ \"$(readlink /proc/$!/ns/net)\" != \"$here\" ]; do :; done
            ip link add p_$1 type veth peer name eth0 netns $!
            ip link set p_$1 master br0 up
            on $1 sh -ec \"ip address add $2/24 dev eth0; ip link set eth0 up; ip route add 10.77.0.0/16 dev eth0\"; }}
         on() {{ it=$(eval echo \\$pid_$1); shift; nsenter --net=/proc/$it/ns/net \"$@\"; }}
         machine fog 10.9.1.2; machine edge 10.9.1.3; machine cloud 10.9.1.4; machine other 10.9.1.9
         serves() {{ it=$(eval echo \\$pid_$1); : >$1.txt
            nsenter --net=/proc/$it/ns/net python3 peer.py serve $2 >$1.txt &
            until grep -q ready $1.txt; do kill -0 $!; done; }}
         read() {{ python3 -c \"import sys, urllib.request as r; print(r.urlopen('http://$api/api/v1/$1').read().decode())\"; }}
         {lines}"
        ),
    )
}

fn ms(line: &str) -> f64 {
    line.parse().unwrap_or_else(|_| panic!("not a round trip: {line}"))
}

pub fn json(line: &str) -> Value {
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
}

/// Whether the machine has namespaces and bridges.
pub fn has_bridges() -> bool {
    has_namespaces() && {
        let tried = script("ip link add br0 type bridge");
        if !tried.status.success() {
            eprintln!("skipped: {}", stderr(&tried));
        }
        tried.status.success()
    }
}

#[test]
fn real_servers_behind_one_interface_are_each_reached_over_a_link_of_their_own() {
    if !has_bridges() {
        return;
    }
    let done = behind_a_bridge(
        TESTBED,
        "start
         for server in fog edge cloud; do pinged node robot ping -q -c 3 -i 0.2 $server; done
         for server in fog edge cloud; do pinged on $server ping -q -c 3 -i 0.2 10.77.0.3; done
         $COTORRA link set lan-edge --run $api --delay 40ms >/dev/null
         pinged node robot ping -q -c 3 -i 0.2 10.9.1.3
         pinged node near ping -q -c 3 -i 0.2 cloud
         ! on other ping -q -c 1 -W 1 10.77.0.1 >/dev/null
         ! node near ping -q -c 1 -W 1 10.9.1.9 >/dev/null 2>&1
         ! $COTORRA run $FILE --headless --api 127.0.0.1:7798 --until 1s 2>&1 | plain; echo
         kill -INT $run; ends
         cat runs/*/summary.json | tr -d '\\n'",
    );
    let said = lines(&done);
    let trips: Vec<_> = said[..8].iter().map(|line| ms(line)).collect();
    // To and from over the server's link and another one, to the radio unit or to `near`.
    let configured = [12.0, 22.0, 42.0, 12.0, 22.0, 42.0, 82.0, 42.0];
    assert!(trips.iter().zip(configured).all(|(trip, configured)| *trip >= configured), "{trips:?}");
    assert!(said[8].contains("interface of `fog`: `br0` is in use by another run"), "{said:?}");
    let summary = json(&said[9]);
    let ports = summary["gateways"].as_array().unwrap();
    assert_eq!(
        ports.iter().map(|port| port["gateway"].as_str().unwrap()).collect::<Vec<_>>(),
        ["fog", "edge", "cloud"]
    );
    for port in ports {
        let count = |name: &str| port[name].as_u64().unwrap();
        assert!(count("received_frames") >= 6 && count("sent_frames") >= 6, "{port}");
        assert_eq!(count("rejected_frames"), 0, "{port}");
    }
}

#[test]
fn programs_on_real_servers_answer_robots_and_the_server_has_its_part_of_the_time() {
    if !has_bridges() {
        return;
    }
    let done = behind_a_bridge(
        TESTBED,
        "start
         pinged node robot ping -q -c 1 edge >/dev/null
         serves edge 10.9.1.3
         node robot python3 peer.py ask 10.9.1.3
         read network/nodes/edge
         until read 'measurements/service-times?limit=100' | tee times.txt | grep -q vnf_ms; do kill -0 $run; done
         cat times.txt
         kill -INT $run; ends
         $COTORRA history state $(ls -d runs/*) --json | tr -d '\\n'",
    );
    let said = lines(&done);
    assert_eq!(said[0], "answered", "{said:?}");
    let node = json(&said[1]);
    assert_eq!((&node["kind"], &node["tier"]), (&"server".into(), &"edge".into()), "{node}");
    assert_eq!(node["real"]["agent"], "edge1", "{node}");
    assert_eq!(node["real"]["address"], "10.9.1.3", "{node}");
    assert!(node["namespace"].is_null() && node["address"].is_null(), "{node}");
    let samples = json(&said[2]);
    let samples = samples["items"].as_array().unwrap();
    assert!(!samples.is_empty());
    for sample in samples {
        assert_eq!((&sample["service"], &sample["server"]), (&"ask".into(), &"edge".into()), "{sample}");
        assert!(sample["service_time_ms"].as_f64().unwrap() >= 22.0, "{sample}");
        assert!(sample["parts"]["vnf_ms"].as_f64().unwrap() > 0.0, "{sample}");
        let links = sample["parts"]["links"].as_array().unwrap();
        let on_its_link = links.iter().filter(|link| link["link"] == "lan-edge");
        let crossing: f64 = on_its_link.map(|link| link["crossing_ms"].as_f64().unwrap()).sum();
        assert!(crossing >= 20.0, "{sample}");
    }
    assert!(said[3].contains("lan-edge"), "the history has its link: {}", said[3]);
}

#[test]
fn frames_to_groups_reach_each_real_server_once_and_nobody_else() {
    if !has_bridges() {
        return;
    }
    let done = behind_a_bridge(
        TESTBED,
        "start
         for server in fog edge cloud; do pinged node robot ping -q -c 1 $server >/dev/null; done
         serves fog 10.9.1.2; serves cloud 10.9.1.4; serves other 10.9.1.9
         node robot python3 peer.py shout 10.9.1.4 10.9.1.2
         tr '\\n' ' ' <fog.txt; echo; tr '\\n' ' ' <cloud.txt; echo; cat other.txt
         kill -INT $run; ends",
    );
    // The longest way is the cloud's, which comes first: copies over the other servers' links would be there by then.
    assert_eq!(lines(&done), ["shouted", "ready shouted last ", "ready shouted last ", "ready"]);
}

#[test]
fn a_vnf_cannot_be_placed_on_a_real_server_whose_agent_is_not_enrolled() {
    if !has_bridges() {
        return;
    }
    let testbed = format!(
        "{TESTBED}  other:\n    robot: robot\n    kpis: {{ service_time: 100 ms }}\n    vnfs:\n      \
         program: {{ command: [sleep, '600'], node: near }}\n"
    );
    let done = behind_a_bridge(
        &testbed,
        "export XDG_CONFIG_HOME=$PWD/nobody
         start
         python3 -c \"import json, urllib.request as r
body = json.dumps({'instruction': {'instruction': 'place', 'vnf': 'program', 'node': 'edge'}}).encode()
r.urlopen(r.Request('http://$api/api/v1/instructions', body, {'Content-Type': 'application/json'}))\"
         until $COTORRA history events $(ls -d runs/*) >events.txt && grep -q 'cannot connect' events.txt
            do kill -0 $run; done
         kill -INT $run; ends
         grep -m1 'cannot connect' events.txt",
    );
    let said = lines(&done).join(" ");
    assert!(said.contains("its agent `edge1` cannot connect: no agent is enrolled"), "{said}");
}

#[test]
fn a_dry_run_lists_real_servers_and_the_route_that_they_need() {
    if !has_bridges() {
        return;
    }
    let testbed = TESTBED.replace("near: { kind", "near: { position: [1, 1], kind");
    let said = lines(&behind_a_bridge(&testbed, "$COTORRA run $FILE --dry-run; ls runs 2>/dev/null || true"));
    let said = said.join("\n");
    let expected = "
Real servers. Each needs a route, as by
  ip route add 10.77.0.0/16 dev INTERFACE
  fog    server, fog    10.9.1.2  br0 of this machine  agent fog1
  edge   server, edge   10.9.1.3  br0 of this machine  agent edge1
  cloud  server, cloud  10.9.1.4  br0 of this machine  agent cloud1
";
    assert!(said.contains(expected), "{said}");
    assert!(said.contains("4 servers (3 real)"), "{said}");
    assert!(!said.contains("10.77.0.4"), "real servers have no other address: {said}");
}

#[test]
fn interfaces_that_cannot_lead_to_a_real_server_are_rejected() {
    if !has_bridges() {
        return;
    }
    for (prepare, interface, told) in [
        ("", "eth9", "interface of `fog`: there is no interface `eth9` there"),
        ("ip link set br0 down", "br0", "interface of `fog`: `br0` is down"),
        (
            "ip address add 10.9.1.1/24 dev br0; ip route add default via 10.9.1.2",
            "br0",
            "--allow-interface br0",
        ),
        ("", "br0, netns: nowhere", "interface of `fog`: cannot enter the network namespace /run/netns"),
    ] {
        let testbed = TESTBED.replace("interface: br0", &format!("interface: {interface}"));
        for arguments in ["--dry-run", "--headless --until 1s"] {
            let run = format!("{prepare}\n! $COTORRA run $FILE {arguments}; ls runs 2>/dev/null || true");
            let refused = behind_a_bridge(&testbed, &run);
            assert_eq!(lines(&refused), [""; 0], "no folder is left");
            let said = stderr(&refused).replace('│', " ");
            let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(said.contains(told), "{interface}: {said}");
        }
    }
}

#[test]
fn virtual_time_emulates_real_servers() {
    let folder = tempfile::tempdir().unwrap();
    let file = project_file("testbeds/real-servers.yaml");
    let run = |more: &[&str]| {
        let arguments = [&["run", file.to_str().unwrap(), "--simulate", "--until", "20s"], more].concat();
        let done = crate::harness::cotorra(arguments).current_dir(folder.path()).output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        String::from_utf8(done.stdout).unwrap()
    };
    let plan = run(&["--dry-run"]);
    assert!(plan.contains("3 servers,") && plan.contains("10.77.0.5"), "{plan}");
    run(&[]);
    let folder = std::fs::read_dir(folder.path().join("runs")).unwrap().next().unwrap().unwrap().path();
    let summary = json(&std::fs::read_to_string(folder.join("summary.json")).unwrap());
    assert_eq!(summary["services"][0]["service"], "navigation", "{summary}");
    // Twice over the air and the link.
    assert!(summary["services"][0]["service_time_ms"]["p50"].as_f64().unwrap() >= 6.0, "{summary}");
    assert!(summary["gateways"].as_array().unwrap().is_empty(), "{summary}");
}
