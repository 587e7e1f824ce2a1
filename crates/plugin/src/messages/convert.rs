//! Between ROS's messages and the hardware graph's poses and velocities.

use cotorra_graph::{self as graph, PoseSource, Timestamp, Velocity};

use super::{Covariance, Header, Point, Pose, PoseWithCovariance, Quaternion, Time, Twist, Vector3};

impl Quaternion {
    /// The rotation about z by `heading` radians.
    pub fn from_heading(heading: f64) -> Self {
        let (z, w) = (heading / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The heading (yaw) of the rotated x axis, in (-π, π].
    pub fn heading(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }

    /// The rotation about x by `roll`, then about y by `pitch`, then about z by `heading`, radians, about the axes at rest (ROS's
    /// order, REP 103).
    pub fn from_angles(roll: f64, pitch: f64, heading: f64) -> Self {
        let [(sr, cr), (sp, cp), (sh, ch)] = [roll, pitch, heading].map(|angle| (angle / 2.0).sin_cos());
        Self {
            x: sr * cp * ch - cr * sp * sh,
            y: cr * sp * ch + sr * cp * sh,
            z: cr * cp * sh - sr * sp * ch,
            w: cr * cp * ch + sr * sp * sh,
        }
    }

    /// Roll in (-π, π] and pitch in [-π/2, π/2] of the rotation, radians.
    pub fn tilt(&self) -> (f64, f64) {
        let Self { x, y, z, w } = self;
        let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
        (roll, (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin())
    }
}

impl Covariance {
    /// Where x, y and the rotation about z stand among the six.
    const PLANAR: [usize; 3] = [0, 1, 5];

    /// From the row-major covariance of (x, y, heading); the rest is zero.
    pub fn from_planar(planar: &[f64; 9]) -> Self {
        let mut full = [0.0; 36];
        for (row, i) in Self::PLANAR.into_iter().enumerate() {
            for (column, j) in Self::PLANAR.into_iter().enumerate() {
                full[6 * i + j] = planar[3 * row + column];
            }
        }
        Self(full)
    }

    /// The row-major covariance of (x, y, heading).
    pub fn planar(&self) -> [f64; 9] {
        std::array::from_fn(|k| self.0[6 * Self::PLANAR[k / 3] + Self::PLANAR[k % 3]])
    }
}

impl From<Timestamp> for Time {
    /// Saturates after 68 years.
    fn from(at: Timestamp) -> Self {
        let nanos = at.as_nanos();
        Self {
            sec: i32::try_from(nanos / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (nanos % 1_000_000_000) as u32,
        }
    }
}

impl Header {
    /// A header for that time and frame.
    pub fn new(stamp: Timestamp, frame_id: &str) -> Self {
        Self { stamp: stamp.into(), frame_id: frame_id.to_owned() }
    }
}

impl From<Velocity> for Twist {
    fn from(velocity: Velocity) -> Self {
        Self {
            linear: Vector3 { x: velocity.linear, y: 0.0, z: velocity.vertical },
            angular: Vector3 { z: velocity.angular, ..Vector3::default() },
        }
    }
}

impl From<&Twist> for Velocity {
    /// Of it, what is forward, upward, and about z.
    fn from(twist: &Twist) -> Self {
        Self { linear: twist.linear.x, vertical: twist.linear.z, angular: twist.angular.z }
    }
}

impl From<&graph::Pose> for Pose {
    fn from(pose: &graph::Pose) -> Self {
        Self {
            position: Point { x: pose.x, y: pose.y, z: pose.z },
            orientation: Quaternion::from_angles(pose.roll, pose.pitch, pose.heading),
        }
    }
}

impl Pose {
    /// The same, exactly known, from `source`, which ROS does not carry.
    pub fn from_source(&self, source: PoseSource) -> graph::Pose {
        let Point { x, y, z } = self.position;
        let (roll, pitch) = self.orientation.tilt();
        graph::Pose {
            z,
            roll,
            pitch,
            ..graph::Pose::planar(x, y, self.orientation.heading(), [0.0; 9], source)
        }
    }
}

impl From<&graph::Pose> for PoseWithCovariance {
    fn from(pose: &graph::Pose) -> Self {
        Self { pose: pose.into(), covariance: Covariance::from_planar(&pose.covariance) }
    }
}

impl PoseWithCovariance {
    /// The same, with the covariance of the plane, from `source`, which ROS does not carry.
    pub fn from_source(&self, source: PoseSource) -> graph::Pose {
        graph::Pose { covariance: self.covariance.planar(), ..self.pose.from_source(source) }
    }
}
