//! Scans of a lidar, and the beams of them that are used: ends in the robot's frame, each with its share of a vote.

use crate::{
    geometry::Pose2,
    parameters::{BeamModel, Weighing},
};

/// One turn of a lidar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan<'a> {
    /// Direction of the first beam in the lidar's frame, radians.
    pub angle_min: f64,
    /// Angle between neighbouring beams, radians; negative for a lidar that turns clockwise.
    pub angle_increment: f64,
    /// Ranges, metres. Ranges that are not finite, not above 0, or not below the lidar's maximum are ignored.
    pub ranges: &'a [f32],
    /// The lidar's pose on the robot.
    pub mount: Pose2,
    /// The robot's motion from the first beam to the last, whose time is that of the odometry. Without it, the first beam
    /// of a lidar with 10 turns a second is 4.5° off on a robot that turns once in 8 s.
    pub sweep: Pose2,
}

impl Scan<'_> {
    /// Whether any beam is usable with this maximum range, metres.
    pub fn is_usable(&self, range_max: f64) -> bool {
        self.ranges.iter().any(|&range| range > 0.0 && f64::from(range) < range_max)
    }

    /// Returns the robot's pose at a beam, relative to its pose at the last beam.
    fn before_the_last(&self, beam: usize) -> Pose2 {
        let left = 1.0 - beam as f64 / self.ranges.len().saturating_sub(1).max(1) as f64;
        let Pose2 { x, y, heading } = self.sweep;
        Pose2::new(left * x, left * y, left * heading).inverse()
    }
}

/// The used beams of a scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct Beams {
    /// Ends in the robot's frame, metres.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// Shares of a vote.
    pub weight: Vec<f32>,
    /// Sum of the weights: the effective number of independent beams.
    pub votes: f32,
}

impl Beams {
    /// Selects evenly spaced beams of a scan, and leaves out those that hit nothing.
    pub fn take(&mut self, scan: &Scan<'_>, model: &BeamModel, weighing: Weighing) {
        self.x.clear();
        self.y.clear();
        // As in AMCL: from the first beam in equal steps.
        let step = (scan.ranges.len().saturating_sub(1) / (model.max_beams.max(2) - 1)).max(1);
        for (beam, &range) in scan.ranges.iter().enumerate().step_by(step) {
            let range = f64::from(range);
            if !(range > 0.0 && range < model.range_max) {
                continue;
            }
            let angle = scan.mount.heading + scan.angle_min + beam as f64 * scan.angle_increment;
            let (sin, cos) = angle.sin_cos();
            let end = Pose2::new(scan.mount.x + range * cos, scan.mount.y + range * sin, 0.0);
            let end = scan.before_the_last(beam) * end;
            if !end.is_valid() {
                continue;
            }
            self.x.push(end.x as f32);
            self.y.push(end.y as f32);
        }
        self.weight.clear();
        match weighing {
            Weighing::Likelihood { correlation_length } => self.share_votes(correlation_length as f32),
            Weighing::Amcl => self.weight.resize(self.x.len(), 1.0),
        }
        self.votes = self.weight.iter().sum();
    }

    /// Returns about `count` of the beams, evenly spaced.
    pub fn some(&self, count: usize) -> Self {
        let step = (self.x.len() / count.max(1)).max(1);
        let every = |values: &[f32]| -> Vec<f32> { values.iter().copied().step_by(step).collect() };
        let weight = every(&self.weight);
        Self { x: every(&self.x), y: every(&self.y), votes: weight.iter().sum(), weight }
    }

    /// Weighs beams by how independent their errors are. Beams that end near each other have common errors: the map is off
    /// there, or something stands before the wall.
    ///
    /// With the correlation ρ(d) = max(0, 1 - d/ℓ) of errors at ends d apart, a beam has the weight ωᵢ = 1 / Σⱼ ρᵢⱼ. Then n
    /// beams on one spot count as one, and n beams far apart as n (the design effect of cluster sampling; Kish 1965, ch.
    /// 5).
    fn share_votes(&mut self, length: f32) {
        let beams = self.x.len();
        self.weight.resize(beams, 1.0);
        for i in 0..beams {
            for j in i + 1..beams {
                let (x, y) = (self.x[i] - self.x[j], self.y[i] - self.y[j]);
                // Nothing overflows here, so that `hypot` is not needed.
                let distance = (x * x + y * y).sqrt();
                // Ends of later beams are farther still, except at corners, which matter little.
                if distance >= length {
                    break;
                }
                let correlation = 1.0 - distance / length;
                self.weight[i] += correlation;
                self.weight[j] += correlation;
            }
        }
        self.weight.iter_mut().for_each(|weight| *weight = weight.recip());
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::Parameters;

    fn taken(ranges: &[f32], weighing: Weighing) -> Beams {
        let scan = Scan {
            angle_min: -PI / 2.0,
            angle_increment: PI / 180.0,
            ranges,
            mount: Pose2::default(),
            sweep: Pose2::default(),
        };
        let mut beams = Beams::default();
        beams.take(&scan, &Parameters::amcl().beams, weighing);
        beams
    }

    #[test]
    fn beams_are_spaced_as_in_amcl() {
        // 361 beams in steps of ⌊360/119⌋ = 3: 121.
        let beams = taken(&[3.0; 361], Weighing::Amcl);
        assert_eq!((beams.votes, beams.x.len()), (121.0, 121));
        // All beams of a small scan are used.
        assert_eq!(taken(&[3.0; 90], Weighing::Amcl).votes, 90.0);
        assert_eq!(taken(&[], Weighing::Amcl).votes, 0.0);
    }

    #[test]
    fn beams_that_hit_nothing_are_left_out() {
        let ranges = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 80.0, 81.83, 2.0];
        let beams = taken(&ranges, Weighing::Amcl);
        assert_eq!(beams.votes, 1.0);
        let angle = -PI / 2.0 + 7.0 * PI / 180.0;
        assert!((f64::from(beams.x[0]) - 2.0 * angle.cos()).abs() < 1e-6);
        assert!((f64::from(beams.y[0]) - 2.0 * angle.sin()).abs() < 1e-6);
    }

    #[test]
    fn ends_are_relative_to_the_pose_at_the_last_beam() {
        // The robot drives 0.5 m and turns left by 90°. The first beam ends 2 m ahead of its initial pose.
        let sweep = Pose2::new(0.5, 0.0, PI / 2.0);
        let ranges = [2.0, f32::NAN, 2.0];
        let scan =
            Scan { angle_min: 0.0, angle_increment: 0.0, ranges: &ranges, mount: Pose2::default(), sweep };
        let mut beams = Beams::default();
        beams.take(&scan, &Parameters::amcl().beams, Weighing::Amcl);
        let ends: Vec<(f32, f32)> = beams.x.iter().copied().zip(beams.y.iter().copied()).take(2).collect();
        assert!(ends[0].0.abs() < 1e-6 && (ends[0].1 + 1.5).abs() < 1e-6, "{ends:?}");
        assert_eq!(ends[1], (2.0, 0.0));
    }

    #[test]
    fn beams_on_one_spot_share_a_vote_and_distant_beams_have_one_each() {
        let weighing = Weighing::Likelihood { correlation_length: 0.25 };
        // A degree apart at 1 cm, and at 20 m (0.35 m).
        let near = taken(&[0.01; 100], weighing);
        assert!(near.votes < 1.2, "{}", near.votes);
        let far = taken(&[20.0; 100], weighing);
        assert_eq!(far.votes, 100.0);
    }
}
