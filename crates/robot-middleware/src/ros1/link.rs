//! The link to a robot that speaks ROS 1: a node that has its topics.

use cotorra_graph::{RosTopics, Timestamp, Velocity};
use cotorra_ros1::{
    Message, Node, NodeConfig, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscriber,
    messages::{self as ros1, Twist},
};

use super::convert::{frames, laser_scan, odometry, pose_stamped};
use crate::{
    heard::{Heard, QUEUE, Source},
    ros_driver::RosLink,
    ros_robot::RosRobot,
    watch::Topic,
};

/// A node that listens to a robot and says velocities to it.
#[derive(Debug)]
pub struct Ros1Link {
    odometry: Heard<Subscriber<ros1::Odometry>>,
    scans: Heard<Subscriber<ros1::LaserScan>>,
    poses: Heard<Subscriber<ros1::PoseWithCovarianceStamped>>,
    frames: Heard<Subscriber<ros1::TFMessage>>,
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
        let queue = SubscribeOptions { queue: QUEUE };
        Ok(Self {
            odometry: Heard::new(node.subscribe(&topics.odom, queue)?, Topic::Odometry),
            scans: Heard::new(node.subscribe(&topics.scan, queue)?, Topic::Scan),
            poses: Heard::new(node.subscribe(&topics.amcl_pose, queue)?, Topic::Localization),
            frames: Heard::new(node.subscribe(&topics.tf, queue)?, Topic::Frames),
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

impl<M: Message> Source for Subscriber<M> {
    type Message = M;

    fn next(&self) -> Option<M> {
        self.try_recv()
    }

    fn dropped(&self) -> u64 {
        self.dropped()
    }

    fn malformed(&self) -> u64 {
        self.malformed()
    }
}
