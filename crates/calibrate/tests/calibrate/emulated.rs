//! Interference that the emulated radio has, found again from how busy its channel was.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, path::Path};

use cotorra_calibrate::{ChannelSurvey, Counters, MeasuredChannel, fit_interference};
use cotorra_fabric::{Fabric, Frame};
use cotorra_graph::{HostAddress, Testbed, Timestamp};

fn testbed(interference: &str) -> Testbed {
    let text = format!(
        "name: lab
wireless:
  lab: {{ access: edca, interference: {{ offices: {{ kind: network, channel: 1, position: [3, 1], {interference} }} }} }}
nodes:
  robot: {{ kind: robot, position: [1, 0] }}
  R: {{ kind: radio_unit, position: [0, 0], channel: 1 }}
"
    );
    cotorra_testbed_file::parse("lab", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Airtime of the radio unit's own beacons, which a driver counts as its own transmissions, ms a second: 250 bytes behind a preamble
/// of 192 µs, at 1 Mbit/s, each 102.4 ms.
const BEACONS: f64 = (0.192 + 2.0) / 0.1024;

/// Runs a testbed, and adds the busy share of each second up.
fn survey(testbed: &Testbed, seconds: u64) -> ChannelSurvey {
    let mut fabric = Fabric::new(&testbed.graph, 3).unwrap();
    let [robot, unit] = ["robot", "R"].map(|name| name.parse().unwrap());
    fabric.attach(Timestamp::ZERO, &robot, &unit).unwrap();
    // A channel begins with its first frame. This one goes to all.
    let port = fabric.port(&robot).unwrap();
    let mut bytes = vec![0; 60];
    bytes[..6].fill(0xff);
    let host = testbed.graph.hosts().position(|host| host.id == robot).unwrap();
    bytes[6..12].copy_from_slice(&HostAddress::of(host).mac);
    bytes[12..14].copy_from_slice(&[0x88, 0xb5]);
    let mut now = Timestamp::from_nanos(500_000_000);
    fabric.push(now, port, Frame::new(bytes));
    let mut sum = Counters { transmit: Some(0.0), own_receive: Some(0.0), ..Counters::default() };
    let mut counters = vec![sum];
    for second in 1..=seconds {
        now = Timestamp::from_nanos(second * 1_000_000_000);
        fabric.poll(now, &mut |_, _| {});
        sum.active += 1000.0;
        sum.transmit = sum.transmit.map(|transmit| transmit + BEACONS);
        sum.busy += 1000.0 * fabric.radio_contexts(now)[0].load.unwrap();
        counters.push(sum);
    }
    ChannelSurvey(BTreeMap::from([(MeasuredChannel::Number(1), counters)]))
}

#[test]
fn the_load_of_an_emulated_network_is_found_again() {
    let testbed = testbed("load: 25 %, airtime: 5 ms");
    let fit = fit_interference(&testbed, "R", &survey(&testbed, 600), 1).unwrap();
    assert!(fit.load.covers(0.25) && fit.load.high - fit.load.low < 0.03, "{fit:?}");
    assert_eq!(fit.presence, None);
}

#[test]
fn an_emulated_network_that_comes_and_goes_is_found_again() {
    let testbed = testbed("load: 40 %, airtime: 10 ms, presence: { on: 8 s, off: 12 s }");
    let fit = fit_interference(&testbed, "R", &survey(&testbed, 900), 1).unwrap();
    assert!(fit.load.covers(0.4), "{fit:?}");
    let presence = fit.presence.unwrap();
    assert!(presence.on_s.covers(8.0) && presence.off_s.covers(12.0), "{fit:?}");
    assert!(presence.background.high < 0.01, "{fit:?}");
}
