//! A topic of a robot, as a link listens to it: no flood keeps the link busy, and what is lost on the way is
//! counted.

use cotorra_graph::Timestamp;

use crate::{ros_robot::RosRobot, watch::Topic};

/// Messages of a topic that wait until they are taken in.
pub(crate) const QUEUE: usize = 32;

/// Where the messages of a topic come from.
pub(crate) trait Source {
    /// What comes.
    type Message;

    /// The next one, if there is one.
    fn next(&self) -> Option<Self::Message>;

    /// The next one, once there is one; `None` if there will be none.
    fn wait(&self) -> Option<Self::Message>;

    /// How many were dropped so far, because they were not taken.
    fn dropped(&self) -> u64;

    /// How many came so far that are none.
    fn malformed(&self) -> u64;
}

/// A topic, and what of it was lost so far.
#[derive(Debug)]
pub(crate) struct Heard<S> {
    source: S,
    topic: Topic,
    dropped: u64,
    malformed: u64,
}

impl<S: Source> Heard<S> {
    pub fn new(source: S, topic: Topic) -> Self {
        Self { source, topic, dropped: 0, malformed: 0 }
    }

    /// Takes in what came.
    pub fn hear(
        &mut self,
        now: Timestamp,
        robot: &mut RosRobot,
        mut take: impl FnMut(&mut RosRobot, S::Message),
    ) {
        let dropped = self.source.dropped();
        if dropped > self.dropped {
            robot.missed(now, self.topic, dropped - self.dropped);
            self.dropped = dropped;
        }
        // No more than can have waited: a flood does not keep anyone here.
        for _ in 0..QUEUE {
            let Some(message) = self.source.next() else { break };
            take(robot, message);
        }
        let malformed = self.source.malformed();
        if malformed > self.malformed {
            robot.malformed(now);
            self.malformed = malformed;
        }
    }
}
