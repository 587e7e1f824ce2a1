//! All that can be set of a filter, and its two modes.

use std::f64::consts::PI;

/// How particles are weighed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weighing {
    /// The likelihood itself: Σ ωᵢ ln pᵢ, each beam with a share ωᵢ of a vote, so that beams that see the same stretch
    /// of wall count as one. See [`crate::Scan`] and docs/localization.md for where that is from.
    Likelihood {
        /// Beams whose ends are that far apart err independently, metres.
        correlation_length: f64,
    },
    /// ROS AMCL's `1 + Σ pᵢ³`. It is no likelihood; it fits only AMCL's motion model, whose noise is far too small.
    Amcl,
}

/// How the noise of odometry follows from a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionNoise {
    /// α₁ to α₄ of Probabilistic Robotics, table 5.6: rotation from rotation, rotation from translation (rad²/m²),
    /// translation from translation, translation from rotation (m²/rad²).
    pub alpha: [f64; 4],
    /// ROS AMCL gives the variance to a function that asks for the standard deviation.
    pub variance_as_deviation: bool,
}

/// The beams and what is expected of them: the likelihood field of Probabilistic Robotics, ch. 6.4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamModel {
    /// No more beams than so many are used, evenly spaced.
    pub max_beams: usize,
    /// Nothing farther is seen, metres. A beam of that length or more hit nothing, and is left out.
    pub range_max: f64,
    /// Share of beams that end at a wall of the map.
    pub z_hit: f64,
    /// Share of beams that end anywhere.
    pub z_rand: f64,
    /// Deviation of a beam's end from the wall, metres.
    pub sigma_hit: f64,
    /// Farther from a wall than that, all places are alike, metres.
    pub likelihood_max_dist: f64,
}

/// All that can be set of a filter.
///
/// [`Parameters::default`] weighs by likelihood; [`Parameters::amcl`] behaves as ROS AMCL does with its defaults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Never fewer particles.
    pub min_particles: usize,
    /// Never more particles.
    pub max_particles: usize,
    /// ε of KLD-sampling (Fox 2003): the divergence allowed between the particles and what they stand for.
    pub kld_error: f64,
    /// Quantile of the standard normal distribution up to which that holds: 2.33 is 99 %.
    pub kld_quantile: f64,
    /// Beams.
    pub beams: BeamModel,
    /// How particles are weighed.
    pub weighing: Weighing,
    /// Odometry.
    pub motion: MotionNoise,
    /// Errors that all scans share, deviations in metres and radians: those of the map, of where the lidar sits, and of
    /// the beams' directions. No number of beams lessens them.
    pub systematic: [f64; 2],
    /// A scan is used when the robot went so far since the last one that was, metres.
    pub update_distance: f64,
    /// Or when it turned so far, radians.
    pub update_angle: f64,
    /// Particles are drawn anew at every so many updates, or, with `None`, when fewer than half of them count.
    pub resample_interval: Option<u32>,
}

impl Parameters {
    /// ROS AMCL with its defaults: `likelihood_field`, odometry model `diff`, no recovery.
    pub fn amcl() -> Self {
        Self {
            min_particles: 500,
            max_particles: 2000,
            kld_error: 0.05,
            // Its documentation means 99 %; its code takes the number for the quantile.
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
            update_distance: 0.25,
            update_angle: 0.2,
            resample_interval: Some(2),
        }
    }

    /// The default for a TurtleBot 2 with an RPLIDAR A2: a reach of 12 m, and odometry whose heading is a gyro's.
    pub fn turtlebot2() -> Self {
        let default = Self::default();
        Self {
            beams: BeamModel { range_max: 12.0, ..default.beams },
            // Its wheels are a percent off for good. As noise that is drawn anew each 0.25 m, 7 % makes as much of 10 m.
            motion: MotionNoise { alpha: [0.005, 0.000_5, 0.006, 0.000_5], variance_as_deviation: false },
            // In a testbed, the map is the world that its lidar sees.
            systematic: [0.01, 0.002],
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
            systematic: [0.034, 0.008],
            update_distance: 0.25,
            update_angle: 0.2,
            resample_interval: None,
        }
    }
}

/// Side of a bin of KLD-sampling, metres and radians: as AMCL has it.
pub(crate) const BIN: [f64; 2] = [0.5, PI / 18.0];
