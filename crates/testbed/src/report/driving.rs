//! Measures how far robots drive blind: while the answer that they follow is older than it would be with timely answers.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{Event, NodeId, Program, ServiceId, Stamped, Testbed, Timestamp};
use serde::Serialize;

/// Distances that a robot drove.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DrivingSummary {
    pub robot: NodeId,
    /// Distance by odometry, metres.
    pub driven_m: f64,
    /// Distance driven blind, metres: while the newest answer belongs to a position packet older than the target plus one
    /// interval between packets.
    pub blind_m: f64,
    /// The longest blind stretch, metres.
    pub longest_blind_m: f64,
}

/// The robots that are navigated along a walk.
#[derive(Debug, Default)]
pub(super) struct Driving {
    robots: BTreeMap<NodeId, Driven>,
    /// Services whose answers the robots follow.
    followed: BTreeSet<ServiceId>,
}

#[derive(Debug)]
struct Driven {
    /// Highest age of the position packet that the newest answer belongs to.
    fresh: Duration,
    /// Emission of that packet.
    answered: Timestamp,
    /// Time up to which the distances are summed up.
    at: Timestamp,
    /// Speed since then, m/s.
    speed: f64,
    driven_m: f64,
    blind_m: f64,
    /// Length of the current blind stretch.
    stretch_m: f64,
    longest_m: f64,
}

impl Driving {
    pub(super) fn new(testbed: &Testbed) -> Self {
        let navigated =
            testbed.services.iter().filter(|s| s.vnfs.iter().any(|vnf| vnf.program == Program::Navigation));
        let driven = |service: &cotorra_graph::Service| {
            let walk = testbed.walk(&service.robot)?;
            let fresh = service.kpis.service_time + walk.position_interval;
            Some((service.robot.clone(), Driven::new(fresh)))
        };
        let followed = testbed.services.iter().filter(|service| service.navigates());
        Self {
            robots: navigated.filter_map(driven).collect(),
            followed: followed.map(|service| service.id.clone()).collect(),
        }
    }

    pub(super) fn absorb(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::Robot(context) => {
                if let Some(driven) = self.robots.get_mut(&context.robot) {
                    driven.advance(*at);
                    let velocity = context.sensors.velocity;
                    driven.speed = velocity.linear.hypot(velocity.vertical);
                }
            }
            Event::ServiceTime(sample)
                if sample.took.is_some() && self.followed.contains(&sample.service) =>
            {
                if let Some(driven) = self.robots.get_mut(&sample.robot) {
                    driven.advance(*at);
                    driven.answered = driven.answered.max(sample.emitted);
                }
            }
            _ => {}
        }
    }

    pub(super) fn summary(&self) -> Vec<DrivingSummary> {
        let summary = |(robot, driven): (&NodeId, &Driven)| DrivingSummary {
            robot: robot.clone(),
            driven_m: driven.driven_m,
            blind_m: driven.blind_m,
            longest_blind_m: driven.longest_m,
        };
        self.robots.iter().map(summary).collect()
    }
}

impl Driven {
    fn new(fresh: Duration) -> Self {
        let (answered, at) = (Timestamp::ZERO, Timestamp::ZERO);
        Self { fresh, answered, at, speed: 0.0, driven_m: 0.0, blind_m: 0.0, stretch_m: 0.0, longest_m: 0.0 }
    }

    /// Adds the distance up to `now`, at the speed of the last context.
    fn advance(&mut self, now: Timestamp) {
        let blind_from = self.at.max(self.answered + self.fresh);
        let blind = now.since(blind_from);
        if blind_from > self.at {
            self.stretch_m = 0.0;
        }
        let blind_m = self.speed * blind.as_secs_f64();
        self.driven_m += self.speed * now.since(self.at).as_secs_f64();
        self.blind_m += blind_m;
        self.stretch_m += blind_m;
        self.longest_m = self.longest_m.max(self.stretch_m);
        self.at = self.at.max(now);
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::ServiceTime;
    use cotorra_graph_testing as base;

    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn a_robot_follows_answers_of_its_navigation_alone() {
        let text = "
name: lab
wireless: { lab: {} }
nodes:
  robot: { kind: robot }
  unit: { kind: radio_unit, position: [0, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links: [{ ends: [unit, edge] }]
services:
  navigation:
    robot: robot
    kpis: { service_time: 500 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      brain: { program: navigation, node: edge }
  detect: { robot: robot, kpis: { service_time: 50 ms, flow: { protocol: udp, port: 9 } }, vnfs: {} }
walks: { robot: { waypoints: [[0, 0], [1, 0]] } }
";
        let testbed = cotorra_testbed_file::parse("lab.yaml", text, std::path::Path::new(""));
        let mut driving = Driving::new(&testbed.unwrap_or_else(|wrong| panic!("{wrong}")));
        let robot: NodeId = "robot".parse().unwrap();
        let mut answered = |service: &str| {
            let sample = ServiceTime {
                service: service.parse().unwrap(),
                robot: robot.clone(),
                ..base::service_time("edge", at(90), Some(Duration::from_millis(10)))
            };
            driving.absorb(&Stamped { at: at(100), event: Event::ServiceTime(sample) });
            driving.robots[&robot].answered
        };
        assert_eq!(answered("detect"), Timestamp::ZERO);
        assert_eq!(answered("navigation"), at(90));
    }

    #[test]
    fn a_robot_drives_blind_while_its_newest_answer_is_too_old() {
        // A target of 20 ms, and a packet every 50 ms.
        let mut driven = Driven::new(Duration::from_millis(70));
        driven.speed = 2.0;
        let mut answer = |emitted: u64, arrived: u64| {
            driven.advance(at(arrived));
            driven.answered = driven.answered.max(at(emitted));
            let round = |metres: f64| (metres * 1e6).round() / 1e6;
            [driven.driven_m, driven.blind_m, driven.longest_m].map(round)
        };
        assert_eq!(answer(0, 10), [0.02, 0.0, 0.0]);
        assert_eq!(answer(50, 70), [0.14, 0.0, 0.0], "in time");
        assert_eq!(answer(100, 150), [0.3, 0.06, 0.06], "30 ms too late");
        // Two answers that are too old on arrival: the robot stays blind.
        assert_eq!(answer(150, 270), [0.54, 0.26, 0.2]);
        assert_eq!(answer(200, 290), [0.58, 0.3, 0.24]);
        assert_eq!(answer(180, 300), [0.6, 0.32, 0.26], "an older one changes nothing");
        assert_eq!(answer(300, 310), [0.62, 0.34, 0.28]);
        assert_eq!(answer(350, 380), [0.76, 0.36, 0.28]);
    }
}
