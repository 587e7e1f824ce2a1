//! The odometry motion model of Probabilistic Robotics, ch. 5.4: a step of odometry with its noise.

use std::f64::consts::PI;

use crate::{
    fast::sin_cos,
    geometry::{Pose2, wrapped},
    parameters::MotionNoise,
    place::Places,
};
use cotorra_numbers::Draws;

/// Shortest step whose direction is meaningful, metres (as in AMCL).
const LEAST_STEP: f64 = 0.01;

/// A step of odometry as turn, straight way and turn, with the deviation of each part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    turn: f64,
    way: f64,
    turn_after: f64,
    turn_deviation: f64,
    way_deviation: f64,
    turn_after_deviation: f64,
}

impl Motion {
    /// Decomposes a step (table 5.6).
    pub fn new(step: Pose2, noise: &MotionNoise) -> Self {
        let way = step.x.hypot(step.y);
        let turn = if way < LEAST_STEP { 0.0 } else { step.y.atan2(step.x) };
        let turn_after = wrapped(step.heading - turn);
        // Driving backwards is not two half turns (as in AMCL).
        let rotation = |turn: f64| turn.abs().min(PI - turn.abs());
        let (first, second) = (rotation(turn), rotation(turn_after));
        let [a1, a2, a3, a4] = noise.alpha;
        let deviation = |variance: f64| if noise.variance_as_deviation { variance } else { variance.sqrt() };
        Self {
            turn,
            way,
            turn_after,
            turn_deviation: deviation(a1 * first * first + a2 * way * way),
            way_deviation: deviation(a3 * way * way + a4 * (first * first + second * second)),
            turn_after_deviation: deviation(a1 * second * second + a2 * way * way),
        }
    }

    /// Moves each particle by a random step of the model; `resolution` is the side of a cell, metres.
    pub fn sample(&self, places: &mut Places, resolution: f64, random: &mut Draws) {
        let in_cells = resolution.recip() as f32;
        let [turn, way, turn_after] = [self.turn, self.way, self.turn_after].map(|mean| mean as f32);
        let [turn_deviation, way_deviation, turn_after_deviation] =
            [self.turn_deviation, self.way_deviation, self.turn_after_deviation]
                .map(|deviation| deviation as f32);
        let places = places.column.iter_mut().zip(&mut places.row).zip(&mut places.heading);
        for ((column, row), heading) in places {
            let direction = *heading + turn + turn_deviation * random.bell_f32();
            let way = (way + way_deviation * random.bell_f32()) * in_cells;
            let (sin, cos) = sin_cos(direction);
            *column += way * cos;
            *row += way * sin;
            *heading = direction + turn_after + turn_after_deviation * random.bell_f32();
        }
    }

    /// Returns the covariance of a pose after the step, to first order, row by row.
    pub fn propagate(&self, heading: f64, covariance: &[f64; 9]) -> [f64; 9] {
        let (sin, cos) = (heading + self.turn).sin_cos();
        // Jacobians of the pose after the step: by the pose before it, and by turn, way and turn.
        let before = [1.0, 0.0, -self.way * sin, 0.0, 1.0, self.way * cos, 0.0, 0.0, 1.0];
        let within = [-self.way * sin, cos, 0.0, self.way * cos, sin, 0.0, 1.0, 0.0, 1.0];
        let squares = [self.turn_deviation, self.way_deviation, self.turn_after_deviation].map(|d| d * d);
        let noise = [squares[0], 0.0, 0.0, 0.0, squares[1], 0.0, 0.0, 0.0, squares[2]];
        let (carried, added) = (congruent(&before, covariance), congruent(&within, &noise));
        std::array::from_fn(|i| carried[i] + added[i])
    }
}

/// Returns J·C·Jᵀ; all matrices row by row.
fn congruent(j: &[f64; 9], c: &[f64; 9]) -> [f64; 9] {
    std::array::from_fn(|i| {
        let (row, column) = (i / 3, i % 3);
        (0..9).map(|k| j[row * 3 + k / 3] * c[k] * j[column * 3 + k % 3]).sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Parameters;

    fn moved(step: Pose2, noise: &MotionNoise, count: usize) -> Places {
        let mut places = Places::default();
        (0..count).for_each(|_| places.push(Default::default()));
        Motion::new(step, noise).sample(&mut places, 1.0, &mut Draws::new(3, "localization"));
        places
    }

    #[test]
    fn particles_follow_the_step_exactly_without_noise() {
        let noise = MotionNoise { alpha: [0.0; 4], variance_as_deviation: false };
        for step in [Pose2::new(1.0, 0.5, 0.7), Pose2::new(-0.4, 0.0, 0.0), Pose2::new(0.001, 0.0, -3.0)] {
            let there = moved(step, &noise, 1);
            let tolerance = if step.x.abs() < 0.01 { 2e-3 } else { 1e-6 };
            assert!((f64::from(there.column[0]) - step.x).abs() < tolerance);
            assert!((f64::from(there.row[0]) - step.y).abs() < tolerance);
            assert!(wrapped(f64::from(there.heading[0]) - step.heading).abs() < 1e-6);
        }
    }

    #[test]
    fn samples_have_the_propagated_covariance() {
        let step = Pose2::new(1.0, 0.2, 0.3);
        let noise = Parameters::default().motion;
        let there = moved(step, &noise, 50_000);
        let propagated = Motion::new(step, &noise).propagate(0.0, &[0.0; 9]);
        let spread = |values: &[f32], mean: f64| {
            values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / values.len() as f64
        };
        let found =
            [spread(&there.column, step.x), spread(&there.row, step.y), spread(&there.heading, step.heading)];
        for (found, expected) in found.into_iter().zip([propagated[0], propagated[4], propagated[8]]) {
            assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
        }
    }

    #[test]
    fn amcl_uses_the_variance_as_deviation() {
        let step = Pose2::new(0.25, 0.0, 0.0);
        let motion = Motion::new(step, &Parameters::amcl().motion);
        assert!((motion.way_deviation - 0.2 * 0.25 * 0.25).abs() < 1e-12);
    }

    #[test]
    fn driving_backwards_is_not_a_turn() {
        let noise = Parameters::default().motion;
        let [back, forth] = [-0.3, 0.3].map(|way| Motion::new(Pose2::new(way, 0.0, 0.0), &noise));
        assert!((back.turn_deviation - forth.turn_deviation).abs() < 1e-12);
    }
}
