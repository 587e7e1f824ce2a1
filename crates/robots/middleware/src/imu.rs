//! Simulated inertial measurement unit with the errors of a real one.
//!
//! The gyro is the Kobuki's, an ST L3G4200D, after calibration. A Kobuki has no accelerometer; this one is that of an
//! InvenSense MPU-9250, which many TurtleBots have.

use std::time::Duration;

use cotorra_graph::{NodeId, Pose, wrapped_angle};
use cotorra_numbers::Draws;

use crate::kobuki::{GYRO_BIAS, GYRO_WALK};

/// m/s².
const GRAVITY: f64 = 9.81;
/// Noise of the accelerometer (300 µg/√Hz), m/s² per √Hz.
const ACCELERATION_NOISE: f64 = 300e-6 * GRAVITY;
/// Standard deviation of the accelerometer's bias between robots, m/s²: the data sheet's 60 mg are taken as three
/// deviations.
const ACCELERATION_BIAS: f64 = 0.02 * GRAVITY;

/// The device. Its axes are the robot's: forward, left, up.
#[derive(Debug, Clone)]
pub(crate) struct Imu {
    noise: Draws,
    /// rad/s, about each axis.
    gyro_bias: [f64; 3],
    /// m/s², along each axis.
    acceleration_bias: [f64; 3],
    /// The pose after the last step, and the velocity on the map in it, m/s.
    before: (Pose, [f64; 3]),
    /// True angular velocity in the last step, rad/s.
    angular: [f64; 3],
    /// True proper acceleration in the last step, m/s².
    acceleration: [f64; 3],
}

impl Imu {
    /// Creates the device of a robot that stands at `start`.
    pub fn new(seed: u64, robot: &NodeId, start: Pose) -> Self {
        let mut noise = Draws::new(seed, &format!("{robot}/imu"));
        let gyro_bias = [(); 3].map(|()| GYRO_BIAS * noise.bell());
        let acceleration_bias = [(); 3].map(|()| ACCELERATION_BIAS * noise.bell());
        let before = (start, [0.0; 3]);
        Self {
            noise,
            gyro_bias,
            acceleration_bias,
            before,
            angular: [0.0; 3],
            acceleration: [0.0, 0.0, GRAVITY],
        }
    }

    /// Moves the device to a pose in a step.
    pub fn advance(&mut self, pose: &Pose, step: Duration) {
        let seconds = step.as_secs_f64();
        let (before, velocity) = self.before;
        let moved = [pose.x - before.x, pose.y - before.y, pose.z - before.z].map(|way| way / seconds);
        let changed = [0, 1, 2].map(|axis| (moved[axis] - velocity[axis]) / seconds);
        self.acceleration = felt(pose, [changed[0], changed[1], changed[2] + GRAVITY]);
        let rate = |now: f64, before: f64| wrapped_angle(now - before) / seconds;
        let (roll, pitch) = (rate(pose.roll, before.roll), rate(pose.pitch, before.pitch));
        let yaw = rate(pose.heading, before.heading);
        let ((sin_roll, cos_roll), (sin_pitch, cos_pitch)) = (pose.roll.sin_cos(), pose.pitch.sin_cos());
        self.angular = [
            roll - yaw * sin_pitch,
            pitch * cos_roll + yaw * cos_pitch * sin_roll,
            yaw * cos_pitch * cos_roll - pitch * sin_roll,
        ];
        self.before = (*pose, moved);
    }

    /// Reads angular velocity and acceleration. White noise increases with the rate of readings.
    pub fn read(&mut self, interval: Duration) -> Vec<f64> {
        let band = 1.0 / interval.as_secs_f64().sqrt();
        let mut erred = |value: f64, bias: f64, noise: f64| value + bias + noise * band * self.noise.bell();
        let angular = [0, 1, 2].map(|axis| erred(self.angular[axis], self.gyro_bias[axis], GYRO_WALK));
        let acceleration = [0, 1, 2]
            .map(|axis| erred(self.acceleration[axis], self.acceleration_bias[axis], ACCELERATION_NOISE));
        [angular, acceleration].concat()
    }
}

/// Rotates a vector from the map's axes to the robot's.
fn felt(pose: &Pose, [x, y, z]: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = pose.heading.sin_cos();
    let [x, y] = [x * cos + y * sin, y * cos - x * sin];
    let (sin, cos) = pose.pitch.sin_cos();
    let [x, z] = [x * cos - z * sin, x * sin + z * cos];
    let (sin, cos) = pose.roll.sin_cos();
    [x, y * cos + z * sin, z * cos - y * sin]
}

#[cfg(test)]
mod tests {
    use cotorra_graph::PoseSource;

    use super::*;
    use crate::fixtures::id;

    const STEP: Duration = Duration::from_millis(20);

    fn pose(x: f64, y: f64, heading: f64) -> Pose {
        Pose::planar(x, y, heading, [0.0; 9], PoseSource::Simulator)
    }

    /// Returns the device after these poses.
    fn after(poses: &[Pose]) -> Imu {
        let mut imu = Imu::new(1, &id("robot1"), poses[0]);
        poses[1..].iter().for_each(|pose| imu.advance(pose, STEP));
        imu
    }

    fn assert_close(found: [f64; 3], wanted: [f64; 3], within: f64) {
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < within), "{found:?} is not {wanted:?}");
    }

    #[test]
    fn standing_robot_measures_gravity_alone() {
        let imu = after(&[pose(1.0, 2.0, 0.5), pose(1.0, 2.0, 0.5)]);
        assert_close(imu.angular, [0.0; 3], 1e-12);
        assert_close(imu.acceleration, [0.0, 0.0, GRAVITY], 1e-12);
    }

    #[test]
    fn robot_on_a_circle_measures_its_turn_and_centripetal_acceleration() {
        // 2 m/s at 0.5 rad/s: 1 m/s² to the left.
        let circle = |step: i32| {
            let angle = 0.01 * f64::from(step);
            pose(4.0 * angle.sin(), 4.0 - 4.0 * angle.cos(), wrapped_angle(angle))
        };
        let imu = after(&(0..400).map(circle).collect::<Vec<_>>());
        assert_close(imu.angular, [0.0, 0.0, 0.5], 1e-9);
        assert_close(imu.acceleration, [0.0, 1.0, GRAVITY], 0.02);
    }

    #[test]
    fn tilted_quadrotor_measures_gravity_along_its_axes() {
        let tilted = |roll, pitch| Pose { roll, pitch, ..pose(0.0, 0.0, 1.0) };
        let imu = after(&[tilted(0.0, 0.1), tilted(0.0, 0.1)]);
        assert_close(imu.acceleration, [-GRAVITY * 0.1_f64.sin(), 0.0, GRAVITY * 0.1_f64.cos()], 1e-12);
        // A change of pitch alone is a turn about the lateral axis.
        let level = after(&[tilted(0.0, 0.0), tilted(0.0, 0.02)]);
        assert_close(level.angular, [0.0, 1.0, 0.0], 1e-9);
        let imu = after(&[tilted(0.3, 0.0), tilted(0.3, 0.0)]);
        assert_close(imu.acceleration, [0.0, GRAVITY * 0.3_f64.sin(), GRAVITY * 0.3_f64.cos()], 1e-12);
    }

    #[test]
    fn errors_match_the_data_sheets_and_depend_on_the_seed() {
        let still = pose(0.0, 0.0, 0.0);
        let read = |seed: u64, interval: Duration| {
            let mut imu = Imu::new(seed, &id("robot1"), still);
            imu.advance(&still, STEP);
            let readings: Vec<_> = (0..4000).map(|_| imu.read(interval)).collect();
            let of = |axis: usize| {
                let all = || readings.iter().map(|reading| reading[axis]);
                let mean = all().sum::<f64>() / 4000.0;
                (mean, (all().map(|x| (x - mean).powi(2)).sum::<f64>() / 4000.0).sqrt())
            };
            [of(2), of(3)]
        };
        let [gyro, acceleration] = read(1, STEP);
        // 0.03 °/s and 300 µg per √Hz, read at 50 Hz.
        assert!((gyro.1 / (0.03_f64.to_radians() * 50_f64.sqrt()) - 1.0).abs() < 0.05, "{gyro:?}");
        assert!((acceleration.1 / (300e-6 * 9.81 * 50_f64.sqrt()) - 1.0).abs() < 0.05, "{acceleration:?}");
        assert!(acceleration.0 != 0.0 && acceleration.0.abs() < 0.02 * 9.81 * 3.5, "{acceleration:?}");
        assert_eq!(read(1, STEP), [gyro, acceleration], "the same seed is the same device");
        assert_ne!(read(2, STEP), [gyro, acceleration]);
        let slow = read(1, STEP * 4)[0].1;
        assert!((slow * 2.0 / gyro.1 - 1.0).abs() < 1e-6, "{slow} is half of {}", gyro.1);
    }
}
