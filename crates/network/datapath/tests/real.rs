//! Tests the datapath's promises with real namespaces, real sockets and unmodified programs, on every kind of port
//! that this machine has. Runs as root and as an ordinary user.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

mod harness;

use std::{
    fs,
    io::{Read, Write},
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket},
    os::fd::AsFd,
    process::{self, Command, ExitCode, Stdio},
    thread,
    time::Duration,
};

use cotorra_datapath::{Datapath, Error, HostsFile, Namespace, Options, PortKind, SpawnOptions};
use cotorra_fabric::Fabric;
use cotorra_graph::{
    ConditionChange, Conditions, Direction, HardwareGraph, HostAddress, Link, LinkId, Loss, NodeId, NodeKind,
    Probability,
};
use cotorra_graph_testing as base;

const HELPER: &str = "COTORRA_TEST_HELPER";
/// The variable with the script of a helper.
const SCRIPT: &str = "COTORRA_TEST_SCRIPT";

type Test = (&'static str, fn(PortKind));
const TESTS: &[Test] = &[
    ("packets travel between all hosts by IPv4 and IPv6", packets_travel_between_hosts),
    ("all pairs of a large mesh reach each other", all_pairs_of_a_large_mesh_reach_each_other),
    ("an unmodified program finds nodes by name", programs_find_nodes_by_name),
    ("broadcast and multicast reach all others", broadcast_and_multicast_reach_all_others),
    ("TCP carries every byte through loss", tcp_carries_every_byte_through_loss),
    ("large datagrams arrive whole", large_datagrams_arrive_whole),
    ("a change applies when it returns, and loses nothing", a_change_loses_nothing),
    ("virtual time drops the datagrams that a kernel drops", virtual_time_drops_what_a_kernel_drops),
    ("commands fail after stop", commands_fail_once_it_has_stopped),
    ("nothing is left after drop", nothing_is_left_once_it_is_dropped),
    ("capabilities in use are reported as available", capabilities_in_use_are_reported),
    ("a program's descendants end with it", descendants_end_with_their_program),
    (
        "a program gets its exit code, its host's name, its limits and its signals",
        programs_get_their_environment,
    ),
    ("nothing survives kill -9", nothing_survives_kill_9),
    ("another process enters a node", another_process_enters_a_node),
    ("signals reach a program of another process", signals_reach_a_program_of_another_process),
    ("programs end with another process", programs_end_with_another_process),
    ("programs see their own interfaces", programs_see_their_own_interfaces),
    ("interfaces that are set up again are complete", interfaces_that_are_set_up_again_are_complete),
    ("names of nodes are in no folder that others share", names_are_in_no_shared_folder),
];

fn main() -> ExitCode {
    let helper = std::env::var(HELPER).unwrap_or_default();
    if let Some(path) = helper.strip_prefix("enter ") {
        return enter_and_run(path);
    }
    let privilege =
        cotorra_datapath::enter_user_namespace_if_needed().expect("tests need user namespaces or root");
    if let Some(kind) = helper.strip_prefix("run ") {
        return run_and_wait(kind);
    }
    let is_there = |kind: &PortKind| match start(&star(2, Conditions::default()).0, *kind) {
        Ok(_) => true,
        Err(error) => {
            println!("{kind:?}: skipped: {error}");
            assert!(*kind == PortKind::Tap, "packet sockets work wherever namespaces do");
            false
        }
    };
    let kinds = [PortKind::Tap, PortKind::PacketSocket].into_iter().filter(is_there);
    harness::run(TESTS, kinds.map(|kind| (format!("{privilege:?}, {kind:?}"), kind)), |test, kind| test(kind))
}

/// Hosts at one switch, each by a link with these conditions.
fn star(hosts: usize, conditions: Conditions) -> (HardwareGraph, Vec<NodeId>) {
    let names: Vec<_> = (0..hosts).map(|i| NodeId::new(&format!("host{i}")).unwrap()).collect();
    let link = |host: &NodeId| Link {
        id: LinkId::new(&format!("link-{host}")).unwrap(),
        ..base::link(host.as_str(), "switch", conditions.clone())
    };
    let links = names.iter().map(link).collect();
    let host = |id: &NodeId| base::node(id.as_str(), NodeKind::Server(base::server()));
    let switch = base::node("switch", NodeKind::Switch);
    (base::graph(names.iter().map(host).chain([switch]).collect(), links), names)
}

fn start(graph: &HardwareGraph, port: PortKind) -> Result<Datapath, Error> {
    Datapath::start(graph, Fabric::new(graph, 7).unwrap(), Options { port, ..Options::default() })
}

fn up(hosts: usize, conditions: Conditions, kind: PortKind) -> (Datapath, Vec<NodeId>) {
    let (graph, names) = star(hosts, conditions);
    (start(&graph, kind).unwrap(), names)
}

fn udp(datapath: &Datapath, host: &NodeId, address: impl Into<IpAddr>) -> UdpSocket {
    datapath.namespace(host).unwrap().udp_socket((address.into(), 4000)).unwrap()
}

fn packets_travel_between_hosts(kind: PortKind) {
    let (datapath, names) = up(3, Conditions::default(), kind);
    assert_eq!(datapath.port_kind(), kind);
    for family in [0, 1] {
        let any: IpAddr = [Ipv4Addr::UNSPECIFIED.into(), Ipv6Addr::UNSPECIFIED.into()][family];
        let address = |i: usize| [HostAddress::of(i).ipv4.into(), HostAddress::of(i).ipv6.into()][family];
        let sockets: Vec<_> = names.iter().map(|name| udp(&datapath, name, any)).collect();
        for (from, to) in [(0, 1), (1, 2), (2, 0), (0, 2)] {
            let message = format!("{from} to {to}");
            sockets[from].send_to(message.as_bytes(), SocketAddr::new(address(to), 4000)).unwrap();
            let mut buffer = [0; 100];
            let (length, sender) = sockets[to].recv_from(&mut buffer).unwrap();
            assert_eq!(&buffer[..length], message.as_bytes());
            assert_eq!(sender, SocketAddr::new(address(from), 4000));
        }
    }
    assert_eq!(datapath.dropped_frames(), 0);
}

/// More pairs than the kernel's table of neighbours has room for by default, for all namespaces together.
fn all_pairs_of_a_large_mesh_reach_each_other(kind: PortKind) {
    const HOSTS: usize = 36;
    const USUAL_LIMIT: usize = 1024;
    const { assert!(HOSTS * (HOSTS - 1) > USUAL_LIMIT) };
    let (datapath, names) = up(HOSTS, Conditions::default(), kind);
    for family in [0, 1] {
        let any: IpAddr = [Ipv4Addr::UNSPECIFIED.into(), Ipv6Addr::UNSPECIFIED.into()][family];
        let address = |i: usize| [HostAddress::of(i).ipv4.into(), HostAddress::of(i).ipv6.into()][family];
        let sockets: Vec<_> = names.iter().map(|name| udp(&datapath, name, any)).collect();
        let mut buffer = [0; 8];
        for (from, socket) in sockets.iter().enumerate() {
            let others = || (0..HOSTS).filter(|to| *to != from);
            for to in others() {
                let error = socket.send_to(&from.to_ne_bytes(), SocketAddr::new(address(to), 4000)).err();
                assert!(error.is_none(), "{from} to {to}: {error:?}");
            }
            for to in others() {
                let (_, sender) = sockets[to].recv_from(&mut buffer).unwrap();
                assert_eq!(sender, SocketAddr::new(address(from), 4000));
                sockets[to].send_to(&buffer, sender).unwrap();
            }
            let mut answered: Vec<_> =
                others().map(|_| socket.recv_from(&mut buffer).unwrap().1.ip()).collect();
            answered.sort();
            assert_eq!(answered, others().map(address).collect::<Vec<IpAddr>>());
        }
    }
    // No address had to be asked for: the first packet goes at once, as in virtual time.
    let table =
        datapath.namespace(&names[0]).unwrap().run(|| fs::read_to_string("/proc/thread-self/net/arp"));
    let table = table.unwrap();
    let permanent = table.lines().filter(|line| line.split_whitespace().nth(2) == Some("0x6")).count();
    assert_eq!((permanent, table.lines().count()), (HOSTS - 1, HOSTS), "{table}");
    assert_eq!(datapath.dropped_frames(), 0);
}

fn programs_find_nodes_by_name(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    if Command::new("ping").arg("-V").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err() {
        println!("skipped: no ping here");
        return;
    }
    // One packet each: ping waits for the next no longer than twice the first round trip.
    for family in ["-4", "-6", "-4", "-6", "-4", "-6"] {
        let mut ping = Command::new("ping");
        ping.args([family, "-c", "1", "-W", "60", names[1].as_str()]).stdout(Stdio::piped());
        let mut ping = datapath.spawn(&names[0], ping, SpawnOptions::default()).unwrap();
        let mut told = String::new();
        ping.pipes().1.unwrap().read_to_string(&mut told).unwrap();
        assert!(ping.wait().unwrap().success(), "{told}");
        assert!(told.contains(" 0% packet loss"), "{told}");
    }
}

fn broadcast_and_multicast_reach_all_others(kind: PortKind) {
    let (datapath, names) = up(4, Conditions::default(), kind);
    let group = Ipv4Addr::new(239, 7, 7, 7);
    let group6: Ipv6Addr = "ff05::77".parse().unwrap();
    let sockets: Vec<_> = names.iter().map(|name| udp(&datapath, name, Ipv4Addr::UNSPECIFIED)).collect();
    let sockets6: Vec<_> =
        names.iter().map(|name| datapath.namespace(name).unwrap().udp_socket(":::4001").unwrap()).collect();
    for (i, (socket, socket6)) in sockets.iter().zip(&sockets6).enumerate() {
        socket.join_multicast_v4(&group, &HostAddress::of(i).ipv4).unwrap();
        let eth0 = datapath.namespace(&names[i]).unwrap().run(|| {
            fs::read_to_string("/proc/thread-self/net/if_inet6")
                .unwrap()
                .lines()
                .find(|l| l.ends_with("eth0"))
                .map(|line| u32::from_str_radix(line.split_whitespace().nth(1).unwrap(), 16).unwrap())
        });
        socket6.join_multicast_v6(&group6, eth0.unwrap()).unwrap();
        socket6.set_multicast_loop_v6(false).unwrap();
        socket.set_multicast_loop_v4(false).unwrap();
    }
    sockets[0].set_broadcast(true).unwrap();
    let all: [(IpAddr, &str); 3] = [
        (Ipv4Addr::new(10, 77, 255, 255).into(), "to the network"),
        (Ipv4Addr::BROADCAST.into(), "to all"),
        (group.into(), "to the group"),
    ];
    let mut buffer = [0; 100];
    for (to, message) in all {
        sockets[0].send_to(message.as_bytes(), (to, 4000)).unwrap();
        for socket in &sockets[1..] {
            let (length, _) = socket.recv_from(&mut buffer).unwrap();
            assert_eq!(&buffer[..length], message.as_bytes());
        }
    }
    sockets6[0].send_to(b"six", (group6, 4001)).unwrap();
    for socket in &sockets6[1..] {
        assert_eq!(socket.recv_from(&mut buffer).unwrap().0, 3);
    }
}

fn tcp_carries_every_byte_through_loss(kind: PortKind) {
    let loss = Loss::Independent { rate: Probability::new(0.01).unwrap() };
    for (conditions, lossy) in
        [(Conditions::default(), false), (Conditions { loss, ..Conditions::default() }, true)]
    {
        let (datapath, names) = up(2, conditions, kind);
        let pattern: Vec<u8> = (0..8 << 20).map(|i: u32| (i ^ (i >> 8) ^ (i >> 16)) as u8).collect();
        let any = (Ipv6Addr::UNSPECIFIED, 4000);
        let listener = datapath.namespace(&names[1]).unwrap().run(|| TcpListener::bind(any)).unwrap();
        let to = (HostAddress::of(1).ipv6, 4000);
        let mut sender = datapath.namespace(&names[0]).unwrap().run(|| TcpStream::connect(to)).unwrap();
        let mut received = Vec::new();
        thread::scope(|scope| {
            scope.spawn(|| listener.accept().unwrap().0.read_to_end(&mut received).unwrap());
            sender.write_all(&pattern).unwrap();
            drop(sender);
        });
        assert!(received == pattern, "{} of {} bytes came", received.len(), pattern.len());
        let mut fabric = datapath.stop().unwrap();
        assert!(fabric.lateness().frames > 0);
        let now = cotorra_graph::Timestamp::MAX;
        let lost: u64 = fabric.link_contexts(now).iter().map(|c| c.counters.lost).sum();
        assert_eq!(lost > 0, lossy, "{lost} were lost");
    }
}

fn large_datagrams_arrive_whole(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    let [a, b] = [0, 1].map(|i| udp(&datapath, &names[i], Ipv4Addr::UNSPECIFIED));
    let datagram: Vec<u8> = (0..65_000u32).map(|i| (i * 7) as u8).collect();
    a.send_to(&datagram, (HostAddress::of(1).ipv4, 4000)).unwrap();
    let mut buffer = vec![0; 70_000];
    let (length, _) = b.recv_from(&mut buffer).unwrap();
    assert!(buffer[..length] == datagram);
}

fn a_change_loses_nothing(kind: PortKind) {
    let far = Conditions { delay: Duration::from_millis(20), ..Conditions::default() };
    let (datapath, names) = up(2, far, kind);
    let [a, b] = [0, 1].map(|i| udp(&datapath, &names[i], Ipv4Addr::UNSPECIFIED));
    let clock = datapath.clock();
    let to = (HostAddress::of(1).ipv4, 4000);
    let mut buffer = [0; 8];
    // Resolves addresses.
    a.send_to(&u64::MAX.to_ne_bytes(), to).unwrap();
    b.recv_from(&mut buffer).unwrap();
    for number in 0..20u64 {
        a.send_to(&number.to_ne_bytes(), to).unwrap();
    }
    let asked = clock.now();
    let link = LinkId::new("link-host0").unwrap();
    let near = ConditionChange { delay_ms: Some(0.0), ..ConditionChange::default() };
    let (changed, ran_at) =
        datapath.handle().with(move |fabric, now| (fabric.change(now, &link, None, &near), now)).unwrap();
    changed.unwrap();
    assert!(ran_at >= asked && ran_at <= clock.now());
    a.send_to(&20u64.to_ne_bytes(), to).unwrap();
    let received: Vec<_> = (0..=20u64)
        .map(|_| {
            b.recv_from(&mut buffer).unwrap();
            u64::from_ne_bytes(buffer)
        })
        .collect();
    assert_eq!(received, (0..=20).collect::<Vec<_>>(), "all, in order");
    let context = datapath.handle().with(|fabric, now| fabric.link_contexts(now)).unwrap();
    let changed = context.iter().find(|c| c.link == "link-host0").unwrap();
    assert_eq!(changed.effective.delay, Duration::ZERO);
}

/// Bits are flipped on both links, so that some checksums are correct again.
fn virtual_time_drops_what_a_kernel_drops(kind: PortKind) {
    const BURST: u64 = 50;
    let (datapath, names) = up(2, Conditions::default(), kind);
    let [a, b] = [0, 1].map(|i| udp(&datapath, &names[i], Ipv4Addr::UNSPECIFIED));
    let HostAddress { mac, ipv4, .. } = HostAddress::of(1);
    let network = u32::from(ipv4) >> (32 - HostAddress::IPV4_PREFIX);
    let is_host = |sender: Ipv4Addr| u32::from(sender) >> (32 - HostAddress::IPV4_PREFIX) == network;
    let corrupt = |share: f64| {
        let corruption = Some(Probability::new(share).unwrap());
        let change = ConditionChange { corruption, ..ConditionChange::default() };
        let links = ["link-host0", "link-host1"].map(|link| LinkId::new(link).unwrap());
        let change =
            move |fabric: &mut Fabric, now| links.map(|link| fabric.change(now, &link, None, &change));
        datapath.handle().with(change).unwrap().into_iter().for_each(|changed| changed.unwrap());
    };
    let mut buffer = [0; 200];
    let mut received_until = |last: &[u8]| {
        let receive = || {
            let (length, sender) = b.recv_from(&mut buffer).unwrap();
            (buffer[..length].to_vec(), sender)
        };
        let mut received: Vec<_> =
            std::iter::repeat_with(receive).take_while(|(bytes, _)| bytes != last).collect();
        received.retain(|(_, sender)| matches!(sender.ip(), IpAddr::V4(sender) if is_host(sender)));
        received
    };
    // Resolves addresses.
    a.send_to(b"first", (ipv4, 4000)).unwrap();
    received_until(b"first");
    let (frames, seen) = std::sync::mpsc::channel();
    let tap = move |fabric: &mut Fabric, _| {
        fabric.tap(
            "link-host1",
            Box::new(move |passage| {
                let to_host = passage.filter(|passage| passage.direction == Direction::Backward);
                to_host.is_none_or(|passage| frames.send(passage.frame.clone()).is_ok())
            }),
        )
    };
    datapath.handle().with(tap).unwrap().unwrap();
    let mut taken = 0;
    for (share, bursts) in [(0.01, 20), (0.2, 20), (1.0, 60)] {
        for burst in 0..bursts {
            corrupt(share);
            let datagram = |i: u64| [(burst * BURST + i).to_be_bytes(); 9].concat();
            for i in 0..BURST {
                a.send_to(&datagram(i), (ipv4, 4000)).unwrap();
            }
            let is_ipv4 = |frame: &cotorra_fabric::Frame| frame.bytes().get(12..14) == Some(&[8, 0]);
            let crossed: Vec<_> = seen.iter().filter(is_ipv4).take(BURST as usize).collect();
            corrupt(0.0);
            a.send_to(b"last", (ipv4, 4000)).unwrap();
            let received = received_until(b"last");
            let last = seen.iter().find(is_ipv4).unwrap();
            assert!(last.bytes().ends_with(b"last"));
            let expected: Vec<_> = crossed
                .iter()
                .filter_map(|frame| {
                    let checksum_left = frame.offload().checksum.is_some();
                    let frame = cotorra_flows::Frame { bytes: frame.bytes(), checksum_left, segment: None };
                    let datagram = cotorra_flows::Datagram::received(&frame, mac, ipv4)?;
                    let is_for_socket = datagram.to == 4000 && is_host(*datagram.from.ip());
                    is_for_socket.then(|| (datagram.payload.to_vec(), SocketAddr::V4(datagram.from)))
                })
                .collect();
            assert_eq!(received, expected, "{share}");
            taken += if share == 1.0 { received.len() } else { 0 };
        }
    }
    assert!(taken > 0, "two flipped bits can cancel out");
}

fn commands_fail_once_it_has_stopped(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    let handle = datapath.handle();
    assert_eq!(handle.with(|fabric, _| fabric.in_flight()).unwrap(), 0);
    let nobody = NodeId::new("switch").unwrap();
    assert!(matches!(datapath.namespace(&nobody), Err(Error::NoSuchHost(_))));
    assert!(datapath.namespace(&names[1]).is_ok());
    datapath.stop().unwrap();
    assert!(matches!(handle.with(|_, _| ()), Err(Error::Stopped)));
}

fn nothing_is_left_once_it_is_dropped(kind: PortKind) {
    let held = || ["/proc/self/fd", "/proc/self/task"].map(|what| fs::read_dir(what).unwrap().count());
    let before = held();
    let (datapath, names) = up(20, Conditions::default(), kind);
    let child = datapath.spawn(&names[0], shell("sleep 1000"), SpawnOptions::default()).unwrap();
    let process = child.id();
    assert!(held()[0] > before[0] + 20);
    drop(child);
    drop(datapath);
    assert!(!is_alive(process));
    // Joined threads are listed for another moment.
    wait_until(|| held() == before);
}

fn capabilities_in_use_are_reported(kind: PortKind) {
    let capabilities = cotorra_datapath::probe();
    let port = if kind == PortKind::Tap { "TAP with offloads" } else { "packet sockets with offloads" };
    for name in ["network namespaces", "process and mount namespaces", port] {
        let capability = capabilities.iter().find(|c| c.name == name).unwrap();
        assert!(capability.state.is_available(), "{capability:?}");
    }
}

/// A shell command in a namespace of its own, with readable output.
fn shell(script: &str) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", script]).stdin(Stdio::null()).stdout(Stdio::piped());
    command
}

fn descendants_end_with_their_program(_: PortKind) {
    let namespace = Namespace::new().unwrap();
    // The pipe hangs up once the last of them is gone.
    let script = "trap '' TERM HUP; (setsid sh -c 'trap \"\" TERM HUP; sleep 1000' &) ; echo up; sleep 1000";
    for end in [true, false] {
        let mut child = namespace.spawn(shell(script), SpawnOptions::default()).unwrap();
        let mut output = child.pipes().1.unwrap();
        let mut word = [0; 3];
        output.read_exact(&mut word).unwrap();
        if end {
            child.kill().unwrap();
        } else {
            drop(child);
        }
        assert_eq!(output.read(&mut word).unwrap(), 0);
    }
}

fn programs_get_their_environment(_: PortKind) {
    let namespace = Namespace::new().unwrap();
    let run = |script: &str, options: SpawnOptions<'_>| {
        let mut child = namespace.spawn(shell(script), options).unwrap();
        let mut told = String::new();
        child.pipes().1.unwrap().read_to_string(&mut told).unwrap();
        (child.wait().unwrap().code(), told.trim().to_owned())
    };
    assert_eq!(run("exit 42", SpawnOptions::default()).0, Some(42));
    assert_eq!(run("kill -KILL $$", SpawnOptions::default()).0, Some(128 + 9));
    let options = SpawnOptions { hostname: Some("robot"), ..SpawnOptions::default() };
    assert_eq!(run("uname -n", options).1, "robot");
    let here = std::env::current_dir().unwrap().display().to_string();
    assert_eq!(run("pwd", SpawnOptions::default()).1, here);

    let script = "trap 'echo bye; exit 3' TERM; echo up; while :; do sleep 0.01; done";
    let mut child = namespace.spawn(shell(script), SpawnOptions::default()).unwrap();
    let mut output = child.pipes().1.unwrap();
    output.read_exact(&mut [0; 3]).unwrap();
    assert_eq!(child.try_wait().unwrap(), None);
    child.terminate().unwrap();
    let mut told = String::new();
    output.read_to_string(&mut told).unwrap();
    assert_eq!((told.trim(), child.wait().unwrap().code()), ("bye", Some(3)));
    child.terminate().unwrap();

    let missing = namespace.spawn(Command::new("/no/such/program"), SpawnOptions::default()).unwrap_err();
    assert!(missing.to_string().contains("`/no/such/program`"), "{missing}");
    let no_group = SpawnOptions { cgroups: vec!["/no/such/group".into()], ..SpawnOptions::default() };
    assert!(matches!(namespace.spawn(shell("true"), no_group), Err(Error::Spawn { .. })));
    let file = std::env::temp_dir().join(format!("cotorra-test-group-{}", process::id()));
    fs::write(&file, "").unwrap();
    let group = SpawnOptions { cgroups: vec![file.clone()], ..SpawnOptions::default() };
    assert_eq!(run("exit 0", group).0, Some(0));
    assert_eq!(fs::read_to_string(&file).unwrap(), "0", "the program joined as itself");
    fs::remove_file(&file).unwrap();
}

/// This test program in a helper role.
fn helper(what: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.env(HELPER, what).stdin(Stdio::piped()).stdout(Stdio::piped());
    command
}

/// Brings hosts up, runs a program in one, prints where that is, and waits to be killed.
fn run_and_wait(kind: &str) -> ExitCode {
    let kind = if kind == "Tap" { PortKind::Tap } else { PortKind::PacketSocket };
    let (datapath, names) = up(3, Conditions::default(), kind);
    let script = shell("(sleep 1000 &) ; echo up; sleep 1000");
    let mut child = datapath.spawn(&names[0], script, SpawnOptions::default()).unwrap();
    child.pipes().1.unwrap().read_exact(&mut [0; 3]).unwrap();
    println!("{} {}", child.id(), datapath.namespace(&names[1]).unwrap().path().display());
    let _ = std::io::stdin().read(&mut [0]);
    ExitCode::SUCCESS
}

/// Runs a script in a namespace of another process, as node `host1`.
fn enter_and_run(path: &str) -> ExitCode {
    let namespace = Namespace::open(path.as_ref()).unwrap();
    let hosts = HostsFile::of(&star(2, Conditions::default()).0).unwrap();
    let mut script = Command::new("sh");
    script.args(["-c", &std::env::var(SCRIPT).unwrap()]);
    let options = SpawnOptions { hosts: Some(&hosts), hostname: Some("host1"), ..SpawnOptions::default() };
    let status = namespace.run_program(script, options).unwrap();
    ExitCode::from(status.code().unwrap() as u8)
}

/// A helper that runs a script in a namespace of this process.
fn inside(namespace: &Namespace, script: &str) -> Command {
    let mut helper = helper(&format!("enter {}", namespace.path().display()));
    helper.env(SCRIPT, script).stdin(Stdio::null());
    helper
}

fn nothing_survives_kill_9(kind: PortKind) {
    let mut helper = helper(&format!("run {kind:?}")).spawn().unwrap();
    let mut output = helper.stdout.take().unwrap();
    let mut line = Vec::new();
    let mut byte = [0];
    while output.read(&mut byte).unwrap() == 1 && byte != *b"\n" {
        line.push(byte[0]);
    }
    let line = String::from_utf8(line).unwrap();
    let init: u32 = line.split(' ').next().unwrap().parse().unwrap();
    let processes = descendants(init);
    assert!(processes.len() >= 3, "the init, the shell and what it started: {processes:?}");
    helper.kill().unwrap();
    helper.wait().unwrap();
    for process in processes {
        wait_until(|| !is_alive(process));
    }
    // Namespaces are held by descriptors of the helper alone. No path, process or name refers to them.
    assert!(!fs::exists(line.split(' ').nth(1).unwrap()).unwrap());
    let leftover = fs::read_dir(std::env::temp_dir()).unwrap().flatten().any(|entry| {
        entry.file_name().to_string_lossy().starts_with(&format!("cotorra-hosts-{}", helper.id()))
    });
    assert!(!leftover);
}

fn another_process_enters_a_node(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    let namespace = datapath.namespace(&names[1]).unwrap();
    let script = "grep -h . /proc/net/if_inet6 /etc/hosts; grep SigBlk /proc/self/status; uname -n; exit 42";
    let told = inside(namespace, script).output().unwrap();
    let text = String::from_utf8(told.stdout).unwrap();
    assert!(text.contains("fd770000000000000000000000000002") && text.contains("eth0"), "{text}");
    assert!(text.contains("10.77.0.1 host0"), "{text}");
    assert!(text.ends_with("SigBlk:\t0000000000000000\nhost1\n"), "{text}");
    assert_eq!(told.status.code(), Some(42));
}

fn signals_reach_a_program_of_another_process(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    let script = "trap 'echo bye; exit 3' TERM; echo up; while :; do sleep 0.01; done";
    let mut helper = inside(datapath.namespace(&names[1]).unwrap(), script).spawn().unwrap();
    let mut output = helper.stdout.take().unwrap();
    output.read_exact(&mut [0; 3]).unwrap();
    let sent = Command::new("kill").args(["-TERM", &helper.id().to_string()]).status();
    assert!(sent.unwrap().success());
    let mut told = String::new();
    output.read_to_string(&mut told).unwrap();
    assert_eq!((told.trim(), helper.wait().unwrap().code()), ("bye", Some(3)));
}

fn programs_end_with_another_process(_: PortKind) {
    let namespace = Namespace::new().unwrap();
    let mut other = Command::new("sleep").arg("1000").spawn().unwrap();
    let process = cotorra_datapath::open_process(other.id()).unwrap();
    let options = SpawnOptions { ends_with: Some(process.as_fd()), ..SpawnOptions::default() };
    // The pipe hangs up once the last of them is gone.
    let script = "trap '' TERM HUP; (setsid sh -c 'trap \"\" TERM HUP; sleep 1000' &) ; echo up; sleep 1000";
    let mut child = namespace.spawn(shell(script), options).unwrap();
    let mut output = child.pipes().1.unwrap();
    output.read_exact(&mut [0; 3]).unwrap();
    assert_eq!(child.try_wait().unwrap(), None);
    other.kill().unwrap();
    assert_eq!(output.read(&mut [0]).unwrap(), 0);
    assert_eq!(child.wait().unwrap().code(), Some(128 + 9));
    other.wait().unwrap();
}

fn programs_see_their_own_interfaces(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    let script = "cat /sys/class/net/eth0/address 2> /dev/null || ls /sys/class/net";
    let mut child = datapath.spawn(&names[1], shell(script), SpawnOptions::default()).unwrap();
    let mut spawned = String::new();
    child.pipes().1.unwrap().read_to_string(&mut spawned).unwrap();
    let told = inside(datapath.namespace(&names[1]).unwrap(), script).output().unwrap();
    assert_eq!(spawned, String::from_utf8(told.stdout).unwrap());
    // A kernel that shows an ordinary user no `/sys` in a container shows no interface at all.
    assert!(["02:77:00:00:00:02\n", ""].contains(&&*spawned), "{spawned}");
}

fn interfaces_that_are_set_up_again_are_complete(kind: PortKind) {
    let (datapath, names) = up(2, Conditions::default(), kind);
    if Command::new("ip").arg("-V").stdout(Stdio::null()).status().is_err() {
        println!("skipped: no ip here");
        return;
    }
    let namespace = datapath.namespace(&names[0]).unwrap();
    let ip = |arguments: &str| {
        let told = inside(namespace, &format!("ip {arguments}")).output().unwrap();
        assert!(told.status.success(), "{arguments}");
        String::from_utf8(told.stdout).unwrap()
    };
    let own = || {
        let mut lines = Vec::new();
        for list in ["-br address show eth0", "route", "-6 route show table all", "neighbour"] {
            let told = ip(list);
            // The kernel resolves these by itself: they say nothing of hosts.
            let own = told.lines().filter(|line| !line.contains("fe80::/64") && !line.contains("ff00::/8"));
            lines.extend(own.map(|line| line.split(" proto ").next().unwrap().trim().to_owned()));
        }
        lines.sort();
        lines
    };
    let before = own();
    for has in ["fd77::1/64", "224.0.0.0/4", "10.77.0.2 dev eth0 lladdr 02:77:00:00:00:02 PERMANENT"] {
        assert!(before.iter().any(|line| line.contains(has)), "{has}: {before:#?}");
    }
    ip("link set eth0 down");
    assert!(!own().iter().any(|line| line.contains("224.0.0.0/4")));
    ip("link set eth0 up");
    wait_until(|| own().iter().any(|line| line.contains("PERMANENT") && line.contains("fd77::2")));
    assert_eq!(own(), before);
}

fn names_are_in_no_shared_folder(_: PortKind) {
    // A file placed there by someone who guessed the name.
    let victim = std::env::temp_dir().join(format!("cotorra-test-victim-{}", process::id()));
    fs::write(&victim, "untouched").unwrap();
    let name = |i: u32| format!("cotorra-hosts-{}-ThreadId({i})", process::id());
    let links: Vec<_> = (1..5000).map(|i| std::env::temp_dir().join(name(i))).collect();
    links.iter().for_each(|link| std::os::unix::fs::symlink(&victim, link).unwrap());
    let hosts = HostsFile::new("10.77.0.9 known");
    let untouched = links.iter().filter(|link| fs::remove_file(link).is_ok()).count();
    assert_eq!((fs::read_to_string(&victim).unwrap().as_str(), untouched), ("untouched", links.len()));
    fs::remove_file(victim).unwrap();
    let hosts = hosts.unwrap();
    let options = SpawnOptions { hosts: Some(&hosts), ..SpawnOptions::default() };
    let mut child =
        Namespace::new().unwrap().spawn(shell("cat /etc/hosts; ls /proc/self/status"), options).unwrap();
    let mut told = String::new();
    child.pipes().1.unwrap().read_to_string(&mut told).unwrap();
    assert_eq!(told, "10.77.0.9 known/proc/self/status\n");
}

fn parent_of(process: u32) -> Option<u32> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    status.lines().find_map(|line| line.strip_prefix("PPid:"))?.trim().parse().ok()
}

fn is_alive(process: u32) -> bool {
    fs::read_to_string(format!("/proc/{process}/stat"))
        .is_ok_and(|stat| !stat.rsplit(')').next().unwrap_or_default().trim().starts_with('Z'))
}

fn descendants(root: u32) -> Vec<u32> {
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let processes = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let is_below = |process: &u32| {
        let mut at = *process;
        while at != root {
            match parent_of(at) {
                Some(parent) if parent > 0 => at = parent,
                _ => return false,
            }
        }
        true
    };
    processes.filter(is_below).collect()
}

/// Waits for the kernel. The test's own time limit bounds this.
#[allow(clippy::disallowed_methods, reason = "no event reports the end of another process's child")]
fn wait_until(condition: impl Fn() -> bool) {
    while !condition() {
        thread::sleep(Duration::from_millis(1));
    }
}
