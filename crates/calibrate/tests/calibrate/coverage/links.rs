//! Times of packets over emulated links, whose jitter is correlated.

use std::{collections::BTreeSet, path::Path, time::Duration};

use cotorra_calibrate::{PacketTimes, fit_path};
use cotorra_fabric::{Fabric, Frame};
use cotorra_graph::{HostAddress, Timestamp};
use cotorra_numbers::Draws;

use super::{Coverage, between, sites};

/// Packets of a link.
const PACKETS: u64 = 1000;
/// Time between two packets: so long that keeping their order changes nothing.
const INTERVAL: Duration = Duration::from_secs(1);

/// Returns the times of packets over a link with these conditions in a testbed file.
fn packet_times(conditions: &str, seed: u64) -> PacketTimes {
    let text = format!(
        "name: pair
nodes:
  near: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
  far: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
links:
  - {{ ends: [near, far], rate: unlimited, {conditions} }}
"
    );
    let testbed = cotorra_testbed_file::parse("pair", &text, Path::new("")).unwrap();
    let mut fabric = Fabric::new(&testbed.graph, seed).unwrap();
    let [near, far] = ["near", "far"].map(|node| fabric.port(&node.parse().unwrap()).unwrap());
    let mut frame = vec![0; 98];
    frame[..6].copy_from_slice(&HostAddress::of(far.0).mac);
    frame[6..12].copy_from_slice(&HostAddress::of(near.0).mac);
    frame[12..14].copy_from_slice(&[0x88, 0xb5]);
    let mut send = |number: u64| {
        let sent = Timestamp::from_nanos(number * INTERVAL.as_nanos() as u64);
        fabric.push(sent, near, Frame::new(frame.clone()));
        let (mut now, mut arrived) = (sent, None);
        while arrived.is_none() {
            let next = fabric.poll(now, &mut |_, _| arrived = Some(now));
            now = next.filter(|next| next.since(sent) < INTERVAL).or(arrived)?;
        }
        arrived.map(|at| at.since(sent).as_secs_f64() * 1e3)
    };
    PacketTimes {
        times_ms: (0..PACKETS).map(&mut send).collect(),
        duplicated: BTreeSet::new(),
        late: 0,
        counts_losses: true,
        interval: Some(INTERVAL),
        frame_bytes: [98; 2],
        notes: Vec::new(),
    }
}

#[test]
fn intervals_hold_the_correlation_of_a_link() {
    let mut coverage = Coverage::default();
    for seed in 0..sites() as u64 {
        let mut draws = Draws::new(seed, "link");
        let distribution = ["normal", "uniform", "pareto"][draws.below(3)];
        let deviation_ms = between(&mut draws, [0.5, 4.0]);
        let correlation = between(&mut draws, [0.0, 0.8]);
        let percent = correlation * 100.0;
        let jitter = format!(
            "{{ deviation: {deviation_ms} ms, distribution: {distribution}, correlation: {percent} % }}"
        );
        let times = packet_times(&format!("delay: 40 ms, jitter: {jitter}, loss: 2 %"), seed);
        let fit = fit_path(&times, seed).unwrap();
        coverage.count("link's jitter", fit.deviation_ms, deviation_ms);
        coverage.count("link's correlation", fit.correlation, correlation);
    }
    coverage.check();
}
