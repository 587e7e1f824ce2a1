//! Parameters of a filter, and its two modes.

use std::f64::consts::PI;

/// Weighing of particles by a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weighing {
    /// The log-likelihood Σ ωᵢ ln pᵢ. Each beam has a share ωᵢ of a vote, so that beams that hit the same stretch of wall
    /// count as one. docs/use/localization.md gives the sources.
    Likelihood {
        /// Distance between the ends of two beams from which their errors are independent, metres.
        correlation_length: f64,
    },
    /// ROS AMCL's `1 + Σ pᵢ³`. It is not a likelihood, and works only with AMCL's motion model, whose noise is far too
    /// small.
    Amcl,
}

/// Noise of odometry as a function of the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionNoise {
    /// α₁ to α₄ of Probabilistic Robotics, table 5.6: rotation from rotation, rotation from translation (rad²/m²),
    /// translation from translation, translation from rotation (m²/rad²).
    pub alpha: [f64; 4],
    /// Whether the variance is used as standard deviation, as ROS AMCL does.
    pub variance_as_deviation: bool,
}

/// The beam model: the likelihood field of Probabilistic Robotics, ch. 6.4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamModel {
    /// Largest number of beams used of a scan, evenly spaced.
    pub max_beams: usize,
    /// Maximum range of the lidar, metres. Beams of that length or more hit nothing and are left out.
    pub range_max: f64,
    /// Share of beams that end at a wall of the map.
    pub z_hit: f64,
    /// Share of beams that end anywhere.
    pub z_rand: f64,
    /// Standard deviation of a beam's end from the wall, metres.
    pub sigma_hit: f64,
    /// Distance from a wall beyond which the likelihood is constant, metres.
    pub likelihood_max_dist: f64,
}

/// Parameters of a filter.
///
/// [`Parameters::default`] weighs by likelihood; [`Parameters::amcl`] behaves as ROS AMCL does with its defaults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Smallest number of particles.
    pub min_particles: usize,
    /// Largest number of particles.
    pub max_particles: usize,
    /// ε of KLD-sampling (Fox 2003): the allowed divergence between the particles and the true distribution.
    pub kld_error: f64,
    /// Quantile of the standard normal distribution with which ε holds: 2.33 for 99 %.
    pub kld_quantile: f64,
    /// Beam model.
    pub beams: BeamModel,
    /// Weighing of particles.
    pub weighing: Weighing,
    /// Noise of odometry.
    pub motion: MotionNoise,
    /// Standard deviations of the errors that all scans share, metres and radians: of the map, the lidar's mount and the
    /// beams' directions. No number of beams reduces them.
    pub systematic: [f64; 2],
    /// Factor of the covariance by which the parts of a scan disagree about the pose: 1 if their errors are independent, as
    /// on an exact map. 0 leaves it out, and [`Weighing::Amcl`] always does.
    pub disagreement: f64,
    /// Distance from the last used scan at which the next one is used, metres.
    pub update_distance: f64,
    /// Turn since the last used scan at which the next one is used, radians.
    pub update_angle: f64,
    /// Number of updates between two resamplings; with `None`, resample when the effective number of particles falls below
    /// half.
    pub resample_interval: Option<u32>,
}

impl Parameters {
    /// Returns ROS AMCL's defaults: `likelihood_field`, odometry model `diff`, no recovery.
    pub fn amcl() -> Self {
        Self {
            min_particles: 500,
            max_particles: 2000,
            kld_error: 0.05,
            // AMCL documents this as 99 %, but its code uses the number as the quantile.
            kld_quantile: 0.99,
            beams: BeamModel {
                max_beams: 120,
                range_max: 80.0,
                z_hit: 0.5,
                z_rand: 0.5,
                sigma_hit: 0.2,
                likelihood_max_dist: 2.0,
            },
            weighing: Weighing::Amcl,
            motion: MotionNoise { alpha: [0.2; 4], variance_as_deviation: true },
            systematic: [0.0; 2],
            disagreement: 0.0,
            update_distance: 0.25,
            update_angle: 0.2,
            resample_interval: Some(2),
        }
    }

    /// Returns parameters for a TurtleBot 2 with an RPLIDAR A2: a range of 12 m, and odometry with a gyro's heading.
    pub fn turtlebot2() -> Self {
        let default = Self::default();
        Self {
            beams: BeamModel { range_max: 12.0, ..default.beams },
            // The wheels have a constant error of 1 %. Over 10 m, noise of 7 % that is drawn anew each 0.25 m adds up to as
            // much.
            motion: MotionNoise { alpha: [0.005, 0.000_5, 0.006, 0.000_5], variance_as_deviation: false },
            // In a testbed, the map is exactly what the lidar sees.
            systematic: [0.01, 0.002],
            disagreement: 1.0,
            ..default
        }
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            min_particles: 500,
            max_particles: 10_000,
            kld_error: 0.05,
            kld_quantile: 2.33,
            beams: BeamModel {
                max_beams: 120,
                range_max: 80.0,
                z_hit: 0.9,
                z_rand: 0.1,
                sigma_hit: 0.07,
                likelihood_max_dist: 2.0,
            },
            weighing: Weighing::Likelihood { correlation_length: 0.5 },
            motion: MotionNoise { alpha: [0.1, 0.02, 0.02, 0.01], variance_as_deviation: false },
            systematic: [0.01, 0.005],
            disagreement: 6.0,
            update_distance: 0.25,
            update_angle: 0.2,
            resample_interval: None,
        }
    }
}

/// Size of a bin of KLD-sampling, metres and radians (as in AMCL).
pub(crate) const BIN: [f64; 2] = [0.5, PI / 18.0];
