//! Tests observations of the kernel network's links, in a kernel with NetEm; `scripts/uml --radios 0` boots one in virtual time,
//! where no delay depends on the machine.
//!
//! No packet arrives sooner than NetEm lets it. A measured delay is therefore at least the requested one, and a direction
//! without delay measures less than the other one's.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "tests may panic; the kernel works on the wall clock"
)]

use std::{net::UdpSocket, thread, time::Duration};

use cotorra_datapath::{KernelNetwork, KernelNetworkError, Observed, ReservedHop};
use cotorra_fabric::{Fabric, FabricError, Reservation};
use cotorra_graph::{
    BitRate, Conditions, Direction, HostAddress, LinkId, Loss, Probability, Probing, Rate, Scale, Testbed,
    ThroughputTest,
};

const PROBING: Probing =
    Probing { interval: Duration::from_millis(10), window: Duration::from_millis(4_000) };

/// Two hosts and a switch, whose links have these keys.
fn testbed(left: &str, right: &str) -> Testbed {
    let host = "{ kind: server, tier: edge, cpus: 1, memory: 1 GB }";
    let text = format!(
        "name: lab\nnodes:\n  left: {host}\n  lan: {{ kind: switch }}\n  right: {host}\n\
         links:\n  - {{ id: one, ends: [left, lan], {left} }}\n  - {{ id: two, ends: [lan, right], {right} }}\n"
    );
    cotorra_testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns `None` with a message if the kernel cannot emulate. Panics instead if the environment demands it.
fn start(testbed: &Testbed, probing: Option<Probing>) -> Option<KernelNetwork> {
    let fabric = Fabric::new(&testbed.graph, 1).unwrap();
    match KernelNetwork::start(&testbed.graph, &fabric, probing) {
        Ok(network) => Some(network),
        Err(error @ (KernelNetworkError::Lacks(_) | KernelNetworkError::Datapath(_))) => {
            assert!(
                std::env::var_os("COTORRA_KERNEL").is_none(),
                "COTORRA_KERNEL demands a kernel with NetEm: {error}"
            );
            eprintln!("skipped: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn link(name: &str) -> LinkId {
    name.parse().unwrap()
}

fn observe(network: &KernelNetwork, name: &str, direction: Direction) -> Observed {
    network.observe().unwrap()[&(link(name), direction)]
}

/// Waits until the condition holds for one direction of a link, and returns the observation.
fn wait_until(
    network: &KernelNetwork,
    (name, direction): (&str, Direction),
    holds: impl Fn(&Observed) -> bool,
) -> Observed {
    loop {
        let observed = observe(network, name, direction);
        if holds(&observed) {
            return observed;
        }
        thread::sleep(Duration::from_millis(20));
    }
}

fn delay(observed: &Observed) -> Option<Duration> {
    observed.probed?.delay
}

const MS: Duration = Duration::from_millis(1);

#[test]
fn probes_measure_each_direction_and_follow_changes() {
    let mut testbed =
        testbed("forward: { delay: 100 ms }, backward: { delay: 0 ms }", "delay: 300 ms, loss: 100 %");
    // The file's own scales apply from the start.
    testbed.graph.links[0].scales[0] = Scale { delay_scale: 3.0, drop_scale: 1.0 };
    let Some(network) = start(&testbed, Some(PROBING)) else { return };
    let known = wait_until(&network, ("one", Direction::Forward), |known| delay(known).is_some());
    let probed = known.probed.unwrap();
    assert!(probed.delay.unwrap() >= 300 * MS && probed.loss == Some(0.0), "{probed:?}");
    let back = observe(&network, "one", Direction::Backward);
    assert!(delay(&back).unwrap() < 300 * MS, "{back:?}");
    let lossy = wait_until(&network, ("two", Direction::Forward), |known| known.probed.is_some());
    let probed = lossy.probed.unwrap();
    assert_eq!((probed.delay, probed.loss), (None, Some(1.0)), "{probed:?}");
    assert_eq!(observe(&network, "two", Direction::Backward).probed.unwrap().loss, None, "no probe arrived");

    let slower = Conditions { delay: 600 * MS, ..Conditions::default() };
    network.set(&link("one"), Direction::Backward, &slower).unwrap();
    wait_until(&network, ("one", Direction::Backward), |known| delay(known) >= Some(600 * MS));
    let whole = Conditions { loss: Loss::None, delay: 300 * MS, ..Conditions::default() };
    network.set(&link("two"), Direction::Forward, &whole).unwrap();
    let half = Conditions {
        loss: Loss::Independent { rate: Probability::new(0.5).unwrap() },
        ..Conditions::default()
    };
    network.set(&link("two"), Direction::Backward, &half).unwrap();
    wait_until(&network, ("two", Direction::Forward), |known| known.probed.unwrap().loss == Some(0.0));
    let back = observe(&network, "two", Direction::Backward).probed.unwrap();
    // Of up to 400 probes: 10 standard deviations are 0.25.
    assert!((0.2..0.8).contains(&back.loss.unwrap()), "{back:?}");
}

#[test]
fn probes_are_not_counted_and_can_be_off() {
    let lab = testbed("delay: 1 ms, loss: 50 %", "delay: 1 ms");
    let Some(network) = start(&lab, Some(Probing { interval: MS, ..PROBING })) else { return };
    // Some 2000 probes, half of which got lost.
    while network.lateness().frames < 2_000 {
        thread::sleep(20 * MS);
    }
    for ((name, direction), observed) in network.observe().unwrap() {
        // The hosts' own few neighbour packets.
        let counters = observed.counters;
        assert!(counters.packets < 200 && counters.lost < 200, "{name} {direction:?}: {counters:?}");
        assert!(observed.probed.is_some() && observed.tested.is_none());
    }
    drop(network);
    let silent = start(&lab, None).unwrap();
    thread::sleep(100 * MS);
    assert!(silent.observe().unwrap().values().all(|observed| observed.probed.is_none()));
    assert_eq!(silent.lateness().frames, 0);
}

#[test]
fn lateness_covers_probes_of_deterministic_delay() {
    let lab = testbed("delay: 5 ms, jitter: 1 ms", "delay: 40 ms");
    let Some(network) = start(&lab, Some(PROBING)) else { return };
    wait_until(&network, ("one", Direction::Backward), |known| delay(known).is_some());
    while network.lateness().frames < 20 {
        thread::sleep(20 * MS);
    }
    let two = observe(&network, "two", Direction::Forward);
    // The worst of all probes is at least as late as the mean of one direction.
    let late_us = (delay(&two).unwrap() - 40 * MS).as_secs_f64() * 1e6;
    let lateness = network.lateness();
    assert!(lateness.max_us >= late_us, "{lateness:?}, {two:?}");
    // The other link's probes vary by five milliseconds and are not included.
    let jitter = observe(&network, "one", Direction::Forward).probed.unwrap().jitter.unwrap();
    assert!(jitter > Duration::ZERO);
}

#[test]
fn throughput_tests_measure_links_within_bounds() {
    let lab = testbed("delay: 5 ms, rate: 8 Mbit/s", "delay: 5 ms");
    let Some(network) = start(&lab, None) else { return };
    let test = |duration_ms, mbps| ThroughputTest {
        duration: Duration::from_millis(duration_ms),
        rate_limit: BitRate::from_mbps(mbps),
    };
    let (one, backward) = (link("one"), Direction::Backward);
    for (name, asked, refused) in [
        (&one, test(11_000, 1.0), FabricError::TestDuration(Duration::from_secs(11))),
        (&one, test(500, 1_001.0), FabricError::TestRate(BitRate::from_mbps(1_001.0).unwrap())),
        (&link("other"), test(500, 1.0), FabricError::UnknownLink(link("other"))),
    ] {
        assert_eq!(network.test_throughput(name, backward, asked), Err(refused));
    }
    network.test_throughput(&one, backward, test(1_000, 24.0)).unwrap();
    let again = network.test_throughput(&one, backward, test(1_000, 24.0));
    assert!(matches!(again, Err(FabricError::TestTooSoon { .. })), "{again:?}");
    let known = wait_until(&network, ("one", Direction::Backward), |known| known.tested.is_some());
    let tested = known.tested.unwrap();
    // Three times as much was sent, if the machine kept up.
    assert!((4e6..12e6).contains(&tested.throughput_bps) && tested.offered_bps <= 24e6, "{tested:?}");
    assert!(known.counters.packets < 200 && known.counters.lost < 200, "{known:?}");
    assert_eq!(observe(&network, "one", Direction::Forward).tested, None);
    // A test without a rate uses the rate of the link's conditions.
    let faster = Conditions {
        rate: Rate::Fixed { bits_per_second: BitRate::from_mbps(2.0).unwrap() },
        ..Conditions::default()
    };
    network.set(&link("two"), backward, &faster).unwrap();
    let half_a_second = ThroughputTest { duration: 500 * MS, rate_limit: None };
    network.test_throughput(&link("two"), backward, half_a_second).unwrap();
    let known = wait_until(&network, ("two", Direction::Backward), |known| known.tested.is_some());
    assert!(known.tested.unwrap().offered_bps <= 2.2e6, "{known:?}");
}

/// Three hosts at a switch. Two send to the third over its link.
fn funnel(right: &str) -> Testbed {
    let host = "{ kind: server, tier: edge, cpus: 1, memory: 1 GB }";
    let text = format!(
        "name: lab\nnodes:\n  left: {host}\n  other: {host}\n  lan: {{ kind: switch }}\n  right: {host}\n\
         links:\n  - {{ ends: [lan, [left, other]] }}\n  - {{ id: two, ends: [lan, right], {right} }}\n"
    );
    cotorra_testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap_or_else(|error| panic!("{error}"))
}

fn reserved(from: &str, mbps: f64, is_limited: bool) -> ReservedHop {
    let reservation = Reservation { rate: BitRate::from_mbps(mbps).unwrap(), is_limited };
    let [from, to] = [from, "right"].map(|name| name.parse().unwrap());
    ReservedHop { link: link("two"), direction: Direction::Forward, from, to, reservation }
}

const FRAMES: usize = 300;
const PAYLOAD: usize = 1472;

/// Lets both hosts send as many full frames to the third as fast as they can. Returns how many of `slow` arrive while those of
/// `fast` do, in shares of all.
fn share(network: &KernelNetwork, fast: &str, slow: &str) -> f64 {
    let namespace = |name: &str| network.namespace(&name.parse().unwrap()).unwrap();
    let right = HostAddress::of(2).ipv4;
    let pairs = [fast, slow].map(|name| {
        let to = namespace("right").udp_socket((right, 0)).unwrap();
        to.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let from = namespace(name).udp_socket("0.0.0.0:0").unwrap();
        from.connect(to.local_addr().unwrap()).unwrap();
        // Neighbours are known before it counts.
        from.send(&[0; 10]).unwrap();
        to.recv(&mut [0; 10]).unwrap();
        (from, to)
    });
    thread::scope(|scope| {
        for (from, _) in &pairs {
            scope.spawn(|| (0..FRAMES).for_each(|_| assert_eq!(from.send(&[0; PAYLOAD]).unwrap(), PAYLOAD)));
        }
        let [(_, fast), (_, slow)] = &pairs;
        let receive = |socket: &UdpSocket| socket.recv(&mut [0; 2000]).unwrap();
        (0..FRAMES).for_each(|_| assert_eq!(receive(fast), PAYLOAD));
        slow.set_nonblocking(true).unwrap();
        let meanwhile = std::iter::from_fn(|| slow.recv(&mut [0; 2000]).ok()).count();
        slow.set_nonblocking(false).unwrap();
        (meanwhile..FRAMES).for_each(|_| assert_eq!(receive(slow), PAYLOAD));
        meanwhile as f64 / FRAMES as f64
    })
}

#[test]
fn reservations_are_kept_by_htb_and_follow_the_links_rate() {
    let lab = funnel("delay: 2 ms, rate: 8 Mbit/s, queue: 2000 packets");
    let Some(network) = start(&lab, None) else { return };
    // A fifth of what is right is more than the first packets and the buckets explain.
    let assert_share = |fast: &str, slow: &str, expected: f64| {
        let share = share(&network, fast, slow);
        println!("{slow} beside {fast}: {share:.3} of {expected:.3}");
        assert!((share / expected - 1.0).abs() < 0.2, "{slow} beside {fast}: {share} of {expected}");
    };
    network.reserve(&[reserved("left", 6.0, false)]).unwrap();
    assert_share("left", "other", 1.0 / 3.0);
    network.reserve(&[reserved("left", 2.0, true), reserved("other", 6.0, false)]).unwrap();
    assert_share("other", "left", 1.0 / 3.0);
    let faster = Conditions {
        delay: 2 * MS,
        rate: Rate::Fixed { bits_per_second: BitRate::from_mbps(12.0).unwrap() },
        ..lab.graph.links[2].forward.clone()
    };
    network.set(&link("two"), Direction::Forward, &faster).unwrap();
    assert_share("other", "left", 2.0 / 10.0);
    let counters = || observe(&network, "two", Direction::Forward).counters;
    let before = counters();
    assert!(before.packets >= 6 * FRAMES as u64, "{before:?}");
    network.reserve(&[]).unwrap();
    // Counters go on when the classes are gone.
    let after = counters();
    assert!(after.packets >= before.packets && after.lost == before.lost, "{before:?} and {after:?}");
    network.set(&link("two"), Direction::Forward, &faster).unwrap();
}
