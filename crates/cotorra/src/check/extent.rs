//! Part of the floor that a picture shows.

use cotorra_figure::Extent;
use cotorra_graph::{OccupancyGrid, Position, Testbed};

/// Room around places outside of a map, as a share of the longer side, and metres at least.
const MARGIN: f64 = 0.1;
const LEAST_MARGIN_M: f64 = 5.0;
/// The longer side is at most so many times the shorter one.
const LONGEST: f64 = 8.0;

/// Returns the area of a map.
pub fn of_map(map: &OccupancyGrid) -> Extent {
    let Position { x, y, .. } = map.origin();
    let [width, height] = [map.width(), map.height()].map(|cells| cells as f64 * map.resolution());
    Extent { left: x, bottom: y, right: x + width, top: y + height }
}

/// Returns the map's area if all radio units, robots and walks are on it. Otherwise it has these and a margin, too.
pub fn of(testbed: &Testbed) -> Extent {
    let graph = &testbed.graph;
    let units = graph.radio_units().map(|(node, _)| node);
    let nodes = units.chain(graph.robots().map(|(node, _)| node)).filter_map(|node| node.position);
    let waypoints = testbed.walks.iter().flat_map(|walk| walk.waypoints.iter().copied());
    let map = testbed.map.as_ref().map(of_map);
    let all = nodes.chain(waypoints).fold(map, |extent, place| Some(joined(extent, place)));
    let extent = all.unwrap_or_else(|| joined(None, Position::default()));
    let extent = if Some(extent) == map {
        extent
    } else {
        grown(extent, [(extent.width().max(extent.height()) * MARGIN).max(LEAST_MARGIN_M); 2])
    };
    let [short_x, short_y] =
        [extent.height() / LONGEST - extent.width(), extent.width() / LONGEST - extent.height()];
    grown(extent, [short_x, short_y].map(|short| short.max(0.0) / 2.0))
}

/// Returns an extent that has a place, too.
fn joined(extent: Option<Extent>, Position { x, y, .. }: Position) -> Extent {
    extent.map_or(Extent { left: x, bottom: y, right: x, top: y }, |extent| Extent {
        left: extent.left.min(x),
        bottom: extent.bottom.min(y),
        right: extent.right.max(x),
        top: extent.top.max(y),
    })
}

fn grown(extent: Extent, [x, y]: [f64; 2]) -> Extent {
    let Extent { left, bottom, right, top } = extent;
    Extent { left: left - x, bottom: bottom - y, right: right + x, top: top + y }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Cell;

    use super::*;
    use crate::check::tests::testbed;

    #[test]
    fn open_space_is_that_of_nodes_and_walks_with_a_margin() {
        let extent = of(&testbed(
            "  R: { kind: radio_unit, position: [10, 20], channel: 1 }\n",
            "[[0, 0], [100, 40]]",
        ));
        assert_eq!(extent, Extent { left: -10.0, bottom: -10.0, right: 110.0, top: 50.0 });
        let alone =
            of(&testbed("  R: { kind: radio_unit, position: [0, 0], channel: 1 }\n", "[[0, 0], [0, 1]]"));
        assert_eq!(alone, Extent { left: -5.0, bottom: -5.0, right: 5.0, top: 6.0 });
    }

    #[test]
    fn long_floors_are_widened() {
        let extent =
            of(&testbed("  R: { kind: radio_unit, position: [0, 0], channel: 1 }\n", "[[0, 0], [1000, 0]]"));
        assert_eq!((extent.width(), extent.height()), (1200.0, 200.0));
        let longer = Testbed {
            map: OccupancyGrid::new(800, 1, 2.0, Position::default(), vec![Cell::Free; 800]),
            ..testbed("  R: { kind: radio_unit, position: [5, 1], channel: 1 }\n", "[[0, 1], [9, 1]]")
        };
        assert_eq!(of(&longer), Extent { left: 0.0, bottom: -99.0, right: 1600.0, top: 101.0 });
    }

    #[test]
    fn a_map_is_drawn_as_it_is_unless_a_radio_unit_is_outside() {
        let map = || OccupancyGrid::new(40, 20, 0.5, Position::new(-1.0, -1.0), vec![Cell::Free; 800]);
        let inside = Testbed {
            map: map(),
            ..testbed("  R: { kind: radio_unit, position: [1, 1], channel: 1 }\n", "[[0, 0], [1, 0]]")
        };
        assert_eq!(of(&inside), of_map(&map().unwrap()));
        let outside = Testbed {
            map: map(),
            ..testbed("  R: { kind: radio_unit, position: [49, 1], channel: 1 }\n", "[[0, 0], [1, 0]]")
        };
        assert_eq!(of(&outside), Extent { left: -6.0, bottom: -6.0, right: 54.0, top: 14.0 });
    }
}
