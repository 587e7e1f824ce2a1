//! Simulated RPLIDAR A2: 360 rays a turn, ten turns a second, each ray cast from the robot's pose at that time.

use std::{f64::consts::PI, time::Duration};

use cotorra_graph::{NodeId, Position, Timestamp};
use cotorra_numbers::Draws;

use crate::world::World;

/// Rays per turn.
pub(crate) const RAYS: usize = 360;
/// Smallest range, metres.
pub(crate) const RANGE_MIN: f64 = 0.15;
/// Largest range, metres.
pub(crate) const RANGE_MAX: f64 = 12.0;
/// Relative standard deviation of a range: the data sheet's 1 % is taken as two deviations.
const RELATIVE_ERROR: f64 = 0.005;
/// Smallest standard deviation, metres: the resolution at short range.
const LEAST_ERROR: f64 = 0.0005;

/// One turn of a lidar.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Time of the first ray.
    pub at: Timestamp,
    /// Direction of the first ray, radians from the robot's heading, counter-clockwise.
    pub first_angle: f64,
    /// Angle between neighbouring rays, radians; negative for clockwise turns.
    pub angle_step: f64,
    /// Time between neighbouring rays.
    pub ray_interval: Duration,
    /// Time from this turn to the next.
    pub turn: Duration,
    /// Smallest range, metres.
    pub range_min: f64,
    /// Largest range, metres.
    pub range_max: f64,
    /// Range of each ray, metres: +∞ if nothing is within range, -∞ if something is too near, NaN if the measurement failed
    /// (REP 117).
    pub ranges: Vec<f32>,
}

impl Scan {
    /// Returns the direction of a ray, radians from the robot's heading, counter-clockwise.
    pub fn angle(&self, ray: usize) -> f64 {
        self.first_angle + ray as f64 * self.angle_step
    }

    /// Returns the smallest range, metres; `None` if nothing is within range.
    pub fn nearest(&self) -> Option<f64> {
        // `min` ignores failed measurements, which are NaN.
        let nearest = f64::from(self.ranges.iter().fold(f32::INFINITY, |nearest, range| range.min(nearest)));
        (nearest <= self.range_max).then(|| nearest.max(self.range_min))
    }

    /// Creates a turn of the simulated lidar without rays. It goes counter-clockwise from the robot's back, one degree per
    /// ray, so that ray 180 looks forward.
    fn blank(at: Timestamp) -> Self {
        const TURN: Duration = Duration::from_millis(100);
        Self {
            at,
            first_angle: -PI,
            angle_step: 2.0 * PI / RAYS as f64,
            ray_interval: Duration::from_nanos(TURN.as_nanos() as u64 / RAYS as u64),
            turn: TURN,
            range_min: RANGE_MIN,
            range_max: RANGE_MAX,
            ranges: Vec::with_capacity(RAYS),
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Lidar {
    noise: Draws,
    /// Unit vectors of the rays in the robot's frame.
    rays: Vec<(f64, f64)>,
    turning: Scan,
    complete: Option<Scan>,
}

impl Lidar {
    pub fn new(seed: u64, robot: &NodeId) -> Self {
        let turning = Scan::blank(Timestamp::ZERO);
        let ray = |i| {
            let (sin, cos) = turning.angle(i).sin_cos();
            (cos, sin)
        };
        Self {
            noise: Draws::new(seed, &format!("{robot}/lidar")),
            rays: (0..RAYS).map(ray).collect(),
            turning,
            complete: None,
        }
    }

    /// Returns the last complete turn.
    pub fn scan(&self) -> Option<&Scan> {
        self.complete.as_ref()
    }

    /// Casts the next `count` rays of the turn from this pose.
    pub fn sweep(&mut self, now: Timestamp, count: usize, world: &World, from: Position, heading: f64) {
        if self.turning.ranges.is_empty() {
            self.turning.at = now;
        }
        let (sin, cos) = heading.sin_cos();
        let begin = self.turning.ranges.len();
        for &(x, y) in &self.rays[begin..RAYS.min(begin + count)] {
            let direction = (x * cos - y * sin, x * sin + y * cos);
            let range = match world.cast(from, direction, RANGE_MAX) {
                Some(range) => measured(range, &mut self.noise),
                None => f32::INFINITY,
            };
            self.turning.ranges.push(range);
        }
        if self.turning.ranges.len() == RAYS {
            // The buffers are swapped, so that only the first turn allocates.
            std::mem::swap(self.complete.get_or_insert_with(|| Scan::blank(now)), &mut self.turning);
            self.turning.ranges.clear();
        }
    }
}

fn measured(range: f64, noise: &mut Draws) -> f32 {
    let read = range + (range * RELATIVE_ERROR).max(LEAST_ERROR) * noise.bell();
    if read < RANGE_MIN {
        f32::NEG_INFINITY
    } else if read > RANGE_MAX {
        f32::INFINITY
    } else {
        read as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{id, room};

    fn scan(world: &World, from: Position, heading: f64) -> Scan {
        let mut lidar = Lidar::new(5, &id("robot1"));
        lidar.sweep(Timestamp::ZERO, RAYS, world, from, heading);
        lidar.scan().unwrap().clone()
    }

    /// Returns the largest error of a range; the noise is bounded.
    fn tolerance(range: f64) -> f64 {
        12f64.sqrt() * (range * RELATIVE_ERROR).max(LEAST_ERROR) + 1e-6
    }

    #[test]
    fn ranges_in_a_room_match_its_geometry() {
        let world = World::new(&room(6.0, 4.0));
        let scan = scan(&world, Position::new(2.0, 1.5), PI / 2.0);
        assert_eq!(scan.ranges.len(), 360);
        // Facing north: back, right, front, left, and 45° to the front left, where the western wall is nearest.
        for (ray, range) in [(0, 1.5), (90, 4.0), (180, 2.5), (270, 2.0), (225, 2.0 * 2f64.sqrt())] {
            let seen = f64::from(scan.ranges[ray]);
            assert!((seen - range).abs() < tolerance(range), "ray {ray}: {seen} m, not {range} m");
        }
        assert!((scan.nearest().unwrap() - 1.5).abs() < tolerance(1.5));
    }

    #[test]
    fn errors_have_the_specified_deviation_and_no_bias() {
        let world = World::new(&room(20.0, 20.0));
        let mut lidar = Lidar::new(5, &id("robot1"));
        let mut errors = Vec::new();
        for _ in 0..400 {
            lidar.sweep(Timestamp::ZERO, RAYS, &world, Position::new(10.0, 10.0), 0.0);
            errors.push(f64::from(lidar.scan().unwrap().ranges[180]) / 10.0 - 1.0);
        }
        let mean = errors.iter().sum::<f64>() / 400.0;
        let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / 400.0).sqrt();
        assert!(mean.abs() < 0.001, "{mean}");
        assert!((deviation - RELATIVE_ERROR).abs() < 0.0006, "{deviation}");
    }

    #[test]
    fn ranges_beyond_the_limits_are_infinite() {
        let world = World::new(&room(30.0, 4.0));
        let seen = scan(&world, Position::new(15.0, 0.1), 0.0);
        assert_eq!(seen.ranges[180], f32::INFINITY, "the wall is 15 m ahead");
        assert_eq!(seen.ranges[90], f32::NEG_INFINITY, "0.1 m to the right is too near");
        assert_eq!(seen.nearest(), Some(RANGE_MIN));
        let open = scan(&World::open(), Position::default(), 0.0);
        assert!(open.ranges.iter().all(|range| *range == f32::INFINITY));
        assert_eq!(open.nearest(), None);
    }

    #[test]
    fn turn_is_visible_once_it_is_complete() {
        let world = World::new(&room(6.0, 4.0));
        let mut lidar = Lidar::new(5, &id("robot1"));
        for part in 0..5 {
            assert!(lidar.scan().is_none());
            let now = Timestamp::from_nanos(part);
            lidar.sweep(now, RAYS / 5, &world, Position::new(2.0, 1.5), 0.0);
        }
        assert_eq!(lidar.scan().unwrap().at, Timestamp::ZERO);
        let first = lidar.scan().unwrap().clone();
        lidar.sweep(Timestamp::from_nanos(9), RAYS / 5, &world, Position::new(2.0, 1.5), 0.0);
        assert_eq!(lidar.scan().unwrap(), &first);
    }
}
