//! Robots that start where they hear no radio unit.

use cotorra_fabric::sensitivity;
use cotorra_graph::{Node, Position, RadioUnit, Testbed};

/// Returns a hint for each robot with a walk that starts out of reach of all radio units that serve. Their mean signals decide:
/// shadowing and fading may differ by some dB.
pub fn hints(testbed: &Testbed) -> Vec<String> {
    let graph = &testbed.graph;
    let is_emulated = |unit: &RadioUnit| {
        graph.wireless.get(&unit.network).is_some_and(|network| network.access.software().is_none())
    };
    let units: Vec<_> = graph.radio_units().filter(|(_, unit)| unit.serving).collect();
    if units.is_empty() || !units.iter().all(|(_, unit)| is_emulated(unit)) {
        return Vec::new();
    }
    let is_heard = |(node, unit): &(&Node, &RadioUnit), at: Position| {
        let weakest = graph.wireless.get(&unit.network).map_or(f64::NEG_INFINITY, |of| sensitivity(of).0);
        graph.mean_signal(node, at).is_some_and(|signal| signal.0 >= weakest)
    };
    let starts = testbed.walks.iter().filter_map(|walk| {
        let node = graph.robots().find(|(node, _)| node.id == walk.robot)?.0;
        Some((&walk.robot, node.position.or(walk.waypoints.first().copied())?))
    });
    starts
        .filter(|(_, at)| !units.iter().any(|unit| is_heard(unit, *at)))
        .map(|(robot, at)| {
            format!(
                "hint: `{robot}` starts at {at}, where it hears no radio unit: nothing answers it there, and its walk ends \
                 after 60 s without progress. `cotorra check --coverage` draws the signal"
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{super::tests::testbed, *};

    #[test]
    fn a_robot_that_starts_out_of_reach_gets_a_hint() {
        let of =
            |walk: &str| hints(&testbed("  A: { kind: radio_unit, position: [0, 0], channel: 1 }\n", walk));
        assert_eq!(of("[[5, 0], [9000, 0]]"), [""; 0]);
        let [hint] = &of("[[9000, 0], [5, 0]]")[..] else { panic!("one hint") };
        assert!(hint.contains("`robot` starts at (9000.0, 0.0)"), "{hint}");
    }
}
