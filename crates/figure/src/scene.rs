//! Drawings of areas, lines and texts. Lengths are points (1/72 inch); y grows downwards.

use std::{fmt, path::Path, str::FromStr};

use crate::{font, pdf, png, style::Colour, svg};

/// Width of all scenes, points: a column of a paper, 8.5 cm.
pub(crate) const WIDTH: f64 = 241.0;

pub(crate) type Point = (f64, f64);

/// File format of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Svg,
    Pdf,
    Png,
}

impl Format {
    pub const ALL: [Self; 3] = [Self::Svg, Self::Pdf, Self::Png];

    /// Returns the format of a file by the ending of its name.
    pub fn of(file: &Path) -> Option<Self> {
        file.extension()?.to_str()?.parse().ok()
    }

    /// Returns its name, which is also the ending of its files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Pdf => "pdf",
            Self::Png => "png",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|format| format.as_str() == name);
        found.ok_or_else(|| "formats of figures are svg, pdf and png".to_owned())
    }
}

/// A rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rect {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Rect {
    pub fn width(&self) -> f64 {
        self.right - self.left
    }

    pub fn height(&self) -> f64 {
        self.bottom - self.top
    }

    pub fn corners(&self) -> Vec<Point> {
        let Self { left, top, right, bottom } = *self;
        vec![(left, top), (right, top), (right, bottom), (left, bottom)]
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }

    /// Returns the rectangle that is so much larger on each side.
    pub fn grown(&self, by: f64) -> Self {
        let Self { left, top, right, bottom } = *self;
        Self { left: left - by, top: top - by, right: right + by, bottom: bottom + by }
    }

    /// Whether a line crosses the rectangle.
    pub fn is_crossed(&self, line: &[Point]) -> bool {
        line.windows(2).any(|pair| self.clip((pair[0], pair[1])).is_some())
    }

    /// Returns the part of a segment inside the rectangle (Liang and Barsky).
    pub fn clip(&self, (from, to): (Point, Point)) -> Option<(Point, Point)> {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let (mut first, mut last) = (0.0_f64, 1.0_f64);
        let sides = [
            (-dx, from.0 - self.left),
            (dx, self.right - from.0),
            (-dy, from.1 - self.top),
            (dy, self.bottom - from.1),
        ];
        for (outwards, room) in sides {
            if outwards < 0.0 {
                first = first.max(room / outwards);
            } else if outwards > 0.0 {
                last = last.min(room / outwards);
            } else if room < 0.0 {
                return None;
            }
        }
        let at = |share: f64| (from.0 + dx * share, from.1 + dy * share);
        // An end inside stays as it is, whatever the rounding.
        let begin = if first > 0.0 { at(first) } else { from };
        let end = if last < 1.0 { at(last) } else { to };
        (first <= last).then_some((begin, end))
    }

    /// Returns the parts of a line inside the rectangle.
    pub fn clip_line(&self, points: &[Point]) -> Vec<Vec<Point>> {
        let mut parts: Vec<Vec<Point>> = Vec::new();
        for pair in points.windows(2) {
            let Some((from, to)) = self.clip((pair[0], pair[1])) else { continue };
            match parts.last_mut() {
                Some(part) if part.last() == Some(&from) => part.push(to),
                _ => parts.push(vec![from, to]),
            }
        }
        parts
    }
}

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

    /// Writes the scene as a file of this format.
    pub fn render(&self, format: Format) -> Vec<u8> {
        match format {
            Format::Svg => svg::render(self).into_bytes(),
            Format::Pdf => pdf::render(self),
            Format::Png => png::render(self),
        }
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

    const PAGE: Rect = Rect { left: 0.0, top: 0.0, right: 10.0, bottom: 10.0 };

    #[test]
    fn lines_are_clipped_at_the_edge() {
        assert_eq!(PAGE.clip(((-5.0, 5.0), (15.0, 5.0))), Some(((0.0, 5.0), (10.0, 5.0))));
        assert_eq!(PAGE.clip(((-5.0, 5.0), (-1.0, 5.0))), None);
        assert_eq!(PAGE.clip(((2.0, 11.0), (8.0, 11.0))), None);
        let spike = PAGE.clip_line(&[(1.0, 1.0), (2.0, 1.0), (3.0, 21.0), (4.0, 1.0), (5.0, 1.0)]);
        assert_eq!(spike.len(), 2, "{spike:?}");
        assert_eq!(spike[0].last(), Some(&(2.45, 10.0)));
        assert_eq!(spike[1].first(), Some(&(3.55, 10.0)));
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

    #[test]
    fn formats_have_the_names_of_their_files() {
        for format in Format::ALL {
            assert_eq!(format.as_str().parse(), Ok(format));
            assert_eq!(Format::of(&Path::new("a.b").with_extension(format.as_str())), Some(format));
        }
        assert!("gif".parse::<Format>().unwrap_err().contains("svg, pdf and png"));
    }
}
