//! A way as points in order, with what following it needs: where one is on it, and what lies ahead.

use cotorra_graph::Position;

/// A polyline of one point or more.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    points: Vec<Position>,
}

/// The place on a path that is nearest to some other place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// The place on the path.
    pub place: Position,
    /// Distance from the other place, metres.
    pub distance: f64,
    /// The stretch it lies on begins at this point.
    stretch: usize,
}

impl Path {
    /// The lines between those corners, one or more, with a point at least every `spacing` metres.
    pub fn new(corners: &[Position], spacing: f64) -> Self {
        let mut points = vec![corners[0]];
        for pair in corners.windows(2) {
            let steps = (pair[0].distance(pair[1]) / spacing).ceil().max(1.0);
            points.extend((1..=steps as usize).map(|i| pair[0].towards(pair[1], i as f64 / steps)));
        }
        Self { points }
    }

    /// The straight way.
    pub fn straight(from: Position, to: Position) -> Self {
        Self { points: vec![from, to] }
    }

    /// Returns the points of the path.
    #[cfg(test)]
    pub fn points(&self) -> &[Position] {
        &self.points
    }

    /// Returns its length in metres.
    pub fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
    }

    /// The way above it that begins at one height and ends at another, and rises evenly in between.
    pub fn rising(mut self, from: f64, to: f64) -> Self {
        let length = |pair: &[Position]| pair[0].distance(pair[1]);
        let whole = self.length();
        let mut gone = 0.0;
        for i in 0..self.points.len() {
            let share = if i + 1 == self.points.len() { 1.0 } else { gone / whole };
            gone += self.points.get(i..i + 2).map_or(0.0, length);
            self.points[i].z = from * (1.0 - share) + to * share;
        }
        self
    }

    /// Returns the points of the path, to be moved.
    pub(crate) fn points_mut(&mut self) -> &mut [Position] {
        &mut self.points
    }

    /// The place on it that is nearest to `place`; of equally near ones the last.
    pub fn project(&self, place: Position) -> Projection {
        let end = self.points[self.points.len() - 1];
        let mut nearest =
            Projection { place: end, distance: place.distance(end), stretch: self.points.len() - 1 };
        for (stretch, pair) in self.points.windows(2).enumerate().rev() {
            let (a, b) = (pair[0], pair[1]);
            let (dx, dy, dz) = (b.x - a.x, b.y - a.y, b.z - a.z);
            let square = dx * dx + dy * dy + dz * dz;
            let along = ((place.x - a.x) * dx + (place.y - a.y) * dy + (place.z - a.z) * dz) / square;
            let t = if square > 0.0 { along.clamp(0.0, 1.0) } else { 0.0 };
            let on = a.towards(b, t);
            let distance = place.distance(on);
            if distance < nearest.distance {
                nearest = Projection { place: on, distance, stretch };
            }
        }
        nearest
    }

    /// The place so many metres further along; the end if it comes before.
    pub fn ahead(&self, from: &Projection, metres: f64) -> Position {
        let mut here = from.place;
        let mut left = metres;
        for &point in self.points.iter().skip(from.stretch + 1) {
            let length = here.distance(point);
            if length >= left && length > 0.0 {
                return here.towards(point, left / length);
            }
            left -= length;
            here = point;
        }
        here
    }

    /// Metres from there to the end, along the path.
    pub fn remaining(&self, from: &Projection) -> f64 {
        let mut here = from.place;
        let rest = self.points.iter().skip(from.stretch + 1);
        rest.map(|&point| std::mem::replace(&mut here, point).distance(point)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Path {
        Path::new(&[Position::new(0.0, 0.0), Position::new(2.0, 0.0), Position::new(2.0, 2.0)], 0.1)
    }

    fn near(a: Position, b: Position) -> bool {
        a.distance(b) < 1e-9
    }

    #[test]
    fn projects_onto_the_nearest_stretch() {
        let on = corner().project(Position::new(0.75, 0.3));
        assert!(near(on.place, Position::new(0.75, 0.0)));
        assert!((on.distance - 0.3).abs() < 1e-9);
        assert!((corner().remaining(&on) - 3.25).abs() < 1e-9);
    }

    #[test]
    fn looks_ahead_around_the_corner_and_stops_at_the_end() {
        let path = corner();
        let on = path.project(Position::new(1.75, 0.0));
        assert!(near(path.ahead(&on, 0.5), Position::new(2.0, 0.25)));
        assert!(near(path.ahead(&on, 50.0), Position::new(2.0, 2.0)));
        assert!(near(path.ahead(&on, 0.0), on.place));
    }

    #[test]
    fn a_rising_path_rises_evenly_with_its_length() {
        let path = corner().rising(1.0, 3.0);
        let points = path.points();
        assert_eq!((points[0].z, points[points.len() - 1].z), (1.0, 3.0));
        let half_way = path.project(Position::new(2.0, 0.0).at_height(2.0));
        assert!(near(half_way.place, Position::new(2.0, 0.0).at_height(2.0)), "{half_way:?}");
        assert!((path.ahead(&half_way, 0.5).z - 2.22).abs() < 0.01);
    }

    #[test]
    fn a_path_straight_up_is_followed_by_height() {
        let (low, high) = (Position::new(1.0, 1.0), Position::new(1.0, 1.0).at_height(4.0));
        let path = Path::straight(low, high);
        let on = path.project(Position::new(1.3, 1.0).at_height(1.0));
        assert!((on.place.z - 1.0).abs() < 1e-9 && (on.distance - 0.3).abs() < 1e-9);
        assert!((path.remaining(&on) - 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_path_of_one_place_is_a_path() {
        let place = Position::new(1.0, 1.0);
        for path in [Path::new(&[place], 0.1), Path::straight(place, place)] {
            let on = path.project(Position::new(1.0, 2.0));
            assert_eq!((on.place, on.distance), (place, 1.0));
            assert_eq!(path.ahead(&on, 1.0), place);
            assert_eq!(path.remaining(&on), 0.0);
        }
    }
}
