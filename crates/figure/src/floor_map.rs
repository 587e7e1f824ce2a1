//! Values over a floor, as colours: panels of the same floor, which share one scale.

use crate::{
    axis::{Axis, ROW},
    colour::Colour,
    figure::Level,
    font,
    geometry::{Point, Rect},
    legend::{Entry, Legend, Look},
    names,
    scene::{Anchor, Cells, Scene, WIDTH},
    style::{AXIS, BLACK, BOLD, DASHES, FINE, GRID, LABEL, SERIES, SMALL, THIN, TITLE, WHITE, mark, ramp},
};

const SIDE: f64 = 4.0;
const RIGHT: f64 = 7.0;
/// Width of a name that reads upwards, points.
const NAME: f64 = 10.0;
/// Height of the bar of colours, points.
const BAR: f64 = 7.0;
/// Colours of the bar; more cannot be told apart.
const SHADES: usize = 200;
/// Share of the bar below the weakest level.
const BELOW: f64 = 0.06;
/// Room between panels, points.
const BETWEEN: f64 = 6.0;
/// Room between two columns, beside labels at the ends of their axes, points.
const COLUMNS: f64 = 5.0;
/// Heights of a plot that has the whole width, and of one in a column, points, at most.
const HIGH: f64 = 200.0;
const LOW: f64 = 130.0;
/// Plots that are so much wider than high have the whole width.
const WIDE: f64 = 2.2;
/// Radius of a spot that a panel is about, and of others, points.
const SPOT: f64 = 2.6;
const SMALL_SPOT: f64 = 1.3;
/// Width of the white edge around lines and spots, points.
const EDGE: f64 = 0.6;
/// Width of lines in a column, points.
const THINNER: f64 = 0.8;
/// Room between the middles of markers and spots, points.
const APART: f64 = 6.0;
/// The marker of a path stands at most so far from its begin, points.
const FARTHEST: u32 = 60;

/// Values over a floor.
#[derive(Debug, Clone, PartialEq)]
pub struct FloorMap {
    pub title: String,
    /// Name of the values, with their unit.
    pub label: String,
    /// The values with the first and the last colour.
    pub scale: (f64, f64),
    pub extent: Extent,
    pub panels: Vec<FloorPanel>,
    pub walls: Vec<Extent>,
    pub spots: Vec<Spot>,
    /// At most [`MAX_SERIES`](crate::MAX_SERIES), so that each has its own look.
    pub paths: Vec<Path>,
    /// Lines below the panels.
    pub notes: Vec<String>,
}

/// A rectangle on the floor, metres; its sides are above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    pub left: f64,
    pub bottom: f64,
    pub right: f64,
    pub top: f64,
}

impl Extent {
    pub fn width(&self) -> f64 {
        self.right - self.left
    }

    pub fn height(&self) -> f64 {
        self.top - self.bottom
    }
}

/// Values over the whole extent.
#[derive(Debug, Clone, PartialEq)]
pub struct FloorPanel {
    pub title: String,
    /// Number of cells in a row.
    pub columns: usize,
    /// Row by row from the lower left.
    pub values: Vec<f64>,
    /// Values below it are grey. It is marked on the scale.
    pub weakest: Level,
    /// Places in [`FloorMap::spots`] of those that the panel is about. Several have their names beside them.
    pub about: Vec<usize>,
}

/// A place with a name.
#[derive(Debug, Clone, PartialEq)]
pub struct Spot {
    pub name: String,
    pub x: f64,
    pub y: f64,
}

/// A line with a name. A marker stands at its begin, or at the next free place.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

/// The place of a panel in the scene.
struct Place<'a> {
    panel: &'a FloorPanel,
    plot: Rect,
    /// Width of its column.
    room: f64,
    has_whole_width: bool,
    /// Whether its axes have labels.
    x_is_labelled: bool,
    y_is_labelled: bool,
}

impl FloorMap {
    /// Draws the panels: those about several spots over the whole width, others in two columns if they are not too wide.
    pub fn draw(&self) -> Scene {
        let mut scene = Scene::new();
        let mut top = SIDE;
        let title = font::fit(&self.title, TITLE, WIDTH - 2.0 * SIDE);
        scene.text((SIDE, top + font::ASCENT * TITLE), &title, TITLE, Anchor::Start, BLACK);
        top += TITLE + SIDE;
        let [x, y] = self.axes();
        let labels =
            [20.0, LOW / 2.0, LOW, HIGH].map(|height| y.width(height)).into_iter().fold(0.0, f64::max);
        let left = SIDE + NAME + labels;
        self.draw_scale(&mut scene, &mut top, left);
        let entries = self.paths.iter().enumerate();
        let entries = entries.map(|(i, path)| Entry { name: path.name.clone(), look: Look::Marked(i) });
        let legend = Legend::new(entries.collect(), WIDTH, WIDTH);
        if !self.paths.is_empty() {
            legend.draw(&mut scene, top);
            top += ROW + legend.height() + 1.0;
        }
        for place in self.places(&mut top, left, &x) {
            self.draw_panel(&mut scene, &place, &x, &y);
        }
        for note in &self.notes {
            let note = font::fit(note, SMALL, WIDTH - 2.0 * SIDE);
            scene.text((SIDE, top + font::ASCENT * SMALL), &note, SMALL, Anchor::Start, BLACK);
            top += ROW;
        }
        scene.height = (top + 1.0).ceil();
        scene
    }

    fn axes(&self) -> [Axis; 2] {
        let Extent { left, bottom, right, top } = self.extent;
        [Axis::between("x (m)", left, right), Axis::between("y (m)", bottom, top)]
    }

    /// Draws the bar of colours below `top`, with the weakest levels above it, and moves `top` below it.
    fn draw_scale(&self, scene: &mut Scene, top: &mut f64, left: f64) {
        let mut levels: Vec<&Level> = Vec::new();
        for panel in &self.panels {
            if !levels.contains(&&panel.weakest) {
                levels.push(&panel.weakest);
            }
        }
        levels.sort_by(|a, b| a.at.total_cmp(&b.at));
        let lowest = levels.first().map_or(self.scale.0, |level| level.at.min(self.scale.0));
        let axis = Axis::between(&self.label, lowest - (self.scale.1 - lowest) * BELOW, self.scale.1);
        let names = *top;
        *top += levels.len() as f64 * ROW;
        let bar = Rect { left, top: *top, right: WIDTH - RIGHT, bottom: *top + BAR };
        let grey_below = levels.first().map_or(f64::NEG_INFINITY, |level| level.at);
        let value = |i: usize| axis.from + (axis.to - axis.from) * (i as f64 + 0.5) / SHADES as f64;
        let colours = (0..SHADES).map(|i| self.colour(value(i), grey_below)).collect();
        scene.cells(Cells { area: bar, columns: SHADES, colours });
        for (row, level) in levels.iter().enumerate() {
            let x = bar.left + axis.share(level.at).clamp(0.0, 1.0) * bar.width();
            let name_top = names + row as f64 * ROW;
            scene.line(vec![(x, name_top), (x, bar.bottom)], BLACK, FINE, &[]);
            let name = font::fit(&level.name, SMALL, bar.right - x - 2.0);
            scene.text((x + 2.0, name_top + font::ASCENT * SMALL), &name, SMALL, Anchor::Start, BLACK);
        }
        axis.draw_below(scene, &bar, 0.0, true);
        *top = bar.bottom + axis.height(bar.width()) + BETWEEN;
    }

    fn colour(&self, value: f64, weakest: f64) -> Colour {
        let (low, high) = self.scale;
        if value < weakest { GRID } else { ramp((value - low) / (high - low)) }
    }

    /// Places all panels below `top`, and moves `top` below them.
    fn places(&self, top: &mut f64, left: f64, x: &Axis) -> Vec<Place<'_>> {
        let ratio = self.extent.width() / self.extent.height();
        let whole = WIDTH - RIGHT - left;
        let between = COLUMNS + x.label_width(whole / 2.0);
        let has_whole_width =
            |panel: &FloorPanel| panel.about.len() > 1 || self.panels.len() == 1 || ratio > WIDE;
        let mut rows: Vec<Vec<&FloorPanel>> = Vec::new();
        for panel in &self.panels {
            match rows.last_mut() {
                Some(row) if row.len() == 1 && !has_whole_width(row[0]) && !has_whole_width(panel) => {
                    row.push(panel);
                }
                _ => rows.push(vec![panel]),
            }
        }
        let mut places = Vec::new();
        for (i, row) in rows.iter().enumerate() {
            let is_whole = has_whole_width(row[0]);
            let (room, highest) = if is_whole { (whole, HIGH) } else { ((whole - between) / 2.0, LOW) };
            let width = room.min(highest * ratio);
            let height = width / ratio;
            let mut below: f64 = 0.0;
            for (column, panel) in row.iter().enumerate() {
                let left = left + column as f64 * (room + between);
                let plot = Rect { left, top: *top + ROW, right: left + width, bottom: *top + ROW + height };
                // The axis of a column stands below the last of its panels about one spot.
                let is_single = |row: &[&FloorPanel]| row[0].about.len() == 1;
                let next = rows.get(i + 1).filter(|next| is_single(row) && is_single(next));
                let x_is_labelled = next.is_none_or(|next| next.len() <= column);
                below = below.max(if x_is_labelled { x.height(width) } else { 2.0 });
                let y_is_labelled = column == 0;
                let place =
                    Place { panel, plot, room, has_whole_width: is_whole, x_is_labelled, y_is_labelled };
                places.push(place);
            }
            *top += ROW + height + below + BETWEEN;
        }
        places
    }

    fn draw_panel(&self, scene: &mut Scene, place: &Place<'_>, x: &Axis, y: &Axis) {
        let Place { panel, plot, .. } = place;
        let title = font::fit(&panel.title, LABEL, place.room);
        scene.text((plot.left, plot.top - ROW + LABEL), &title, LABEL, Anchor::Start, BLACK);
        self.draw_values(scene, place);
        let at = |(metres_x, metres_y): (f64, f64)| -> Point {
            (plot.left + x.share(metres_x) * plot.width(), plot.bottom - y.share(metres_y) * plot.height())
        };
        let wall = |wall: &Extent| {
            let ((left, bottom), (right, top)) = (at((wall.left, wall.bottom)), at((wall.right, wall.top)));
            Rect { left, top, right, bottom }
        };
        let walls: Vec<_> = self.walls.iter().map(wall).collect();
        walls.iter().for_each(|wall| scene.area(wall.corners(), BLACK));
        if place.y_is_labelled {
            y.draw_beside(scene, plot, false);
            let middle = f64::midpoint(plot.top, plot.bottom);
            let name = font::fit(&y.label, LABEL, plot.height() + ROW);
            scene.turned((SIDE + LABEL * 0.8, middle), &name, LABEL, Anchor::Middle, BLACK);
        }
        x.draw_below(scene, plot, 0.0, place.x_is_labelled);
        let frame = [plot.corners(), vec![(plot.left, plot.top)]].concat();
        scene.line(frame, AXIS, THIN, &[]);

        let paths: Vec<Vec<Point>> =
            self.paths.iter().map(|path| path.points.iter().map(|point| at(*point)).collect()).collect();
        let spots: Vec<Point> = self.spots.iter().map(|spot| at((spot.x, spot.y))).collect();
        draw_paths(scene, place, &paths);
        let markers = markers(&paths, &spots);
        markers.iter().for_each(|(path, at)| mark(scene, *at, *path));
        let (about, others): (Vec<usize>, Vec<usize>) =
            (0..spots.len()).partition(|i| panel.about.contains(i));
        for spot in others {
            draw_spot(scene, spots[spot], SMALL_SPOT, WHITE);
        }
        for spot in &about {
            draw_spot(scene, spots[*spot], SPOT, BLACK);
        }
        if about.len() > 1 {
            let named: Vec<_> = about.iter().map(|i| (spots[*i], self.spots[*i].name.as_str())).collect();
            // A marker is a line of one point: names leave room where lines begin.
            let lines: Vec<_> = paths.into_iter().chain(markers.iter().map(|(_, at)| vec![*at])).collect();
            names::draw(scene, plot, &named, &lines, &walls);
        }
    }

    fn draw_values(&self, scene: &mut Scene, place: &Place<'_>) {
        let Place { panel, plot, .. } = place;
        let rows = panel.values.chunks_exact(panel.columns.max(1)).rev();
        let colours = rows.flatten().map(|value| self.colour(*value, panel.weakest.at)).collect();
        scene.cells(Cells { area: *plot, columns: panel.columns, colours });
    }
}

/// Draws the paths with a white edge, all edges first, so that no path hides another.
fn draw_paths(scene: &mut Scene, place: &Place<'_>, paths: &[Vec<Point>]) {
    let width = if place.has_whole_width { BOLD } else { THINNER };
    for path in paths {
        for part in place.plot.clip_line(path) {
            scene.line(part, WHITE, width + 2.0 * EDGE, &[]);
        }
    }
    for (i, path) in paths.iter().enumerate() {
        for part in place.plot.clip_line(path) {
            scene.line(part, SERIES[i % SERIES.len()], width, DASHES[i % DASHES.len()]);
        }
    }
}

/// Returns the place of each path's marker: the first that is apart from all spots and markers, or else its begin.
fn markers(paths: &[Vec<Point>], spots: &[Point]) -> Vec<(usize, Point)> {
    let mut markers: Vec<(usize, Point)> = Vec::new();
    for (i, path) in paths.iter().enumerate() {
        let is_free = |(x, y): &Point| {
            let mut others = spots.iter().chain(markers.iter().map(|(_, at)| at));
            others.all(|(other_x, other_y)| (x - other_x).hypot(y - other_y) >= APART)
        };
        let free = (0..FARTHEST).filter_map(|far| along(path, f64::from(far))).find(is_free);
        let at = free.or_else(|| path.first().copied());
        markers.extend(at.map(|at| (i, at)));
    }
    markers
}

/// Returns the place so far along a line; `None` beyond its end.
fn along(line: &[Point], mut far: f64) -> Option<Point> {
    for pair in line.windows(2) {
        let ((x, y), (to_x, to_y)) = (pair[0], pair[1]);
        let length = (to_x - x).hypot(to_y - y);
        if far < length {
            return Some((x + (to_x - x) * far / length, y + (to_y - y) * far / length));
        }
        far -= length;
    }
    None
}

/// Draws a disc with an edge: black in white, or white in black.
fn draw_spot(scene: &mut Scene, at: Point, radius: f64, colour: Colour) {
    const CORNERS: u32 = 16;
    let disc = |radius: f64| -> Vec<Point> {
        let angle = |i: u32| std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS);
        (0..CORNERS).map(|i| (at.0 + radius * angle(i).sin(), at.1 - radius * angle(i).cos())).collect()
    };
    let edge = if colour == WHITE { BLACK } else { WHITE };
    scene.area(disc(radius + EDGE), edge);
    scene.area(disc(radius), colour);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{MAX_SERIES, scene::Item};

    fn level() -> Level {
        Level { at: -91.0, name: "sensitivity −91 dBm".to_owned() }
    }

    /// A map of so many metres with spots along its diagonal: one panel with all spots, and one for each.
    fn floor(width: f64, height: f64, spots: usize, paths: usize) -> FloorMap {
        let extent = Extent { left: -3.0, bottom: 7.0, right: width - 3.0, top: 7.0 + height };
        let at = |share: f64| (extent.left + share * width, extent.bottom + share * height);
        let spot = |i: usize| {
            let (x, y) = at((i as f64 + 0.5) / spots as f64);
            Spot { name: format!("radio-unit-{i}"), x, y }
        };
        let panel = |about: Vec<usize>| FloorPanel {
            title: format!("panel about {about:?}"),
            columns: 4,
            values: vec![-100.0, -80.0, -60.0, -40.0, -90.0, -70.0, -50.0, -30.0],
            weakest: level(),
            about,
        };
        let all: Vec<usize> = (0..spots).collect();
        let single = all.iter().map(|i| panel(vec![*i]));
        let panels = [all.clone()].into_iter().filter(|all| all.len() > 1).map(panel).chain(single).collect();
        let path = |i: usize| {
            let points = vec![at(0.1), (extent.right, extent.bottom + height * i as f64 / 8.0), at(0.9)];
            Path { name: format!("robot-{i}"), points }
        };
        FloorMap {
            title: "A floor".to_owned(),
            label: "mean signal (dBm)".to_owned(),
            scale: (-91.0, -30.0),
            extent,
            panels,
            walls: vec![Extent {
                right: extent.left + width / 2.0,
                top: extent.bottom + height / 20.0,
                ..extent
            }],
            spots: (0..spots).map(spot).collect(),
            paths: (0..paths).map(path).collect(),
            notes: vec!["the mean of path loss".to_owned()],
        }
    }

    fn texts(scene: &Scene) -> Vec<&str> {
        let texts = scene.items.iter();
        texts
            .filter_map(|item| if let Item::Text(text) = item { Some(text.text.as_str()) } else { None })
            .collect()
    }

    fn cells(scene: &Scene) -> Vec<&Cells> {
        let items = scene.items.iter();
        items.filter_map(|item| if let Item::Cells(cells) = item { Some(cells) } else { None }).collect()
    }

    #[test]
    fn values_have_the_colours_of_the_scale_and_weak_ones_are_grey() {
        let floor = floor(40.0, 20.0, 1, 0);
        let scene = floor.draw();
        let panel = cells(&scene)[1];
        assert_eq!((panel.columns, panel.rows()), (4, 2));
        // The upper row comes first.
        assert_eq!(panel.colours[0], ramp((-90.0 + 91.0) / 61.0));
        assert_eq!(panel.colours[4], GRID, "−100 dBm is below the sensitivity");
        assert_eq!(panel.colours[3], ramp(1.0));
        let bar = cells(&scene)[0];
        assert_eq!(bar.colours[0], GRID);
        assert!((bar.colours.iter().filter(|colour| **colour == GRID).count() as f64) < 0.07 * SHADES as f64);
    }

    #[test]
    fn metres_are_as_long_along_both_axes() {
        for (width, height) in [(40.0, 20.0), (10.0, 10.0), (5.0, 40.0), (80.0, 10.0)] {
            for drawn in &cells(&floor(width, height, 3, 0).draw())[1..] {
                let ratio = drawn.area.width() / drawn.area.height();
                assert!((ratio / (width / height) - 1.0).abs() < 1e-9, "{ratio}");
            }
        }
    }

    #[test]
    fn several_spots_have_their_names_and_one_has_the_title() {
        let several = floor(40.0, 30.0, 5, 2).draw();
        for i in 0..5 {
            let name = format!("radio-unit-{i}");
            assert_eq!(texts(&several).iter().filter(|text| **text == name).count(), 1, "{name}");
        }
        assert!(!texts(&floor(40.0, 30.0, 1, 2).draw()).contains(&"radio-unit-0"));
    }

    #[test]
    fn markers_stand_beside_spots_and_each_other() {
        let line = vec![(0.0, 0.0), (10.0, 0.0), (10.0, 50.0)];
        let paths = [line.clone(), line.clone(), vec![(0.0, 1.0)]];
        let alone = markers(&paths, &[(100.0, 0.0)]);
        assert_eq!(
            alone,
            [(0, (0.0, 0.0)), (1, (6.0, 0.0)), (2, (0.0, 1.0))],
            "a path without length has one place"
        );
        assert_eq!(markers(&paths[..2], &[(0.0, 0.0)]), [(0, (6.0, 0.0)), (1, (10.0, 5.0))]);
    }

    #[test]
    fn names_leave_room_for_markers_that_stand_aside() {
        for (magnitude, ratio, spots, paths) in
            [(5.883290311038901, 3.8121447080986095, 5, 8), (3.78827655776718, 2.860284950158455, 7, 4)]
        {
            let width = 10_f64.powf(magnitude);
            let scene = floor(width, width / ratio, spots, paths).draw();
            assert_eq!(scene.collisions(), Vec::<String>::new());
        }
    }

    #[test]
    fn each_weakest_level_is_marked_once() {
        let mut floor = floor(40.0, 30.0, 3, 0);
        assert_eq!(texts(&floor.draw()).iter().filter(|text| text.starts_with("sensitivity")).count(), 1);
        for (i, panel) in floor.panels.iter_mut().enumerate() {
            panel.weakest = Level { at: -91.0 + i as f64 * 0.1, name: format!("sensitivity of network {i}") };
        }
        let scene = floor.draw();
        assert_eq!(texts(&scene).iter().filter(|text| text.starts_with("sensitivity")).count(), 4);
        assert_eq!(scene.collisions(), Vec::<String>::new());
    }

    proptest! {
        #[test]
        fn nothing_overlaps_and_nothing_leaves_the_page(
            magnitude in -1.0..7.0_f64, ratio in 0.13..8.0_f64, spots in 1..12_usize, paths in 0..=MAX_SERIES
        ) {
            let width = 10_f64.powf(magnitude);
            let scene = floor(width, width / ratio, spots, paths).draw();
            prop_assert_eq!(scene.collisions(), Vec::<String>::new());
            for drawn in cells(&scene) {
                prop_assert!(drawn.area.right <= WIDTH && drawn.area.bottom <= scene.height);
            }
        }
    }
}
