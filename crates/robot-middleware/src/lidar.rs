//! An RPLIDAR A2 on the robot: 360 rays a turn, ten turns a second, each ray cast from where the robot then is.

use std::f64::consts::PI;

use cotorra_graph::{NodeId, Position, Timestamp};

use crate::{random::Stream, world::World};

/// Rays a turn.
pub(crate) const RAYS: usize = 360;
/// Nearer things are not measured, metres.
pub(crate) const RANGE_MIN: f64 = 0.15;
/// Farther things are not seen, metres.
pub(crate) const RANGE_MAX: f64 = 12.0;
/// Deviation of a range, as its share: the data sheet's 1 % is taken for twice that.
const RELATIVE_ERROR: f64 = 0.005;
/// It is never below the resolution at short range, metres.
const LEAST_ERROR: f64 = 0.0005;

/// One turn of the lidar.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// When its first ray was cast.
    pub at: Timestamp,
    /// Metres, from the robot's back counter-clockwise, a degree a ray: ray 180 looks forward. +∞ where nothing is
    /// within range, -∞ where something is too near to be measured (REP 117).
    pub ranges: Vec<f32>,
}

impl Scan {
    /// Direction of a ray, radians from the robot's heading, in [-π, π).
    pub fn angle(ray: usize) -> f64 {
        ray as f64 * (2.0 * PI / RAYS as f64) - PI
    }

    /// The nearest thing seen, metres; `None` if nothing is within range.
    pub fn nearest(&self) -> Option<f64> {
        let nearest = self.ranges.iter().fold(f32::INFINITY, |nearest, range| range.min(nearest));
        (nearest < f32::INFINITY).then(|| f64::from(nearest).max(RANGE_MIN))
    }
}

/// The device.
#[derive(Debug, Clone)]
pub(crate) struct Lidar {
    noise: Stream,
    /// Unit vectors of the rays in the robot's frame.
    rays: Vec<(f64, f64)>,
    turning: Scan,
    complete: Option<Scan>,
}

impl Lidar {
    pub fn new(seed: u64, robot: &NodeId) -> Self {
        let ray = |i| {
            let (sin, cos) = Scan::angle(i).sin_cos();
            (cos, sin)
        };
        Self {
            noise: Stream::new(seed, &format!("{robot}/lidar")),
            rays: (0..RAYS).map(ray).collect(),
            turning: Scan { at: Timestamp::ZERO, ranges: Vec::with_capacity(RAYS) },
            complete: None,
        }
    }

    /// The last complete turn.
    pub fn scan(&self) -> Option<&Scan> {
        self.complete.as_ref()
    }

    /// Casts the next `count` rays of the turn from there.
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
            // The buffers change places: no turn but the first allocates.
            let blank = || Scan { at: now, ranges: Vec::with_capacity(RAYS) };
            std::mem::swap(self.complete.get_or_insert_with(blank), &mut self.turning);
            self.turning.ranges.clear();
        }
    }
}

fn measured(range: f64, noise: &mut Stream) -> f32 {
    let read = range + (range * RELATIVE_ERROR).max(LEAST_ERROR) * noise.bell();
    if read < RANGE_MIN {
        f32::NEG_INFINITY
    } else if read > RANGE_MAX {
        f32::INFINITY
    } else {
        read as f32
    }
}
