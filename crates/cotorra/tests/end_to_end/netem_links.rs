//! Links of a testbed over real interfaces: a virtual Ethernet pair between two network namespaces.
//!
//! Tests that need NetEm run in the kernel of `scripts/uml`.

use std::process::Output;

use crate::{
    harness::{stderr, stdout},
    netem::{has_netem, script},
};

const TESTBED: &str = "\
name: real
nodes:
  desk: { kind: machine }
  arm: { kind: machine, interface: va, address: 10.9.0.2 }
  leg: { kind: machine, interface: va, address: 10.9.0.3 }
links:
  - { ends: [desk, arm], delay: 10 ms }
  - { ends: [desk, leg], forward: { loss: 100 % } }
";

/// Runs a script at this machine's end, `va`, of a wire whose far end has two addresses.
pub fn on_a_wire(testbed: &str, lines: &str) -> Output {
    let folder = tempfile::tempdir().expect("there is room for a folder");
    let file = folder.path().join("real.yaml");
    std::fs::write(&file, testbed).expect("there is room for a file");
    let set_up = "
        cd $(dirname $FILE)
        # Runs of other tests are not found there.
        export TMPDIR=$PWD
        here=$(readlink /proc/self/ns/net)
        unshare --net sleep 600 & far=$!
        run=
        # A process that outlives the script would keep its output open, and the test waiting.
        trap 'trap \"\" TERM; kill 0' EXIT
        until [ \"$(readlink /proc/$far/ns/net)\" != \"$here\" ]; do :; done
        ip link set lo up
        ip link add va type veth peer name vb
        ip link set vb netns $far
        ip address add 10.9.0.1/24 dev va; ip link set va up
        nsenter --net=/proc/$far/ns/net sh -ec '
            for a in 10.9.0.2/24 10.9.0.3/24; do ip address add $a dev vb; done; ip link set vb up'
        api=127.0.0.1:7799
        far() { nsenter --net=/proc/$far/ns/net \"$@\"; }
        plain() { tr -s '\\n│ ' ' '; }
        start() { : >run.txt
            $COTORRA run $FILE --headless --no-token --api $api --until 600s \"$@\" >>run.txt 2>&1 & run=$!
            until grep -q '^API on' run.txt; do kill -0 $run || { cat run.txt; exit 1; }; sleep 0.1; done; }
        ends() { wait $run || true; run=; }
        rtt() { ping -q -c 3 -i 0.2 $1 | sed -n 's,.*mdev = \\([0-9.]*\\)/.*,\\1,p'; }
        node() { it=$1; shift; $COTORRA exec $it --run $api -- \"$@\"; }
        # Repeats, because a robot has no radio unit at first. Prints the least round trip.
        pinged() { until \"$@\" >ping.txt; do kill -0 $run; done
            sed -n 's,.*= \\([0-9.]*\\)/.*,\\1,p' ping.txt; }
        qdiscs() { tc qdisc show dev va; ip -brief link show type ifb; }
";
    script(&format!("FILE={}\n{set_up}\n{lines}", file.display()))
}

pub fn lines(done: &Output) -> Vec<String> {
    assert!(done.status.success(), "{}{}", stdout(done), stderr(done));
    stdout(done).lines().map(str::to_owned).collect()
}

/// Returns whether this user can create namespaces, inspect interfaces and save records in /run, as root can.
pub fn has_namespaces() -> bool {
    let tried = script("command -v tc >/dev/null && test -w /run && unshare --net ip link add va type veth");
    if !tried.status.success() {
        eprintln!("skipped: {}", stderr(&tried));
    }
    tried.status.success()
}

#[test]
fn a_dry_run_lists_the_changes_of_each_interface() {
    if !has_namespaces() {
        return;
    }
    let done = on_a_wire(TESTBED, "$COTORRA run $FILE --dry-run; qdiscs");
    let said = lines(&done);
    let from = said.iter().position(|line| line.starts_with("Interface va of this machine")).unwrap();
    let limit = "limit 9257";
    let keeps = "delay 0ms";
    let rate = "rate 10000000000bit";
    let expected = format!(
        "  tc qdisc add dev va root handle c070: htb
  tc class add dev va parent c070: classid c070:1 htb rate 1tbit
  tc qdisc add dev va parent c070:1 handle c071: netem {limit} delay 10ms {rate}
  tc filter add dev va parent c070: protocol ip pref 1 u32 match ip dst 10.9.0.2/32 flowid c070:1
  ip link add cotorra-i2 type ifb && ip link set cotorra-i2 up
  tc qdisc add dev cotorra-i2 root handle c070: htb
  tc class add dev cotorra-i2 parent c070: classid c070:1 htb rate 1tbit
  tc qdisc add dev cotorra-i2 parent c070:1 handle c071: netem {limit} delay 10ms {rate}
  tc filter add dev cotorra-i2 parent c070: protocol ip pref 1 u32 match ip src 10.9.0.2/32 flowid c070:1
  tc qdisc add dev va ingress handle ffff:
  tc filter add dev va parent ffff: protocol all pref 49264 u32 match u32 0 0 action mirred egress redirect index 1000
  tc class add dev va parent c070: classid c070:2 htb rate 1tbit
  tc qdisc add dev va parent c070:2 handle c072: netem limit 1000 {keeps} loss 100% {rate}
  tc filter add dev va parent c070: protocol ip pref 2 u32 match ip dst 10.9.0.3/32 flowid c070:2
  tc class add dev cotorra-i2 parent c070: classid c070:2 htb rate 1tbit
  tc qdisc add dev cotorra-i2 parent c070:2 handle c072: netem limit 1000 {keeps} {rate}
  tc filter add dev cotorra-i2 parent c070: protocol ip pref 2 u32 match ip src 10.9.0.3/32 flowid c070:2"
    );
    let index = said.iter().find_map(|line| line.split_once("cotorra-i")?.1.split_once(' ')).unwrap().0;
    let expected = expected.replace("cotorra-i2", &format!("cotorra-i{index}"));
    let expected: Vec<_> = expected.lines().collect();
    assert_eq!(said[from + 1..][..expected.len()], expected);
    assert!(said.last().unwrap().starts_with("qdisc noqueue 0:"), "nothing was done: {said:?}");
}

#[test]
fn interfaces_in_other_use_are_rejected() {
    if !has_namespaces() {
        return;
    }
    for (prepare, interface, confirm, told) in [
        ("", "lo", "--allow-interface lo", "`lo` is the loopback interface"),
        ("ip route add default via 10.9.0.2", "va", "--allow-interface va", "`va` carries the default route"),
        ("tc qdisc add dev va root handle 9: pfifo", "va", "--replace", "discipline of kind pfifo"),
        ("", "eth9", "", "there is no interface `eth9` here: there are"),
    ] {
        let testbed = TESTBED.replace("interface: va", &format!("interface: {interface}"));
        let refused = on_a_wire(
            &testbed,
            &format!(
                "{prepare}\n! $COTORRA run $FILE --headless --until 1s; qdiscs; ls runs 2>/dev/null || true"
            ),
        );
        let before = if prepare.starts_with("tc") { "qdisc pfifo 9: root" } else { "qdisc noqueue 0: root" };
        let left = lines(&refused);
        assert!(
            left[0].starts_with(before) && left.len() == 1,
            "nothing was done, no folder is left: {left:?}"
        );
        let broken = stderr(&refused).replace('│', " ");
        let said = broken.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains(told), "{interface}: {said}");
        if !confirm.is_empty() {
            assert!(said.contains(confirm.split(' ').next().unwrap()), "{interface}: {said}");
            let planned = on_a_wire(&testbed, &format!("{prepare}\n$COTORRA run $FILE {confirm} --dry-run"));
            let plan = lines(&planned).join("\n");
            assert!(plan.contains(&format!("tc qdisc add dev {interface} root handle c070: htb")), "{plan}");
        }
    }
}

#[test]
fn a_missing_netem_module_is_named() {
    if !has_namespaces() || has_netem() {
        return;
    }
    let refused = on_a_wire(TESTBED, "! $COTORRA run $FILE --headless --until 1s; qdiscs");
    assert!(lines(&refused)[0].starts_with("qdisc noqueue 0:"));
    let said = stderr(&refused).replace('│', " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    let told = ["this kernel has no sch_", "/run", "needs root"];
    assert!(told.iter().any(|part| said.contains(part)), "{said}");
}

#[test]
fn a_real_link_has_its_conditions_as_long_as_the_run_goes_on() {
    if !has_netem() {
        return;
    }
    let done = on_a_wire(
        TESTBED,
        "tc qdisc add dev va root handle 9: pfifo limit 50
         start --replace
         rtt 10.9.0.2
         ping -q -c 2 -i 0.2 -W 1 10.9.0.3 | grep -o '100% packet loss'
         $COTORRA link set desk-arm --api $api --delay 10ms --delay-scale 3 >/dev/null
         rtt 10.9.0.2
         $COTORRA netem set va --delay 1ms 2>&1 | grep -o 'held by a run'
         $COTORRA link set desk-leg --api $api --loss 0% >/dev/null
         ping -q -c 2 -i 0.2 -W 1 10.9.0.3 | grep -o ' 0% packet loss'
         until $COTORRA link show desk-arm --api $api --json | grep -q '\"packets\": [1-9]'; do sleep 0.2; done
         kill -INT $run; ends
         qdiscs; ls /run/cotorra/netem | grep -c -- -va.json || true",
    );
    let said = lines(&done);
    let rtt = |line: &str| line.parse::<f64>().unwrap();
    assert!(rtt(&said[0]) >= 20.0, "10 ms each way: {said:?}");
    assert_eq!(said[1], "100% packet loss", "of the other address alone");
    assert!(rtt(&said[2]) >= 60.0, "30 ms each way: {said:?}");
    assert_eq!(said[3..5], ["held by a run", " 0% packet loss"]);
    assert!(said[5].starts_with("qdisc pfifo 9: root"), "what was there is back: {said:?}");
    assert_eq!(said[6..], ["0"], "no detour and no record are left");
}

#[test]
fn an_interface_that_already_has_conditions_is_rejected() {
    if !has_netem() {
        return;
    }
    let done = on_a_wire(
        TESTBED,
        "refused() { ! $COTORRA run $FILE --headless --api 127.0.0.1:7798 --until 1s \"$@\" >refused.txt 2>&1 || exit 1
             plain <refused.txt; echo; }
         $COTORRA netem set va --delay 1ms >/dev/null
         refused; refused --replace
         tc qdisc show dev va | grep -c 'delay 1ms'
         $COTORRA netem clear va >/dev/null
         start
         refused --replace
         rtt 10.9.0.2
         kill -INT $run; ends
         qdiscs",
    );
    let said = lines(&done);
    for refused in &said[..2] {
        assert!(
            refused.contains("`va` has conditions already") && refused.contains("netem clear va"),
            "{said:?}"
        );
    }
    assert_eq!(said[2], "1", "they are there as before");
    assert!(said[3].contains("`va` is held by another run, process"), "{said:?}");
    assert!(said[4].parse::<f64>().unwrap() >= 20.0, "and that run goes on: {said:?}");
    assert!(said[5].starts_with("qdisc noqueue 0:") && said.len() == 6, "{said:?}");
}

#[test]
fn interfaces_of_a_killed_run_are_restored() {
    if !has_netem() {
        return;
    }
    let done = on_a_wire(
        TESTBED,
        "tc qdisc add dev va root handle 9: pfifo limit 50
         start --replace
         kill -KILL $run; ends
         tc qdisc show dev va | grep -c netem
         $COTORRA clean --dry-run
         $COTORRA clean
         qdiscs
         start --replace
         kill -KILL $run; ends
         start --replace
         rtt 10.9.0.2
         kill -INT $run; ends
         qdiscs; ls /run/cotorra/netem | grep -c -- -va.json || true",
    );
    let others = ["control group", "the entry of a killed run"];
    let is_other = |line: &str| others.iter().any(|other| line.contains(other));
    let said: Vec<_> = lines(&done).into_iter().filter(|line| !is_other(line)).collect();
    assert_eq!(said[0], "2");
    assert_eq!(said[1], "va: the conditions of a killed run would be removed");
    assert_eq!(said[2], "va: the conditions of a killed run removed");
    assert!(said[3].starts_with("qdisc pfifo 9: root"), "{said:?}");
    assert!(said[4].parse::<f64>().unwrap() >= 20.0, "the next run begins as if nothing were left: {said:?}");
    assert!(said[5].starts_with("qdisc pfifo 9: root"), "{said:?}");
    assert_eq!(said[6..], ["0"]);
}

/// The medium adds 8 ms on the way back, half of which counts for each direction. Emulation adds the rest of ψ·d.
#[test]
fn the_delay_of_the_medium_is_measured_and_scaled_once() {
    if !has_netem() {
        return;
    }
    let testbed = TESTBED.replace("10.9.0.2 }", "10.9.0.2, reflector: true }").replace(", delay: 10 ms", "");
    let done = on_a_wire(
        &testbed,
        "$COTORRA run $FILE --headless --until 1s 2>&1 | plain | grep -o 'answers no probes of STAMP'
         far tc qdisc add dev vb root netem delay 8ms
         nsenter --net=/proc/$far/ns/net $COTORRA stamp reflect --listen 10.9.0.2:862 >reflect.txt 2>&1 & reflector=$!
         until grep -q reflecting reflect.txt; do kill -0 $reflector; sleep 0.1; done
         start
         set -- link set desk-arm --api $api --direction forward
         shown() { $COTORRA link show desk-arm --api $api --json | sed -n '/\"effective\"/,/}/s/ *\"delay_ms\": \\([0-9.]*\\),/\\1/p' | head -1
             $COTORRA netem show va --json | sed -n 's/ *\"delay_ms\": \\([0-9.]*\\),/\\1/p' | head -1; }
         shown
         $COTORRA \"$@\" --delay-scale 3 >/dev/null; shown
         $COTORRA \"$@\" --delay-scale 3 >/dev/null; shown
         $COTORRA \"$@\" --delay-scale 0.5 2>&1 | plain | grep -o 'the medium itself takes'
         $COTORRA \"$@\" --delay-scale 0.5 --delay 20ms >/dev/null; shown
         kill -INT $run; ends",
    );
    let said = lines(&done);
    assert_eq!(said[0], "answers no probes of STAMP");
    assert_eq!(said[7], "the medium itself takes");
    let figures = said[1..7].iter().chain(&said[8..10]).map(|line| line.parse::<f64>().unwrap());
    let figures: Vec<_> = figures.collect();
    let [d, added] = [figures[0], figures[1]];
    assert!(d >= 4.0 && added == 0.0, "half of 8 ms and what the kernels take: {said:?}");
    let is = |figure: f64, expected: f64| (figure - expected).abs() < 1e-5;
    assert!(is(figures[2], 3.0 * d) && is(figures[3], 2.0 * d), "(ψ - 1)·d is added: {said:?}");
    assert_eq!(figures[4..6], figures[2..4], "nothing is scaled twice");
    assert!(is(figures[6], 0.5 * (d + 20.0)) && is(figures[7], 10.0 - 0.5 * d), "{said:?}");
}

/// A reflector at the other end measures each direction of a link during the run. Nothing else does.
#[test]
fn a_real_link_with_a_reflector_is_probed_as_long_as_the_run_goes_on() {
    if !has_netem() {
        return;
    }
    let testbed = TESTBED
        .replace("10.9.0.2 }", "10.9.0.2, reflector: true }")
        .replace(", delay: 10 ms", ", forward: { delay: 30 ms }, backward: { delay: 10 ms, loss: 20 % }")
        + "probes: { interval: 20 ms, window: 2 s }\n";
    let done = on_a_wire(
        &testbed,
        "nsenter --net=/proc/$far/ns/net $COTORRA stamp reflect --listen 10.9.0.2:862 >reflect.txt 2>&1 & reflector=$!
         until grep -q reflecting reflect.txt; do kill -0 $reflector; sleep 0.1; done
         start
         shown() { $COTORRA link show $1 --api $api --json; }
         told() { shown desk-arm | python3 -c '
import json, sys
for way in json.load(sys.stdin):
    probed = way[\"probed\"] or {}
    print(way[\"direction\"], probed.get(\"delay_ms\") or 0, probed.get(\"loss\") or 0)' | tr '\\n' ' '; echo; }
         # Waits until the window has filled since the change.
         filled() { sleep 3; }
         filled; told
         $COTORRA link set desk-arm --api $api --direction backward --delay 50ms --loss 0% >/dev/null
         filled; told
         # No reflector is at the other machine's address.
         shown desk-leg | grep -c '\"probed\": {' || true
         kill -INT $run; ends
         # Its first lines repeat the reason if the figures are not valid.
         grep -m 1 -o 'only probes tell how late' run.txt",
    );
    let said = lines(&done);
    let told = |line: &str| -> Vec<f64> { line.split(' ').filter_map(|word| word.parse().ok()).collect() };
    // Delays forward and backward: the condition, plus the medium and the lateness of the kernel.
    let [before, after] = [told(&said[0]), told(&said[1])];
    assert!((30.0..45.0).contains(&before[0]) && (10.0..25.0).contains(&before[2]), "{said:?}");
    assert!(before[1] == 0.0 && (0.05..0.4).contains(&before[3]), "the loss is the way back's: {said:?}");
    assert!((30.0..45.0).contains(&after[0]) && (50.0..65.0).contains(&after[2]), "{said:?}");
    assert_eq!((after[1], after[3]), (0.0, 0.0), "{said:?}");
    assert_eq!(said[2..], ["0", "only probes tell how late"]);
}
