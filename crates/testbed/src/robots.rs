//! Robots in real time: each is driven as the testbed file says, over ROS in the network that it says, and the masters
//! that it asks for run in their nodes.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_datapath::Datapath;
use cotorra_graph::{
    Driver, Node, NodeId, NodeKind, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork, Testbed, Timestamp,
};
use cotorra_robot_middleware::{
    Clock, OfferedRobot, OfferedTime, RobotDriver, Ros1Link, Ros1Offer, Ros2Link, Ros2Offer, RosDriver,
    RosRobot, SimulatedRobot, SimulationError,
};
use cotorra_ros1::{ConfigError, Endpoint, MasterServer, NodeConfig};
use cotorra_ros2::{self as ros2, Middleware};

/// Why a robot cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// It cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Where its master is.
    #[error("robot `{robot}`: {reason}")]
    Master {
        /// The robot.
        robot: NodeId,
        /// Why.
        reason: ConfigError,
    },
    /// Which is its domain.
    #[error("robot `{robot}`: {reason}")]
    Domain {
        /// The robot.
        robot: NodeId,
        /// Why.
        reason: ros2::ConfigError,
    },
    /// A master cannot listen, or there is no thread.
    #[error("robot `{robot}`: {source}")]
    System {
        /// The robot.
        robot: NodeId,
        /// What the system says.
        source: std::io::Error,
    },
    /// It speaks Zenoh, which is left out of this build.
    #[error(
        "robot `{0}` speaks Zenoh, and this cotorra was built without: build it with `--features zenoh`, or leave out \
         `rmw: zenoh`"
    )]
    WithoutZenoh(NodeId),
    /// Virtual time has no ROS.
    #[error(
        "robot `{0}` speaks ROS, which goes by the clock on the wall: run without `--simulate`, or simulate it all by \
         `--set nodes.{0}.driver=simulated` and without an `offer`"
    )]
    VirtualTime(NodeId),
}

/// What drives a robot in virtual time.
pub(crate) fn simulated(node: &Node, robot: SimulatedRobot) -> Result<Box<dyn RobotDriver>, RobotError> {
    match driver(node) {
        Driver::Simulated { offer: None } => Ok(Box::new(robot)),
        Driver::Simulated { offer: Some(_) } | Driver::Ros1(_) | Driver::Ros2(_) => {
            Err(RobotError::VirtualTime(node.id.clone()))
        }
    }
}

fn driver(node: &Node) -> Driver {
    match &node.kind {
        NodeKind::Robot(robot) => robot.driver.clone(),
        NodeKind::RadioUnit(_) | NodeKind::Switch | NodeKind::Server(_) | NodeKind::Machine(_) => {
            Driver::default()
        }
    }
}

/// A master in a node. It ends in the node's network, where its own thread is.
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

/// What drives the robots of a run, in real time.
pub(crate) struct Robots {
    testbed: Arc<Testbed>,
    datapath: Arc<Datapath>,
    clock: Clock,
    /// The beginning of the run, since 1970.
    epoch: Timestamp,
    masters: BTreeMap<NodeId, NodeMaster>,
}

/// Keeps the masters going as long as it lives.
pub(crate) struct Masters {
    _masters: BTreeMap<NodeId, NodeMaster>,
}

impl Robots {
    pub fn new(testbed: Arc<Testbed>, datapath: Arc<Datapath>, clock: Clock) -> Self {
        let epoch = since_1970().saturating_sub(clock().since(Timestamp::ZERO));
        Self { testbed, datapath, clock, epoch: Timestamp::ZERO + epoch, masters: BTreeMap::new() }
    }

    /// What is to outlive the robots.
    pub fn masters(self) -> Masters {
        Masters { _masters: self.masters }
    }

    /// What drives a robot.
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
                Ok(Box::new(self.inside(node, network(&ros1.master), start).map_err(system)?))
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
                let robot = self.out_there(node, &robot);
                let start = || RosDriver::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, network(&ros1.master), start).map_err(system)?))
            }
            Driver::Ros2(ros2) => {
                let config = ros2_config(&node.id, &ros2, "driver")?;
                let (topics, network, epoch) = (ros2.topics, ros2.rmw.network(), self.epoch);
                let connect = move || Ros2Link::connect(config.clone(), &topics, epoch);
                let robot = self.out_there(node, &robot);
                let start = || RosDriver::start(robot, clock, connect);
                Ok(Box::new(self.inside(node, network, start).map_err(system)?))
            }
        }
    }

    /// What the stamps of an offered robot count.
    fn time(&self, tells: bool) -> OfferedTime {
        if tells { OfferedTime::Testbed } else { OfferedTime::Day { epoch: self.epoch } }
    }

    /// A robot that begins where a simulated one would.
    fn out_there(&self, node: &Node, simulated: &SimulatedRobot) -> RosRobot {
        let pose = simulated.pose();
        let walk = self.testbed.walk(&node.id);
        RosRobot::new(node.id.clone(), simulated.model(), pose.position(), pose.heading, walk)
    }

    /// Starts something in the network in which the robot speaks ROS.
    fn inside<R: Send>(&self, node: &Node, network: RosNetwork, start: impl FnOnce() -> R + Send) -> R {
        match (network, self.datapath.namespace(&node.id)) {
            (RosNetwork::Testbed, Ok(namespace)) => namespace.run(start),
            _ => start(),
        }
    }

    /// Where a robot's ROS node is, its master running if cotorra is to run it.
    fn config(&mut self, node: &Node, ros1: &Ros1, what: &str) -> Result<NodeConfig, RobotError> {
        let robot = &node.id;
        let wrong = |reason: ConfigError| RobotError::Master { robot: robot.clone(), reason };
        let name = node_name(robot, what);
        let namespace = ros1.namespace.clone();
        let address =
            |node: &NodeId| self.testbed.graph.address(node).map(|address| address.ipv4.to_string());
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

    /// Runs a master in a node, if none runs there yet.
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

/// What cotorra's node for a robot is called: no two have one name, and names of ROS's are letters, digits and
/// underscores, in ROS 2 no two of these behind each other.
fn node_name(robot: &NodeId, what: &str) -> String {
    let parts = robot.as_str().split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    parts.fold(format!("cotorra_{what}"), |name, part| name + "_" + part)
}

/// In which network a master is reached.
fn network(master: &RosMaster) -> RosNetwork {
    match master {
        RosMaster::Machine { .. } => RosNetwork::Machine,
        RosMaster::Testbed { .. } | RosMaster::Node { .. } => RosNetwork::Testbed,
    }
}

/// Where a robot's ROS 2 node is.
fn ros2_config(robot: &NodeId, said: &Ros2, what: &str) -> Result<ros2::NodeConfig, RobotError> {
    let name = node_name(robot, what);
    let usual = match said.domain {
        // What the environment says of it is no matter then.
        Some(domain) => ros2::NodeConfig { domain, ..ros2::NodeConfig::new(&name) },
        None => ros2::NodeConfig::from_env(&name)
            .map_err(|reason| RobotError::Domain { robot: robot.clone(), reason })?,
    };
    let middleware = match (&said.rmw, usual.middleware) {
        (Rmw::Zenoh { .. }, _) if !Middleware::HAS_ZENOH => {
            return Err(RobotError::WithoutZenoh(robot.clone()));
        }
        (Rmw::Zenoh { router }, _) => Middleware::Zenoh { router: router.clone() },
        // Of this machine's interfaces, the emulated network has none.
        (Rmw::Dds { interface: None, network: RosNetwork::Machine }, usual) => usual,
        (Rmw::Dds { interface, .. }, _) => Middleware::Dds { interface: *interface },
    };
    Ok(ros2::NodeConfig { namespace: said.namespace.clone(), middleware, ..usual })
}

#[allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "stamps of ROS's messages count from 1970; the calendar is read once, when a run begins"
)]
fn since_1970() -> Duration {
    std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default()
}
