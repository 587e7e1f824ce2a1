//! Handovers of real Wi-Fi software: by instruction, and by the supplicant alone.

use std::time::Duration;

use crate::{
    packets::Packets,
    rig::{FLOOR, Rig},
};

/// Gaps of roams, in ms, shortest first.
#[derive(Debug, Default)]
struct Gaps(Vec<f64>);

impl Gaps {
    fn add(&mut self, gap: Duration) {
        self.0.push(gap.as_secs_f64() * 1e3);
        self.0.sort_by(f64::total_cmp);
    }

    /// Returns the gap that this share of them does not exceed.
    fn quantile(&self, share: f64) -> f64 {
        let rank = (share * self.0.len() as f64).ceil() as usize;
        self.0[rank.clamp(1, self.0.len()) - 1]
    }
}

/// Gaps of the same roams, as each sees them.
#[derive(Debug, Default)]
struct Roams {
    /// From the first frame to the new access point until the robot is connected.
    events: Gaps,
    /// Of packets to the robot.
    down: Gaps,
    /// Of packets from the robot.
    up: Gaps,
    /// How many had no handshake of keys.
    fast: usize,
}

impl Roams {
    /// Sends the robot there and back, and measures.
    fn by_attach(rig: &mut Rig, number: usize) -> Self {
        let mut roams = Self::default();
        for unit in ["B", "A"].into_iter().cycle().take(number) {
            // Ticks of the kernel, beacons and packets are at another phase each time.
            rig.wait(Duration::from_micros(200_730));
            let down = Packets::start(rig, "fog", "r1");
            let up = Packets::start(rig, "r1", "fog");
            rig.wait(Duration::from_millis(50));
            rig.attach("r1", unit).unwrap();
            let handover = rig.wait_for_handover("r1", unit);
            rig.wait(Duration::from_millis(50));
            roams.fast += usize::from(handover["fast"] == true);
            roams.events.add(Duration::from_secs_f64(handover["gap_ms"].as_f64().unwrap() / 1e3));
            roams.down.add(down.longest_gap());
            roams.up.add(up.longest_gap());
        }
        roams
    }

    fn print(&self, name: &str) {
        for (of, gaps) in [("events", &self.events), ("packets down", &self.down), ("packets up", &self.up)] {
            let [p50, p95, most] = [0.5, 0.95, 1.0].map(|share| gaps.quantile(share));
            println!("{name}, gap by {of}: p50 {p50:.2}, p95 {p95:.2}, most {most:.2} ms");
        }
    }
}

#[test]
fn fast_transitions_by_instruction_have_short_gaps() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    let roams = Roams::by_attach(&mut rig, 5);
    roams.print("FT-PSK");
    assert_eq!(roams.fast, 5);
    for gaps in [&roams.events, &roams.down, &roams.up] {
        assert!(gaps.quantile(0.5) <= 40.0 && gaps.quantile(1.0) <= 60.0, "{roams:?}");
    }
    let ended = rig.end();
    assert_eq!(ended.summary["fidelity"]["valid"], true);
}
