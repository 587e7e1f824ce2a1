//! Radio units, servers, walks, robots and their attachments, as markers of `RViz` and Foxglove.

use std::collections::BTreeMap;

use cotorra_graph::{self as graph, Cell, NodeId, NodeKind, Position, RobotContext, Testbed, Timestamp};
use cotorra_plugin::convert::{to_header, to_pose};
use cotorra_robot_middleware::{RADIUS, ros::MAP_FRAME};
use cotorra_ros_messages::{
    ColorRGBA, MapMetaData, Marker, MarkerArray, OccupancyGrid, Point, Pose, Vector3,
};

/// `visualization_msgs/Marker`'s numbers.
const CUBE: i32 = 1;
const CYLINDER: i32 = 3;
const LINE_STRIP: i32 = 4;
const TEXT: i32 = 9;
const DELETE: i32 = 2;

const RADIO_UNIT: ColorRGBA = ColorRGBA { r: 0.13, g: 0.45, b: 0.75, a: 1.0 };
const SERVER: ColorRGBA = ColorRGBA { r: 0.45, g: 0.35, b: 0.65, a: 1.0 };
const WALK: ColorRGBA = ColorRGBA { r: 0.55, g: 0.55, b: 0.55, a: 0.6 };
const ROBOT: ColorRGBA = ColorRGBA { r: 0.95, g: 0.55, b: 0.1, a: 1.0 };
const ATTACHED: ColorRGBA = ColorRGBA { r: 0.2, g: 0.7, b: 0.3, a: 0.9 };
const LABEL: ColorRGBA = ColorRGBA { r: 0.5, g: 0.5, b: 0.5, a: 1.0 };

/// Height of radio units, metres.
const CEILING: f64 = 2.5;

/// Returns the markers of fixed parts: radio units and servers with a position, and walks.
pub(crate) fn standing(testbed: &Testbed) -> MarkerArray {
    let mut markers = Vec::new();
    for (number, node) in testbed.graph.nodes.iter().enumerate() {
        let Some(place) = node.position else { continue };
        let (kind, scale, height, color) = match node.kind {
            NodeKind::RadioUnit(_) => (CYLINDER, (0.4, 0.4, 0.1), CEILING, RADIO_UNIT),
            NodeKind::Server(_) => (CUBE, (0.5, 0.5, 1.0), 0.5, SERVER),
            NodeKind::Robot(_) | NodeKind::Switch | NodeKind::Gateway(_) | NodeKind::Machine(_) => continue,
        };
        let id = number as i32;
        let body =
            Marker { r#type: kind, scale: vector(scale), color, ..at_place("nodes", id, place, height) };
        markers.extend([body, label("names", id, place, height + 0.5, node.id.as_str())]);
    }
    for (number, walk) in testbed.walks.iter().enumerate() {
        let points = walk.waypoints.iter().map(|waypoint| point(*waypoint, 0.02)).collect();
        markers.push(line("walks", number as i32, points, WALK));
    }
    MarkerArray { markers }
}

/// Returns the markers of a robot: its body, its label, and a line to its radio unit.
pub(crate) fn robot(
    number: usize,
    context: &RobotContext,
    radio_units: &BTreeMap<NodeId, Position>,
    text: &str,
) -> MarkerArray {
    let (id, pose) = (number as i32, &context.sensors.pose);
    let place = pose.position();
    let mut body = at_place("robots", id, place, 0.2);
    body.pose.orientation = to_pose(pose).orientation;
    body =
        Marker { r#type: CYLINDER, scale: vector((2.0 * RADIUS, 2.0 * RADIUS, 0.4)), color: ROBOT, ..body };
    let attached = context.attached_to().and_then(|unit| radio_units.get(unit));
    let attachment = match attached {
        Some(unit) => line("attachments", id, vec![point(place, 0.4), point(*unit, CEILING)], ATTACHED),
        None => Marker { action: DELETE, ..marker("attachments", id) },
    };
    MarkerArray { markers: vec![body, label("robots_told", id, place, 1.0, text), attachment] }
}

/// Converts a map to `nav_msgs/OccupancyGrid`.
pub(crate) fn map(grid: &graph::OccupancyGrid) -> OccupancyGrid {
    let (width, height) = (grid.width(), grid.height());
    let occupancy = |cell| match cell {
        Cell::Free => 0,
        Cell::Occupied => 100,
        Cell::Unknown => -1,
    };
    let cells = (0..width * height).map(|i| occupancy(grid.cell(i % width, i / width)));
    let origin = grid.origin();
    OccupancyGrid {
        header: to_header(Timestamp::ZERO, MAP_FRAME),
        info: MapMetaData {
            resolution: grid.resolution() as f32,
            width: width as u32,
            height: height as u32,
            origin: Pose { position: point(origin, 0.0), ..Pose::default() },
            ..MapMetaData::default()
        },
        data: cells.collect(),
    }
}

/// Returns a marker in the frame of the map. Its time is zero: viewers use the latest transform.
fn marker(namespace: &str, id: i32) -> Marker {
    Marker {
        header: to_header(Timestamp::ZERO, MAP_FRAME),
        ns: namespace.to_owned(),
        id,
        ..Marker::default()
    }
}

fn at_place(namespace: &str, id: i32, place: Position, height: f64) -> Marker {
    Marker { pose: Pose { position: point(place, height), ..Pose::default() }, ..marker(namespace, id) }
}

fn label(namespace: &str, id: i32, place: Position, height: f64, text: &str) -> Marker {
    let letters = Vector3 { z: 0.4, ..Vector3::default() };
    let text = text.to_owned();
    Marker { r#type: TEXT, scale: letters, color: LABEL, text, ..at_place(namespace, id, place, height) }
}

fn line(namespace: &str, id: i32, points: Vec<Point>, color: ColorRGBA) -> Marker {
    let width = Vector3 { x: 0.05, ..Vector3::default() };
    Marker { r#type: LINE_STRIP, scale: width, color, points, ..marker(namespace, id) }
}

/// Returns the point `height` metres above a position.
fn point(place: Position, height: f64) -> Point {
    Point { x: place.x, y: place.y, z: place.z + height }
}

fn vector((x, y, z): (f64, f64, f64)) -> Vector3 {
    Vector3 { x, y, z }
}
