//! Health of a robot in ROS, from its messages: detects silence, floods and impossible content.
//!
//! A fault lasts until none of its kind was seen for [`HOLD`], so that it does not come and go with each message.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{RobotFault, Timestamp};
use cotorra_ros_messages::Time;

/// Time without messages of a steady topic after which a robot counts as silent.
const SILENCE: Duration = Duration::from_secs(1);
/// Time that a fault lasts after it was last seen.
pub(crate) const HOLD: Duration = Duration::from_secs(1);
/// Allowed backward step of stamps, ns: clocks are corrected in small steps.
const BACK: i128 = 100_000_000;
/// Allowed lead of stamps over time from one message to the next, ns: messages that a network held back arrive at once.
const AHEAD: i128 = 5_000_000_000;
/// Period over which messages are counted.
const WINDOW: Duration = Duration::from_secs(1);

/// Topics of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Odometry, which every robot has.
    Odometry,
    /// Turns of its lidar.
    Scan,
    /// Poses by localization.
    Localization,
    /// Coordinate frames.
    Frames,
}

impl Topic {
    const ALL: [Self; 4] = [Self::Odometry, Self::Scan, Self::Localization, Self::Frames];

    /// Returns the number of messages per second that counts as a flood: ten times that of known robots.
    const fn flood(self) -> u64 {
        match self {
            Self::Odometry | Self::Localization => 2_000,
            Self::Scan => 500,
            Self::Frames => 5_000,
        }
    }

    /// Whether a robot that once sent the topic sends it all the time.
    const fn is_steady(self) -> bool {
        matches!(self, Self::Odometry | Self::Scan)
    }
}

/// Messages of one topic.
#[derive(Debug, Clone, Copy, Default)]
struct Heard {
    last: Option<Timestamp>,
    /// The last stamp, nanoseconds, and its time of arrival.
    stamped: Option<(i128, Timestamp)>,
    window: Timestamp,
    count: u64,
}

/// Health of one robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Watch {
    topics: [Heard; Topic::ALL.len()],
    /// Time at which each fault was last seen.
    seen: BTreeMap<RobotFault, Timestamp>,
}

impl Watch {
    /// Counts messages of a topic.
    pub fn count(&mut self, now: Timestamp, topic: Topic, messages: u64) {
        let heard = &mut self.topics[topic as usize];
        if now.since(heard.window) >= WINDOW {
            (heard.window, heard.count) = (now, 0);
        }
        heard.count = heard.count.saturating_add(messages);
        if heard.count > topic.flood() {
            self.record(now, RobotFault::Flood);
        }
    }

    /// Records a valid message. A stamp of 0 means none.
    pub fn heard(&mut self, now: Timestamp, topic: Topic, stamp: &Time) {
        let stamp = i128::from(stamp.sec) * 1_000_000_000 + i128::from(stamp.nanosec);
        let heard = &mut self.topics[topic as usize];
        heard.last = Some(now);
        if stamp == 0 {
            return;
        }
        let jumped = heard.stamped.is_some_and(|(before, at)| {
            let went = stamp - before;
            went < -BACK || went > now.since(at).as_nanos().cast_signed() + AHEAD
        });
        heard.stamped = Some((stamp, now));
        if jumped {
            self.record(now, RobotFault::TimeJump);
        }
    }

    /// Records a fault.
    pub fn record(&mut self, now: Timestamp, fault: RobotFault) {
        self.seen.insert(fault, now);
    }

    /// Returns the present faults, in order.
    pub fn faults(&self, now: Timestamp) -> Vec<RobotFault> {
        let last = |topic: Topic| self.topics[topic as usize].last;
        let is_silent = |topic: &Topic| {
            topic.is_steady() && last(*topic).is_some_and(|heard| now.since(heard) >= SILENCE)
        };
        let lasts = |fault| self.seen.get(&fault).is_some_and(|seen| now.since(*seen) < HOLD);
        let is_there = |fault: &RobotFault| match fault {
            RobotFault::Absent => last(Topic::Odometry).is_none(),
            RobotFault::Silent => Topic::ALL.iter().any(is_silent),
            fault => lasts(*fault),
        };
        RobotFault::ALL.into_iter().filter(is_there).collect()
    }

    /// Returns the next time at which the faults may change without a message.
    pub fn next_deadline(&self, now: Timestamp) -> Option<Timestamp> {
        let steady = Topic::ALL.iter().filter(|topic| topic.is_steady());
        let silent = steady.filter_map(|topic| Some(self.topics[*topic as usize].last? + SILENCE));
        silent.chain(self.seen.values().map(|seen| *seen + HOLD)).filter(|at| *at > now).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn stamp(ms: i32) -> Time {
        Time { sec: ms / 1000, nanosec: (ms % 1000) as u32 * 1_000_000 }
    }

    fn well() -> Watch {
        let mut watch = Watch::default();
        watch.heard(at(1000), Topic::Odometry, &stamp(500_000));
        watch
    }

    #[test]
    fn robot_is_absent_until_its_first_odometry_and_silent_after_its_last() {
        let mut watch = Watch::default();
        assert_eq!(watch.faults(at(0)), [RobotFault::Absent]);
        watch.heard(at(10), Topic::Scan, &stamp(1));
        assert_eq!(watch.faults(at(20)), [RobotFault::Absent], "a scan alone is no robot");
        watch.heard(at(30), Topic::Odometry, &stamp(1));
        assert_eq!(watch.faults(at(1009)), []);
        assert_eq!(watch.faults(at(1010)), [RobotFault::Silent], "its lidar is");
        watch.heard(at(1020), Topic::Scan, &stamp(2));
        assert_eq!(watch.faults(at(1030)), [RobotFault::Silent], "its base is");
        watch.heard(at(1040), Topic::Odometry, &stamp(2));
        assert_eq!(watch.faults(at(1050)), []);
        assert_eq!(watch.next_deadline(at(1050)), Some(at(2020)));
    }

    #[test]
    fn lidar_and_localization_are_optional() {
        let mut watch = well();
        watch.heard(at(1000), Topic::Localization, &stamp(500_000));
        watch.heard(at(9000), Topic::Odometry, &stamp(508_000));
        assert_eq!(watch.faults(at(9500)), []);
    }

    #[test]
    fn stamps_may_lag_and_catch_up_but_not_jump() {
        let mut watch = well();
        // Messages are held back for 3 s and then arrive at once.
        for ms in [3900, 3901, 3902] {
            watch.heard(at(ms), Topic::Odometry, &stamp(503_000));
        }
        assert_eq!(watch.faults(at(3903)), []);
        watch.heard(at(3910), Topic::Odometry, &stamp(502_000));
        assert_eq!(watch.faults(at(3911)), [RobotFault::TimeJump], "back");
        watch.heard(at(4900), Topic::Odometry, &stamp(502_990));
        assert_eq!(watch.faults(at(4911)), [], "that is over after a second");
        watch.heard(at(5000), Topic::Odometry, &stamp(600_000));
        assert_eq!(watch.faults(at(5001)), [RobotFault::TimeJump], "ahead");
        watch.heard(at(5900), Topic::Odometry, &stamp(0));
        assert_eq!(watch.faults(at(6001)), [], "who has no clock cannot jump");
    }

    #[test]
    fn floods_are_counted_per_second() {
        let mut watch = well();
        for second in 1..5 {
            watch.count(at(second * 1000), Topic::Scan, Topic::Scan.flood());
            watch.heard(at(second * 1000), Topic::Odometry, &stamp(0));
        }
        assert_eq!(watch.faults(at(4500)), [], "much is not too much");
        watch.count(at(4500), Topic::Scan, 1);
        assert_eq!(watch.faults(at(4501)), [RobotFault::Flood]);
    }
}
