//! Drawings of areas, lines and texts. Lengths are points (1/72 inch); y grows downwards.

use crate::{
    colour::Colour,
    font,
    geometry::{Point, Rect},
};

/// Width of all scenes, points: a column of a paper, 8.5 cm.
pub(crate) const WIDTH: f64 = 241.0;

/// The place of a text that its coordinates name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A line of text.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Text {
    /// A point of its baseline.
    pub at: Point,
    pub text: String,
    pub size: f64,
    pub anchor: Anchor,
    /// Whether it reads upwards.
    pub is_turned: bool,
    pub colour: Colour,
}

impl Text {
    /// Returns where its baseline begins.
    pub fn start(&self) -> Point {
        let back = match self.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => font::width(&self.text, self.size) / 2.0,
            Anchor::End => font::width(&self.text, self.size),
        };
        if self.is_turned { (self.at.0, self.at.1 + back) } else { (self.at.0 - back, self.at.1) }
    }

    pub fn bounds(&self) -> Rect {
        let ((x, y), along) = (self.start(), font::width(&self.text, self.size));
        let (above, below) = (font::ASCENT * self.size, font::DESCENT * self.size);
        if self.is_turned {
            Rect { left: x - above, top: y - along, right: x + below, bottom: y }
        } else {
            Rect { left: x, top: y - above, right: x + along, bottom: y + below }
        }
    }
}

/// A line. It does not close by itself.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Line {
    pub points: Vec<Point>,
    pub colour: Colour,
    pub width: f64,
    /// Lengths of dashes and gaps in turn; none for a solid line.
    pub dashes: &'static [f64],
}

/// Cells of one colour each.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cells {
    /// The area that they fill.
    pub area: Rect,
    /// Number of cells in a row.
    pub columns: usize,
    /// Row by row from the top.
    pub colours: Vec<Colour>,
}

impl Cells {
    pub fn rows(&self) -> usize {
        self.colours.len() / self.columns.max(1)
    }
}

/// A part of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Item {
    /// A filled polygon.
    Area(Vec<Point>, Colour),
    Cells(Cells),
    Line(Line),
    Text(Text),
}

/// A drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    pub(crate) height: f64,
    pub(crate) items: Vec<Item>,
}

impl Scene {
    pub(crate) fn new() -> Self {
        Self { height: 0.0, items: Vec::new() }
    }

    pub(crate) fn area(&mut self, points: Vec<Point>, colour: Colour) {
        self.items.push(Item::Area(points, colour));
    }

    pub(crate) fn cells(&mut self, cells: Cells) {
        self.items.push(Item::Cells(cells));
    }

    pub(crate) fn line(&mut self, points: Vec<Point>, colour: Colour, width: f64, dashes: &'static [f64]) {
        self.items.push(Item::Line(Line { points, colour, width, dashes }));
    }

    pub(crate) fn text(&mut self, at: Point, text: &str, size: f64, anchor: Anchor, colour: Colour) {
        let text = Text { at, text: text.to_owned(), size, anchor, is_turned: false, colour };
        self.items.push(Item::Text(text));
    }

    pub(crate) fn turned(&mut self, at: Point, text: &str, size: f64, anchor: Anchor, colour: Colour) {
        let text = Text { at, text: text.to_owned(), size, anchor, is_turned: true, colour };
        self.items.push(Item::Text(text));
    }

    /// Lists texts that leave the page, or that overlap another text or a line. Empty for all figures of this crate.
    pub fn collisions(&self) -> Vec<String> {
        let texts = self.items.iter().filter_map(|item| match item {
            Item::Text(text) => Some((text, text.bounds())),
            _ => None,
        });
        let texts: Vec<_> = texts.collect();
        let mut found = Vec::new();
        for (i, (text, bounds)) in texts.iter().enumerate() {
            if bounds.left < 0.0 || bounds.top < 0.0 || bounds.right > WIDTH || bounds.bottom > self.height {
                found.push(format!("`{}` leaves the page: {bounds:?}", text.text));
            }
            for (other, _) in texts[i + 1..].iter().filter(|(_, other)| other.overlaps(bounds)) {
                found.push(format!("`{}` overlaps `{}`", text.text, other.text));
            }
            for item in &self.items {
                let Item::Line(line) = item else { continue };
                if bounds.grown(line.width / 2.0).is_crossed(&line.points) {
                    found.push(format!("a line crosses `{}` at {:?}", text.text, text.at));
                }
            }
        }
        found
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::style::{BLACK, WHITE};

    /// Two columns and one row: black and white.
    pub(crate) fn checkers() -> Cells {
        let area = Rect { left: 10.0, top: 2.0, right: 30.0, bottom: 12.0 };
        Cells { area, columns: 2, colours: vec![BLACK, WHITE] }
    }

    #[test]
    fn collisions_are_found() {
        let mut scene = Scene { height: 100.0, ..Scene::new() };
        scene.text((10.0, 50.0), "target", 7.0, Anchor::Start, BLACK);
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let mut crossed = scene.clone();
        crossed.line(vec![(0.0, 48.0), (200.0, 48.0)], BLACK, 1.0, &[]);
        assert_eq!(crossed.collisions().len(), 1);
        let mut covered = scene.clone();
        covered.turned((20.0, 40.0), "delay", 7.0, Anchor::End, BLACK);
        assert_eq!(covered.collisions(), ["`target` overlaps `delay`"]);
        scene.text((WIDTH, 20.0), "s", 7.0, Anchor::Start, BLACK);
        assert!(scene.collisions()[0].contains("leaves the page"));
    }
}
