//! Handovers of real Wi-Fi software: by instruction, and by the supplicant alone.

use std::{env, time::Duration};

use cotorra_numbers::quantile;

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

    fn quantile(&self, share: f64) -> f64 {
        quantile(&self.0, share).unwrap()
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
    /// Number of those without a handshake of keys.
    fast: usize,
}

impl Roams {
    /// Sends the robot there and back, and measures. Packets go on for a while after each handover.
    fn by_attach(rig: &mut Rig, number: usize, afterwards: Duration) -> Self {
        let mut roams = Self::default();
        for unit in ["B", "A"].into_iter().cycle().take(number) {
            // Ticks of the kernel, beacons and packets are at another phase each time.
            rig.wait(Duration::from_micros(200_730));
            let down = Packets::start(rig, "fog", "r1");
            let up = Packets::start(rig, "r1", "fog");
            rig.wait(Duration::from_millis(50));
            rig.attach("r1", unit).unwrap();
            let handover = rig.wait_for_handover("r1", unit);
            rig.wait(afterwards);
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

/// Number of roams: a few, or as many as the figures of docs/use/wifi.md need.
fn number(few: usize, many: usize) -> usize {
    if env::var_os("COTORRA_FULL").is_some() { many } else { few }
}

#[test]
fn fast_transitions_by_suggestion_and_by_instruction_have_short_gaps() {
    let floor = FLOOR.replace("[12, 5], channel: 11, serving: false", "[4000, 0], channel: 11");
    let Some(mut rig) = Rig::start(&floor) else { return };
    // The first suggestion comes before A has keys for the robot, and the next one right after a roam.
    for unit in ["B", "A"] {
        assert_eq!(rig.suggest("r1", unit), 0);
        let handover = rig.wait_for_handover("r1", unit);
        assert!(handover["fast"] == true && handover["gap_ms"].as_f64().unwrap() <= 40.0, "{handover}");
    }
    assert_eq!(rig.suggest("r1", "C"), 7, "no suitable candidate");
    assert_eq!(rig.place_of("r1").as_deref(), Some("A"));

    let number = number(5, 50);
    let roams = Roams::by_attach(&mut rig, number, Duration::from_millis(50));
    roams.print("FT-PSK");
    assert_eq!(roams.fast, number);
    for gaps in [&roams.events, &roams.down, &roams.up] {
        assert!(gaps.quantile(0.5) <= 40.0 && gaps.quantile(0.95) <= 60.0, "{roams:?}");
    }
    if number < 20 {
        assert!(roams.up.quantile(1.0) <= 60.0 && roams.down.quantile(1.0) <= 60.0, "{roams:?}");
    }
    let ended = rig.end();
    assert_eq!(ended.summary["fidelity"]["valid"], true);
    let log = ended.log("hostapd-B.log");
    assert!(log.contains("AP-STA-CONNECTED"), "{log}");
}

/// Figures to compare with; nothing promises them.
#[test]
fn roams_without_fast_transition_have_their_gaps() {
    let number = number(1, 50);
    for (name, security) in [("WPA2-PSK", "wpa2"), ("SAE", "wpa3")] {
        let floor = FLOOR
            .replace("fast_transition: true", &format!("fast_transition: false\n    security: {security}"));
        let Some(mut rig) = Rig::start(&floor) else { return };
        // An access point that still knew the robot may hold packets to it for a second.
        let roams = Roams::by_attach(&mut rig, number, Duration::from_millis(1500));
        roams.print(name);
        assert_eq!(roams.fast, 0);
        rig.end();
    }
}

#[test]
fn a_robot_roams_by_itself_as_it_walks() {
    let number = number(2, 10);
    let way: String = (0..=number).map(|leg| if leg % 2 == 0 { "[1, 0], " } else { "[15, 0], " }).collect();
    // It hears an access point with -65 dBm at a distance of 10 m.
    let floor = FLOOR
        .replace("roaming: instructed", "roaming: { policy: supplicant, short_interval: 2 s }")
        .replace("exponent: 3.0", "exponent: 4.0")
        .replace("position: [12, 0]", "position: [16, 0]")
        .replace("[4, 0], [8, 0], [4, 0], [8, 0], [4, 0], [8, 0], [4, 0], [8, 0]", way.trim_end_matches(", "))
        .replace("    and_back: true\n", "")
        .replace("speed_limit: 0.2 m/s", "speed_limit: 0.6 m/s");
    let Some(mut rig) = Rig::start(&floor) else { return };
    for (from, to) in [("A", "B"), ("B", "A")].into_iter().cycle().take(number) {
        let handover = rig.wait_for_handover("r1", to);
        assert_eq!((&handover["from"], &handover["fast"]), (&from.into(), &true.into()), "{handover}");
        let robot = rig.run.get("/api/v1/robots/r1");
        let (gap, x) =
            (handover["gap_ms"].as_f64().unwrap(), robot["sensors"]["pose"]["x"].as_f64().unwrap());
        println!("by itself from {from} to {to} at {x:.1} m, gap {gap:.2} ms");
        assert!(gap <= 60.0, "{handover}");
        // It leaves an access point only when that has become weak.
        assert!(if to == "B" { x > 10.0 } else { x < 6.0 }, "{handover}");
    }
    let lost = rig.news().into_iter().filter(|event| event["event"] == "detached").count();
    assert_eq!(lost, 0);
    rig.end();
}
