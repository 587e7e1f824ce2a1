//! Transforms between level frames, by which poses in a robot's own frames are mapped onto the map.

use cotorra_graph::{Pose, wrapped_angle};

/// Pose of one frame in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Planar {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    /// Radians.
    pub heading: f64,
}

impl Planar {
    pub fn of(pose: &Pose) -> Self {
        Self { x: pose.x, y: pose.y, z: pose.z, heading: pose.heading }
    }

    /// Returns the pose of `inner`, which is given in this frame, in the outer frame.
    pub fn then(self, inner: Self) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self {
            x: self.x + inner.x * cos - inner.y * sin,
            y: self.y + inner.x * sin + inner.y * cos,
            z: self.z + inner.z,
            heading: wrapped_angle(self.heading + inner.heading),
        }
    }

    /// Returns the pose of the outer frame in this one.
    pub fn inverse(self) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self {
            x: -self.x * cos - self.y * sin,
            y: self.x * sin - self.y * cos,
            z: -self.z,
            heading: wrapped_angle(-self.heading),
        }
    }

    /// Transforms a pose with its covariance from this frame to the outer one.
    pub fn place(self, pose: &Pose) -> Pose {
        let placed = self.then(Self::of(pose));
        let (sin, cos) = self.heading.sin_cos();
        // R Σ Rᵀ, where R rotates x and y.
        let turn = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let covariance = std::array::from_fn(|k| {
            let (row, column) = (k / 3, k % 3);
            let term = |i: usize, j: usize| turn[row][i] * pose.covariance[3 * i + j] * turn[column][j];
            (0..3).flat_map(|i| (0..3).map(move |j| term(i, j))).sum()
        });
        Pose { x: placed.x, y: placed.y, z: placed.z, heading: placed.heading, covariance, ..*pose }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use cotorra_graph::PoseSource;
    use proptest::prelude::*;

    use super::*;

    fn planar() -> impl Strategy<Value = Planar> {
        (-1e3..1e3, -1e3..1e3, -1e2..1e2, -PI..PI).prop_map(|(x, y, z, heading)| Planar { x, y, z, heading })
    }

    fn near(a: Planar, b: Planar) -> bool {
        let apart = (a.x - b.x).abs().max((a.y - b.y).abs()).max((a.z - b.z).abs());
        apart < 1e-6 && wrapped_angle(a.heading - b.heading).abs() < 1e-9
    }

    proptest! {
        #[test]
        fn transforms_and_their_inverses_cancel(a in planar(), b in planar()) {
            let nowhere = Planar { x: 0.0, y: 0.0, z: 0.0, heading: 0.0 };
            prop_assert!(near(a.then(a.inverse()), nowhere));
            prop_assert!(near(a.inverse().then(a.then(b)), b));
        }
    }

    #[test]
    fn quarter_turn_swaps_the_axes_of_a_covariance() {
        let quarter = Planar { x: 1.0, y: 2.0, z: 0.0, heading: PI / 2.0 };
        let covariance = [4.0, 0.5, 0.2, 0.5, 1.0, 0.1, 0.2, 0.1, 9.0];
        let pose = Pose::planar(3.0, 0.0, 0.0, covariance, PoseSource::Odometry);
        let placed = quarter.place(&pose);
        assert!((placed.x - 1.0).abs() < 1e-12 && (placed.y - 5.0).abs() < 1e-12);
        for (found, expected) in
            placed.covariance.iter().zip([1.0, -0.5, -0.1, -0.5, 4.0, 0.2, -0.1, 0.2, 9.0])
        {
            assert!((found - expected).abs() < 1e-12, "{:?}", placed.covariance);
        }
    }
}
