//! Compares conditions with those that a real kernel applies, with `tc` as an independent witness. Needs a kernel
//! with NetEm; `scripts/uml --radios 0` boots one in virtual time.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "packets are timed on the wall clock"
)]

use std::{
    collections::BTreeMap,
    io,
    net::{IpAddr, SocketAddr, UdpSocket},
    process::Command,
    time::{Duration, Instant},
};

use cotorra_datapath::Namespace;
use cotorra_graph::{BitRate, IpNetwork, Probability};
use cotorra_netem::{Device, DisciplineError, Distribution, Error, Jitter, Kernel, Loss, Netem, Rule, Side};
use proptest::prelude::*;

/// Two hosts and a wire: `a` at 10.0.0.1 with the interface `va`, `b` at 10.0.0.2 and 10.0.0.3 with `vb`.
struct Wire {
    a: Namespace,
    b: Namespace,
}

fn sh(namespace: &Namespace, line: &str) -> String {
    let output = namespace.run(|| Command::new("sh").args(["-ec", line]).output().unwrap());
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{line}: {text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

impl Wire {
    /// Returns `None` with a message if the kernel has no NetEm. Panics instead if the environment demands NetEm.
    fn new() -> Option<Self> {
        let rig = std::env::var_os("COTORRA_KERNEL").is_some();
        let a = match Namespace::new() {
            Ok(namespace) => namespace,
            Err(error) if !rig => {
                eprintln!("skipped: {error}");
                return None;
            }
            Err(error) => panic!("{error}"),
        };
        let lacks = a.run(|| Kernel::open().unwrap().lacks().unwrap());
        if !lacks.is_empty() {
            assert!(!rig, "the rig's kernel lacks {lacks:?}");
            eprintln!("skipped: this kernel lacks {}", lacks.join(", "));
            return None;
        }
        let b = Namespace::new().unwrap();
        let wire = Self { a, b };
        let there = wire.b.path();
        sh(&wire.a, &format!("ip link add va type veth peer name vb netns {}", there.display()));
        sh(
            &wire.a,
            "ip address add 10.0.0.1/24 dev va; ip address add fd00::1/64 dev va nodad; ip link set va up",
        );
        sh(
            &wire.b,
            "for a in 10.0.0.2/24 10.0.0.3/24; do ip address add $a dev vb; done
                     ip address add fd00::2/64 dev vb nodad; ip link set vb up",
        );
        // Static neighbours avoid ARP while packets are counted.
        let mac = sh(&wire.b, "ip -brief link show vb | awk '{print $3}'");
        for address in ["10.0.0.2", "10.0.0.3", "fd00::2"] {
            sh(
                &wire.a,
                &format!("ip neighbour replace {address} lladdr {} dev va nud permanent", mac.trim()),
            );
        }
        // Router solicitations would be counted, too.
        sh(
            &wire.a,
            "until ip -6 -brief address show dev va | grep -q fe80; do :; done; ip -6 address flush dev va scope link",
        );
        Some(wire)
    }

    fn device(&self) -> Device {
        self.a.run(|| Kernel::open().unwrap().device("va").unwrap())
    }

    fn try_set(&self, rule: &Rule) -> Result<(), Error> {
        let plan = self.device().set(rule, false).unwrap();
        self.a.run(|| Kernel::open().unwrap().apply(&plan))
    }

    fn set(&self, netem: Netem) {
        self.try_set(&Rule { netem, ..Rule::default() }).unwrap();
    }

    fn rules(&self) -> Vec<Rule> {
        self.device().rules().map(|(rule, _)| rule).collect()
    }

    fn receiver(&self, address: &str) -> UdpSocket {
        let address: IpAddr = address.parse().unwrap();
        self.b.udp_socket(SocketAddr::new(address, 0)).unwrap()
    }

    fn sender(&self, to: &UdpSocket) -> UdpSocket {
        let to = to.local_addr().unwrap();
        let any: IpAddr = if to.is_ipv4() { [0; 4].into() } else { [0; 16].into() };
        let socket = self.a.udp_socket(SocketAddr::new(any, 0)).unwrap();
        socket.connect(to).unwrap();
        socket
    }

    /// Sends numbered packets, slowly enough that none overflows. Returns the numbers that arrived, in order, with
    /// their transit times.
    fn send(&self, to: &str, count: u32, bytes: usize, gap: Duration) -> Vec<(u32, Duration)> {
        self.exchange(to, count, bytes, gap, true)
    }

    /// Sends all packets at once, and stops when nothing arrives any more.
    fn send_without_last(&self, to: &str, count: u32, bytes: usize) -> Vec<(u32, Duration)> {
        self.exchange(to, count, bytes, Duration::ZERO, false)
    }

    fn exchange(
        &self,
        to: &str,
        count: u32,
        bytes: usize,
        gap: Duration,
        last: bool,
    ) -> Vec<(u32, Duration)> {
        let receiver = self.receiver(to);
        let sender = self.sender(&receiver);
        let begin = Instant::now();
        let receive = std::thread::spawn(move || receive(&receiver, begin));
        let mut packet = vec![0; bytes.max(16)];
        for number in 0..count {
            let now = begin.elapsed();
            packet[..4].copy_from_slice(&number.to_ne_bytes());
            packet[4..12].copy_from_slice(&(now.as_nanos() as u64).to_ne_bytes());
            // A full discipline reports it.
            let _ = sender.send(&packet);
            if number % 100 == 99 {
                // The receiver's buffer holds some 200.
                std::thread::sleep(ms(1));
            }
            while begin.elapsed() < gap * (number + 1) {
                std::thread::sleep(gap / 4);
            }
        }
        packet[..4].copy_from_slice(&LAST.to_ne_bytes());
        while last && !receive.is_finished() {
            // Repeat until it arrives, or nothing does.
            let _ = sender.send(&packet);
            std::thread::sleep(ms(20));
        }
        receive.join().unwrap()
    }
}

/// Number of the packet that ends an exchange.
const LAST: u32 = u32::MAX;

/// Collects packets until the last one, or until two seconds pass without any.
fn receive(socket: &UdpSocket, begin: Instant) -> Vec<(u32, Duration)> {
    socket.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    let mut arrived = Vec::new();
    let mut packet = [0; 2048];
    loop {
        match socket.recv(&mut packet) {
            Ok(_) => {
                let number = u32::from_ne_bytes(*packet.first_chunk().unwrap());
                if number == LAST {
                    return arrived;
                }
                let sent = u64::from_ne_bytes(*packet[4..].first_chunk().unwrap());
                arrived.push((number, begin.elapsed().saturating_sub(Duration::from_nanos(sent))));
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return arrived,
            Err(error) => panic!("{error}"),
        }
    }
}

fn p(p: f64) -> Probability {
    Probability::new(p).unwrap()
}

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Repeats a measurement until it is as expected. A busy machine delays packets now and then; a wrong condition fails
/// every time.
fn soon<T: std::fmt::Debug>(mut measure: impl FnMut() -> T, is_expected: impl Fn(&T) -> bool) {
    let mut measured = Vec::new();
    while measured.len() < 20 {
        let value = measure();
        if is_expected(&value) {
            return;
        }
        measured.push(value);
    }
    panic!("never as expected: {measured:?}");
}

fn fastest(arrived: &[(u32, Duration)]) -> Duration {
    arrived.iter().map(|(_, took)| *took).min().expect("something arrived")
}

#[test]
fn packets_take_the_delay() {
    let Some(wire) = Wire::new() else { return };
    soon(|| fastest(&wire.send("10.0.0.2", 20, 64, ms(1))), |took| *took < ms(20));
    wire.set(Netem { delay: ms(20), ..Netem::default() });
    let measure = || {
        let arrived = wire.send("10.0.0.2", 20, 64, ms(1));
        assert_eq!(arrived.len(), 20);
        let fastest = fastest(&arrived);
        assert!(fastest >= ms(20), "{fastest:?}");
        fastest
    };
    soon(measure, |took| *took < ms(40));
    let witness = sh(&wire.a, "tc qdisc show dev va");
    assert!(witness.contains("qdisc netem c070: root") && witness.contains("delay 20ms"), "{witness}");
}

#[test]
fn jitter_has_its_deviation_and_keeps_order() {
    let Some(wire) = Wire::new() else { return };
    let jitter = |distribution| Some(Jitter { deviation: ms(5), distribution: Some(distribution) });
    for distribution in Distribution::ALL {
        wire.set(Netem { delay: ms(30), jitter: jitter(distribution), ..Netem::default() });
        let arrived = wire.send("10.0.0.2", 200, 64, Duration::ZERO);
        assert!(arrived.is_sorted_by_key(|(number, _)| *number), "{distribution:?}");
        assert_eq!(arrived.len(), 200, "{distribution:?}");
    }
    let free =
        Netem { delay: ms(30), jitter: jitter(Distribution::Normal), in_order: false, ..Netem::default() };
    wire.set(free);
    let deviation = || {
        let arrived = wire.send("10.0.0.2", 200, 64, Duration::ZERO);
        assert!(!arrived.is_sorted_by_key(|(number, _)| *number), "order was not requested");
        // All were sent at once, so the differences are the jitter.
        let took: Vec<_> = arrived.iter().map(|(_, took)| took.as_secs_f64() * 1e3).collect();
        let mean = took.iter().sum::<f64>() / took.len() as f64;
        (took.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / took.len() as f64).sqrt()
    };
    soon(deviation, |deviation| (4.0..6.0).contains(deviation));
    let witness = sh(&wire.a, "tc qdisc show dev va");
    assert!(witness.contains("delay 30ms  5ms"), "{witness}");
}

#[test]
fn losses_match_the_rate_and_the_kernels_count() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { loss: Loss::Independent { rate: p(0.1) }, ..Netem::default() });
    let arrived = wire.send("10.0.0.2", 4000, 64, Duration::ZERO);
    let lost = 4000 - arrived.len();
    // Five standard deviations of a binomial.
    assert!((305..=495).contains(&lost), "{lost}");
    let counters = wire.device().rules().next().unwrap().1;
    // The last packet may have been lost a few times, too.
    assert!((lost as u64..lost as u64 + 10).contains(&counters.dropped), "{lost} {counters:?}");
    let witness = sh(&wire.a, "tc -s qdisc show dev va");
    assert!(
        witness.contains("loss 10%") && witness.contains(&format!("dropped {}", counters.dropped)),
        "{witness}"
    );
}

#[test]
fn bursts_have_the_requested_length() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { loss: Loss::bursty(p(0.2), 10.0).unwrap(), ..Netem::default() });
    let arrived = wire.send("10.0.0.2", 20_000, 64, Duration::ZERO);
    let share = 1.0 - arrived.len() as f64 / 20_000.0;
    assert!((0.12..0.28).contains(&share), "{share}");
    let gaps: Vec<_> = arrived.windows(2).map(|w| w[1].0 - w[0].0 - 1).filter(|gap| *gap > 0).collect();
    let mean = f64::from(gaps.iter().sum::<u32>()) / gaps.len() as f64;
    assert!((7.0..13.0).contains(&mean), "{mean}");
    let witness = sh(&wire.a, "tc qdisc show dev va");
    assert!(witness.contains("loss gemodel p 2.5% r 10% 1-h 100% 1-k 0%"), "{witness}");
}

#[test]
fn burst_models_keep_their_state_when_other_parameters_change() {
    let Some(wire) = Wire::new() else { return };
    // The first packet enters the bad state, which never ends.
    let loss = Loss::GilbertElliott {
        to_bad: Probability::ONE,
        to_good: Probability::ZERO,
        lost_in_bad: Probability::ONE,
        lost_in_good: Probability::ZERO,
    };
    // A packet sent by the kernel itself, such as a multicast listener report, would be that first packet.
    sh(&wire.a, "echo 1 >/proc/sys/net/ipv6/conf/va/disable_ipv6");
    wire.set(Netem { loss, ..Netem::default() });
    assert_eq!(wire.send("10.0.0.2", 10, 64, Duration::ZERO).len(), 1);
    wire.set(Netem { loss, delay: ms(1), ..Netem::default() });
    assert_eq!(wire.send("10.0.0.2", 10, 64, Duration::ZERO).len(), 0);
    let witness = sh(&wire.a, "tc qdisc show dev va");
    assert!(
        witness.contains("delay 1ms") && witness.contains("gemodel p 100% r 0% 1-h 100% 1-k 0%"),
        "{witness}"
    );
}

#[test]
fn changes_neither_lose_nor_reorder_packets() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { delay: ms(500), ..Netem::default() });
    let receiver = wire.receiver("10.0.0.2");
    let sender = wire.sender(&receiver);
    let begin = Instant::now();
    for number in 0_u32..200 {
        if number % 50 == 49 {
            let delay = ms(u64::from(number / 50) * 100);
            wire.set(Netem { delay, rate: BitRate::from_mbps(100.0), ..Netem::default() });
        }
        let mut packet = [0; 16];
        packet[..4].copy_from_slice(&number.to_ne_bytes());
        sender.send(&packet).unwrap();
    }
    let mut last = [0xff; 16];
    last[4..].fill(0);
    sender.send(&last).unwrap();
    let arrived: Vec<_> = receive(&receiver, begin).into_iter().map(|(number, _)| number).collect();
    assert_eq!(arrived, (0..200).collect::<Vec<_>>());
    assert!(begin.elapsed() >= ms(500), "the first packet stayed in flight");
}

#[test]
fn a_rate_is_kept() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { rate: BitRate::from_mbps(0.8), ..Netem::default() });
    // 20 packets of 958 + 42 bytes at 0.8 Mbit/s: 10 ms each. A token bucket's burst would let them pass.
    let measure = || {
        let arrived = wire.send("10.0.0.2", 20, 958, Duration::ZERO);
        assert_eq!(arrived.len(), 20);
        arrived.last().unwrap().1
    };
    soon(measure, |last| (ms(150)..ms(600)).contains(last));
    assert!(sh(&wire.a, "tc qdisc show dev va").contains("rate 800Kbit"));
}

#[test]
fn limit_counts_packets_in_flight() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { delay: ms(300), limit: Some(50), ..Netem::default() });
    // IPv6 router and group messages of the kernel take a place, too.
    soon(|| wire.send_without_last("10.0.0.2", 100, 64).len(), |arrived| (40..=50).contains(arrived));
}

#[test]
fn packets_are_duplicated_corrupted_and_reordered() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { duplication: Probability::ONE, ..Netem::default() });
    assert_eq!(wire.send("10.0.0.2", 10, 64, Duration::ZERO).len(), 20);
    wire.set(Netem { reordering: p(0.5), delay: ms(50), ..Netem::default() });
    // The last packet would overtake others, too.
    let not_delayed = || {
        let arrived = wire.send_without_last("10.0.0.2", 100, 64);
        assert_eq!(arrived.len(), 100);
        arrived.iter().filter(|(_, took)| *took < ms(40)).count()
    };
    soon(not_delayed, |fast| (20..=80).contains(fast));
    wire.set(Netem { corruption: Probability::ONE, ..Netem::default() });
    // A flipped bit fails a checksum or changes an address. Bits of the sender's address do not matter.
    let arrived = wire.send_without_last("10.0.0.2", 50, 500).len();
    assert!(arrived < 10, "{arrived}");
    assert!(sh(&wire.a, "tc qdisc show dev va").contains("corrupt 100%"));
}

fn to(network: &str, delay: u64) -> Rule {
    let network = (!network.is_empty()).then(|| network.parse::<IpNetwork>().unwrap());
    Rule { side: Side::Egress, network, netem: Netem { delay: ms(delay), ..Netem::default() } }
}

#[test]
fn each_destination_has_its_own_conditions() {
    let Some(wire) = Wire::new() else { return };
    let delays = |wire: &Wire| {
        ["10.0.0.2", "10.0.0.3", "fd00::2"].map(|address| {
            let fastest = fastest(&wire.send(address, 10, 64, Duration::ZERO));
            // Tens of milliseconds: load rarely blurs them in the best of ten.
            fastest.as_millis() / 40 * 40
        })
    };
    wire.try_set(&to("10.0.0.3", 80)).unwrap();
    soon(|| delays(&wire), |delays| *delays == [0, 80, 0]);
    wire.try_set(&to("fd00::/16", 120)).unwrap();
    soon(|| delays(&wire), |delays| *delays == [0, 80, 120]);
    wire.try_set(&to("10.0.0.0/24", 160)).unwrap();
    // The longest prefix wins.
    soon(|| delays(&wire), |delays| *delays == [160, 80, 120]);
    wire.try_set(&to("10.0.0.3", 200)).unwrap();
    // Changed in place.
    soon(|| delays(&wire), |delays| *delays == [160, 200, 120]);
    let asked = [to("10.0.0.3", 200), to("10.0.0.0/24", 160), to("fd00::/16", 120)];
    let kept: BTreeMap<_, _> = wire.rules().into_iter().map(|rule| (rule.network, rule.netem)).collect();
    assert_eq!(kept, asked.into_iter().map(|rule| (rule.network, rule.netem.as_kept())).collect());
    let plan = wire.device().remove(Side::Egress, Some("10.0.0.3".parse().unwrap()), None);
    wire.a.run(|| Kernel::open().unwrap().apply(&plan).unwrap());
    soon(|| delays(&wire), |delays| *delays == [160, 160, 120]);
    let plan = wire.device().clear(Side::Egress, None);
    wire.a.run(|| Kernel::open().unwrap().apply(&plan).unwrap());
    soon(|| delays(&wire), |delays| *delays == [0, 0, 0]);
    assert!(!sh(&wire.a, "tc qdisc show dev va").contains("netem"));
}

#[test]
fn rule_for_all_packets_becomes_the_fallback_of_several() {
    let Some(wire) = Wire::new() else { return };
    wire.try_set(&to("", 40)).unwrap();
    let plan = wire.device().set(&to("10.0.0.3", 80), false).unwrap();
    assert!(plan.loses_packets(), "recreating the root loses packets");
    wire.try_set(&to("10.0.0.3", 80)).unwrap();
    assert!(!wire.device().set(&to("10.0.0.3", 90), false).unwrap().loses_packets());
    let rules: Vec<_> = wire.rules().iter().map(|rule| (rule.network, rule.netem.delay)).collect();
    assert_eq!(rules, [(None, ms(40)), (Some("10.0.0.3".parse().unwrap()), ms(80))]);
    assert!(fastest(&wire.send("10.0.0.2", 5, 64, ms(1))) >= ms(40));
    assert!(fastest(&wire.send("10.0.0.3", 5, 64, ms(1))) >= ms(80));
}

#[test]
fn ingress_packets_are_conditioned() {
    let Some(wire) = Wire::new() else { return };
    let at_b = |rule: &Rule| {
        wire.b.run(|| {
            let kernel = Kernel::open().unwrap();
            kernel.apply(&kernel.device("vb").unwrap().set(rule, false).unwrap()).unwrap();
        });
    };
    let netem = |delay| Netem { delay: ms(delay), ..Netem::default() };
    at_b(&Rule { side: Side::Ingress, network: None, netem: netem(40) });
    assert!(fastest(&wire.send("10.0.0.2", 5, 64, ms(1))) >= ms(40));
    at_b(&Rule { side: Side::Ingress, network: Some("10.0.0.1".parse().unwrap()), netem: netem(80) });
    assert!(fastest(&wire.send("10.0.0.2", 5, 64, ms(1))) >= ms(80));
    let v6 = || fastest(&wire.send("fd00::2", 5, 64, ms(1)));
    soon(v6, |took| (ms(40)..ms(80)).contains(took));
    wire.b.run(|| {
        let kernel = Kernel::open().unwrap();
        kernel.apply(&kernel.device("vb").unwrap().clear(Side::Ingress, None)).unwrap();
    });
    soon(|| fastest(&wire.send("10.0.0.2", 5, 64, ms(1))), |took| *took < ms(40));
    assert!(!sh(&wire.b, "ip link; tc qdisc show dev vb").contains("ingress"), "the detour is gone");
}

#[test]
fn foreign_disciplines_are_kept_or_restored() {
    let Some(wire) = Wire::new() else { return };
    sh(&wire.a, "tc qdisc add dev va root handle 7: pfifo limit 77");
    let rule = to("", 40);
    let device = wire.device();
    let refusal = device.set(&rule, false).unwrap_err();
    assert!(matches!(&refusal, DisciplineError::Foreign { kind, .. } if kind == "pfifo"), "{refusal}");
    let replaced = device.foreign().unwrap().clone();
    let plan = device.set(&rule, true).unwrap();
    wire.a.run(|| Kernel::open().unwrap().apply(&plan).unwrap());
    assert!(sh(&wire.a, "tc qdisc show dev va").contains("netem"));
    let plan = wire.device().clear(Side::Egress, Some(&replaced));
    wire.a.run(|| Kernel::open().unwrap().apply(&plan).unwrap());
    let witness = sh(&wire.a, "tc qdisc show dev va");
    assert!(witness.contains("qdisc pfifo 7: root") && witness.contains("limit 77p"), "{witness}");
    sh(
        &wire.a,
        "tc qdisc delete dev va root; tc qdisc add dev va root handle 8: prio; tc qdisc add dev va parent 8:1 pfifo",
    );
    assert!(matches!(wire.device().set(&rule, true), Err(DisciplineError::ForeignTree { .. })));
}

#[test]
fn failed_plans_change_nothing() {
    let Some(wire) = Wire::new() else { return };
    let stale = wire.device().set(&to("10.0.0.3", 80), false).unwrap();
    sh(&wire.a, "tc qdisc add dev va root handle 7: pfifo");
    let error = wire.a.run(|| Kernel::open().unwrap().apply(&stale).unwrap_err());
    assert!(matches!(&error, Error::Refused { .. }), "{error}");
    assert!(sh(&wire.a, "tc qdisc show dev va").contains("pfifo 7: root"));
    let nowhere = wire.a.run(|| Kernel::open().unwrap().device("eth9").unwrap_err().to_string());
    assert!(nowhere.contains("no interface `eth9` here: there are lo, va"), "{nowhere}");
}

/// The kernel reports the requested parameters in its units, except for those that it never reports.
#[test]
fn the_kernel_reports_the_requested_parameters() {
    let Some(wire) = Wire::new() else { return };
    let any_p = || prop_oneof![Just(0.0), Just(1.0), 0.0..1.0].prop_map(p);
    let any_loss = prop_oneof![
        Just(Loss::None),
        any_p().prop_map(|rate| Loss::Independent { rate }),
        (0.0..0.9, 10.0..50.0).prop_map(|(rate, burst)| Loss::bursty(p(rate), burst).unwrap()),
    ];
    let any = (
        0_u64..10_000_000_000,
        0_u64..2_000_000_000,
        any_loss,
        [any_p(), any_p(), any_p()],
        0_u64..100_000_000_000,
        1_u32..100_000,
        any::<bool>(),
    );
    let config = ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |((delay, deviation, loss, [duplication, corruption, reordering], rate, limit, in_order) in any)| {
        let jitter = Jitter { deviation: Duration::from_nanos(deviation), distribution: None };
        let netem = Netem {
            delay: Duration::from_nanos(delay),
            jitter: (deviation > 0).then_some(jitter),
            loss, duplication, corruption, reordering,
            rate: BitRate::from_bits_per_second(rate),
            limit: Some(limit),
            in_order,
            seed: None,
        };
        wire.set(netem.clone());
        let mut kept = wire.rules().remove(0).netem;
        // Newer kernels report the seed that they chose.
        kept.seed = None;
        prop_assert_eq!(kept, netem.as_kept());
    });
}

#[test]
fn seeds_are_kept_or_reported_unsupported() {
    let Some(wire) = Wire::new() else { return };
    wire.set(Netem { seed: Some(42), ..Netem::default() });
    let kept = wire.rules().remove(0).netem.seed;
    let takes_seeds = wire.a.run(|| Kernel::open().unwrap().takes_seeds().unwrap());
    assert_eq!(kept, takes_seeds.then_some(42));
}
