//! The floor that a robot can reach on a map. Chooses places on it, and measures the ways between them.

use cotorra_graph::{OccupancyGrid, Position, RobotModel};

use crate::{
    costmap::Costmap,
    path::Path,
    planner::{Planner, Unreachable},
};

/// Distance between the places to choose from, metres.
const SPACING: f64 = 0.25;
/// Distance from obstacles that a place keeps if the floor is wide enough, metres.
const COMFORT: f64 = 0.5;
/// Rounds of Lloyd's algorithm.
const ROUNDS: usize = 20;

/// The largest connected floor of a map on which a robot fits.
#[derive(Debug)]
pub struct Floor {
    map: Costmap,
    planner: Planner,
    places: Vec<Position>,
    area: f64,
}

impl Floor {
    /// Finds the floor of a robot; `None` if it fits nowhere.
    pub fn new(grid: &OccupancyGrid, model: RobotModel) -> Option<Self> {
        let map = Costmap::new(grid, model.radius());
        let cells = map.largest_component();
        let area = cells.len() as f64 * map.resolution().powi(2);
        let every = (SPACING / map.resolution()).round().max(1.0) as usize;
        let on_lattice = |cell: &usize| {
            (cell % map.width()).is_multiple_of(every) && (cell / map.width()).is_multiple_of(every)
        };
        let on_lattice: Vec<_> = cells.iter().copied().filter(on_lattice).collect();
        // A floor of a few cells may lie between the lattice's.
        let all = if on_lattice.is_empty() { cells } else { on_lattice };
        let all: Vec<_> = all.into_iter().map(|cell| map.centre(cell)).collect();
        let wide: Vec<_> = all.iter().copied().filter(|&at| map.clearance_at(at) >= COMFORT).collect();
        let places = if wide.is_empty() { all } else { wide };
        (!places.is_empty()).then_some(Self { map, planner: Planner::default(), places, area })
    }

    /// Returns the area where the robot's centre can be, in square metres.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Chooses places that are far from each other, beginning at the end of the floor. Places repeat if there are too few.
    pub fn ends(&self, count: usize) -> Vec<Position> {
        let mut chosen = vec![farthest(&self.places, &[mean(&self.places)])];
        while chosen.len() < count {
            chosen.push(farthest(&self.places, &chosen));
        }
        chosen.truncate(count);
        chosen
    }

    /// Chooses places from which the whole floor is near (Lloyd, "Least squares quantization in PCM", 1982).
    pub fn centres(&self, count: usize) -> Vec<Position> {
        let mut centres = self.ends(count);
        for _ in 0..ROUNDS {
            let mut parts = vec![Vec::new(); centres.len()];
            for &place in &self.places {
                let distance = |i: &usize| centres[*i].distance(place);
                let nearest = (0..centres.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
                parts[nearest.unwrap_or(0)].push(place);
            }
            for (centre, part) in centres.iter_mut().zip(parts).filter(|(_, part)| !part.is_empty()) {
                *centre = mean(&part);
            }
        }
        // The middle of a part may lie in a wall.
        let nearest = |centre: &Position| {
            let distance = |place: &&Position| place.distance(*centre);
            self.places.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).copied()
        };
        centres.iter().filter_map(nearest).collect()
    }

    /// Returns the length of the way that navigation plans between two places, in metres.
    ///
    /// # Errors
    /// [`Unreachable`] if the robot cannot drive it.
    pub fn way(&mut self, from: Position, to: Position) -> Result<f64, Unreachable> {
        self.planner.plan(&self.map, from, to).as_ref().map(Path::length).map_err(|&reason| reason)
    }
}

fn mean(places: &[Position]) -> Position {
    let count = places.len() as f64;
    let sum = |axis: fn(&Position) -> f64| places.iter().map(axis).sum::<f64>();
    Position::new(sum(|at| at.x) / count, sum(|at| at.y) / count)
}

/// Returns the place with the greatest distance from all others. There is at least one of each.
fn farthest(places: &[Position], others: &[Position]) -> Position {
    let distance =
        |at: &Position| others.iter().map(|other| other.distance(*at)).fold(f64::INFINITY, f64::min);
    let farther = |best: Position, &at: &Position| if distance(&at) > distance(&best) { at } else { best };
    places.iter().fold(places[0], farther)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::grid;

    /// Two rooms of 8 m × 10 m beside each other with a door between them, and a closet without a door.
    fn two_rooms() -> OccupancyGrid {
        let row = |y: usize| -> String {
            let cell = |x: usize| match (x, y) {
                (0 | 34 | 44, _) | (_, 0 | 21) => '#',
                (17, y) if !(9..13).contains(&y) => '#',
                _ => '.',
            };
            (0..45).map(cell).collect()
        };
        grid(&(0..22).map(row).collect::<Vec<_>>(), 0.5)
    }

    fn floor() -> Floor {
        Floor::new(&two_rooms(), RobotModel::Turtlebot2).unwrap()
    }

    #[test]
    fn floor_is_the_largest_part_that_is_connected() {
        let floor = floor();
        assert!(floor.places.iter().all(|at| at.x < 17.0), "nothing is in the closet");
        assert!(floor.area() > 120.0 && floor.area() < 165.0, "{}", floor.area());
    }

    #[test]
    fn ends_lie_far_apart_and_every_way_between_them_can_be_driven() {
        let mut floor = floor();
        let ends = floor.ends(4);
        for (i, &from) in ends.iter().enumerate() {
            for &to in &ends[..i] {
                assert!(from.distance(to) > 6.0, "{from} and {to}");
                assert!(floor.way(from, to).unwrap() >= from.distance(to) - 1e-6);
            }
        }
        let closet = Position::new(19.0, 5.0);
        assert!(matches!(floor.way(ends[0], closet), Err(Unreachable::NoWay { .. })));
    }

    #[test]
    fn centres_share_the_floor() {
        let centres = floor().centres(2);
        // One for each room, near its middle.
        let mut columns: Vec<_> = centres.iter().map(|at| at.x).collect();
        columns.sort_by(f64::total_cmp);
        assert!((columns[0] - 4.5).abs() < 1.5 && (columns[1] - 13.0).abs() < 1.5, "{centres:?}");
        assert!(centres.iter().all(|&at| two_rooms().not_free(at).is_none()));
    }

    #[test]
    fn too_little_floor_is_none() {
        let walls = grid(&["###", "#.#", "###"], 0.2);
        assert!(Floor::new(&walls, RobotModel::Turtlebot2).is_none());
    }

    #[test]
    fn the_smallest_floor_gives_as_many_places_as_asked() {
        let closet = grid(&["###", "#.#", "###"], 1.0);
        let floor = Floor::new(&closet, RobotModel::Turtlebot2).unwrap();
        assert_eq!(floor.ends(3), [Position::new(1.5, 1.5); 3]);
    }
}
