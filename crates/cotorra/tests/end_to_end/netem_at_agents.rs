//! Links over interfaces of an agent's machine. Tests that need NetEm run in the kernel of `scripts/uml`.

use std::process::Output;

use crate::{
    agents::with_agents_in,
    harness::{stderr, stdout},
    netem::has_netem,
    netem_links::lines,
    real_servers::has_bridges,
};

const TESTBED: &str = "\
name: gate
nodes:
  gate: { kind: machine, agent: fog1 }
  arm: { kind: machine, interface: eth1, address: 10.9.2.2, via: gate }
links:
  - { ends: [gate, arm], delay: 20 ms }
";

/// Runs a script on the core's machine. The agent's machine is `fog`. `wire` adds its interface `eth1`, which leads to the
/// machine `other` with the address 10.9.2.2.
fn via_an_agent(testbed: &str, script: &str) -> Output {
    let set_up = r#"
        wire() {
            ip link add eth1 netns $pid_fog type veth peer name eth1 netns $pid_other
            on fog ip address add 10.9.2.1/24 dev eth1; on fog ip link set eth1 up
            on other ip address add 10.9.2.2/24 dev eth1; on other ip link set eth1 up
        }
        # Prints what became of it.
        set_link() { $COTORRA link set gate-arm --api $api "$@" 2>&1 >/dev/null | plain; echo; }
        # Prints the delays that the link has at the next two contexts of both directions.
        delays_soon() {
            contexts() { $COTORRA history events $(ls -d runs/* | tail -1) --kinds link --limit 10000 --json; }
            n=$(contexts | wc -l)
            until [ $(contexts | wc -l) -ge $((n + 4)) ]; do kill -0 $run; sleep 0.2; done
            contexts | tail -2 | sed 's/.*"effective":{"delay_ms":\([0-9.]*\).*/\1/' | tr '\n' ' '; echo
        }
    "#;
    with_agents_in(testbed, &format!("{set_up}\n{script}"))
}

#[test]
fn a_dry_run_and_a_run_say_what_agents_are_to_emulate() {
    if !has_bridges() || !cotorra_testing::can_enroll_agents() {
        return;
    }
    let done = via_an_agent(
        TESTBED,
        r#"$COTORRA run $FILE --dry-run | sed -n '/^Interface/,/^$/p' | plain; echo
        $COTORRA agent revoke fog1 --authority authority >/dev/null
        ! $COTORRA run $FILE --headless --authority authority 2>&1 | plain | grep -o 'agent .fog1. is not enrolled'
        ls runs 2>/dev/null || true
        $COTORRA agent enrol fog1 --core 10.9.1.1:7448 --authority authority --force >/dev/null
        start --authority authority
        event 'link `gate-arm` waits for agent `fog1`' 1
        set_link --delay 30ms
        delays_soon
        kill -INT $run; ends"#,
    );
    let said = lines(&done);
    let planned = "Interface eth1 of the machine of agent fog1, restored at the end, by NetEm there: \
                   to 10.9.2.2 delay 20 ms, rate";
    assert!(said[0].starts_with(planned), "{said:?}");
    assert!(said[0].contains("from 10.9.2.2 delay 20 ms"), "{said:?}");
    assert_eq!(said[1], "agent `fog1` is not enrolled");
    assert!(said[2].contains("agent `fog1`, which emulates `gate-arm`, is not connected"), "{said:?}");
    assert_eq!(said[3..], ["20.0 20.0 "], "what was rejected changed nothing");
}

#[test]
fn an_agent_that_cannot_emulate_a_link_says_why_and_tries_again() {
    if !has_bridges() || !cotorra_testing::can_enroll_agents() {
        return;
    }
    let testbed = TESTBED.replace("interface: eth1", "interface: lo");
    let done = via_an_agent(
        TESTBED,
        r#"agent fog
        start --authority authority
        event 'cannot apply its conditions: there is no interface `eth1` here' 1
        set_link --delay 30ms
        wire
        event 'link `gate-arm`: agent `fog1` \(has applied\|cannot apply its conditions: this kernel has no sch_\)' 1
        kill -KILL $agent_fog
        event 'fog1. is lost' 1
        set_link --delay 40ms
        delays_soon
        kill -INT $run; ends
        grep -c 'there is no interface' run.txt"#,
    );
    let said = lines(&done);
    assert!(said[0].starts_with("changed gate-arm"), "it is sent: {said:?}");
    assert!(said[1].contains("is not connected"), "{said:?}");
    assert_eq!(said[2..], ["30.0 30.0 ", "1"], "each reason is told once");
    let done = via_an_agent(
        &testbed,
        r#"agent fog
        start --authority authority
        event 'cannot apply its conditions: `lo` is the loopback interface' 1
        kill $agent_fog; wait $agent_fog || true
        event 'fog1. is lost' 1
        OPTIONS='--allow-interface lo'; agent fog
        event 'link `gate-arm`: agent `fog1` \(has applied\|cannot apply its conditions: this kernel has no sch_\)' 1
        kill -INT $run; ends"#,
    );
    assert!(done.status.success(), "{}{}", stdout(&done), stderr(&done));
}

#[test]
fn an_interface_of_an_agent_has_its_conditions_as_long_as_core_and_agent_are_there() {
    if !has_bridges() || !has_netem() || !cotorra_testing::can_enroll_agents() {
        return;
    }
    let done = via_an_agent(
        TESTBED,
        r#"wire
        on fog tc qdisc add dev eth1 root handle 9: pfifo limit 50
        kind() { on fog tc qdisc show dev eth1 | sed -n 's/^qdisc \([a-z]*\) .* root.*/\1/p'; }
        until_kind() { until [ "$(kind)" = $1 ]; do sleep 0.1; done; }
        delays() { on fog $COTORRA netem show eth1 --json | sed -n 's/ *"delay_ms": \([0-9.]*\),/\1/p' | tr '\n' ' '; }
        until_delays() { until [ "$(delays)" = "$1" ]; do sleep 0.1; done; }
        rtt() { on fog ping -q -c 3 -i 0.2 10.9.2.2 | sed -n 's,.*mdev = \([0-9.]*\)/.*,\1,p'; }
        OPTIONS=
        agent fog
        start --authority authority
        event 'NetEm would replace: pass --replace' 1
        kind
        kill $agent_fog; wait $agent_fog || true
        OPTIONS=--replace; agent fog
        event 'fog1. has applied its conditions' 1
        delays; rtt
        set_link --delay 10ms --delay-scale 3
        until_delays '30.0 30.0 '; rtt
        until $COTORRA link show gate-arm --api $api --json | grep -q '"packets": [1-9]'; do sleep 0.2; done
        until on fog ping -q -c 20 -i 0.01 -s 1000 10.9.2.2 >/dev/null
            $COTORRA link show gate-arm --api $api --json | grep -q '"throughput_bps": [1-9]'; do :; done
        on fog tc qdisc delete dev eth1 root
        event 'cannot apply its conditions: somebody removed conditions of `eth1`' 1
        event 'fog1. has applied its conditions' 2
        echo again; delays; echo
        echo core; kill -KILL $run; ends
        until_kind pfifo
        start --authority authority; until_delays '20.0 20.0 '
        event 'fog1. has applied its conditions' 1
        echo agent; kill -KILL $agent_fog; wait $agent_fog || true
        kind
        event 'fog1. is lost' 1
        : >agent_fog.txt; agent fog
        event 'fog1. has applied its conditions' 2
        grep -o 'restored eth1, which a killed process left' agent_fog.txt
        delays
        echo; kill $agent_fog; wait $agent_fog || true
        kind
        agent fog; event 'fog1. has applied its conditions' 3
        delays
        echo; kill -INT $run; ends
        kind; on fog ip -brief link show type ifb | wc -l; ls /run/cotorra/netem | grep -c -- -eth1.json || true"#,
    );
    let said = lines(&done);
    assert_eq!(said[0], "pfifo", "the owner did not permit it: {said:?}");
    let (delays, rtt) = said[1].rsplit_once(' ').unwrap();
    assert_eq!(delays, "20.0 20.0");
    assert!(rtt.parse::<f64>().unwrap() >= 40.0, "{said:?}");
    assert!(said[2].starts_with("changed gate-arm"), "{said:?}");
    assert!(said[3].parse::<f64>().unwrap() >= 60.0, "{said:?}");
    assert_eq!(said[4..6], ["again", "30.0 30.0 "], "what somebody removed is applied again");
    let killed = ["core", "agent", "htb", "restored eth1, which a killed process left", "20.0 20.0 "];
    assert_eq!(said[6..11], killed);
    assert_eq!(said[11..], ["pfifo", "20.0 20.0 ", "pfifo", "0", "0"]);
}

/// The agent measures each direction by a reflector on the machine behind it. The medium adds nothing that is declared.
#[test]
fn an_agent_probes_its_links_as_long_as_the_run_goes_on() {
    if !has_bridges() || !has_netem() || !cotorra_testing::can_enroll_agents() {
        return;
    }
    let testbed = TESTBED
        .replace("via: gate }", "via: gate, reflector: true }")
        .replace(", delay: 20 ms", ", forward: { delay: 30 ms }, backward: { delay: 10 ms, loss: 20 % }")
        + "probes: { interval: 20 ms, window: 2 s }\n";
    let done = via_an_agent(
        &testbed,
        r#"wire
        nsenter --net=/proc/$pid_other/ns/net $COTORRA stamp reflect --listen 10.9.2.2:862 >reflect.txt 2>&1 & reflector=$!
        until grep -q reflecting reflect.txt; do kill -0 $reflector; sleep 0.1; done
        agent fog
        start --authority authority
        # Waits until the probes of both directions tell this: the mean delay there and back, and the shares that were lost.
        until_probed() { until $COTORRA link show gate-arm --api $api --json | python3 -c '
import json, sys
there, back = [way["probed"] or sys.exit(1) for way in json.load(sys.stdin)]
delays, losses = [[of[key] for of in (there, back)] for key in ("delay_ms", "loss")]
if None in delays + losses or not eval(sys.argv[1]): sys.exit(1)' "$1"; do kill -0 $run; sleep 0.2; done; }
        # The rest of the fastest round trip counts half for each direction.
        until_probed 'delays[0] >= 30 and delays[1] >= 10 and delays[0] > delays[1] + 15'
        until_probed 'losses[0] == 0 and 0.02 < losses[1] < 0.5'
        set_link --direction backward --delay 50ms --loss 0% >/dev/null
        until_probed 'delays[0] >= 30 and delays[1] >= 50 and delays[1] > delays[0] + 15 and losses == [0, 0]'
        kill -KILL $agent_fog; wait $agent_fog || true
        event 'fog1. is lost' 1
        until $COTORRA link show gate-arm --api $api --json | grep -q '"probed": null'; do kill -0 $run; sleep 0.2; done
        agent fog
        until_probed 'delays[1] >= 50'
        kill -INT $run; ends
        echo probed"#,
    );
    assert_eq!(lines(&done), ["probed"]);
}
