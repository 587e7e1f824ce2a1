//! `cotorra new testbed`: a testbed on a floor plan, or in a small building.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use cotorra_brain::{Floor, Unreachable};
use cotorra_graph::{OccupancyGrid, Position, Probability, RobotModel};

use super::{
    files::{Destination, NewFile},
    plan::{self, PlanError, Size},
};
use crate::{
    quantity::{parse_length, parse_share},
    testbed_file,
};

/// Make a testbed on a floor plan, on a map, or in a small building
///
/// Writes a map, and a testbed file with three robots, four radio units and three servers. Robots walk over floor that they
/// can reach, and navigation runs in the cloud. Files that exist are never overwritten.
///
/// A floor plan is a PNG or PGM picture, seen from above, dark where walls are. Doors must be gaps. Floor outside the walls
/// does not count if the walls enclose the rest.
///
/// A map is that of ROS's map_server. What it does not know is no floor.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra new testbed demo                                           a corridor and two rooms
  cotorra new testbed office --floor-plan plan.png --width 30m       the whole picture is 30 m wide
  cotorra new testbed office --floor-plan plan.png --scale 5cm       a pixel is 5 cm wide
  cotorra new testbed office --map ~/maps/office.yaml                the map of a robot's SLAM
  cotorra new testbed office --floor-plan plan.png --width 30m --dry-run")]
pub struct TestbedArgs {
    /// The new folder, whose name becomes the testbed's
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The floor plan: a PNG or PGM picture, dark where walls are
    #[arg(long, value_name = "PICTURE", requires = "size")]
    pub floor_plan: Option<PathBuf>,
    /// Side of one pixel, such as 5cm
    #[arg(long, value_name = "LENGTH", value_parser = parse_length, group = "size", requires = "floor_plan")]
    pub scale: Option<f64>,
    /// Width of the whole picture, such as 30m
    #[arg(long, value_name = "LENGTH", value_parser = parse_length, group = "size", requires = "floor_plan")]
    pub width: Option<f64>,
    /// Share of black from which a pixel is a wall; white is 0%
    #[arg(long, value_name = "SHARE", value_parser = parse_share, default_value = "50%", requires = "floor_plan")]
    pub threshold: Probability,
    /// A map that ROS's map_server serves, such as map_saver writes
    #[arg(long, value_name = "YAML", conflicts_with = "floor_plan")]
    pub map: Option<PathBuf>,
    /// Only say what would be written
    #[arg(short = 'n', long)]
    pub dry_run: bool,
}

/// Robots of a new testbed.
const ROBOTS: usize = 3;
/// Channels of its radio units. Three of the 2.4 GHz band do not overlap.
const CHANNELS: [u8; 4] = [1, 6, 11, 1];
/// Waypoints of a walk, at most.
const WAYPOINTS: usize = 4;
/// A walk gets no further waypoint beyond this length, metres.
const LONGEST_WALK: f64 = 60.0;
/// Distance between two waypoints, at least, metres.
const SHORTEST_LEG: f64 = 1.0;

/// Error of a new testbed.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum TestbedError {
    #[error("floor plan {}: {reason}", path.display())]
    Plan { path: PathBuf, reason: PlanError },
    #[error(
        "the floor plan has {area:.1} m² of connected floor that a robot can reach, too little for a walk"
    )]
    #[diagnostic(help(
        "check `--scale` or `--width`; walls must be dark and floor bright (`--threshold`), and doors must be gaps"
    ))]
    NoFloor { area: f64 },
    #[error("no walk leads over the floor: {0}")]
    NoWalk(#[from] Unreachable),
}

/// Program of a new plug-in, as a testbed file declares it.
pub struct Declared<'a> {
    pub id: &'a str,
    pub command: &'a str,
}

/// Returns the files, and what the user should know about them.
pub fn testbed(args: &TestbedArgs) -> miette::Result<(Vec<NewFile>, String)> {
    let size = args.scale.map(Size::Pixel).or(args.width.map(Size::Width));
    let (grid, is_open) = match (&args.floor_plan, size) {
        _ if let Some(map) = &args.map => (testbed_file::load_map(map)?, false),
        (Some(path), Some(size)) => {
            let read = plan::read(path, size, args.threshold);
            let plan = read.map_err(|reason| TestbedError::Plan { path: path.clone(), reason })?;
            (plan.grid, plan.is_open)
        }
        _ => (plan::building(), false),
    };
    let side = grid.resolution();
    let (width, height) = (grid.width() as f64 * side, grid.height() as f64 * side);
    let (files, area) = files(&Destination::new(&args.folder).name(), &grid, None)?;
    let mut text = format!("map: {width:.1} m × {height:.1} m; robots can reach {area:.0} m² of floor\n");
    if is_open {
        text += "note: floor leads past the walls to the edge of the picture, and all of it counts. If it should not, \
                 close the walls in the picture\n";
    }
    Ok((files, text))
}

/// Returns the files of a testbed on a map, and the area that its robots can reach.
pub fn files(
    name: &str,
    grid: &OccupancyGrid,
    plugin: Option<&Declared<'_>>,
) -> Result<(Vec<NewFile>, f64), TestbedError> {
    let mut floor = Floor::new(grid, RobotModel::Turtlebot2).ok_or(TestbedError::NoFloor { area: 0.0 })?;
    let walks = walks(&mut floor)?;
    let radio_units = floor.centres(CHANNELS.len());
    let map = format!(
        "# The map of ROS's map_server: black is occupied, white is free, grey is unknown.\nimage: map.pgm\n\
         resolution: {}\norigin: [{}, {}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        grid.resolution(),
        grid.origin().x,
        grid.origin().y
    );
    let files = vec![
        NewFile::new("testbed.yaml", text(name, &walks, &radio_units, plugin)),
        NewFile::new("map.yaml", map),
        NewFile::new("map.pgm", plan::pgm(grid)),
    ];
    Ok((files, floor.area()))
}

/// Chooses a walk for each robot: from an end of the floor to the nearest of the other ends, and on. Each robot has an end
/// of its own if there are enough.
fn walks(floor: &mut Floor) -> Result<Vec<Vec<Position>>, TestbedError> {
    // A small floor has no room for all of them.
    let mut ends: Vec<Position> = Vec::new();
    for end in floor.ends(2 * ROBOTS) {
        if ends.iter().all(|other| other.distance(end) >= SHORTEST_LEG) {
            ends.push(end);
        }
    }
    if ends.len() < 2 {
        return Err(TestbedError::NoFloor { area: floor.area() });
    }
    let mut ways = vec![vec![0.0; ends.len()]; ends.len()];
    for from in 0..ends.len() {
        for to in 0..from {
            let way = floor.way(ends[from], ends[to])?;
            (ways[from][to], ways[to][from]) = (way, way);
        }
    }
    let walk = |robot: usize| {
        let (mut walk, mut length) = (vec![robot % ends.len()], 0.0);
        while walk.len() < WAYPOINTS && length < LONGEST_WALK {
            let here = &ways[walk[walk.len() - 1]];
            let others = (0..ends.len()).filter(|end| !walk.contains(end));
            let Some(nearest) = others.min_by(|&a, &b| here[a].total_cmp(&here[b])) else { break };
            length += here[nearest];
            walk.push(nearest);
        }
        walk.into_iter().map(|end| ends[end]).collect()
    };
    Ok((0..ROBOTS).map(walk).collect())
}

/// Returns the testbed file. Names are quoted, because a folder's can be a number or a word of YAML.
fn text(
    name: &str,
    walks: &[Vec<Position>],
    radio_units: &[Position],
    plugin: Option<&Declared<'_>>,
) -> String {
    let mut robots = String::new();
    let mut services = String::new();
    let mut waypoints = String::new();
    for (i, walk) in walks.iter().enumerate() {
        let n = i + 1;
        robots += &format!("  robot-{n}: {{ kind: robot, roaming: signal }}\n");
        services += &format!(
            "  \
  navigation-{n}:
    robot: robot-{n}
    kpis: {{ service_time: 20 ms }} # with `kept: 95 %` in it, each run passes or fails
    vnfs:
      driver-{n}: {{ program: robot_driver, pinned_to: robot-{n} }}
      navigation-{n}: {{ program: navigation, node: cloud, cpus: 1 }}
    virtual_links:
      - {{ from: driver-{n}, to: navigation-{n}, rate: 1 Mbit/s }}
"
        );
        let places: Vec<_> = walk.iter().map(|at| format!("[{:.2}, {:.2}]", at.x, at.y)).collect();
        let places = places.join(", ");
        waypoints += &format!(
            "  \
  robot-{n}:
    waypoints: [{places}]
    and_back: true
    speed_limit: 0.5 m/s
    position_interval: 100 ms
"
        );
    }
    let mut units = String::new();
    let mut names = Vec::new();
    for (i, (at, channel)) in radio_units.iter().zip(CHANNELS).enumerate() {
        let n = i + 1;
        units += &format!(
            "  R{n}: {{ kind: radio_unit, position: [{:.2}, {:.2}], channel: {channel} }}\n",
            at.x, at.y
        );
        names.push(format!("R{n}"));
    }
    let names = names.join(", ");
    let mut text = format!(
        "\
# Made by `cotorra new`. Delays, rates and costs are examples: write those of your network.
name: \"{name}\"
description: Three robots walk a floor. Their navigation runs on a server, over a wireless network.

map: map.yaml

wireless:
  floor:                      # the SSID
    standard: n
    fast_transition: true
    path_loss: {{ model: log_distance, exponent: 3.0 }}

nodes:
  # A robot changes its radio unit by signal. With `roaming: instructed`, a plug-in decides.
{robots}
{units}
  lan: {{ kind: switch }}

  # The order of cost: cloud < edge < fog.
  fog: {{ kind: server, tier: fog, cpus: 4, memory: 8 GB, cost: 3 }}
  edge: {{ kind: server, tier: edge, cpus: 8, memory: 16 GB, cost: 2 }}
  cloud: {{ kind: server, tier: cloud, cpus: 16, memory: 32 GB, cost: 1 }}

links:
  - {{ ends: [lan, [{names}]], delay: 500 us, rate: 1 Gbit/s }}
  - {{ ends: [lan, fog], delay: 500 us, rate: 1 Gbit/s }}
  - {{ ends: [lan, edge], delay: 4 ms, jitter: 500 us, rate: 1 Gbit/s }}
  - {{ ends: [lan, cloud], delay: 12 ms, jitter: 2 ms, loss: 0.1 %, rate: 100 Mbit/s }}

services:
{services}
walks:
{waypoints}"
    );
    if let Some(Declared { id, command }) = plugin {
        write!(
            text,
            "\nplugins:\n  - id: \"{id}\"\n    command: [{command}]\n    settings: {{ patience: 6 }}\n"
        )
        .expect("writing into a string cannot fail");
    }
    text
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Cell;

    use super::*;

    #[test]
    fn every_robot_walks_over_floor_that_it_can_reach() {
        let mut floor = Floor::new(&plan::building(), RobotModel::Turtlebot2).unwrap();
        let walks = walks(&mut floor).unwrap();
        assert_eq!(walks.len(), ROBOTS);
        for walk in &walks {
            assert!(walk.len() >= 2);
            for leg in walk.windows(2) {
                assert!(floor.way(leg[0], leg[1]).unwrap() >= SHORTEST_LEG);
            }
        }
        assert!(walks[0][0] != walks[1][0] && walks[1][0] != walks[2][0], "robots start apart");
    }

    #[test]
    fn a_floor_of_few_places_is_walked_by_all_robots() {
        // A room of 2 m × 0.5 m, in which only the two places at its ends are apart.
        let cell = |i| {
            if (1..21).contains(&(i % 22)) && (1..6).contains(&(i / 22)) {
                Cell::Free
            } else {
                Cell::Occupied
            }
        };
        let grid =
            OccupancyGrid::new(22, 7, 0.1, Position::new(0.0, 0.0), (0..154).map(cell).collect()).unwrap();
        let mut floor = Floor::new(&grid, RobotModel::Turtlebot2).unwrap();
        let walks = walks(&mut floor).unwrap();
        assert_eq!(walks.len(), ROBOTS);
        for walk in &walks {
            assert_eq!(walk.len(), 2, "{walk:?}");
            assert!(floor.way(walk[0], walk[1]).unwrap() >= SHORTEST_LEG, "{walk:?}");
        }
    }

    #[test]
    fn any_folder_and_plugin_gives_a_name() {
        for name in ["2024", "null", "true", "1e5", "0x10", "nan"] {
            let declared = Declared { id: name, command: "echo" };
            let (files, _) = files(name, &plan::building(), Some(&declared)).unwrap();
            let folder = tempfile::tempdir().unwrap();
            Destination::new(folder.path()).write(&files).unwrap();
            let testbed = cotorra_testbed_file::load(folder.path().join("testbed.yaml")).unwrap();
            assert_eq!((testbed.name.as_str(), testbed.plugins[0].id.as_str()), (name, name));
        }
    }

    #[test]
    fn nothing_of_a_testbed_is_where_its_map_knows_nothing() {
        // A room of 5 m × 6 m, beside as much that was not explored.
        let (width, height) = (100, 60);
        let cell = |at: usize| match (at % width, at / width) {
            (50.., _) => Cell::Unknown,
            (0 | 49, _) | (_, 0 | 59) => Cell::Occupied,
            _ => Cell::Free,
        };
        let origin = Position::new(-12.25, 3.5);
        let grid = OccupancyGrid::new(width, height, 0.1, origin, (0..width * height).map(cell).collect());
        let grid = grid.unwrap();
        let (files, _) = files("explored", &grid, None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        Destination::new(folder.path()).write(&files).unwrap();
        let testbed = cotorra_testbed_file::load(folder.path().join("testbed.yaml")).unwrap();
        assert!(testbed.map.as_ref() == Some(&grid));
        let waypoints = testbed.walks.iter().flat_map(|walk| walk.waypoints.iter().copied());
        let units = testbed.graph.nodes.iter().filter_map(|node| node.position);
        let places: Vec<_> = waypoints.chain(units).collect();
        assert!(places.len() > 2 * ROBOTS + CHANNELS.len());
        assert!(places.iter().all(|at| grid.at(*at) == Cell::Free), "{places:?}");
    }

    #[test]
    fn a_floor_without_room_for_a_walk_is_rejected_with_its_area() {
        let closet: Vec<_> = (0..9).map(|i| if i == 4 { Cell::Free } else { Cell::Occupied }).collect();
        for side in [0.3, 0.8] {
            let grid = OccupancyGrid::new(3, 3, side, Position::new(0.0, 0.0), closet.clone()).unwrap();
            let error = files("closet", &grid, None).err().unwrap();
            assert!(matches!(error, TestbedError::NoFloor { area } if area < 1.0), "{error}");
        }
    }
}
