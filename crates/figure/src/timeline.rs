//! Bars over time in rows, with their names inside or above.

use crate::{
    axis::{Axis, ROW},
    font,
    geometry::Rect,
    scene::{Anchor, Scene, WIDTH},
    style::{AXIS, BANDS, BLACK, GREY, LABEL, LIGHT, SMALL, THIN, TITLE},
};

const SIDE: f64 = 4.0;
const RIGHT: f64 = 7.0;
/// Thickness of a bar, points.
const BAR: f64 = 12.0;
/// Shortest bar, points, so that each is seen.
const SHORTEST: f64 = 0.8;
/// Room between rows, and around the name of a bar, points.
const GAP: f64 = 3.0;
/// Room between the line from a bar and its name, points.
const ASIDE: f64 = 1.5;

/// Bars over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    pub title: String,
    /// A line below the axis; empty for none.
    pub note: String,
    pub x: Axis,
    /// Rows from top to bottom.
    pub rows: Vec<Row>,
}

/// A row of bars.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub name: String,
    pub bars: Vec<Bar>,
}

/// A bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    pub from: f64,
    pub to: f64,
    pub name: String,
}

/// A name above a row: its level from the row, and the middle of its bar.
struct Above<'a> {
    bar: &'a Bar,
    level: usize,
    middle: f64,
}

impl Timeline {
    /// Draws the rows. The names of bars that have no room inside stand above, on as many levels as they need.
    pub fn draw(&self) -> Scene {
        let mut scene = Scene::new();
        let mut top = SIDE;
        let title = font::fit(&self.title, TITLE, WIDTH - 2.0 * SIDE);
        scene.text((SIDE, top + font::ASCENT * TITLE), &title, TITLE, Anchor::Start, BLACK);
        top += TITLE + SIDE;
        let widest = self.rows.iter().map(|row| font::width(&row.name, LABEL)).fold(0.0, f64::max);
        let left = (SIDE + widest + GAP).min(WIDTH / 2.0);
        let mut plot = Rect { left, top, right: WIDTH - RIGHT, bottom: top };
        self.narrow(&mut plot);
        let mut colour = 0;
        for row in &self.rows {
            let above = self.names_above(row, &plot);
            let levels = above.iter().map(|name| name.level + 1).max().unwrap_or_default();
            top += GAP + levels as f64 * ROW;
            for bar in &row.bars {
                let (from, to) = self.ends(bar, &plot);
                let area = Rect { left: from, top, right: to, bottom: top + BAR };
                scene.area(area.corners(), BANDS[colour % BANDS.len()].lighter(LIGHT / 2.0));
                colour += 1;
                if !above.iter().any(|name| std::ptr::eq(name.bar, bar)) {
                    let at = ((from + to) / 2.0, top + BAR / 2.0 + SMALL * 0.35);
                    scene.text(at, &bar.name, SMALL, Anchor::Middle, BLACK);
                }
            }
            for Above { bar, level, middle } in above {
                let baseline = top - level as f64 * ROW - GAP;
                scene.line(vec![(middle, top), (middle, baseline - SMALL * 0.6)], GREY, THIN, &[]);
                scene.text((middle + ASIDE, baseline), &bar.name, SMALL, Anchor::Start, BLACK);
            }
            let name = font::fit(&row.name, LABEL, left - SIDE - GAP);
            scene.text((left - GAP, top + BAR / 2.0 + LABEL * 0.35), &name, LABEL, Anchor::End, BLACK);
            top += BAR;
        }
        top += GAP;
        plot.bottom = top;
        scene.line(vec![(plot.left, plot.top), (plot.left, plot.bottom)], AXIS, THIN, &[]);
        self.x.draw_below(&mut scene, &plot, 0.0, true);
        top += self.x.height(plot.width()) + SIDE;
        if !self.note.is_empty() {
            let note = font::fit(&self.note, SMALL, WIDTH - 2.0 * SIDE);
            scene.text((SIDE, top + font::ASCENT * SMALL), &note, SMALL, Anchor::Start, BLACK);
            top += ROW;
        }
        scene.height = top.ceil();
        scene
    }

    fn ends(&self, bar: &Bar, plot: &Rect) -> (f64, f64) {
        let at = |value: f64| plot.left + self.x.share(value).clamp(0.0, 1.0) * plot.width();
        let (from, to) = (at(bar.from), at(bar.to));
        (from, to.max(from + SHORTEST))
    }

    /// Whether the name of a bar has room inside it.
    fn has_room(&self, bar: &Bar, plot: &Rect) -> bool {
        let (from, to) = self.ends(bar, plot);
        font::width(&bar.name, SMALL) + 2.0 <= to - from
    }

    /// Returns the middle of a bar, where the line to its name begins.
    fn middle(&self, bar: &Bar, plot: &Rect) -> f64 {
        let (from, to) = self.ends(bar, plot);
        (from + to) / 2.0
    }

    /// Narrows a plot until each name that stands above its bar has room to the right of the bar's middle.
    fn narrow(&self, plot: &mut Rect) {
        let bars = || self.rows.iter().flat_map(|row| &row.bars);
        // A narrower plot can move further names out of their bars.
        for _ in 0..=bars().count() {
            for bar in bars() {
                if self.has_room(bar, plot) {
                    continue;
                }
                let over = self.middle(bar, plot) + ASIDE + font::width(&bar.name, SMALL) - (WIDTH - 2.0);
                let share = (self.middle(bar, plot) - plot.left) / plot.width();
                if over > 0.0 && share > 0.0 {
                    plot.right = (plot.right - over / share).max(plot.left + plot.width() / 2.0);
                }
            }
        }
    }

    /// Places names that have no room inside their bars above them, to the right of the middle. A name that would reach the
    /// line of a bar behind it stands higher than that bar's name, so that no line crosses a name.
    fn names_above<'a>(&self, row: &'a Row, plot: &Rect) -> Vec<Above<'a>> {
        let mut outside: Vec<_> = row.bars.iter().filter(|bar| !self.has_room(bar, plot)).collect();
        outside.sort_by(|a, b| self.middle(a, plot).total_cmp(&self.middle(b, plot)));
        let mut placed: Vec<Above<'a>> = Vec::new();
        for bar in outside.into_iter().rev() {
            let middle = self.middle(bar, plot);
            let end = middle + ASIDE + font::width(&bar.name, SMALL) + GAP;
            let reached = placed.iter().filter(|name| name.middle < end);
            let level = reached.map(|name| name.level + 1).max().unwrap_or_default();
            placed.push(Above { bar, level, middle });
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Item;

    fn bar(from: f64, to: f64, name: &str) -> Bar {
        Bar { from, to, name: name.to_owned() }
    }

    fn timeline(bars: Vec<Bar>) -> Timeline {
        let rows = vec![
            Row { name: "negotiation".to_owned(), bars },
            Row {
                name: "attachment".to_owned(),
                bars: vec![bar(-5.0, 20.0, "AP of the own domain"), bar(20.0, 25.0, "vAP")],
            },
        ];
        let x = Axis::around("time (s)", -5.0, 25.0);
        Timeline { title: "Federation".to_owned(), note: "on a modelled ledger".to_owned(), x, rows }
    }

    #[test]
    fn names_of_short_bars_stand_above_and_never_collide() {
        let steps = ["announcement", "bids", "choice", "confirmation", "attachment"];
        for between in [0.0, 0.1, 0.5, 1.0, 2.0, 4.0] {
            let bars = steps.iter().enumerate().map(|(i, name)| {
                let from = i as f64 * between;
                bar(from, from + between / 2.0, name)
            });
            let scene = timeline(bars.collect()).draw();
            assert_eq!(scene.collisions(), Vec::<String>::new(), "{between}");
            for name in steps {
                let is_drawn = |item: &Item| matches!(item, Item::Text(text) if text.text == name);
                assert!(scene.items.iter().any(is_drawn), "{name}");
            }
        }
    }
}
