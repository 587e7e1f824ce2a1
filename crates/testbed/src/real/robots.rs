//! Drivers of robots in real time: simulated, at serial ports, or over ROS in the network that the testbed file names. ROS
//! masters run in their nodes.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_datapath::Datapath;
use cotorra_graph::{
    AgentId, Driver, Kobuki, Node, NodeId, NodeKind, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork,
    Testbed, Timestamp, ros_node_name,
};
use cotorra_robot_middleware::{
    Clock, OfferedRobot, OfferedTime, RobotDriver, Ros1Link, Ros1Offer, Ros2Link, Ros2Offer, RosDriver,
    RosRobot, SimulatedRobot, SimulationError, TurtlebotDriver,
};
use cotorra_ros1::{ConfigError, Endpoint, MasterServer, NodeConfig};
use cotorra_ros2::{self as ros2, Middleware};
use cotorra_turtlebot::{Body, PortError, Turtlebot};

/// The reason for which a robot cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The robot cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The address of its ROS 1 master is invalid.
    #[error("robot `{robot}`: {reason}")]
    Master {
        /// The robot.
        robot: NodeId,
        /// The cause.
        reason: ConfigError,
    },
    /// The ROS 2 settings of the environment are invalid.
    #[error("robot `{robot}`: {reason}")]
    Domain {
        /// The robot.
        robot: NodeId,
        /// The cause.
        reason: ros2::ConfigError,
    },
    /// A master cannot listen, or there is no thread.
    #[error("robot `{robot}`: {source}")]
    System {
        /// The robot.
        robot: NodeId,
        /// The system's error.
        source: std::io::Error,
    },
    /// The robot uses Zenoh, which is left out of this build.
    #[error(
        "robot `{0}` speaks Zenoh, and this cotorra was built without: build it with `--features zenoh`, or leave out \
         `rmw: zenoh`"
    )]
    WithoutZenoh(NodeId),
    /// The robot uses ROS, which does not work in virtual time.
    #[error(
        "robot `{0}` speaks ROS, which goes by the clock on the wall: run without `--simulate`, or simulate it all by \
         `--set nodes.{0}.driver=simulated` and without an `offer`"
    )]
    VirtualTime(NodeId),
    /// The robot is a real one at serial ports, which does not work in virtual time.
    #[error(
        "robot `{0}` is a real one, which goes by the clock on the wall: run without `--simulate`, or simulate it by \
         `--set nodes.{0}.driver=simulated`"
    )]
    RealInVirtualTime(NodeId),
    /// A serial port of the robot cannot be used.
    #[error("robot `{robot}`: {source}")]
    Port {
        /// The robot.
        robot: NodeId,
        /// The cause.
        source: PortError,
    },
    /// The agent of the robot cannot connect.
    #[error("robot `{robot}` is at agent `{agent}`, which cannot connect to this run")]
    NoAgent {
        /// The robot.
        robot: NodeId,
        /// Its agent.
        agent: AgentId,
    },
}

/// Robots whose serial ports are at agents.
pub(crate) type AtAgents = BTreeMap<NodeId, Box<dyn Body>>;

/// Returns the driver of a robot in virtual time.
pub(crate) fn simulated(node: &Node, robot: SimulatedRobot) -> Result<Box<dyn RobotDriver>, RobotError> {
    match driver(node) {
        Driver::Simulated { offer: None } => Ok(Box::new(robot)),
        Driver::Simulated { offer: Some(_) } | Driver::Ros1(_) | Driver::Ros2(_) => {
            Err(RobotError::VirtualTime(node.id.clone()))
        }
        Driver::Kobuki(_) => Err(RobotError::RealInVirtualTime(node.id.clone())),
    }
}

fn driver(node: &Node) -> Driver {
    match &node.kind {
        NodeKind::Robot(robot) => robot.driver.clone(),
        NodeKind::RadioUnit(_)
        | NodeKind::Switch
        | NodeKind::Server(_)
        | NodeKind::Gateway(_)
        | NodeKind::Machine(_) => Driver::default(),
    }
}

/// A ROS master in a node. It is stopped in the node's network namespace, where its thread runs.
struct NodeMaster {
    server: Option<MasterServer>,
    node: NodeId,
    datapath: Arc<Datapath>,
}

impl Drop for NodeMaster {
    fn drop(&mut self) {
        let server = self.server.take();
        if let Ok(namespace) = self.datapath.namespace(&self.node) {
            namespace.run(|| drop(server));
        }
    }
}

/// Makes the drivers of a run's robots in real time.
pub(crate) struct Robots {
    testbed: Arc<Testbed>,
    datapath: Arc<Datapath>,
    clock: Clock,
    /// Start of the run, since 1970.
    epoch: Timestamp,
    masters: BTreeMap<NodeId, NodeMaster>,
    at_agents: AtAgents,
}

/// Keeps the ROS masters running while it exists.
pub(crate) struct Masters {
    _masters: BTreeMap<NodeId, NodeMaster>,
}

impl Robots {
    pub fn new(testbed: Arc<Testbed>, datapath: Arc<Datapath>, clock: Clock, at_agents: AtAgents) -> Self {
        let epoch = since_1970().saturating_sub(clock().since(Timestamp::ZERO));
        Self { testbed, datapath, clock, epoch: Timestamp::ZERO + epoch, masters: BTreeMap::new(), at_agents }
    }

    /// Returns the masters, which must outlive the robots.
    pub fn masters(self) -> Masters {
        Masters { _masters: self.masters }
    }

    /// Creates the driver of a robot.
    pub fn drive(&mut self, node: &Node, robot: SimulatedRobot) -> Result<Box<dyn RobotDriver>, RobotError> {
        let system = |source| RobotError::System { robot: node.id.clone(), source };
        let clock = Arc::clone(&self.clock);
        match driver(node) {
            Driver::Simulated { offer: None } => Ok(Box::new(robot)),
            Driver::Simulated { offer: Some(Offer { ros: Ros::Ros1(ros1), clock: tells }) } => {
                let config = self.config(node, &ros1, "offer")?;
                let (testbed, time) = (Arc::clone(&self.testbed), self.time(tells));
                let topics = ros1.topics;
                let connect = move || Ros1Offer::connect(config.clone(), &topics, testbed.map.as_ref(), time);
                let start = || OfferedRobot::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, ros1.master.network(), start).map_err(system)?))
            }
            Driver::Simulated { offer: Some(Offer { ros: Ros::Ros2(ros2), clock: tells }) } => {
                let config = ros2_config(&node.id, &ros2, "offer")?;
                let (testbed, time) = (Arc::clone(&self.testbed), self.time(tells));
                let (topics, network) = (ros2.topics, ros2.rmw.network());
                let connect = move || Ros2Offer::connect(config.clone(), &topics, testbed.map.as_ref(), time);
                let start = || OfferedRobot::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, network, start).map_err(system)?))
            }
            Driver::Ros1(ros1) => {
                let config = self.config(node, &ros1, "driver")?;
                let topics = ros1.topics;
                let connect = move || Ros1Link::connect(config.clone(), &topics);
                let robot = self.ros_robot(node, &robot);
                let start = || RosDriver::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, ros1.master.network(), start).map_err(system)?))
            }
            Driver::Ros2(ros2) => {
                let config = ros2_config(&node.id, &ros2, "driver")?;
                let (topics, network, epoch) = (ros2.topics, ros2.rmw.network(), self.epoch);
                let connect = move || Ros2Link::connect(config.clone(), &topics, epoch);
                let robot = self.ros_robot(node, &robot);
                let start = || RosDriver::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, network, start).map_err(system)?))
            }
            Driver::Kobuki(kobuki) => Ok(Box::new(self.turtlebot(node, &robot, &kobuki)?)),
        }
    }

    /// Drives a TurtleBot 2, which has the start of a simulated one.
    fn turtlebot(
        &mut self,
        node: &Node,
        simulated: &SimulatedRobot,
        kobuki: &Kobuki,
    ) -> Result<TurtlebotDriver, RobotError> {
        let (pose, walk) = (simulated.pose(), self.testbed.walk(&node.id));
        let (id, start, heading) = (node.id.clone(), pose.position(), pose.heading);
        let driver = match (&kobuki.agent, self.at_agents.remove(&node.id)) {
            (Some(_), Some(body)) => TurtlebotDriver::new(id, start, heading, walk, body),
            (Some(agent), None) => {
                return Err(RobotError::NoAgent { robot: node.id.clone(), agent: agent.clone() });
            }
            (None, _) => {
                let opened = Turtlebot::open(node.id.as_str(), kobuki, &self.clock);
                let body = opened.map_err(|source| RobotError::Port { robot: node.id.clone(), source })?;
                TurtlebotDriver::new(id, start, heading, walk, Box::new(body))
            }
        };
        Ok(match &kobuki.lidar {
            Some(lidar) => driver.with_lidar(lidar.position, lidar.heading),
            None => driver,
        })
    }

    /// Returns the time base of an offered robot's stamps.
    fn time(&self, is_testbed_time: bool) -> OfferedTime {
        if is_testbed_time { OfferedTime::Testbed } else { OfferedTime::Day { epoch: self.epoch } }
    }

    /// Creates a robot in ROS with the start of a simulated one.
    fn ros_robot(&self, node: &Node, simulated: &SimulatedRobot) -> RosRobot {
        let pose = simulated.pose();
        let walk = self.testbed.walk(&node.id);
        RosRobot::new(node.id.clone(), simulated.model(), pose.position(), pose.heading, walk)
    }

    /// Runs `start` in the network in which the robot uses ROS.
    fn inside<R: Send>(&self, node: &Node, network: RosNetwork, start: impl FnOnce() -> R + Send) -> R {
        match (network, self.datapath.namespace(&node.id)) {
            (RosNetwork::Testbed, Ok(namespace)) => namespace.run(start),
            _ => start(),
        }
    }

    /// Returns the configuration of a robot's ROS 1 node. Starts its master, if cotorra is to run it.
    fn config(&mut self, node: &Node, ros1: &Ros1, what: &str) -> Result<NodeConfig, RobotError> {
        let robot = &node.id;
        let wrong = |reason: ConfigError| RobotError::Master { robot: robot.clone(), reason };
        let name = ros_node_name(robot, what);
        let namespace = ros1.namespace.clone();
        let address = |node: &NodeId| self.testbed.graph.ipv4(node).map(|address| address.to_string());
        let parse = |uri: &str| uri.parse::<Endpoint>().map_err(|error| wrong(error.into()));
        let (master, host) = match &ros1.master {
            RosMaster::Machine { uri } => {
                let mut config = NodeConfig::from_env(&name).map_err(wrong)?;
                if let Some(uri) = uri {
                    config.master = parse(uri)?;
                }
                return Ok(NodeConfig { namespace, ..config });
            }
            RosMaster::Testbed { uri } => {
                let mut master = parse(uri)?;
                let named = NodeId::new(&master.host).ok().and_then(|node| address(&node));
                master.host = named.unwrap_or(master.host);
                (master, address(robot))
            }
            RosMaster::Node { node } => {
                let host = address(node).unwrap_or_default();
                let its = address(robot);
                self.run_master(node, &host)
                    .map_err(|source| RobotError::System { robot: robot.clone(), source })?;
                (Endpoint { host, port: RosMaster::PORT }, its)
            }
        };
        Ok(NodeConfig { namespace, master, host, ..NodeConfig::new(&name) })
    }

    /// Starts a master in a node, unless one runs there.
    fn run_master(&mut self, node: &NodeId, host: &str) -> std::io::Result<()> {
        if self.masters.contains_key(node) {
            return Ok(());
        }
        let namespace = self.datapath.namespace(node).map_err(std::io::Error::other)?;
        let server = Some(namespace.run(|| MasterServer::start(host, RosMaster::PORT))?);
        let master = NodeMaster { server, node: node.clone(), datapath: Arc::clone(&self.datapath) };
        self.masters.insert(node.clone(), master);
        Ok(())
    }
}

/// Returns the configuration of a robot's ROS 2 node.
fn ros2_config(robot: &NodeId, settings: &Ros2, what: &str) -> Result<ros2::NodeConfig, RobotError> {
    let name = ros_node_name(robot, what);
    let usual = match settings.domain {
        // The environment is ignored then.
        Some(domain) => ros2::NodeConfig { domain, ..ros2::NodeConfig::new(&name) },
        None => ros2::NodeConfig::from_env(&name)
            .map_err(|reason| RobotError::Domain { robot: robot.clone(), reason })?,
    };
    let middleware = match (&settings.rmw, usual.middleware) {
        (Rmw::Zenoh { .. }, _) if !Middleware::HAS_ZENOH => {
            return Err(RobotError::WithoutZenoh(robot.clone()));
        }
        (Rmw::Zenoh { router }, _) => Middleware::Zenoh { router: router.clone() },
        // The environment's interface is valid on this machine only, not in the emulated network.
        (Rmw::Dds { interface: None, network: RosNetwork::Machine }, usual) => usual,
        (Rmw::Dds { interface, .. }, _) => Middleware::Dds { interface: *interface },
    };
    Ok(ros2::NodeConfig { namespace: settings.namespace.clone(), middleware, ..usual })
}

#[allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "stamps of ROS's messages count from 1970; the calendar is read once, when a run begins"
)]
fn since_1970() -> Duration {
    std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default()
}
