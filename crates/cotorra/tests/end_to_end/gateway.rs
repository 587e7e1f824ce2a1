//! Gateways: a virtual Ethernet pair, whose far end in another network namespace is the real machine.

use serde_json::Value;

use crate::{
    harness::stderr,
    netem::script,
    netem_links::{has_namespaces, lines, on_a_wire},
};

/// The machine behind `va` is at 10.9.0.2. Hosts are 10.77.0.1 to 10.77.0.3, in this order.
const TESTBED: &str = "\
name: gated
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0] }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  gate: { kind: gateway, interface: va, machines: { plc: 10.9.0.2 } }
links:
  - { ends: [lan, [R1, edge]], delay: 1 ms }
  - { ends: [lan, gate], delay: 10 ms }
";

/// A program for both sides. `serve KIND` answers clients with what it got, `ask KIND ADDRESS` prints whether the answer
/// is what it sent, `attack MAC` sends frames that break rules from `vb`. A client repeats datagrams that are not answered.
const PEER: &str = r#"
import hashlib, socket, struct, sys
job, rest = sys.argv[1], sys.argv[2:]
kind = dict(tcp=socket.SOCK_STREAM, udp=socket.SOCK_DGRAM).get(rest[0])
data = bytes(range(256)) * 8192
def read(s, count):
    got = b''
    while len(got) < count:
        part = s.recv(count - len(got))
        assert part, 'it ended early'
        got += part
    return got
if job == 'serve':
    s = socket.socket(socket.AF_INET, kind)
    s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    s.bind(('', 7000))
    if rest[0] == 'tcp':
        s.listen()
        print('ready', flush=True)
        c, _ = s.accept()
        c.sendall(hashlib.sha256(read(c, len(data))).digest())
    else:
        print('ready', flush=True)
        while True:
            s.sendto(*s.recvfrom(2000))
elif job == 'ask':
    s = socket.socket(socket.AF_INET, kind)
    s.connect((rest[1], 7000))
    if rest[0] == 'tcp':
        s.sendall(data)
        print(read(s, 32) == hashlib.sha256(data).digest())
    else:
        s.settimeout(1)
        for number in range(100):
            sent = struct.pack('>I', number) + data[:1400]
            for attempt in range(60):
                s.send(sent)
                try:
                    if s.recv(2000) == sent:
                        break
                except TimeoutError:
                    pass
            else:
                sys.exit(f'no answer to datagram {number}')
        print(True)
else:
    s = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
    s.bind(('vb', 0))
    own, host, all = bytes.fromhex(rest[0].replace(':', '')), bytes.fromhex('027700000003'), b'\xff' * 6
    ip = lambda source, more=b'': (b'\x45\0' + struct.pack('>H', 20 + len(more)) + b'\0\x01\x20\0\x40\x11\0\0'
        + socket.inet_aton(source) + socket.inet_aton('10.77.0.3') + more)
    arp = lambda mac, sender: (b'\0\x01\x08\0\x06\x04\0\x01' + mac + socket.inet_aton(sender) + b'\0' * 6
        + socket.inet_aton('10.77.0.3'))
    wrong = [
        host + bytes.fromhex('027700000001') + b'\x08\0' + ip('10.9.0.2'),
        bytes.fromhex('027700000009') + own + b'\x08\0' + ip('10.9.0.2'),
        all + own + b'\x08\x06' + arp(bytes.fromhex('027700000001'), '10.9.0.2'),
        host + own + b'\x08\0' + ip('10.9.0.2', b'x' * 3000),
    ]
    other = [
        host + own + b'\x08\0' + ip('10.9.0.99'),
        host + own + b'\x81\0\0\x05\x08\0' + ip('10.9.0.2'),
        all + own + b'\x08\x06' + arp(own, '10.77.0.1'),
        host + own + b'\x86\xdd' + b'\x60' + b'\0' * 60,
        host + own + b'\x08\0',
        b'\0' * 14,
    ]
    right = [host + own + b'\x08\0' + ip('10.9.0.2', b'\xff' * n) for n in range(64)]
    for frame in (wrong + other + right) * 20 + [all + own + b'\x08\x06' + arp(own, '10.9.0.2')] * 5000:
        s.send(frame)
"#;

/// Runs a script where a real machine, `far`, has the route to hosts.
fn at_a_gateway(testbed: &str, lines: &str) -> std::process::Output {
    let peer = format!("cat >peer.py <<'EOF'{PEER}EOF");
    on_a_wire(
        testbed,
        &format!(
            "{peer}
         far ip route add 10.77.0.0/16 dev vb
         joined() {{ ip -d link show va | grep -o 'promiscuity [0-9]*'; }}
         # Serves on the side that `$3` names, and asks from the side that `$4` names.
         transfer() {{ : >served.txt
            $3 python3 peer.py serve $1 >served.txt & server=$!
            until grep -q ready served.txt; do kill -0 $server; done
            $4 python3 peer.py ask $1 $2; }}
         {lines}"
        ),
    )
}

/// Returns the minimum of round trips of `ping`, from the line with its statistics.
fn least_ms(line: &str) -> f64 {
    line.parse().unwrap_or_else(|_| panic!("not a round trip: {line}"))
}

#[test]
fn real_and_emulated_machines_reach_each_other_through_a_gateway() {
    if !has_namespaces() {
        return;
    }
    let done = at_a_gateway(
        TESTBED,
        "joined
         start
         pinged far ping -q -c 5 -i 0.2 10.77.0.3
         pinged node edge ping -q -c 5 -i 0.2 10.9.0.2
         pinged node robot ping -q -c 5 -i 0.2 plc
         $COTORRA link set lan-gate --run $api --delay 20ms >/dev/null
         pinged far ping -q -c 5 -i 0.2 10.77.0.1
         for kind in tcp udp; do
            transfer $kind 10.77.0.3 'node edge' far
            transfer $kind plc far 'node edge'
         done
         ! ping -q -c 1 -W 1 10.77.0.3 >/dev/null 2>&1
         ! $COTORRA run $FILE --headless --api 127.0.0.1:7798 --until 1s 2>&1 | plain; echo
         ls runs | wc -l
         kill -INT $run; ends
         joined
         cat runs/*/summary.json | tr -d '\\n'",
    );
    let said = lines(&done);
    assert_eq!(said[0], "promiscuity 0", "{said:?}");
    let trips: Vec<_> = said[1..5].iter().map(|line| least_ms(line)).collect();
    for (trip, configured) in trips.iter().zip([22.0, 22.0, 22.0, 42.0]) {
        assert!(*trip >= configured, "{trips:?}");
    }
    assert_eq!(said[5..9], ["True"; 4], "all bytes arrived: {said:?}");
    assert!(said[9].contains("interface of `gate`: `va` is in use by another run"), "{said:?}");
    assert_eq!(
        said[10..12],
        ["1", "promiscuity 0"],
        "no folder is left, and the interface is as before: {said:?}"
    );
    let summary: Value = serde_json::from_str(&said[12]).unwrap();
    let gateway = &summary["gateways"][0];
    let count = |name: &str| gateway[name].as_u64().unwrap();
    assert_eq!(gateway["gateway"], "gate");
    assert!(count("received_frames") > 200 && count("sent_frames") > 200, "{gateway}");
    assert_eq!(count("rejected_frames"), 0, "{gateway}");
    for delay in ["received_lateness_us", "sent_lateness_us"] {
        let quantile = |name: &str| gateway[delay][name].as_f64().unwrap();
        assert!(0.0 < quantile("p50") && quantile("p50") <= quantile("p99"), "{gateway}");
    }
}

#[test]
fn hostile_frames_do_not_disturb_the_emulated_network() {
    if !has_namespaces() {
        return;
    }
    let done = at_a_gateway(
        TESTBED,
        "ip link set va mtu 9000; far ip link set vb mtu 9000
         start
         pinged far ping -q -c 2 -i 0.2 10.77.0.3
         far python3 peer.py attack $(far cat /sys/class/net/vb/address || far ip -br link show vb | awk '{print $3}')
         pinged far ping -q -c 2 -i 0.2 10.77.0.3
         pinged node robot ping -q -c 2 -i 0.2 edge
         kill -INT $run; ends
         cat runs/*/summary.json | tr -d '\\n'",
    );
    let said = lines(&done);
    assert!(least_ms(&said[0]) >= 22.0 && least_ms(&said[1]) >= 22.0, "{said:?}");
    assert!(least_ms(&said[2]) >= 2.0, "hosts still find each other: {said:?}");
    let summary: Value = serde_json::from_str(&said[3]).unwrap();
    let gateway = &summary["gateways"][0];
    let count = |name: &str| gateway[name].as_u64().unwrap();
    // Four rules are broken twenty times each. How many of the broadcasts are too many depends on the machine's speed.
    let dropped = count("frames_dropped");
    assert!(count("rejected_frames") + dropped >= 80, "{gateway}");
    assert!(count("received_frames") + dropped >= 20 * 64, "fragments are IP packets like others: {gateway}");
}

#[test]
fn nothing_of_a_gateway_is_left_after_kill_9() {
    if !has_namespaces() {
        return;
    }
    let done = at_a_gateway(
        TESTBED,
        "start; pinged far ping -q -c 2 -i 0.2 10.77.0.3
         kill -9 $run; ends
         joined
         start; pinged far ping -q -c 2 -i 0.2 10.77.0.3
         kill -INT $run; ends
         joined",
    );
    let said = lines(&done);
    assert!(least_ms(&said[0]) >= 22.0 && least_ms(&said[2]) >= 22.0, "{said:?}");
    assert_eq!([&said[1], &said[3]], ["promiscuity 0"; 2]);
}

/// Here this side of the wire is the real machine, and the gateway has the far side.
#[test]
fn a_gateway_uses_an_interface_of_another_namespace() {
    if !has_namespaces() {
        return;
    }
    let testbed =
        TESTBED.replace("va, machines: { plc: 10.9.0.2 }", "vb, netns: FAR, machines: { plc: 10.9.0.1 }");
    let done = at_a_gateway(
        &testbed,
        "sed -i s,FAR,/proc/$far/ns/net, $FILE
         ip route add 10.77.0.0/16 dev va
         start
         pinged ping -q -c 2 -i 0.2 10.77.0.3
         pinged node robot ping -q -c 2 -i 0.2 plc
         kill -INT $run; ends",
    );
    let said = lines(&done);
    assert!(said.iter().all(|line| least_ms(line) >= 22.0) && said.len() == 2, "{said:?}");
}

/// Which of these a kernel has differs. Each prints its kind, a round trip and the state of the wire afterwards.
#[test]
fn a_gateway_uses_bridges_and_macvlan_interfaces_in_passthru() {
    if !has_namespaces() {
        return;
    }
    let done = at_a_gateway(
        &TESTBED.replace("interface: va", "interface: gate0"),
        "used() { ip link set gate0 up; start; echo $1; pinged far ping -q -c 2 -i 0.2 10.77.0.3
            kill -INT $run; ends; ip link delete gate0; joined; }
         ip address flush dev va
         if ip link add gate0 type bridge; then ip link set va master gate0; used bridge; fi
         if ip link add link va name gate0 type macvlan mode passthru; then used macvlan; fi",
    );
    for used in lines(&done).chunks(3) {
        assert!(least_ms(&used[1]) >= 22.0 && used[2] == "promiscuity 0", "{used:?}");
    }
}

#[test]
fn a_dry_run_lists_gateways_and_the_route_that_machines_need() {
    if !has_namespaces() {
        return;
    }
    let said =
        lines(&on_a_wire(TESTBED, "$COTORRA run $FILE --dry-run; ls runs 2>/dev/null || true")).join("\n");
    let expected = "
Gateway gate on the interface va of this machine, for the machines behind it. Each needs a route, as by
  ip route add 10.77.0.0/16 dev INTERFACE
  plc  10.9.0.2
";
    assert!(said.contains(expected), "{said}");
}

#[test]
fn interfaces_that_cannot_be_gateways_are_rejected() {
    if !has_namespaces() {
        return;
    }
    for (prepare, interface, told) in [
        ("", "eth9", "interface of `gate`: there is no interface `eth9` there"),
        ("", "lo", "interface of `gate`: `lo` is not an Ethernet interface"),
        ("ip link set va down", "va", "interface of `gate`: `va` is down: `ip link set va up` sets it up"),
        ("ip link set va mtu 1400", "va", "interface of `gate`: `va` has an MTU of 1400 bytes"),
        ("ip route add default via 10.9.0.2", "va", "pass `--allow-interface va` to use it anyway"),
        ("", "va, netns: nowhere", "interface of `gate`: cannot enter the network namespace /run/netns"),
    ] {
        let testbed = TESTBED.replace("interface: va", &format!("interface: {interface}"));
        for arguments in ["--dry-run", "--headless --until 1s"] {
            let run = format!("{prepare}\n! $COTORRA run $FILE {arguments}; ls runs 2>/dev/null || true");
            let refused = on_a_wire(&testbed, &run);
            assert_eq!(lines(&refused), [""; 0], "no folder is left");
            let said = stderr(&refused).replace('│', " ");
            let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(said.contains(told), "{interface}: {said}");
        }
    }
    let allowed = on_a_wire(
        TESTBED,
        "ip route add default via 10.9.0.2; $COTORRA run $FILE --allow-interface va --dry-run >/dev/null",
    );
    lines(&allowed);
}

/// Rights in a namespace of one's own are none over the interfaces of others.
#[test]
fn a_gateway_needs_rights_over_its_interface() {
    if !has_namespaces() {
        return;
    }
    let testbed = TESTBED.replace("interface: va", "interface: vb");
    let done = on_a_wire(
        &testbed,
        "for way in '--dry-run' '--headless --until 1s'; do
            ! far capsh --drop=cap_net_raw,cap_net_admin,cap_sys_admin -- -c \"$COTORRA run $FILE $way\"
         done; ls runs 2>/dev/null || true",
    );
    let said = stderr(&done).replace('│', " ");
    if said.contains("capsh") {
        eprintln!("skipped: {said}");
        return;
    }
    assert_eq!(lines(&done), [""; 0], "no folder is left");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(said.matches("interface of `gate`: cannot open a packet socket on `vb`").count(), 2, "{said}");
    assert!(said.contains("gateways and real servers need root"), "{said}");
}

#[test]
fn virtual_time_rejects_gateways() {
    let refused = script(
        "cd $(mktemp -d); trap 'rm -r $PWD' EXIT
         cat >gated.yaml <<'EOF'
name: gated
nodes:
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
  gate: { kind: gateway, interface: eth9, machines: { plc: 10.9.0.2 } }
links: [{ ends: [edge, gate] }]
EOF
         $COTORRA check gated.yaml >/dev/null
         ! $COTORRA run gated.yaml --simulate --until 1s",
    );
    if stderr(&refused).contains("unshare") {
        return;
    }
    assert!(refused.status.success(), "{}", stderr(&refused));
    let said = stderr(&refused).replace('│', " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("`gate` is a gateway, and virtual time has no real machines"), "{said}");
}
