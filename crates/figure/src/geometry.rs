//! Points and rectangles. Lengths are points (1/72 inch); y grows downwards.

pub(crate) type Point = (f64, f64);

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
