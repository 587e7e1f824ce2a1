//! Mean signal of radio units over a floor: the picture of `cotorra check --coverage`.

use std::path::{Path, PathBuf};

use cotorra_fabric::sensitivity;
use cotorra_figure::{Extent, FloorMap, FloorPanel, Format, Level, MAX_SERIES, Spot};
use cotorra_graph::{HardwareGraph, Node, Position, RadioUnit, Testbed, Walk};
use cotorra_testbed::{FolderError, write_file};

use super::{extent, walls::walls};

/// Cells, at most: 200 by 200 of a square.
const CELLS: f64 = 40_000.0;
/// Panels, at most.
const MAX_PANELS: usize = 25;
/// Range of the colours above the weakest sensitivity, dB, at least and at most.
const RANGE_DB: (f64, f64) = (10.0, 60.0);
/// The end of the colours is a multiple of it, dB.
const ROUND_DB: f64 = 5.0;
/// Parts of a walk that are shorter than this share of the longer side are not seen.
const SHORTEST: f64 = 0.002;

/// A picture of coverage is not possible.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum CoverageError {
    #[error("`--coverage` draws one testbed, and these are {0} files")]
    #[diagnostic(help("name one testbed file, and draw each other one by a command of its own"))]
    SeveralFiles(usize),
    #[error("{} exists already, and is not overwritten: choose another file, or remove it first", .0.display())]
    Exists(PathBuf),
    #[error("`{0}` has no radio units, so there is no coverage to draw")]
    #[diagnostic(help("add a node with `kind: radio_unit`, as in docs/reference/testbed-file.md"))]
    NoRadioUnits(String),
    #[error(transparent)]
    Unwritable(#[from] FolderError),
}

/// Checks that a picture of so many files can be written.
pub fn check(out: &Path, files: usize) -> Result<(), CoverageError> {
    if files > 1 {
        return Err(CoverageError::SeveralFiles(files));
    }
    // A link to nowhere exists, too.
    if out.symlink_metadata().is_ok() { Err(CoverageError::Exists(out.to_owned())) } else { Ok(()) }
}

/// Writes the picture into a file, whose name ends with a format's. Returns what it shows.
pub fn write(testbed: &Testbed, out: &Path) -> Result<String, CoverageError> {
    let is_figure = "the parser of arguments accepts names of figures only";
    let (format, name) = (Format::of(out).expect(is_figure), out.file_name().expect(is_figure));
    let units = testbed.graph.radio_units().count();
    if units == 0 {
        return Err(CoverageError::NoRadioUnits(testbed.name.clone()));
    }
    let picture = draw(testbed).draw().render(format);
    write_file(out.parent().unwrap_or(Path::new("")), &name.to_string_lossy(), picture)?;
    let height = Height::of(testbed).metres;
    Ok(format!("mean signal of {} at a height of {height} m", crate::words::count(units, "radio unit")))
}

/// Subject of a panel: one radio unit, or the strongest of several of a network.
struct Subject<'a> {
    network: &'a str,
    /// Places among all radio units.
    units: Vec<usize>,
}

fn draw(testbed: &Testbed) -> FloorMap {
    let graph = &testbed.graph;
    let units: Vec<_> = graph.radio_units().collect();
    let subjects = subjects(graph, &units);
    let extent = extent::of(testbed);
    let height = Height::of(testbed);
    let grid = Grid::over(extent);
    let shown = &subjects[..subjects.len().min(MAX_PANELS)];
    let panels: Vec<_> =
        shown.iter().map(|subject| panel(graph, &units, subject, &grid, height.metres)).collect();
    let lowest = panels.iter().map(|panel| panel.weakest.at).fold(f64::INFINITY, f64::min);
    let highest = panels.iter().flat_map(|panel| &panel.values).fold(f64::NEG_INFINITY, |a, b| a.max(*b));
    let highest = (highest.clamp(lowest + RANGE_DB.0, lowest + RANGE_DB.1) / ROUND_DB).ceil() * ROUND_DB;
    let spot = |(node, _): &(&Node, &RadioUnit)| {
        let Position { x, y, .. } = node.position.unwrap_or_default();
        Spot { name: node.id.to_string(), x, y }
    };
    let mut notes = vec![mean_of(graph).to_owned(), height.note];
    notes.extend(left_out(shown.len(), subjects.len(), "panels"));
    notes.extend(left_out(testbed.walks.len().min(MAX_SERIES), testbed.walks.len(), "walks"));
    FloorMap {
        title: testbed.name.clone(),
        label: "mean signal (dBm)".to_owned(),
        scale: (lowest, highest),
        extent,
        panels,
        walls: testbed.map.as_ref().map(walls).unwrap_or_default(),
        spots: units.iter().map(spot).collect(),
        paths: testbed.walks.iter().take(MAX_SERIES).map(|walk| path(walk, extent)).collect(),
        notes,
    }
}

/// Describes the mean signal.
fn mean_of(graph: &HardwareGraph) -> &'static str {
    let has_walls = |(_, unit): (&Node, &RadioUnit)| {
        graph.wireless.get(&unit.network).is_some_and(|network| network.walls.is_some())
    };
    if graph.radio_units().all(has_walls) {
        "The mean by path loss and walls: shadowing and fading are left out."
    } else if graph.radio_units().any(has_walls) {
        "The mean by path loss, and by walls if a network has any: shadowing and fading are left out."
    } else {
        "The mean by path loss alone: walls, shadowing and fading are left out."
    }
}

fn left_out(shown: usize, all: usize, what: &str) -> Option<String> {
    (shown < all).then(|| format!("{shown} of {all} {what} are drawn."))
}

/// Lists the strongest of each network that has several radio units, then each radio unit.
fn subjects<'a>(graph: &'a HardwareGraph, units: &[(&'a Node, &'a RadioUnit)]) -> Vec<Subject<'a>> {
    let of_network = |network: &'a String| {
        let its = units.iter().enumerate().filter(|(_, (_, unit))| unit.network == *network);
        Subject { network, units: its.map(|(i, _)| i).collect() }
    };
    let strongest = graph.wireless.keys().map(of_network).filter(|subject| subject.units.len() > 1);
    let each =
        units.iter().enumerate().map(|(i, (_, unit))| Subject { network: &unit.network, units: vec![i] });
    strongest.chain(each).collect()
}

fn panel(
    graph: &HardwareGraph,
    units: &[(&Node, &RadioUnit)],
    subject: &Subject<'_>,
    grid: &Grid,
    height_m: f64,
) -> FloorPanel {
    let of_network =
        || if graph.wireless.len() > 1 { format!(" of {}", subject.network) } else { String::new() };
    let title = match subject.units[..] {
        [i] => {
            let (Node { id, .. }, RadioUnit { channel, tx_power, serving, .. }) = units[i];
            let off = if *serving { "" } else { " (off)" };
            format!("{id}{off}: channel {channel}, {} dBm", tx_power.0)
        }
        _ => format!("strongest of {} radio units{}", subject.units.len(), of_network()),
    };
    let strongest = |place: Position| {
        let signals = subject.units.iter().filter_map(|i| graph.mean_signal(units[*i].0, place));
        signals.map(|signal| signal.0).fold(f64::NEG_INFINITY, f64::max)
    };
    let weakest =
        graph.wireless.get(subject.network).map_or(f64::NEG_INFINITY, |network| sensitivity(network).0);
    let dbm = format!("{weakest:.1} dBm").replace('-', "−");
    let name = format!("sensitivity{}: {dbm}", of_network());
    FloorPanel {
        title,
        columns: grid.columns,
        values: grid.places().map(|place| strongest(place.at_height(height_m))).collect(),
        weakest: Level { at: weakest, name },
        about: subject.units.clone(),
    }
}

/// Returns a walk without the parts that are too short to be seen.
fn path(walk: &Walk, extent: Extent) -> cotorra_figure::Path {
    let shortest = SHORTEST * extent.width().max(extent.height());
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (i, Position { x, y, .. }) in walk.waypoints.iter().enumerate() {
        let is_last = i + 1 == walk.waypoints.len();
        let is_seen = |(last_x, last_y): &(f64, f64)| (x - last_x).hypot(y - last_y) >= shortest;
        if is_last || points.last().is_none_or(is_seen) {
            points.push((*x, *y));
        }
    }
    cotorra_figure::Path { name: walk.robot.to_string(), points }
}

/// Cells over an extent.
struct Grid {
    extent: Extent,
    columns: usize,
    rows: usize,
}

impl Grid {
    fn over(extent: Extent) -> Self {
        let side_m = (extent.width() * extent.height() / CELLS).sqrt();
        // Rounding errors do not take a cell away.
        let cells = |length: f64| (length / side_m + 1e-9).floor().max(1.0) as usize;
        Self { extent, columns: cells(extent.width()), rows: cells(extent.height()) }
    }

    /// Returns the middles of the cells, row by row from the lower left.
    fn places(&self) -> impl Iterator<Item = Position> {
        let Self { extent, columns, rows, .. } = *self;
        let at = |cell: usize, count: usize| (cell as f64 + 0.5) / count as f64;
        (0..rows).flat_map(move |row| {
            (0..columns).map(move |column| {
                let (x, y) = (at(column, columns) * extent.width(), at(row, rows) * extent.height());
                Position::new(extent.left + x, extent.bottom + y)
            })
        })
    }
}

/// Height of the floor's picture, and the reason.
struct Height {
    metres: f64,
    note: String,
}

impl Height {
    /// Returns the height at which robots walk the longest way; of equals, the lowest. Without level parts of walks, it is
    /// that of the lowest robot.
    fn of(testbed: &Testbed) -> Self {
        let robots = testbed.graph.robots().filter_map(|(node, _)| node.position);
        let walks = || testbed.walks.iter().map(|walk| &walk.waypoints);
        let level_legs =
            walks().flat_map(|waypoints| waypoints.windows(2)).filter(|leg| leg[0].z == leg[1].z);
        let walked = level_legs.map(|leg| (leg[0].z, leg[0].distance(leg[1])));
        let places = walks().flatten().copied().chain(robots).map(|place| (place.z, 0.0));
        let mut heights: Vec<(f64, f64)> = walked.chain(places).collect();
        heights.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at_each = heights.chunk_by(|a, b| a.0 == b.0);
        let lengths = at_each.map(|parts| (parts[0].0, parts.iter().map(|(_, length)| length).sum::<f64>()));
        let longest = lengths.reduce(|a, b| if b.1 > a.1 { b } else { a });
        let (Some((metres, _)), Some((low, _)), Some((high, _))) = (longest, heights.first(), heights.last())
        else {
            return Self { metres: 0.0, note: "At a height of 0 m: there are no robots.".to_owned() };
        };
        let note = if low == high {
            format!("At a height of {metres} m, that of the robots.")
        } else {
            format!(
                "At a height of {metres} m, at which robots walk farthest; they are at {low} to {high} m."
            )
        };
        Self { metres, note }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::check::tests::testbed;

    const TWO: &str = "  R1: { kind: radio_unit, position: [0, 0, 3], channel: 1 }\n  \
                       R2: { kind: radio_unit, position: [30, 0, 3], channel: 6, tx_power: 20 dBm }\n";

    #[test]
    fn cells_are_bounded_and_hold_the_mean_signal_at_their_middles() {
        let testbed = testbed(TWO, "[[0, 0, 1], [100, 0, 1]]");
        let map = draw(&testbed);
        let [strongest, first, second] = &map.panels[..] else { panic!("{}", map.panels.len()) };
        // 120 m by 20 m in cells of 0.245 m.
        assert_eq!((first.columns, first.values.len()), (489, 489 * 81));
        let unit = testbed.graph.radio_units().next().unwrap().0;
        let lower_left = Position { x: -10.0 + 60.0 / 489.0, y: -10.0 + 10.0 / 81.0, z: 1.0 };
        let signal = testbed.graph.mean_signal(unit, lower_left).unwrap().0;
        assert!((first.values[0] - signal).abs() < 1e-9, "{signal}");
        let square = Grid::over(Extent { left: 0.0, bottom: 0.0, right: 40.0, top: 40.0 });
        assert_eq!((square.columns, square.rows), (200, 200));
        for (i, value) in strongest.values.iter().enumerate() {
            assert_eq!(*value, first.values[i].max(second.values[i]));
        }
        assert!(strongest.about.len() == 2 && map.scale.0 == strongest.weakest.at);
        assert_eq!(second.title, "R2: channel 6, 20 dBm");
    }

    #[test]
    fn the_scale_begins_at_the_sensitivity_and_ends_at_a_round_signal() {
        let map = draw(&testbed(TWO, "[[0, 0], [10, 0]]"));
        assert!((map.scale.0 + 91.15).abs() < 0.01, "{:?}", map.scale);
        assert_eq!(map.scale.1 % ROUND_DB, 0.0);
        let high = map.panels[0].values.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
        assert!((0.0..ROUND_DB).contains(&(map.scale.1 - high)), "{high}");
        assert_eq!(map.panels[0].weakest.name, "sensitivity: −91.2 dBm");
    }

    #[test]
    fn the_height_is_that_of_the_longest_way() {
        let height = |walk: &str| Height::of(&testbed(TWO, walk));
        let flat = height("[[0, 0], [5, 0]]");
        assert_eq!((flat.metres, flat.note.as_str()), (0.0, "At a height of 0 m, that of the robots."));
        let up = height("[[0, 0], [0, 0, 2], [9, 0, 2], [9, 0, 6], [0, 0, 6]]");
        assert_eq!(up.metres, 2.0);
        assert!(up.note.ends_with("they are at 0 to 6 m."), "{}", up.note);
        assert_eq!(height("[[0, 0, 1], [0, 0, 9]]").metres, 1.0);
    }

    #[test]
    fn walls_are_drawn_in_the_signal_and_told() {
        let (mut testbed, open) =
            (testbed(TWO, "[[0, 0, 1], [30, 0, 1]]"), testbed(TWO, "[[0, 0, 1], [30, 0, 1]]"));
        // One column of occupied cells, from 10 m to 11 m, across the whole picture.
        let cells = vec![cotorra_graph::Cell::Occupied; 40];
        let map = cotorra_graph::OccupancyGrid::new(1, 40, 1.0, Position::new(10.0, -20.0), cells).unwrap();
        let loss = cotorra_graph::WallLoss { loss_db: 5.0, at_most_db: None };
        let lab = testbed.graph.wireless.get_mut("lab").unwrap();
        lab.walls = Some(cotorra_graph::Walls { loss, map: Arc::new(map) });
        let (walled, open) = (draw(&testbed), draw(&open));
        let losses: Vec<_> =
            open.panels[1].values.iter().zip(&walled.panels[1].values).map(|(a, b)| a - b).collect();
        let first_row = &losses[..walled.panels[1].columns];
        assert!(first_row[0].abs() < 1e-9 && (first_row[first_row.len() - 1] - 5.0).abs() < 1e-9);
        assert_eq!(walled.notes[0], "The mean by path loss and walls: shadowing and fading are left out.");
        assert_eq!(open.notes[0], "The mean by path loss alone: walls, shadowing and fading are left out.");
        let command = <crate::check::CheckArgs as clap::Args>::augment_args(clap::Command::new("check"));
        let help = command.term_width(1000).render_long_help().to_string();
        assert!(help.contains("path loss and of the walls of networks that have `walls`"), "{help}");
    }

    #[test]
    fn panels_and_walks_that_are_left_out_are_counted() {
        let units: String = (0..30)
            .map(|i| format!("  R{i}: {{ kind: radio_unit, position: [{i}, 0], channel: 1 }}\n"))
            .collect();
        let map = draw(&testbed(&units, "[[0, 0], [5, 0]]"));
        assert_eq!(map.panels.len(), MAX_PANELS);
        assert_eq!(map.notes[2..], ["25 of 31 panels are drawn."]);
    }

    #[test]
    fn parts_of_walks_that_cannot_be_seen_are_left_out() {
        let walk: Vec<_> = (0..=1000).map(|i| format!("[{}, 0]", f64::from(i) * 0.1)).collect();
        let testbed = testbed(TWO, &format!("[{}]", walk.join(", ")));
        let points = &draw(&testbed).paths[0].points;
        assert!(points.len() <= 501, "{}", points.len());
        assert_eq!((points[0], points[points.len() - 1]), ((0.0, 0.0), (100.0, 0.0)));
    }
}
