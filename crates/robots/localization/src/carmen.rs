//! Reader of CARMEN logs, the format of most public lidar data sets: one message per line, its name first.
//!
//! It reads `ODOM`, `FLASER` (the older laser message, of a SICK that looks forward) and `ROBOTLASER1`, which includes the
//! laser's mount. It skips other messages.

use std::{f64::consts::PI, io::BufRead, num::ParseFloatError};

use crate::{
    geometry::{FARTHEST, Pose2},
    scan::Scan,
};

/// A message of a log.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A pose by odometry.
    Odometry {
        /// Seconds since an epoch of the log's own.
        at: f64,
        /// The robot's pose.
        pose: Pose2,
    },
    /// A scan.
    Laser(Laser),
}

/// A scan, with the robot's pose at that time.
#[derive(Debug, Clone, PartialEq)]
pub struct Laser {
    /// Seconds since an epoch of the log's own.
    pub at: f64,
    /// The robot's pose: by odometry, or the corrected one in a corrected log.
    pub robot: Pose2,
    /// The laser's pose.
    pub laser: Pose2,
    /// Direction of the first beam in the laser's frame, radians.
    pub angle_min: f64,
    /// Angle between neighbouring beams, radians.
    pub angle_increment: f64,
    /// The laser's maximum range, metres, if the log has it.
    pub range_max: Option<f64>,
    /// Ranges of all beams, metres.
    pub ranges: Vec<f32>,
}

impl Laser {
    /// Returns the scan as the filter takes it.
    pub fn scan(&self) -> Scan<'_> {
        let &Self { angle_min, angle_increment, ref ranges, .. } = self;
        // A SICK turns 75 times a second, so that the robot hardly moves during a turn.
        let (mount, sweep) = (self.robot.step_to(self.laser), Pose2::default());
        Scan { angle_min, angle_increment, ranges, mount, sweep }
    }
}

/// An error in a log.
#[derive(Debug, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct LogError {
    /// The line, counted from 1.
    pub line: usize,
    /// The cause.
    pub problem: LogProblem,
}

/// A mistake in a line of a log.
#[derive(Debug, thiserror::Error)]
pub enum LogProblem {
    /// The file cannot be read, or is not text.
    #[error("it cannot be read: {0}")]
    Unreadable(#[from] std::io::Error),
    /// A message ends too early.
    #[error("`{message}` ends before its {field}")]
    Short {
        /// The message's name.
        message: &'static str,
        /// The missing field.
        field: &'static str,
    },
    /// A field is not a number.
    #[error("the {field} of `{message}` is `{found}`, which is no number")]
    NoNumber {
        /// The message's name.
        message: &'static str,
        /// The field.
        field: &'static str,
        /// Its text.
        found: String,
    },
    /// A pose is beyond any map.
    #[error("the {field} of `{message}` is ({x:?}, {y:?}), but no map reaches beyond {FARTHEST:e} m")]
    TooFar {
        /// The message's name.
        message: &'static str,
        /// The pose's name.
        field: &'static str,
        /// Metres.
        x: f64,
        /// Metres.
        y: f64,
    },
    /// The number of readings is negative or not whole.
    #[error("`{message}` announces {count} {field}, which is no count")]
    NoCount {
        /// The message's name.
        message: &'static str,
        /// The list's name.
        field: &'static str,
        /// The number.
        count: f64,
    },
    /// The number of readings exceeds that of any laser.
    #[error("`{message}` announces {count} {field}, but no laser has more than {MAX_READINGS}")]
    TooMany {
        /// The message's name.
        message: &'static str,
        /// The list's name.
        field: &'static str,
        /// The number.
        count: f64,
    },
}

/// Largest number of beams of any laser.
const MAX_READINGS: usize = 1 << 20;

/// Reads a log line by line.
#[derive(Debug)]
pub struct Log<R> {
    source: R,
    text: String,
    line: usize,
    failed: bool,
}

impl<R: BufRead> Log<R> {
    /// Creates a reader of this source.
    pub fn new(source: R) -> Self {
        Self { source, text: String::new(), line: 0, failed: false }
    }

    /// Returns the number of lines read so far.
    pub fn line(&self) -> usize {
        self.line
    }
}

/// Yields the known messages, and ends at the first error.
impl<R: BufRead> Iterator for Log<R> {
    type Item = Result<Message, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.failed {
            self.line += 1;
            self.text.clear();
            let message = match self.source.read_line(&mut self.text) {
                Ok(0) => return None,
                Ok(_) => message(&self.text),
                Err(error) => Err(error.into()),
            };
            match message {
                Ok(Some(message)) => return Some(Ok(message)),
                Ok(None) => {}
                Err(problem) => {
                    self.failed = true;
                    return Some(Err(LogError { line: self.line, problem }));
                }
            }
        }
        None
    }
}

/// Parses one line; `None` for messages other than odometry and laser.
fn message(line: &str) -> Result<Option<Message>, LogProblem> {
    let mut fields = line.split_ascii_whitespace();
    Ok(match fields.next() {
        Some("ODOM") => Some(odometry(Fields { message: "ODOM", fields })?),
        Some("FLASER") => Some(front_laser(Fields { message: "FLASER", fields })?),
        Some("ROBOTLASER1") => Some(robot_laser(Fields { message: "ROBOTLASER1", fields })?),
        _ => None,
    })
}

/// `ODOM x y theta tv rv accel timestamp host logger_timestamp`
fn odometry(mut fields: Fields<'_>) -> Result<Message, LogProblem> {
    let pose = fields.pose("pose")?;
    for field in ["velocity", "angular velocity", "acceleration"] {
        fields.number(field)?;
    }
    Ok(Message::Odometry { at: fields.number("time")?, pose })
}

/// `FLASER n ranges... laser_x laser_y laser_theta x y theta timestamp host logger_timestamp`
fn front_laser(mut fields: Fields<'_>) -> Result<Message, LogProblem> {
    let ranges = fields.list("ranges")?;
    let (laser, robot) = (fields.pose("laser's pose")?, fields.pose("robot's pose")?);
    let at = fields.number("time")?;
    // The message lacks the angle: 180 or 181 beams are a degree apart, 360 or 361 half a degree, and so on. They cover the
    // half turn ahead, the first one to the right.
    let angle_increment = match ranges.len() {
        0 => 0.0,
        beams if beams % 10 == 1 && beams > 1 => PI / (beams - 1) as f64,
        beams => PI / beams as f64,
    };
    let angle_min = -PI / 2.0;
    Ok(Message::Laser(Laser { at, robot, laser, angle_min, angle_increment, range_max: None, ranges }))
}

/// `ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode n ranges... m
/// remissions... laser_x laser_y laser_theta x y theta tv rv forward_safety side_safety turn_axis timestamp host
/// logger_timestamp`
fn robot_laser(mut fields: Fields<'_>) -> Result<Message, LogProblem> {
    fields.number("laser's type")?;
    let angle_min = fields.number("start angle")?;
    fields.number("field of view")?;
    let angle_increment = fields.number("angular resolution")?;
    let range_max = fields.number("maximum range")?;
    fields.number("accuracy")?;
    fields.number("remission mode")?;
    let ranges = fields.list("ranges")?;
    fields.list("remissions")?;
    let (laser, robot) = (fields.pose("laser's pose")?, fields.pose("robot's pose")?);
    for field in ["velocity", "angular velocity", "forward safety", "side safety", "turn axis"] {
        fields.number(field)?;
    }
    let at = fields.number("time")?;
    let range_max = (range_max > 0.0).then_some(range_max);
    Ok(Message::Laser(Laser { at, robot, laser, angle_min, angle_increment, range_max, ranges }))
}

/// The fields after a message's name.
struct Fields<'a> {
    message: &'static str,
    fields: std::str::SplitAsciiWhitespace<'a>,
}

impl Fields<'_> {
    fn number(&mut self, field: &'static str) -> Result<f64, LogProblem> {
        let message = self.message;
        let found = self.fields.next().ok_or(LogProblem::Short { message, field })?;
        let number: Result<f64, ParseFloatError> = found.parse();
        match number {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(LogProblem::NoNumber { message, field, found: shortened(found) }),
        }
    }

    fn pose(&mut self, field: &'static str) -> Result<Pose2, LogProblem> {
        let [x, y, heading] = [self.number(field)?, self.number(field)?, self.number(field)?];
        valid(self.message, field, Pose2::new(x, y, heading))
    }

    /// Parses a count and as many numbers. A range may be NaN or infinite: that beam hit nothing.
    fn list(&mut self, field: &'static str) -> Result<Vec<f32>, LogProblem> {
        let message = self.message;
        let count = self.number(field)?;
        if count < 0.0 || count.fract() != 0.0 {
            return Err(LogProblem::NoCount { message, field, count });
        }
        if count > MAX_READINGS as f64 {
            return Err(LogProblem::TooMany { message, field, count });
        }
        let read = |_| {
            let found = self.fields.next().ok_or(LogProblem::Short { message, field })?;
            found.parse().map_err(|_| LogProblem::NoNumber { message, field, found: shortened(found) })
        };
        (0..count as usize).map(read).collect()
    }
}

/// Returns the pose if it is valid ([`Pose2::is_valid`]).
pub(crate) fn valid(message: &'static str, field: &'static str, pose: Pose2) -> Result<Pose2, LogProblem> {
    let Pose2 { x, y, .. } = pose;
    if pose.is_valid() { Ok(pose) } else { Err(LogProblem::TooFar { message, field, x, y }) }
}

fn shortened(found: &str) -> String {
    found.chars().take(40).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(text: &str) -> Vec<Result<Message, LogError>> {
        Log::new(text.as_bytes()).collect()
    }

    fn wrong(text: &str) -> String {
        read(text).pop().unwrap().unwrap_err().to_string()
    }

    #[test]
    fn laser_messages_and_odometry_are_read() {
        let text = "# CARMEN Logfile\nPARAM robot_width 0.5 nohost 0\n\n\
            ODOM 1 2 0.5 0.1 0 0 7.25 host 7.3\n\
            FLASER 3 1.0 2.0 inf 1.1 2 0.5 1 2 0.5 7.5 host 7.6\n\
            ROBOTLASER1 0 -1.57 3.14 0.0174 81.9 0.01 0 2 1.5 2.5 1 0.3 3 4 0 2.9 4 0 0.1 0.2 0 0 0 8 host 8.1\n";
        let messages: Vec<Message> = read(text).into_iter().map(Result::unwrap).collect();
        assert_eq!(messages[0], Message::Odometry { at: 7.25, pose: Pose2::new(1.0, 2.0, 0.5) });
        let [Message::Laser(front), Message::Laser(robot)] = &messages[1..] else {
            panic!("{messages:?}");
        };
        assert_eq!((front.at, front.ranges.as_slice()), (7.5, [1.0, 2.0, f32::INFINITY].as_slice()));
        assert_eq!((front.angle_min, front.range_max), (-PI / 2.0, None));
        assert!((front.scan().mount.x - 0.1 * 0.5_f64.cos()).abs() < 1e-12);
        assert_eq!((robot.at, robot.ranges.as_slice()), (8.0, [1.5, 2.5].as_slice()));
        assert_eq!((robot.angle_min, robot.angle_increment, robot.range_max), (-1.57, 0.0174, Some(81.9)));
        assert!((robot.scan().mount.x - 0.1).abs() < 1e-12);
    }

    #[test]
    fn beams_of_a_front_laser_cover_half_a_turn() {
        for (beams, degrees) in [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (90, 2.0)] {
            let ranges = vec!["1"; beams].join(" ");
            let messages = read(&format!("FLASER {beams} {ranges} 0 0 0 0 0 0 0 h 0"));
            let Some(Ok(Message::Laser(laser))) = messages.first() else { panic!("{messages:?}") };
            assert!((laser.angle_increment.to_degrees() - degrees).abs() < 1e-9, "{beams}");
        }
    }

    #[test]
    fn errors_name_their_line() {
        assert_eq!(wrong("\nODOM 1 2\n"), "line 2: `ODOM` ends before its pose");
        assert_eq!(wrong("FLASER 3 1 2"), "line 1: `FLASER` ends before its ranges");
        assert_eq!(wrong("FLASER 2 1 x"), "line 1: the ranges of `FLASER` is `x`, which is no number");
        assert_eq!(
            wrong("FLASER 1e9 1"),
            "line 1: `FLASER` announces 1000000000 ranges, but no laser has more than 1048576"
        );
        assert_eq!(
            wrong("ODOM nan 2 3 0 0 0 1 h 1"),
            "line 1: the pose of `ODOM` is `nan`, which is no number"
        );
        assert_eq!(wrong("FLASER -5 1"), "line 1: `FLASER` announces -5 ranges, which is no count");
        assert_eq!(wrong("FLASER 1.5 1"), "line 1: `FLASER` announces 1.5 ranges, which is no count");
        assert_eq!(
            wrong("ODOM 1e8 2 3 0 0 0 1 h 1"),
            "line 1: the pose of `ODOM` is (100000000.0, 2.0), but no map reaches beyond 1e7 m"
        );
        // Nothing follows an error.
        assert_eq!(read("ODOM\nODOM 1 2 3 0 0 0 1 h 1\n").len(), 1);
    }

    proptest! {
        #[test]
        fn arbitrary_logs_never_panic(text in "(ODOM|FLASER|ROBOTLASER1)( -?[0-9.einf]{1,4}){0,30}\n?") {
            read(&text).into_iter().for_each(|message| if let Ok(Message::Laser(laser)) = message {
                _ = laser.scan();
            });
        }
    }
}
