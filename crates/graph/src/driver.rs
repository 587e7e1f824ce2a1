//! Drivers of robots: the simulation, a robot reached over ROS, or a TurtleBot 2 at serial ports. Also how a simulated
//! robot is offered to ROS programs.

use std::{collections::BTreeMap, net::IpAddr, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    flow::FlowProtocol,
    id::{AgentId, NodeId, SensorId},
    units::Position,
};

/// Driver of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Driver {
    /// Simulated by cotorra.
    Simulated {
        /// ROS interface by which other programs reach it.
        offer: Option<Offer>,
    },
    /// Robot that speaks ROS 1.
    Ros1(Box<Ros1>),
    /// Robot that speaks ROS 2.
    Ros2(Box<Ros2>),
    /// TurtleBot 2 at serial ports: of this machine, or of an agent's.
    Kobuki(Box<Kobuki>),
}

impl Driver {
    /// The agent at which its serial ports are, if they are at one.
    pub fn agent(&self) -> Option<&AgentId> {
        match self {
            Self::Kobuki(kobuki) => kobuki.agent.as_ref(),
            Self::Simulated { .. } | Self::Ros1(_) | Self::Ros2(_) => None,
        }
    }

    /// Returns the robot's address in ROS, if it has one.
    pub fn ros(&self) -> Option<Ros> {
        match self {
            Self::Ros1(ros1) => Some(Ros::Ros1(ros1.clone())),
            Self::Ros2(ros2) => Some(Ros::Ros2(ros2.clone())),
            Self::Simulated { offer } => offer.as_ref().map(|offer| offer.ros.clone()),
            Self::Kobuki(_) => None,
        }
    }
}

impl Default for Driver {
    /// Simulated, by this testbed alone.
    fn default() -> Self {
        Self::Simulated { offer: None }
    }
}

/// Serial ports of a TurtleBot 2.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Kobuki {
    /// Device file of its Kobuki base.
    #[schema(value_type = String)]
    pub port: PathBuf,
    /// Its lidar, if it has one.
    pub lidar: Option<Rplidar>,
    /// The agent on whose machine the ports are. Without one: they are this machine's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<AgentId>,
}

/// Serial port of an RPLIDAR A2, and its pose on the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Rplidar {
    /// Device file.
    #[schema(value_type = String)]
    pub port: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Drive of its motor, 1 to 1023.
    pub motor_pwm: u16,
    /// Its position on the robot, metres from the middle between the wheels: forward, to the left, and up.
    pub position: Position,
    /// Direction of its front, radians counter-clockwise from the robot's.
    pub heading: f64,
}

/// ROS interface of a simulated robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Offer {
    /// As what, and where.
    pub ros: Ros,
    /// Whether it tells the testbed's time on `/clock`, and stamps what it says with that; else stamps are the time of
    /// day.
    pub clock: bool,
}

/// Address of a robot in ROS.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Ros {
    /// Address in ROS 1.
    Ros1(Box<Ros1>),
    /// Address in ROS 2.
    Ros2(Box<Ros2>),
}

impl Ros {
    /// Returns the network in which the robot is reached.
    pub fn network(&self) -> RosNetwork {
        match self {
            Self::Ros1(ros1) => ros1.master.network(),
            Self::Ros2(ros2) => ros2.rmw.network(),
        }
    }

    /// Returns the protocol of a flow from the robot's poses to its velocity commands. Commands repeat nothing of a pose.
    pub fn poses_to_commands(&self) -> FlowProtocol {
        match self {
            Self::Ros1(ros1) => FlowProtocol::Ros1 {
                request: ros1.resolved(&ros1.topics.amcl_pose),
                answer: ros1.resolved(&ros1.topics.cmd_vel),
                id: None,
            },
            Self::Ros2(ros2) => FlowProtocol::Ros2 {
                request: ros2.resolved(&ros2.topics.amcl_pose),
                answer: ros2.resolved(&ros2.topics.cmd_vel),
                id: None,
            },
        }
    }
}

/// Address of a robot in ROS 1.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Ros1 {
    /// Its master, and the network in which it is reached.
    pub master: RosMaster,
    /// The namespace in which its topics are.
    pub namespace: String,
    /// Its topics.
    pub topics: RosTopics,
}

impl Ros1 {
    /// The global name of a topic.
    pub fn resolved(&self, topic: &str) -> String {
        resolved(&self.namespace, topic)
    }
}

/// Address of a robot in ROS 2.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Ros2 {
    /// Its middleware.
    pub rmw: Rmw,
    /// ROS domain, 0 to 232. Without one, that of `ROS_DOMAIN_ID`, or 0.
    pub domain: Option<u16>,
    /// The namespace in which its topics are.
    pub namespace: String,
    /// Its topics.
    pub topics: RosTopics,
}

impl Ros2 {
    /// The global name of a topic.
    pub fn resolved(&self, topic: &str) -> String {
        resolved(&self.namespace, topic)
    }
}

/// ROS 2 middleware (RMW) of a robot.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Rmw {
    /// DDS.
    Dds {
        /// Network in which the robot is reached.
        network: RosNetwork,
        /// The address of the one network interface to use; without one, all of them.
        #[schema(value_type = Option<String>)]
        interface: Option<IpAddr>,
    },
    /// Zenoh, as `rmw_zenoh` has it, in the network of this machine.
    Zenoh {
        /// Zenoh's endpoint of the router, such as `tcp/192.168.0.20:7447`.
        router: String,
    },
}

impl Rmw {
    /// Returns the network in which the robot is reached.
    pub fn network(&self) -> RosNetwork {
        match self {
            Self::Dds { network, .. } => *network,
            Self::Zenoh { .. } => RosNetwork::Machine,
        }
    }
}

/// Network in which a robot speaks ROS 2.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum RosNetwork {
    /// The network of this machine.
    Machine,
    /// The emulated network. The robot's ROS node runs in the robot's own node.
    Testbed,
}

/// Returns the name of a ROS node of cotorra's for a robot. Names in ROS consist of letters, digits and underscores, in ROS 2
/// without two underscores in a row.
pub fn ros_node_name(robot: &NodeId, what: &str) -> String {
    let parts = robot.as_str().split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    parts.fold(format!("cotorra_{what}"), |name, part| name + "_" + part)
}

fn resolved(namespace: &str, topic: &str) -> String {
    let namespace = namespace.trim_end_matches('/');
    if topic.starts_with('/') { topic.to_owned() } else { format!("{namespace}/{topic}") }
}

/// Address of a ROS 1 master.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "network")]
pub enum RosMaster {
    /// Master in the network of this machine: at this address, or at that of `ROS_MASTER_URI`.
    Machine {
        /// Such as `http://localhost:11311`.
        uri: Option<String>,
    },
    /// Master in the emulated network, started by the user. The robot's ROS node runs in the robot's own node.
    Testbed {
        /// Such as `http://10.77.0.3:11311`; the host may be a node's name.
        uri: String,
    },
    /// Master in the emulated network, at port 11311 of this node, started by cotorra. The robot's ROS node runs in the
    /// robot's own node.
    Node {
        /// The node.
        node: NodeId,
    },
}

impl RosMaster {
    /// The port of a master that cotorra runs, which is that of every ROS 1 master.
    pub const PORT: u16 = 11311;

    /// Returns the network in which it is reached.
    pub fn network(&self) -> RosNetwork {
        match self {
            Self::Machine { .. } => RosNetwork::Machine,
            Self::Testbed { .. } | Self::Node { .. } => RosNetwork::Testbed,
        }
    }
}

/// Names of a robot's topics: global ones begin with `/`, others are in its namespace. The same for ROS 1 and 2.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RosTopics {
    /// `sensor_msgs/LaserScan`.
    pub scan: String,
    /// `nav_msgs/Odometry`.
    pub odom: String,
    /// `geometry_msgs/Twist`, to the robot.
    pub cmd_vel: String,
    /// `tf2_msgs/TFMessage`.
    pub tf: String,
    /// `geometry_msgs/PoseWithCovarianceStamped`.
    pub amcl_pose: String,
    /// `nav_msgs/OccupancyGrid`.
    pub map: String,
    /// Topics of declared sensors.
    #[schema(value_type = BTreeMap<String, SensorTopic>)]
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sensors: BTreeMap<SensorId, SensorTopic>,
}

/// The topic of a sensor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SensorTopic {
    /// Its name.
    pub name: String,
    /// Its message type.
    pub message: SensorMessage,
}

/// Message type of a sensor's topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SensorMessage {
    /// `sensor_msgs/BatteryState`.
    BatteryState,
    /// `sensor_msgs/CompressedImage`.
    CompressedImage,
    /// `std_msgs/Float64MultiArray`.
    Float64MultiArray,
    /// `sensor_msgs/Image`.
    Image,
    /// `sensor_msgs/Imu`.
    Imu,
}

impl Default for RosTopics {
    /// Those of a TurtleBot.
    fn default() -> Self {
        let [scan, odom, cmd_vel, tf, amcl_pose, map] =
            ["scan", "odom", "cmd_vel", "tf", "amcl_pose", "map"].map(str::to_owned);
        Self { scan, odom, cmd_vel, tf, amcl_pose, map, sensors: BTreeMap::new() }
    }
}
