//! The brain's topics in ROS 2, over DDS.

use cotorra_graph::{NodeId, Ros2, ros_node_name};
use cotorra_ros_messages::{Header, PoseWithCovarianceStamped, Twist, UInt32};
use cotorra_ros2::{Command, Middleware, Node, NodeConfig, Publisher, Qos, Subscriber};

use crate::{
    error::RosBrainError,
    follow::{NEXT_WAYPOINT, Topics},
};

/// Of poses, only the newest counts; what is lost on the way is old when it comes again.
const NEWEST: Qos = Qos { depth: 1, ..Qos::SENSORS };

/// A node with the brain's topics.
struct Ros2Topics {
    poses: Subscriber<PoseWithCovarianceStamped>,
    commands: Publisher<Command>,
    reports: Publisher<UInt32>,
    reported: Subscriber<UInt32>,
    /// Keeps publishers and subscribers alive.
    _node: Node,
}

/// Starts a node with the brain's topics.
pub(crate) fn connect(robot: &NodeId, ros2: &Ros2) -> Result<impl Topics + use<>, RosBrainError> {
    let node = Node::new(config(robot, ros2)?)?;
    Ok(Ros2Topics {
        poses: node.subscribe(&ros2.topics.amcl_pose, NEWEST)?,
        commands: node.publish(&ros2.topics.cmd_vel, Qos { depth: 1, ..Qos::COMMANDS })?,
        reports: node.publish(NEXT_WAYPOINT, Qos::LATCHED)?,
        reported: node.subscribe(NEXT_WAYPOINT, Qos::LATCHED)?,
        _node: node,
    })
}

/// Returns the node's configuration. The interface in the testbed file is the robot's, and that of the environment is this
/// machine's; the brain uses those of its own node.
fn config(robot: &NodeId, ros2: &Ros2) -> Result<NodeConfig, RosBrainError> {
    let name = ros_node_name(robot, "brain");
    let usual = match ros2.domain {
        Some(domain) => NodeConfig { domain, ..NodeConfig::new(&name) },
        None => NodeConfig::from_env(&name)?,
    };
    let middleware = Middleware::Dds { interface: None };
    Ok(NodeConfig { namespace: ros2.namespace.clone(), middleware, ..usual })
}

impl Topics for Ros2Topics {
    fn pose(&self) -> Option<PoseWithCovarianceStamped> {
        self.poses.recv()
    }

    fn reported(&self) -> Option<u32> {
        self.reported.try_recv().map(|number| number.data)
    }

    fn command(&self, header: Header, twist: Twist) {
        self.commands.publish(&Command { header, twist });
    }

    fn report(&self, waypoint: u32) {
        self.reports.publish(&UInt32 { data: waypoint });
    }
}
