//! Readings of this machine, beside independent witnesses.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{fs, os::unix::fs::MetadataExt, process::Command, time::Duration};

use cotorra_datapath::Namespace;
use cotorra_graph::{BitRate, InterfaceContext};
use cotorra_host::{Host, Part, Reading, Timestamp};

const SECOND: Timestamp = Timestamp::from_nanos(1_000_000_000);

fn host() -> Host {
    Host::new("machine".parse().unwrap())
}

/// Returns a new network namespace; `None` for an ordinary user, who cannot make one among the test's threads.
fn namespace() -> Option<Namespace> {
    let is_root = fs::metadata("/proc/self").unwrap().uid() == 0;
    is_root.then(|| {
        let namespace = Namespace::new().unwrap();
        // Nothing but the test's own packets is counted.
        let off = "/proc/sys/net/ipv6/conf/default/disable_ipv6";
        namespace.run(|| {
            if fs::exists(off).unwrap() {
                fs::write(off, "1").unwrap()
            }
        });
        namespace
    })
}

fn sh(namespace: &Namespace, line: &str) {
    let output = namespace.run(|| Command::new("sh").args(["-ec", line]).output().unwrap());
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

fn interface<'a>(reading: &'a Reading, name: &str) -> &'a InterfaceContext {
    reading.context.interfaces.iter().find(|interface| interface.name == name).unwrap()
}

#[test]
fn this_machine_has_cpus_memory_and_a_loopback_interface() {
    let mut host = host();
    let first = host.read(Timestamp::ZERO);
    let context = first.context;

    let present = fs::read_to_string("/sys/devices/system/cpu/online").unwrap();
    let online: u32 = present
        .trim()
        .split(',')
        .map(|range| {
            let (first, last) = range.split_once('-').unwrap_or((range, range));
            last.parse::<u32>().unwrap() - first.parse::<u32>().unwrap() + 1
        })
        .sum();
    let cpu = context.cpu.unwrap();
    assert_eq!((cpu.cpus, cpu.busy), (online, None));
    let memory = context.memory.unwrap();
    assert!(memory.available_bytes > 0 && memory.available_bytes <= memory.memory_bytes, "{memory:?}");
    assert!(context.load_average.is_some());
    let lo = context.interfaces.iter().find(|interface| interface.name == "lo").unwrap();
    assert_eq!(lo.received.bytes, lo.sent.bytes);

    // The kernel need not have nl80211. Everything else is there, and nothing is reported again.
    assert!(first.unavailable.iter().all(|missing| missing.part == Part::Wifi), "{:?}", first.unavailable);
    let second = host.read(SECOND);
    assert!(second.unavailable.is_empty(), "{:?}", second.unavailable);
    assert!(interface(&second, "lo").received.throughput_bps.is_some());
}

#[test]
fn interfaces_have_the_state_speed_and_rate_that_the_kernel_gave_them() {
    let (Some(a), Some(b)) = (namespace(), namespace()) else {
        eprintln!("skipped: needs root");
        return;
    };
    let peer = b.path();
    sh(
        &a,
        &format!(
            "ip link add va mtu 1400 type veth peer name vb address 02:00:00:00:00:02 netns {}
             ip address add 10.0.0.1/24 dev va; ip link set va up
             ip neighbour replace 10.0.0.2 lladdr 02:00:00:00:00:02 dev va nud permanent",
            peer.display()
        ),
    );
    let mut host = host();
    let reading = a.run(|| host.read(Timestamp::ZERO));
    let va = interface(&reading, "va");
    assert_eq!((va.up, va.carrier, va.mtu_bytes), (true, false, 1400));
    assert_eq!(va.sent.packets, 0);

    sh(&b, "ip address add 10.0.0.2/24 dev vb; ip link set vb up");
    let reading = a.run(|| host.read(SECOND));
    let va = interface(&reading, "va");
    assert!(va.carrier);
    // The speed that the kernel's veth claims.
    assert_eq!(va.speed, BitRate::from_mbps(10_000.0));
    assert_eq!(reading.context.interfaces[0].name, "lo");
    assert_eq!(reading.context.interfaces[0].speed, None);

    // The receiver keeps the kernel from answering that there is none.
    let receiver = b.udp_socket("10.0.0.2:0").unwrap();
    let sender = a.udp_socket("10.0.0.1:0").unwrap();
    const PACKETS: u64 = 100;
    for _ in 0..PACKETS {
        sender.send_to(&[0; 972], receiver.local_addr().unwrap()).unwrap();
    }
    let reading = a.run(|| host.read(SECOND + Duration::from_secs(2)));
    let va = interface(&reading, "va");
    // With the headers of UDP, IPv4 and Ethernet.
    const BYTES: u64 = 972 + 8 + 20 + 14;
    assert_eq!((va.sent.packets, va.sent.bytes), (PACKETS, PACKETS * BYTES));
    assert_eq!(va.sent.throughput_bps, Some((PACKETS * BYTES * 8) as f64 / 2.0));
    assert_eq!((va.sent.errors, va.sent.dropped), (0, 0));
    let reading = b.run(|| self::host().read(SECOND));
    let vb = interface(&reading, "vb");
    assert_eq!((vb.received.packets, vb.received.bytes), (PACKETS, PACKETS * BYTES));
}

#[test]
fn interfaces_beyond_the_bound_are_counted() {
    let Some(namespace) = namespace() else {
        eprintln!("skipped: needs root");
        return;
    };
    sh(&namespace, "for n in $(seq 40); do ip link add a$n type veth peer name b$n; done");
    let all = namespace.run(|| fs::read_to_string("/proc/thread-self/net/dev").unwrap()).lines().count() - 2;
    let context = namespace.run(|| host().read(Timestamp::ZERO)).context;
    assert!(all >= 81, "{all}");
    assert_eq!((context.interfaces.len(), context.interfaces_left_out as usize), (64, all - 64));
    assert_eq!(context.interfaces[0].name, "lo");
}
