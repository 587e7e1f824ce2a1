//! Foresees that a robot leaves the coverage of its own domain, for the plug-in that federates at the brain's word.

use std::sync::Arc;

use cotorra_graph::{NodeId, Pose, Testbed, Walk};
use cotorra_plugin::{coverage::Coverage, departure::Departure};

/// The walk of a robot whose domain federates at the brain's word, and the domain's coverage.
#[derive(Debug, Clone)]
pub(crate) struct Departing {
    coverage: Arc<Coverage>,
    walk: Walk,
    /// Distance ahead within which an edge counts, metres.
    horizon_m: f64,
}

impl Departing {
    /// Returns `None` if the plug-in of the robot's domain does not wait for the brain, or the robot has no walk.
    pub(crate) fn of(testbed: &Testbed, robot: &NodeId) -> Option<Self> {
        let domain = &testbed.graph.node(robot)?.domain;
        let walk = testbed.walk(robot)?.clone();
        let Departure { edge, lead, .. } = Departure::by_brain(testbed, domain)?;
        let coverage = Arc::new(Coverage::of_domain(&testbed.graph, domain, edge));
        let horizon_m = walk.speed_limit * lead.as_secs_f64();
        Some(Self { coverage, walk, horizon_m })
    }

    /// Whether the robot, with `waypoint` as the next one, is outside its domain's coverage or soon will be.
    pub(crate) fn is_soon(&self, pose: &Pose, waypoint: u32) -> bool {
        pose.is_finite() && self.coverage.edge(pose, &self.walk, waypoint, self.horizon_m).is_some()
    }
}
