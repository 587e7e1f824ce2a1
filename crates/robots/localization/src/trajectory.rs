//! Reference trajectories of public data sets, errors of estimates against them, and how well deviations foretell errors.

use std::{f64::consts::PI, fmt, io::BufRead};

use cotorra_numbers::Gathered;

use crate::{
    belief::Belief,
    carmen::{Log, LogError, LogProblem, Message, valid},
    geometry::{Pose2, wrapped},
};

/// Poses of a robot over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Times in seconds, with the robot's poses.
    poses: Vec<(f64, Pose2)>,
    /// Whether there is a pose for each scan, as in a CARMEN log. Times are ignored then.
    per_scan: bool,
}

/// Longest interval between two poses that is interpolated, seconds.
const GAP: f64 = 2.0;

impl Trajectory {
    /// Reads a trajectory: a corrected CARMEN log (the robot's pose in its laser messages), or lines of `time x y heading`,
    /// or of `time x y z qx qy qz qw` (TUM), separated by commas or blanks, with or without
    /// quotes. Lines that begin with `#`, a header line and a byte order mark are skipped.
    ///
    /// # Errors
    /// [`LogError`] at the first line in another format.
    pub fn read(source: impl BufRead) -> Result<Self, LogError> {
        let mut text = String::new();
        let mut source = source;
        if let Err(error) = source.read_to_string(&mut text) {
            return Err(LogError { line: 1, problem: error.into() });
        }
        let carmen = |line: &str| {
            ["FLASER ", "ROBOTLASER1 ", "ODOM ", "PARAM "].iter().any(|name| line.starts_with(name))
        };
        if text.lines().any(carmen) {
            let mut poses = Vec::new();
            for message in Log::new(text.as_bytes()) {
                if let Message::Laser(laser) = message? {
                    poses.push((laser.at, laser.robot));
                }
            }
            return Ok(Self { poses, per_scan: true });
        }
        let mut poses: Vec<(f64, Pose2)> = Vec::new();
        for (line, text) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let text = text.trim().trim_start_matches('"');
            let words =
                poses.is_empty() && text.starts_with(|c: char| c.is_alphabetic() && !text.starts_with("nan"));
            if text.is_empty() || text.starts_with('#') || words {
                continue;
            }
            poses.push(row(text).map_err(|problem| LogError { line: line + 1, problem })?);
        }
        Ok(Self { poses, per_scan: false })
    }

    /// Returns the first pose.
    pub fn first(&self) -> Option<Pose2> {
        self.poses.first().map(|(_, pose)| *pose)
    }

    /// Returns the number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are no poses.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Returns the pose at scan number `nth` of `scans`, taken at `time`; `None` if the trajectory does not cover it.
    pub fn at(&self, nth: usize, scans: usize, time: f64) -> Option<Pose2> {
        if self.per_scan && self.poses.len() == scans {
            return self.poses.get(nth).map(|(_, pose)| *pose);
        }
        let after = self.poses.partition_point(|(at, _)| *at < time);
        let (begin, end) =
            (after.checked_sub(1).map(|before| self.poses[before]), self.poses.get(after).copied());
        match (begin, end) {
            (_, Some((at, pose))) if at == time => Some(pose),
            (Some((from, a)), Some((to, b))) if to - from <= GAP => {
                let share = (time - from) / (to - from);
                let turned = a.heading + share * wrapped(b.heading - a.heading);
                Some(Pose2::new(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), turned))
            }
            _ => None,
        }
    }
}

fn row(text: &str) -> Result<(f64, Pose2), LogProblem> {
    let message = "trajectory";
    let mut numbers = Vec::new();
    for found in text.split([',', ' ', '\t', '"']).filter(|field| !field.is_empty()) {
        match found.parse::<f64>() {
            Ok(number) if number.is_finite() => numbers.push(number),
            _ => {
                let found = found.chars().take(40).collect();
                return Err(LogProblem::NoNumber { message, field: "row", found });
            }
        }
    }
    match numbers[..] {
        [at, x, y, _, qx, qy, qz, qw] => {
            let heading = (2.0 * (qw * qz + qx * qy)).atan2(1.0 - 2.0 * (qy * qy + qz * qz));
            Ok((at, valid(message, "row", Pose2::new(x, y, heading))?))
        }
        // Further columns, such as a covariance, are ignored.
        [at, x, y, heading, ..] => Ok((at, valid(message, "row", Pose2::new(x, y, heading))?)),
        _ => Err(LogProblem::Short { message, field: "heading" }),
    }
}

/// Error from which a robot counts as lost, metres.
pub const LOST: f64 = 1.0;

/// Errors of estimates against a reference.
///
/// The memory is bounded: with more than a million estimates, quantiles are approximate ([`Gathered`]).
#[derive(Debug, Clone, Default)]
pub struct Errors {
    positions: Gathered,
    count: usize,
    farthest: f64,
    lost: usize,
    position_squares: f64,
    heading_squares: f64,
    nees: f64,
    nees_count: usize,
}

impl Errors {
    /// Counts an estimate.
    pub fn push(&mut self, believed: &Belief, reference: Pose2) {
        let position = believed.pose.distance(reference);
        let heading = wrapped(believed.pose.heading - reference.heading);
        self.positions.add(position);
        self.count += 1;
        self.farthest = self.farthest.max(position);
        self.lost += usize::from(position > LOST);
        self.position_squares += position * position;
        self.heading_squares += heading * heading;
        if let Some(nees) = believed.nees(reference) {
            self.nees += nees;
            self.nees_count += 1;
        }
    }

    /// Returns the number of estimates.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether no estimate was counted.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the errors of the position, metres.
    pub fn positions(&self) -> &Gathered {
        &self.positions
    }

    /// Returns the largest error of the position, metres.
    pub fn farthest(&self) -> f64 {
        self.farthest
    }

    /// Returns the root mean square error of the position, metres.
    pub fn position_rmse(&self) -> f64 {
        (self.position_squares / self.count as f64).sqrt()
    }

    /// Returns this quantile of the errors of the position, metres.
    pub fn position_quantile(&self, share: f64) -> f64 {
        self.positions.sorted().map_or(f64::NAN, |sorted| sorted.quantile(share).value)
    }

    /// Returns the root mean square error of the heading, radians.
    pub fn heading_rmse(&self) -> f64 {
        (self.heading_squares / self.count as f64).sqrt()
    }

    /// Returns the share of estimates with an error above [`LOST`].
    pub fn lost(&self) -> f64 {
        self.lost as f64 / self.count as f64
    }

    /// Returns the mean of [`Belief::nees`]: 3 if the covariance matches the errors, more if it is too small.
    pub fn mean_nees(&self) -> f64 {
        self.nees / self.nees_count as f64
    }
}

/// Formats the figures as one line.
impl fmt::Display for Errors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let heading = self.heading_rmse().to_degrees();
        let (median, max) = (self.position_quantile(0.5), self.farthest);
        let (lost, nees) = (100.0 * self.lost(), self.mean_nees());
        write!(f, "position RMSE {:.3} m, median {median:.3} m, max {max:.3} m; ", self.position_rmse())?;
        write!(
            f,
            "heading RMSE {heading:.2}°; lost (over {LOST} m) {lost:.2} %; NEES {nees:.1} (3 is consistent)"
        )
    }
}

/// Returns Spearman's rank correlation, i.e. the correlation of the ranks. Equal values share the mean of their ranks.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let middle = (a.len() as f64 - 1.0) / 2.0;
    let ranks = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = |value: &f64| {
            let below = sorted.partition_point(|other| other < value);
            let upto = sorted.partition_point(|other| other <= value);
            (below + upto - 1) as f64 / 2.0 - middle
        };
        values.iter().map(rank).collect::<Vec<f64>>()
    };
    let (a, b) = (ranks(a), ranks(b));
    let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    sum(&a, &b) / (sum(&a, &a) * sum(&b, &b)).sqrt()
}

/// Returns the largest correlation that the logarithms of deviations can have with those of the errors, if each error is
/// normal with its deviation. Zeros are left out.
///
/// The logarithm of a normal error in the plane varies by at least π²/24 on its own, whatever its deviation is.
pub fn best_correlation(errors: &[f64]) -> f64 {
    let logs: Vec<f64> = errors.iter().filter(|error| **error > 0.0).map(|error| error.ln()).collect();
    let count = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / count;
    let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / count;
    (1.0 - PI.powi(2) / 24.0 / variance).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use cotorra_numbers::Draws;

    use super::*;

    fn read(text: &str) -> Trajectory {
        Trajectory::read(text.as_bytes()).unwrap()
    }

    #[test]
    fn tables_and_tum_files_give_the_same_trajectory() {
        let table = read("time,x,y,heading\n# a remark\n1,2,3,1.0\n2,4,3,1.5\n");
        let (sin, cos) = 0.5_f64.sin_cos();
        let (sin_after, cos_after) = 0.75_f64.sin_cos();
        let tum = read(&format!("1 2 3 0 0 0 {sin} {cos}\n2 4 3 0 0 0 {sin_after} {cos_after}\n"));
        let quoted = "\u{feff}\"time\",\"x\",\"y\",\"heading\"\r\n\"1\",\"2\",\"3\",\"1.0\"\r\n2,4,3,1.5\r\n";
        for trajectory in [&table, &tum, &read(quoted)] {
            let between = trajectory.at(0, 9, 1.5).unwrap();
            assert!((between.x - 3.0).abs() < 1e-9 && (between.heading - 1.25).abs() < 1e-9);
            assert_eq!(trajectory.at(0, 9, 0.9), None);
            assert_eq!(trajectory.at(0, 9, 2.1), None);
            assert!(trajectory.at(0, 9, 2.0).is_some());
        }
    }

    #[test]
    fn corrected_log_with_as_many_scans_is_matched_by_number() {
        // Clocks of many public logs stand still or lack digits.
        let log = "FLASER 1 2 5 6 0 5 6 0 0 h 0\nFLASER 1 2 7 6 0 7 6 0 0 h 0\n";
        let trajectory = read(log);
        assert_eq!(trajectory.at(1, 2, 0.0), Some(Pose2::new(7.0, 6.0, 0.0)));
        assert_eq!((trajectory.len(), trajectory.first()), (2, Some(Pose2::new(5.0, 6.0, 0.0))));
    }

    #[test]
    fn errors_name_their_line() {
        let wrong = |text: &str| Trajectory::read(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(wrong("1,2,3,4\n2,x,3,4\n"), "line 2: the row of `trajectory` is `x`, which is no number");
        let far = "line 1: the row of `trajectory` is (20000000.0, 0.0), but no map reaches beyond 1e7 m";
        assert_eq!(wrong("1,2e7,0,0\n"), far);
        assert_eq!(wrong("1,2,3\n"), "line 1: `trajectory` ends before its heading");
    }

    #[test]
    fn rank_correlation_sees_the_order_only() {
        let a = [1.0, 2.0, 3.0, 4.0];
        assert!((rank_correlation(&a, &[0.1, 0.2, 0.4, 80.0]) - 1.0).abs() < 1e-12);
        assert!((rank_correlation(&a, &[4.0, 3.0, 2.0, -9.0]) + 1.0).abs() < 1e-12);
        assert_eq!(rank_correlation(&a, &[1.0, 2.0, 2.0, 1.0]), 0.0);
    }

    #[test]
    fn perfect_deviations_have_about_the_best_rank_correlation() {
        let mut random = Draws::from_seed(1);
        // Deviations with a normal logarithm, and a small and a large one.
        for normal in [true, false] {
            let draw = |random: &mut Draws| {
                let log = if normal { random.normal() } else { 2.0 * random.below(2) as f64 - 1.0 };
                (0.4 * log).exp()
            };
            let deviations: Vec<f64> = (0..20_000).map(|_| draw(&mut random)).collect();
            let errors: Vec<f64> =
                deviations.iter().map(|size| size * random.normal().hypot(random.normal())).collect();
            let (rank, best) = (rank_correlation(&deviations, &errors), best_correlation(&errors));
            assert!(
                (0.5..0.56).contains(&best) && (best - 0.02..best + 0.06).contains(&rank),
                "{rank} {best}"
            );
        }
    }

    #[test]
    fn errors_have_a_root_mean_square_and_consistency() {
        let mut errors = Errors::default();
        let covariance = [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01];
        for x in [0.1, -0.1, 3.0] {
            errors.push(&Belief { pose: Pose2::new(x, 0.0, 0.0), covariance }, Pose2::default());
        }
        assert!((errors.position_rmse() - (9.02_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((errors.lost() - 1.0 / 3.0).abs() < 1e-12);
        assert!((errors.position_quantile(0.5) - 0.1).abs() < 1e-12);
        assert!((errors.mean_nees() - 902.0 / 3.0).abs() < 1e-6);
    }
}
