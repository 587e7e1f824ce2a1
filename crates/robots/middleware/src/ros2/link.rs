//! Link to a robot in ROS 2: a node with its topics.

use cotorra_graph::{RosTopics, SensorMessage, Timestamp, Velocity};
use cotorra_plugin::convert::{to_header, to_twist};
use cotorra_ros2::{
    Carried, Command, Node, NodeConfig, NodeError, Publisher, Qos, Subscriber,
    messages::{
        BatteryState, CompressedImage, Float64MultiArray, Image, Imu, LaserScan, Odometry,
        PoseWithCovarianceStamped, TFMessage,
    },
};

use crate::{
    heard::{Heard, QUEUE, Source},
    picture,
    ros::BASE_FRAME,
    ros_driver::RosLink,
    ros_robot::RosRobot,
    ros_sensors::{self, NEWEST, SensorTopics},
    watch::Topic,
};

/// QoS of frequent topics, for publishers of any reliability.
const OFTEN: Qos = Qos { depth: QUEUE, ..Qos::SENSORS };
/// QoS of rare topics such as localization: lost messages are sent again.
const SELDOM: Qos = Qos { depth: QUEUE, ..Qos::COMMANDS };

/// QoS of a declared sensor.
const SENSOR: Qos = Qos { depth: NEWEST, ..Qos::SENSORS };

/// A node that subscribes to a robot's topics and publishes velocities to it.
#[derive(Debug)]
pub struct Ros2Link {
    odometry: Heard<Subscriber<Odometry>>,
    scans: Heard<Subscriber<LaserScan>>,
    poses: Heard<Subscriber<PoseWithCovarianceStamped>>,
    frames: Heard<Subscriber<TFMessage>>,
    velocities: Publisher<Command>,
    /// Start of the run, since 1970.
    epoch: Timestamp,
    now: Timestamp,
    sensors: SensorTopics,
    /// Keeps publishers and subscribers alive.
    _node: Node,
}

impl Ros2Link {
    /// Starts a node with the robot's topics. Stamps count from 1970; `epoch` is the start of the run.
    ///
    /// # Errors
    /// [`NodeError`] if a name is invalid, or DDS reports an error.
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
            sensors: sensors(&node, topics)?,
            _node: node,
        })
    }
}

/// Subscribes to the topics of sensors.
fn sensors(node: &Node, topics: &RosTopics) -> Result<SensorTopics, NodeError> {
    let mut sensors = SensorTopics::default();
    for (sensor, topic) in &topics.sensors {
        let name = &topic.name;
        match topic.message {
            SensorMessage::BatteryState => {
                let states = node.subscribe::<BatteryState>(name, SENSOR)?;
                sensors.numbers(sensor, states, |message| ros_sensors::battery(&message));
            }
            SensorMessage::Imu => {
                let measured = node.subscribe::<Imu>(name, SENSOR)?;
                sensors.numbers(sensor, measured, |message| ros_sensors::imu(&message));
            }
            SensorMessage::Float64MultiArray => {
                let arrays = node.subscribe::<Float64MultiArray>(name, SENSOR)?;
                sensors.numbers(sensor, arrays, |message| message.data);
            }
            SensorMessage::Image => {
                sensors.images(sensor, node.subscribe::<Image>(name, SENSOR)?, picture::image)?;
            }
            SensorMessage::CompressedImage => {
                let files = node.subscribe::<CompressedImage>(name, SENSOR)?;
                sensors.images(sensor, files, |message| picture::file(message.data, &message.format))?;
            }
        }
    }
    Ok(sensors)
}

impl RosLink for Ros2Link {
    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot) {
        self.now = now;
        // Odometry first, because frames and poses refer to its frame.
        self.odometry.hear(now, robot, |robot, message| robot.odometry(now, &message));
        self.frames.hear(now, robot, |robot, message| robot.frames(now, &message));
        self.poses.hear(now, robot, |robot, message| robot.localized(now, &message));
        self.sensors.hear(now, robot);
        self.scans.hear(now, robot, |robot, message| robot.scanned(now, message));
    }

    fn say(&mut self, velocity: Velocity) {
        let header = to_header(self.now + self.epoch.since(Timestamp::ZERO), BASE_FRAME);
        self.velocities.publish(&Command { header, twist: to_twist(velocity) });
    }
}

impl<M: Carried> Source for Subscriber<M> {
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
