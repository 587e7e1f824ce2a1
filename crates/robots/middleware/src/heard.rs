//! Subscription of a link to a robot's topic. It bounds the work per call and counts lost messages.

use cotorra_graph::Timestamp;

use crate::{ros_robot::RosRobot, watch::Topic};

/// Length of a topic's queue, messages.
pub(crate) const QUEUE: usize = 32;

/// Source of a topic's messages.
pub(crate) trait Source {
    type Message;

    /// Returns the next message that waits.
    fn next(&self) -> Option<Self::Message>;

    /// Waits for the next message; `None` once the source has ended.
    fn wait(&self) -> Option<Self::Message>;

    /// Returns the number of messages dropped so far because the queue was full.
    fn dropped(&self) -> u64;

    /// Returns the number of malformed messages so far.
    fn malformed(&self) -> u64;
}

/// A topic with the numbers of its lost messages so far.
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

    /// Takes the messages that wait, and reports lost ones to the robot.
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
        // At most the queue's length, so that a flood cannot keep the link busy.
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
