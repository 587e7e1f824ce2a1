//! Coverage of radio units, and predictions of when a robot leaves it, from its position, covariance and
//! walk.
//!
//! Signals follow the path-loss model, and walls if the network has any. They are without shadowing, which is unknown in
//! advance.

use std::time::Duration;

use cotorra_graph::{
    Dbm, DomainId, HardwareGraph, Node, NodeId, Pose, Position, RadioUnit, Walk, WirelessNetwork,
};

/// Distance between checked points of a walk, metres.
const STEP_M: f64 = 0.1;
/// A robot may be anywhere within this many standard deviations of its estimated position.
const DEVIATIONS: f64 = 2.0;

/// Coverage of a set of radio units.
#[derive(Debug, Clone)]
pub struct Coverage {
    cells: Vec<Cell>,
    /// Weakest signal that counts as coverage.
    edge: Dbm,
}

#[derive(Debug, Clone)]
struct Cell {
    radio_unit: NodeId,
    position: Position,
    radio: RadioUnit,
    network: WirelessNetwork,
}

/// Point where a walk leaves the coverage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// The last place that is covered.
    pub place: Position,
    /// Distance to it along the walk, metres, minus the uncertainty of the position.
    pub distance_m: f64,
}

impl Edge {
    /// Returns the earliest time until the robot reaches the edge.
    pub fn within(&self, speed: f64) -> Duration {
        // A walk's speed limit is above zero. Any other value means that there is no hurry.
        Duration::try_from_secs_f64(self.distance_m / speed).unwrap_or(Duration::MAX)
    }
}

impl Coverage {
    /// Computes the coverage of a graph's radio units.
    pub fn of(graph: &HardwareGraph, edge: Dbm) -> Self {
        Self::of_some(graph, edge, |_| true)
    }

    /// Computes the coverage of a domain's radio units.
    pub fn of_domain(graph: &HardwareGraph, domain: &DomainId, edge: Dbm) -> Self {
        Self::of_some(graph, edge, |node| node.domain == *domain)
    }

    fn of_some(graph: &HardwareGraph, edge: Dbm, counts: impl Fn(&Node) -> bool) -> Self {
        let units = graph.radio_units().filter(|(node, _)| counts(node));
        let cells = units.filter_map(|(node, radio)| {
            let network = graph.wireless.get(&radio.network)?.clone();
            Some(Cell {
                radio_unit: node.id.clone(),
                position: node.position?,
                radio: radio.clone(),
                network,
            })
        });
        Self { cells: cells.collect(), edge }
    }

    /// Returns the strongest radio unit at a place, with its signal there.
    pub fn strongest(&self, at: Position) -> Option<(&NodeId, Dbm)> {
        let signals = self.cells.iter().map(|cell| (&cell.radio_unit, cell.signal(at, 0.0)));
        signals.max_by(|(_, a), (_, b)| a.0.total_cmp(&b.0))
    }

    /// Returns a radio unit's weakest signal within `radius_m` metres of a place, behind the walls that are between it and
    /// the place.
    pub fn weakest_around(&self, radio_unit: &NodeId, at: Position, radius_m: f64) -> Option<Dbm> {
        let cell = self.cells.iter().find(|cell| cell.radio_unit == *radio_unit)?;
        Some(cell.signal(at, radius_m))
    }

    /// Whether a place is covered.
    pub fn covers(&self, at: Position) -> bool {
        self.strongest(at).is_some_and(|(_, signal)| signal >= self.edge)
    }

    /// Returns where a robot, on its walk from `pose` by the waypoint `waypoint`, leaves the coverage. Returns `None`
    /// if it does not, or not within `horizon_m` metres.
    pub fn edge(&self, pose: &Pose, walk: &Walk, waypoint: u32, horizon_m: f64) -> Option<Edge> {
        let uncertain = DEVIATIONS * deviation_m(pose);
        let (mut at, mut walked) = (pose.position(), 0.0);
        let mut last = at;
        if !self.covers(at) {
            return Some(Edge { place: at, distance_m: 0.0 });
        }
        for next in walk.waypoints.iter().skip(waypoint as usize) {
            let leg = at.distance(*next);
            let steps = (leg / STEP_M).ceil().max(1.0);
            for step in 1..=steps as u32 {
                let share = f64::from(step) / steps;
                let between = |from: f64, to: f64| from + share * (to - from);
                let place =
                    Position { x: between(at.x, next.x), y: between(at.y, next.y), z: between(at.z, next.z) };
                let distance = walked + share * leg;
                if distance > horizon_m + uncertain {
                    return None;
                }
                if !self.covers(place) {
                    let distance_m = (distance - leg / steps - uncertain).max(0.0);
                    return Some(Edge { place: last, distance_m });
                }
                last = place;
            }
            (at, walked) = (*next, walked + leg);
        }
        None
    }
}

impl Cell {
    /// Returns the signal behind a place, so many metres farther away.
    fn signal(&self, at: Position, farther_m: f64) -> Dbm {
        let unobstructed = self.network.mean_signal(&self.radio, self.position.distance(at) + farther_m);
        Dbm(unobstructed.0 - self.network.wall_loss_db(self.position, at))
    }
}

/// Returns the standard deviation of a position along its least certain direction, metres: the root of the larger
/// eigenvalue of its covariance.
fn deviation_m(pose: &Pose) -> f64 {
    let [xx, xy, _, _, yy, ..] = pose.covariance;
    let (mean, half) = ((xx + yy) / 2.0, (xx - yy) / 2.0);
    let largest = mean + half.hypot(xy);
    if largest.is_finite() { largest.max(0.0).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use cotorra_graph::{OccupancyGrid, PoseSource, WallLoss, Walls};
    use proptest::prelude::*;

    use super::*;

    const TESTBED: &str = "
name: edge
wireless: { lab: { path_loss: { model: log_distance, exponent: 3.0 } } }
nodes:
  r: { kind: robot }
  A: { kind: radio_unit, position: [0, 0], channel: 1 }
walks:
  r: { waypoints: [[0, 0], [20, 0], [40, 0], [0, 0]], speed_limit: 0.5 m/s }
";

    /// Log-distance with n = 3: 15 dBm - 40.1 dB at 1 m, and 30 dB a decade: -65 dBm at 21.4 m.
    fn coverage() -> (Coverage, Walk) {
        let testbed =
            cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}"));
        (Coverage::of(&testbed.graph, Dbm(-65.0)), testbed.walks[0].clone())
    }

    fn pose(x: f64, deviation: f64) -> Pose {
        let mut covariance = [0.0; 9];
        (covariance[0], covariance[4]) = (deviation * deviation, deviation * deviation / 4.0);
        Pose::planar(x, 0.0, 0.0, covariance, PoseSource::Localization)
    }

    #[test]
    fn edge_is_where_the_signal_becomes_too_weak() {
        let (coverage, walk) = coverage();
        let edge = coverage.edge(&pose(5.0, 0.0), &walk, 1, 100.0).unwrap();
        assert!((edge.place.x - 21.4).abs() < 0.2, "{edge:?}");
        assert!((edge.distance_m - 16.4).abs() < 0.2, "{edge:?}");
        assert!((edge.within(0.5).as_secs_f64() - 32.8).abs() < 0.4);
        assert_eq!(edge.within(0.0), Duration::MAX);
        assert_eq!(coverage.edge(&pose(5.0, 0.0), &walk, 1, 10.0), None, "beyond the horizon");
        assert_eq!(coverage.edge(&pose(5.0, 0.0), &walk, 3, 100.0), None, "the way back stays inside");
        assert_eq!(
            coverage.edge(&pose(30.0, 0.0), &walk, 3, 100.0).unwrap().distance_m,
            0.0,
            "the robot is outside"
        );
    }

    #[test]
    fn coverage_ends_earlier_behind_a_wall() {
        let testbed = cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap();
        let mut graph = testbed.graph;
        // One column of occupied cells, from 10 m to 11 m.
        let cells = vec![cotorra_graph::Cell::Occupied; 10];
        let map = Arc::new(OccupancyGrid::new(1, 10, 1.0, Position::new(10.0, -5.0), cells).unwrap());
        let loss = WallLoss { loss_db: 6.0, at_most_db: None };
        graph.wireless.get_mut("lab").unwrap().walls = Some(Walls { loss, map });
        let coverage = Coverage::of(&graph, Dbm(-65.0));
        // 6 dB are a factor of 1.58 in distance at 30 dB a decade: 13.5 m in place of 21.4 m.
        let edge = coverage.edge(&pose(5.0, 0.0), &testbed.walks[0], 1, 100.0).unwrap();
        assert!((edge.place.x - 13.5).abs() < 0.2, "{edge:?}");
        let id = "A".parse().unwrap();
        let [before, behind] =
            [9.0, 12.0].map(|x| coverage.weakest_around(&id, Position::new(x, 0.0), 1.0).unwrap().0);
        assert!((before - behind - 6.0 - 30.0 * (13.0_f64 / 10.0).log10()).abs() < 1e-9);
    }

    #[test]
    fn uncertain_robots_reach_the_edge_sooner() {
        let (coverage, walk) = coverage();
        let [sure, unsure] = [0.0, 0.5].map(|d| coverage.edge(&pose(5.0, d), &walk, 1, 100.0).unwrap());
        assert!((sure.distance_m - unsure.distance_m - 1.0).abs() < 1e-9);
    }

    #[test]
    fn deviations_are_of_the_least_certain_direction() {
        let mut tilted = pose(0.0, 0.0);
        // Deviations 2 and 1 along axes turned by 45 degrees.
        (tilted.covariance[0], tilted.covariance[4]) = (2.5, 2.5);
        (tilted.covariance[1], tilted.covariance[3]) = (1.5, 1.5);
        assert!((deviation_m(&tilted) - 2.0).abs() < 1e-9);
        assert_eq!(deviation_m(&pose(0.0, f64::NAN)), 0.0);
    }

    proptest! {
        #[test]
        fn edge_is_covered_and_never_behind(x in -50.0..50.0f64, waypoint in 0..5u32, deviation in 0.0..5.0f64) {
            let (coverage, walk) = coverage();
            if let Some(edge) = coverage.edge(&pose(x, deviation), &walk, waypoint, 1000.0) {
                prop_assert!(edge.distance_m >= 0.0);
                prop_assert!(coverage.covers(edge.place) || edge.place == pose(x, deviation).position());
            }
        }
    }
}
