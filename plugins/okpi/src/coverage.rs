//! Radio units that cover a location: by a survey of their areas, or by the mean signal that the network's path loss
//! gives.

use std::collections::BTreeMap;

use cotorra_graph::{HardwareGraph, NodeId, Position};

/// Source of coverage.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Coverage {
    /// The mean signal is above a floor, and not much weaker than the strongest.
    Signal {
        /// Weakest usable signal, dBm.
        floor_dbm: f64,
        /// Highest difference to the strongest signal, dB.
        margin_db: f64,
    },
    /// The location is in the radio unit's area.
    Survey {
        /// A polygon for each radio unit that is offered.
        areas: BTreeMap<NodeId, Vec<Position>>,
        /// A radio unit is taken up so deep in its area, and kept so far beyond it, metres.
        hysteresis_m: f64,
    },
}

impl Coverage {
    /// The radio units of a network that cover a location, strongest first.
    pub(crate) fn at(
        &self,
        graph: &HardwareGraph,
        network: &str,
        location: Position,
        present: Option<&NodeId>,
    ) -> Vec<NodeId> {
        let mut heard: Vec<(f64, &NodeId)> = graph
            .radio_units()
            .filter(|(_, unit)| unit.network == network)
            .filter_map(|(node, _)| Some((graph.mean_signal(node, location)?.0, &node.id)))
            .collect();
        // Stable: of equals, the first in the testbed file.
        heard.sort_by(|a, b| b.0.total_cmp(&a.0));
        let strongest = heard.first().map_or(f64::NEG_INFINITY, |(signal, _)| *signal);
        let covers = |(signal, unit): &(f64, &NodeId)| match self {
            Self::Signal { floor_dbm, margin_db } => *signal >= floor_dbm.max(strongest - margin_db),
            Self::Survey { areas, hysteresis_m } => areas.get(*unit).is_some_and(|area| {
                let depth = depth(area, location);
                if present == Some(*unit) { depth >= -hysteresis_m } else { depth >= *hysteresis_m }
            }),
        };
        heard.iter().filter(|heard| covers(heard)).map(|(_, unit)| (*unit).clone()).collect()
    }
}

/// Returns the depth of a place inside a polygon on the floor, whatever its height, metres; negative outside.
fn depth(polygon: &[Position], place: Position) -> f64 {
    let edges = || polygon.iter().zip(polygon.iter().cycle().skip(1));
    let distance = edges().map(|(&a, &b)| distance_to(a, b, place)).fold(f64::INFINITY, f64::min);
    if place.is_within(polygon) { distance } else { -distance }
}

/// Distance from a place to the line between two others.
fn distance_to(a: Position, b: Position, place: Position) -> f64 {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let along = ((place.x - a.x) * dx + (place.y - a.y) * dy) / (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
    let along = along.clamp(0.0, 1.0);
    place.on_floor().distance(Position::new(a.x + along * dx, a.y + along * dy))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [Position; 4] =
        [Position::new(0.0, 0.0), Position::new(4.0, 0.0), Position::new(4.0, 4.0), Position::new(0.0, 4.0)];

    #[test]
    fn depth_is_positive_inside_and_negative_outside() {
        let depths = [(2.0, 2.0, 2.0), (1.0, 2.0, 1.0), (-1.0, 2.0, -1.0), (7.0, 8.0, -5.0), (4.0, 2.0, 0.0)];
        for (x, y, expected) in depths {
            assert!((depth(&SQUARE, Position::new(x, y)) - expected).abs() < 1e-12, "({x}, {y})");
        }
    }
}
