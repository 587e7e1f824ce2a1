//! Link to a robot in ROS 1: a node with its topics.

use cotorra_graph::{RosTopics, SensorMessage, Timestamp, Velocity};
use cotorra_ros1::{
    Message, Node, NodeConfig, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscriber,
    messages::{
        BatteryState, CompressedImage, Float64MultiArray, Imu, LaserScan, Odometry,
        PoseWithCovarianceStamped, TFMessage, Twist,
    },
};

use crate::{
    heard::{Heard, QUEUE, Source},
    picture,
    ros_driver::RosLink,
    ros_robot::RosRobot,
    ros_sensors::{self, NEWEST, SensorTopics},
    watch::Topic,
};

/// A node that subscribes to a robot's topics and publishes velocities to it.
#[derive(Debug)]
pub struct Ros1Link {
    odometry: Heard<Subscriber<Odometry>>,
    scans: Heard<Subscriber<LaserScan>>,
    poses: Heard<Subscriber<PoseWithCovarianceStamped>>,
    frames: Heard<Subscriber<TFMessage>>,
    velocities: Publisher<Twist>,
    sensors: SensorTopics,
    /// Keeps publishers and subscribers alive.
    _node: Node,
}

impl Ros1Link {
    /// Starts a node with the robot's topics.
    ///
    /// # Errors
    /// [`NodeError`] if a name is invalid, or the master cannot be reached.
    pub fn connect(config: NodeConfig, topics: &RosTopics) -> Result<Self, NodeError> {
        let node = Node::new(config)?;
        let queue = SubscribeOptions { queue: QUEUE };
        Ok(Self {
            odometry: Heard::new(node.subscribe(&topics.odom, queue)?, Topic::Odometry),
            scans: Heard::new(node.subscribe(&topics.scan, queue)?, Topic::Scan),
            poses: Heard::new(node.subscribe(&topics.amcl_pose, queue)?, Topic::Localization),
            frames: Heard::new(node.subscribe(&topics.tf, queue)?, Topic::Frames),
            velocities: node.publish(&topics.cmd_vel, PublishOptions::default())?,
            sensors: sensors(&node, topics)?,
            _node: node,
        })
    }
}

/// Subscribes to the topics of sensors.
fn sensors(node: &Node, topics: &RosTopics) -> Result<SensorTopics, NodeError> {
    let newest = SubscribeOptions { queue: NEWEST };
    let mut sensors = SensorTopics::default();
    for (sensor, topic) in &topics.sensors {
        let name = &topic.name;
        match topic.message {
            SensorMessage::BatteryState => {
                let states = node.subscribe::<BatteryState>(name, newest)?;
                sensors.numbers(sensor, states, |message| ros_sensors::battery(&message));
            }
            SensorMessage::Imu => {
                let measured = node.subscribe::<Imu>(name, newest)?;
                sensors.numbers(sensor, measured, |message| ros_sensors::imu(&message));
            }
            SensorMessage::Float64MultiArray => {
                let array = node.subscribe::<Float64MultiArray>(name, newest)?;
                sensors.numbers(sensor, array, |message| message.data);
            }
            SensorMessage::Image => {
                sensors.images(sensor, node.subscribe(name, newest)?, picture::image)?;
            }
            SensorMessage::CompressedImage => {
                let files = node.subscribe::<CompressedImage>(name, newest)?;
                sensors.images(sensor, files, |message| picture::file(message.data, &message.format))?;
            }
        }
    }
    Ok(sensors)
}

impl RosLink for Ros1Link {
    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot) {
        // Odometry first, because frames and poses refer to its frame.
        self.odometry.hear(now, robot, |robot, message| robot.odometry(now, &message));
        self.frames.hear(now, robot, |robot, message| robot.frames(now, &message));
        self.poses.hear(now, robot, |robot, message| robot.localized(now, &message));
        self.sensors.hear(now, robot);
        self.scans.hear(now, robot, |robot, message| robot.scanned(now, message));
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

    fn wait(&self) -> Option<M> {
        self.recv()
    }

    fn dropped(&self) -> u64 {
        self.dropped()
    }

    fn malformed(&self) -> u64 {
        self.malformed()
    }
}
