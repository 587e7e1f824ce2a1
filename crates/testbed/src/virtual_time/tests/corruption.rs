//! Corrupted packets: no host of virtual time believes what no kernel hands to a socket.

use std::path::Path;

use crate::virtual_time::*;

const SECONDS: f64 = 300.0;

/// Runs a robot that stays near its radio unit. Returns the navigation samples: how many there are, and how many have no
/// answer.
fn samples(corruption: &str) -> [f64; 2] {
    let text = format!(
        "name: corrupted
wireless: {{ lab: {{ standard: n }} }}
nodes:
  robot: {{ kind: robot, cpus: 2, memory: 4 GB }}
  west: {{ kind: radio_unit, position: [0, 3], channel: 1 }}
  lan: {{ kind: switch }}
  edge: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB }}
links:
  - {{ ends: [lan, west] }}
  - {{ ends: [lan, edge], delay: 2 ms, rate: 100 Mbit/s{corruption} }}
services:
  navigation:
    robot: robot
    kpis: {{ service_time: 15 ms }}
    vnfs:
      robot-driver: {{ program: robot_driver, pinned_to: robot }}
      navigation: {{ program: navigation, node: edge, cpus: 2 }}
    virtual_links: [{{ from: robot-driver, to: navigation, rate: 6 Mbit/s }}]
walks:
  robot: {{ waypoints: [[1, 0], [4, 0], [1, 0], [4, 0], [1, 0], [4, 0], [1, 0], [4, 0], [1, 0], [4, 0]] }}
"
    );
    let testbed = cotorra_testbed_file::parse("corrupted.yaml", &text, Path::new("")).unwrap();
    let mut simulation = Simulation::new(Arc::new(testbed), 3).unwrap();
    let [mut all, mut unanswered] = [0.0; 2];
    while simulation.step().as_secs_f64() < SECONDS && !simulation.is_finished() {
        while let Some(event) = simulation.poll_event() {
            match event.event {
                Event::ServiceTime(sample) => {
                    all += 1.0;
                    unanswered += f64::from(u8::from(sample.took.is_none()));
                }
                Event::AnswersRejected(rejected) => {
                    assert_eq!(
                        rejected.forged + rejected.invalid + rejected.unknown,
                        0,
                        "a corrupted packet came to a socket: {rejected:?}"
                    );
                }
                _ => {}
            }
        }
    }
    [all, unanswered]
}

/// A request and its answer cross the link once each, so that 1 - (1 - p)² of them are lost.
#[test]
fn the_share_of_samples_without_an_answer_is_that_of_packets_with_a_flipped_bit() {
    assert_eq!(samples("")[1], 0.0, "without corruption, all are answered");
    for percent in [1.0, 5.0, 20.0, 100.0] {
        let [all, unanswered] = samples(&format!(", corruption: {percent} %"));
        let expected = 1.0 - (1.0 - percent / 100.0_f64).powi(2);
        // Two-sided, 99.9 %. The last request may still be under way.
        let bound = 3.29 * (expected * (1.0 - expected) * all).sqrt() + 1.0;
        assert!(all > 100.0, "{all} samples at {percent} %");
        assert!((unanswered - expected * all).abs() <= bound, "{unanswered} of {all} at {percent} %");
    }
}
