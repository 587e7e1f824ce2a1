//! A small testbed for tests: two domains, three radio units and three robots.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use cotorra_graph::{
    Attachment, Dbm, NodeId, Pose, PoseSource, RadioContext, RobotContext, StationContext, Testbed, Timestamp,
};
use cotorra_graph_testing as base;

use crate::survey::{Scope, Site, Survey};

const FILE: &str = "
name: rooms
domains: [hall, annex]
wais: { origin: { latitude: 41.5, longitude: 2.25 } }
wireless:
  lab: { standard: n }
nodes:
  r1: { kind: robot, position: [1, 1] }
  r2: { kind: robot, position: [2, 1] }
  r3: { kind: robot, position: [3, 1] }
  west: { kind: radio_unit, position: [0, 0], channel: 1, domain: hall }
  middle: { kind: radio_unit, position: [10, 0], channel: 6, domain: hall }
  east: { kind: radio_unit, position: [20, 0], channel: 6, domain: annex }
  lan: { kind: switch }
links:
  - { ends: [lan, [west, east]], rate: 100 Mbit/s }
  - { ends: [middle, lan], rate: 50 Mbit/s }
";

pub(crate) fn testbed() -> Testbed {
    cotorra_testbed_file::parse("rooms.yaml", FILE, Path::new("")).unwrap()
}

pub(crate) fn site(scope: &Scope) -> Arc<Site> {
    let testbed = testbed();
    Arc::new(Site::new(&testbed.graph, &testbed.wais, scope))
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

/// Builds a survey from each robot's place and downlink rate in Mbit/s. Each robot hears all radio units, 10 dB
/// apart.
pub(crate) fn survey(site: &Arc<Site>, at: f64, places: &[(&str, Option<&str>, f64)]) -> Survey {
    let units = [("west", 1, 0.25), ("middle", 6, 0.5), ("east", 6, 0.5)];
    let radio = units.map(|(unit, channel, load)| {
        let there = places.iter().filter(|(_, place, _)| *place == Some(unit));
        let stations = there.map(|(robot, _, mbps)| StationContext {
            robot: id(robot),
            signal: Dbm(-60.0),
            downlink_bps: mbps * 1e6,
            uplink_bps: mbps / 2.0 * 1e6,
            counted: Default::default(),
        });
        (
            id(unit),
            RadioContext { radio_unit: id(unit), channel, load: Some(load), stations: stations.collect() },
        )
    });
    let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
    let robots = places.iter().map(|(robot, place, _)| {
        let attachments = units.iter().enumerate().map(|(i, (unit, ..))| Attachment {
            radio_unit: id(unit),
            attached: *place == Some(unit),
            signal: Some(Dbm(-50.0 - 10.0 * i as f64)),
            age: None,
        });
        let attachments = attachments.collect();
        (id(robot), RobotContext { robot: id(robot), attachments, ..base::robot_context("robot", pose) })
    });
    let at = Timestamp::from_secs_f64(at);
    site.survey(at, &radio.into_iter().collect(), &robots.collect(), &BTreeMap::new())
}
