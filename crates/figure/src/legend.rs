//! Legends: samples of lines and areas with their names, in rows above a plot.

use crate::{
    axis::ROW,
    colour::Colour,
    font,
    scene::{Anchor, Scene, WIDTH},
    style::{ALERT, AXIS, BLACK, BOLD, DASHES, FINE, LIGHT, SERIES, SMALL, THIN, WIDE, mark, mark_cut},
};

/// Width of a sample, points.
const SAMPLE: f64 = 16.0;
/// Room between a sample and its name, and between entries, points.
const GAP: f64 = 3.0;
const BETWEEN: f64 = 8.0;
/// Room left and right of a legend, points.
const SIDE: f64 = 4.0;

/// The look of an entry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Look {
    /// A wide, pale line in the colour of a series.
    Faint(usize),
    /// A line in the colour of a series.
    Dense(usize),
    /// A line with dashes of a series.
    Line(usize),
    /// A line with dashes and markers of a series.
    Marked(usize),
    /// A range of values in the colour of a series.
    Range(usize),
    Area(Colour),
    /// A dashed line across a plot.
    Level,
    /// A tick for a missing value.
    Missing,
    /// A mark for values above the axis.
    Cut,
}

/// An entry.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    pub name: String,
    pub look: Look,
}

impl Entry {
    fn width(&self) -> f64 {
        SAMPLE + GAP + font::width(&self.name, SMALL)
    }
}

/// Entries in rows.
pub(crate) struct Legend {
    rows: Vec<Vec<Entry>>,
}

impl Legend {
    /// Puts entries into rows. The first row has `first` points, and is left empty if no entry fits into it; others have
    /// `room` points.
    pub fn new(entries: Vec<Entry>, first: f64, room: f64) -> Self {
        let mut rows: Vec<Vec<Entry>> = vec![Vec::new()];
        let mut left = first - 2.0 * SIDE;
        for mut entry in entries {
            entry.name = font::fit(&entry.name, SMALL, room - 2.0 * SIDE - SAMPLE - GAP);
            if entry.width() > left {
                rows.push(Vec::new());
                left = room - 2.0 * SIDE;
            }
            left -= entry.width() + BETWEEN;
            if let Some(row) = rows.last_mut() {
                row.push(entry);
            }
        }
        Self { rows }
    }

    /// Returns the height of all rows but the first.
    pub fn height(&self) -> f64 {
        (self.rows.len() - 1) as f64 * ROW
    }

    /// Draws the rows, right-aligned; `top` is the top of the first.
    pub fn draw(&self, scene: &mut Scene, mut top: f64) {
        for row in &self.rows {
            let wide: f64 =
                row.iter().map(Entry::width).sum::<f64>() + BETWEEN * row.len().saturating_sub(1) as f64;
            let mut x = WIDTH - SIDE - wide;
            for entry in row {
                draw_sample(scene, x, top + ROW / 2.0, entry.look);
                let at = (x + SAMPLE + GAP, top + ROW / 2.0 + SMALL * 0.34);
                scene.text(at, &entry.name, SMALL, Anchor::Start, BLACK);
                x += entry.width() + BETWEEN;
            }
            top += ROW;
        }
    }
}

fn draw_sample(scene: &mut Scene, x: f64, y: f64, look: Look) {
    let ends = vec![(x, y), (x + SAMPLE, y)];
    let rectangle =
        |half: f64| vec![(x, y - half), (x + SAMPLE, y - half), (x + SAMPLE, y + half), (x, y + half)];
    let middle = (x + SAMPLE / 2.0, y);
    match look {
        Look::Faint(series) => {
            scene.line(ends, SERIES[series % SERIES.len()].lighter(LIGHT), WIDE, &[]);
        }
        Look::Dense(series) => scene.line(ends, SERIES[series % SERIES.len()], BOLD, &[]),
        Look::Line(series) => {
            scene.line(ends, SERIES[series % SERIES.len()], BOLD, DASHES[series % DASHES.len()])
        }
        Look::Marked(series) => {
            scene.line(ends, SERIES[series % SERIES.len()], BOLD, DASHES[series % DASHES.len()]);
            mark(scene, middle, series);
        }
        Look::Range(series) => scene.area(rectangle(2.5), SERIES[series % SERIES.len()].lighter(0.6)),
        Look::Area(colour) => {
            scene.area(rectangle(2.5), colour);
            let outline = rectangle(2.5);
            scene.line([outline.clone(), vec![outline[0]]].concat(), AXIS, THIN, &[]);
        }
        Look::Level => scene.line(ends, ALERT, FINE * 1.4, LEVEL_DASHES),
        Look::Missing => scene.line(vec![(middle.0, y - 2.5), (middle.0, y + 2.5)], ALERT, FINE, &[]),
        Look::Cut => mark_cut(scene, (middle.0, y - 1.5), AXIS),
    }
}

/// Dashes of a line across a plot.
pub(crate) const LEVEL_DASHES: &[f64] = &[3.0, 2.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_fill_rows_and_never_leave_the_page() {
        let entry =
            |i: usize, length: usize| Entry { name: format!("{i}-").repeat(length), look: Look::Marked(i) };
        for (count, length) in [(0, 1), (1, 3), (3, 4), (8, 2), (8, 60)] {
            let legend = Legend::new((0..count).map(|i| entry(i, length)).collect(), 100.0, 200.0);
            let mut scene = Scene::new();
            legend.draw(&mut scene, 0.0);
            scene.height = ROW + legend.height();
            assert_eq!(scene.collisions(), Vec::<String>::new(), "{count} {length}");
        }
        assert_eq!(Legend::new(vec![entry(0, 2)], 100.0, 200.0).height(), 0.0);
        assert_eq!(Legend::new(vec![entry(0, 2)], 10.0, 200.0).height(), ROW);
    }
}
