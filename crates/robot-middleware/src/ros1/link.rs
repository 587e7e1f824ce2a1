//! The link to a robot that speaks ROS 1: a node that has its topics.

use cotorra_graph::{RosTopics, Timestamp, Velocity};
use cotorra_ros1::{
    Message, Node, NodeConfig, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscriber,
    messages::{self as ros1, Twist},
};

use super::convert::{frames, laser_scan, odometry, pose_stamped};
use crate::{ros_driver::RosLink, ros_robot::RosRobot, watch::Topic};

/// Messages of a topic that wait until they are taken in.
const QUEUE: usize = 32;

/// A node that listens to a robot and says velocities to it.
#[derive(Debug)]
pub struct Ros1Link {
    odometry: Heard<ros1::Odometry>,
    scans: Heard<ros1::LaserScan>,
    poses: Heard<ros1::PoseWithCovarianceStamped>,
    frames: Heard<ros1::TFMessage>,
    velocities: Publisher<Twist>,
    /// Keeps all of it going.
    _node: Node,
}

impl Ros1Link {
    /// Starts a node that has the robot's topics.
    ///
    /// # Errors
    /// [`NodeError`] if a name is none, or the master is not there.
    pub fn connect(config: NodeConfig, topics: &RosTopics) -> Result<Self, NodeError> {
        let node = Node::new(config)?;
        Ok(Self {
            odometry: Heard::subscribe(&node, &topics.odom, Topic::Odometry)?,
            scans: Heard::subscribe(&node, &topics.scan, Topic::Scan)?,
            poses: Heard::subscribe(&node, &topics.amcl_pose, Topic::Localization)?,
            frames: Heard::subscribe(&node, &topics.tf, Topic::Frames)?,
            velocities: node.publish(&topics.cmd_vel, PublishOptions::default())?,
            _node: node,
        })
    }
}

impl RosLink for Ros1Link {
    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot) {
        // Odometry first: the others say where its frame is.
        self.odometry.hear(now, robot, |robot, message| robot.odometry(now, &odometry(message)));
        self.frames.hear(now, robot, |robot, message| robot.frames(now, &frames(message)));
        self.poses.hear(now, robot, |robot, message| robot.localized(now, &pose_stamped(message)));
        self.scans.hear(now, robot, |robot, message| robot.scanned(now, laser_scan(message)));
    }

    fn say(&mut self, velocity: Velocity) {
        let mut twist = Twist::default();
        (twist.linear.x, twist.angular.z) = (velocity.linear, velocity.angular);
        self.velocities.publish(&twist);
    }
}

/// A topic of the robot's, and what of it was lost so far.
#[derive(Debug)]
struct Heard<M> {
    subscriber: Subscriber<M>,
    topic: Topic,
    dropped: u64,
    malformed: u64,
}

impl<M: Message> Heard<M> {
    fn subscribe(node: &Node, name: &str, topic: Topic) -> Result<Self, NodeError> {
        let subscriber = node.subscribe(name, SubscribeOptions { queue: QUEUE })?;
        Ok(Self { subscriber, topic, dropped: 0, malformed: 0 })
    }

    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot, mut take: impl FnMut(&mut RosRobot, M)) {
        let dropped = self.subscriber.dropped();
        if dropped > self.dropped {
            robot.missed(now, self.topic, dropped - self.dropped);
            self.dropped = dropped;
        }
        // No more than can have waited: a flood does not keep anyone here.
        for _ in 0..QUEUE {
            let Some(message) = self.subscriber.try_recv() else { break };
            take(robot, message);
        }
        let malformed = self.subscriber.malformed();
        if malformed > self.malformed {
            robot.malformed(now);
            self.malformed = malformed;
        }
    }
}
