//! Sources of traffic that need no program.

use cotorra_traffic::{TcpMeasured, UdpMeasured};

use super::*;

/// Runs two servers with a link of 10 Mbit/s and 10 ms between them, and returns what arrived of each source in 20 s.
fn measured(queue: &str, traffic: &str) -> Vec<Measured> {
    let text = format!(
        "name: traffic\nnodes:\n  a: {{ kind: server, tier: fog, cpus: 1, memory: 1 GB }}\n  \
         b: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}\nprobes: none\n\
         links:\n  - {{ ends: [a, b], delay: 10 ms, rate: 10 Mbit/s, queue: {queue} }}\ntraffic:\n{traffic}"
    );
    let testbed = cotorra_testbed_file::parse("test.yaml", &text, Path::new("")).unwrap();
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    while simulation.step().as_secs_f64() < 20.0 {}
    let balance = simulation.packets();
    assert!(balance.is_even(), "{balance:?}");
    simulation.traffic()
}

/// Returns the goodput of a source, Mbit/s.
fn mbps(of: &Measured) -> f64 {
    of.goodput_bps / 1e6
}

/// Returns the most that the link can carry of payloads of so many bytes, Mbit/s.
fn most(payload: f64) -> f64 {
    10.0 * payload / 1514.0
}

#[test]
fn bbr_leaves_the_queue_of_a_link_nearly_empty_and_cubic_fills_it() {
    let trips = |control| {
        let source = format!("  bulk: {{ from: a, to: b, protocol: tcp, congestion_control: {control} }}\n");
        let bulk = measured("500 packets", &source).remove(0);
        assert!(mbps(&bulk) > 0.9 * most(1448.0) && mbps(&bulk) < most(1448.0), "{bulk:?}");
        bulk.tcp.unwrap().round_trip_ms.unwrap().p50
    };
    let (bbr, cubic) = (trips("bbr"), trips("cubic"));
    // 500 packets take 606 ms.
    assert!(bbr < 60.0 && cubic > 300.0, "{bbr} {cubic}");
}

#[test]
fn a_saturated_source_leaves_its_link_no_pause() {
    let full = measured("1000 packets", "  full: { from: a, to: b, protocol: udp, rate: saturated }\n");
    let full = &full[0];
    assert!((mbps(full) / most(1472.0) - 1.0).abs() < 0.002, "{full:?}");
    let UdpMeasured { lost, delay_ms, .. } = full.udp.as_ref().unwrap();
    // All that wait, and those on the way.
    assert!(*lost < 140, "{full:?}");
    assert!((150.0..170.0).contains(&delay_ms.unwrap().p50), "128 packets wait for 155 ms: {full:?}");
}

#[test]
fn sources_share_a_link_and_the_same_seed_gives_the_same_figures() {
    let traffic = "  down: { from: b, to: a, protocol: tcp, bytes: 1 MB, start: 1 s }\n  \
                   video: { from: a, to: b, protocol: udp, rate: 4 Mbit/s, size: 1000 B, arrivals: poisson }\n  \
                   bulk: { from: a, to: b, protocol: tcp, congestion_control: reno, start: 5 s, stop: 15 s }\n";
    let all = measured("50 packets", traffic);
    assert_eq!(all, measured("50 packets", traffic));
    let [down, video, bulk] = &all[..] else { panic!("{all:?}") };
    assert_eq!(down.bytes, 1_000_000);
    let TcpMeasured { finished_after_ms, .. } = down.tcp.as_ref().unwrap();
    assert!((800.0..3000.0).contains(&finished_after_ms.unwrap()), "{down:?}");
    assert!((3.5..4.2).contains(&mbps(video)), "{video:?}");
    assert!(mbps(bulk) > 3.5 && bulk.tcp.as_ref().unwrap().retransmitted_packets > 0, "{bulk:?}");
    assert!(bulk.goodput_by_second_bps[..5].iter().all(|&bps| bps == 0), "{bulk:?}");
}
