//! The link to a robot that speaks ROS 2: a node that has its topics.

use cotorra_graph::{RosTopics, Timestamp, Velocity};
use cotorra_ros2::{
    Carried, Command, Node, NodeConfig, NodeError, Publisher, Qos, Subscriber,
    messages::{Header, LaserScan, Odometry, PoseWithCovarianceStamped, TFMessage},
};

use crate::{
    heard::{Heard, QUEUE, Source},
    ros::BASE_FRAME,
    ros_driver::RosLink,
    ros_robot::RosRobot,
    watch::Topic,
};

/// From who tells often, however it is published.
const OFTEN: Qos = Qos { depth: QUEUE, ..Qos::SENSORS };
/// From who tells seldom, as localization does: what is lost is sent again.
const SELDOM: Qos = Qos { depth: QUEUE, ..Qos::COMMANDS };

/// A node that listens to a robot and says velocities to it.
#[derive(Debug)]
pub struct Ros2Link {
    odometry: Heard<Subscriber<Odometry>>,
    scans: Heard<Subscriber<LaserScan>>,
    poses: Heard<Subscriber<PoseWithCovarianceStamped>>,
    frames: Heard<Subscriber<TFMessage>>,
    velocities: Publisher<Command>,
    /// The beginning of the run, since 1970.
    epoch: Timestamp,
    now: Timestamp,
    /// Keeps all of it going.
    _node: Node,
}

impl Ros2Link {
    /// Starts a node that has the robot's topics. Stamps count from 1970; `epoch` is when the run began.
    ///
    /// # Errors
    /// [`NodeError`] if a name is none, or DDS refuses.
    pub fn connect(config: NodeConfig, topics: &RosTopics, epoch: Timestamp) -> Result<Self, NodeError> {
        let node = Node::new(config)?;
        Ok(Self {
            odometry: Heard::new(node.subscribe(&topics.odom, OFTEN)?, Topic::Odometry),
            scans: Heard::new(node.subscribe(&topics.scan, OFTEN)?, Topic::Scan),
            poses: Heard::new(node.subscribe(&topics.amcl_pose, SELDOM)?, Topic::Localization),
            frames: Heard::new(node.subscribe(&topics.tf, OFTEN)?, Topic::Frames),
            velocities: node.publish(&topics.cmd_vel, Qos::COMMANDS)?,
            epoch,
            now: Timestamp::ZERO,
            _node: node,
        })
    }
}

impl RosLink for Ros2Link {
    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot) {
        self.now = now;
        // Odometry first: the others say where its frame is.
        self.odometry.hear(now, robot, |robot, message| robot.odometry(now, &message));
        self.frames.hear(now, robot, |robot, message| robot.frames(now, &message));
        self.poses.hear(now, robot, |robot, message| robot.localized(now, &message));
        self.scans.hear(now, robot, |robot, message| robot.scanned(now, message));
    }

    fn say(&mut self, velocity: Velocity) {
        let header = Header::new(self.now + self.epoch.since(Timestamp::ZERO), BASE_FRAME);
        self.velocities.publish(&Command { header, twist: velocity.into() });
    }
}

impl<M: Carried> Source for Subscriber<M> {
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
