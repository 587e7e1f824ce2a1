//! The brain's topics in ROS 1.

use cotorra_graph::{NodeId, Ros1, Testbed, ros_node_name};
use cotorra_ros_messages::{Header, PoseWithCovarianceStamped, Twist, UInt32};
use cotorra_ros1::{Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions, Subscriber};

use crate::{
    error::RosBrainError,
    follow::{NEXT_WAYPOINT, Topics},
};

/// Of poses, only the newest counts.
const NEWEST: SubscribeOptions = SubscribeOptions { queue: 1 };

/// A node with the brain's topics.
struct Ros1Topics {
    poses: Subscriber<PoseWithCovarianceStamped>,
    commands: Publisher<Twist>,
    reports: Publisher<UInt32>,
    reported: Subscriber<UInt32>,
    /// Keeps publishers and subscribers alive.
    _node: Node,
}

/// Starts a node with the brain's topics.
pub(crate) fn connect(
    testbed: &Testbed,
    robot: &NodeId,
    ros1: &Ros1,
) -> Result<impl Topics + use<>, RosBrainError> {
    let node = Node::new(config(testbed, robot, ros1)?)?;
    let latched = PublishOptions { queue: 1, latch: true };
    Ok(Ros1Topics {
        poses: node.subscribe(&ros1.topics.amcl_pose, NEWEST)?,
        commands: node.publish(&ros1.topics.cmd_vel, PublishOptions { queue: 1, latch: false })?,
        reports: node.publish(NEXT_WAYPOINT, latched)?,
        reported: node.subscribe(NEXT_WAYPOINT, SubscribeOptions::default())?,
        _node: node,
    })
}

/// Returns the node's configuration. Its name has the address, because ROS 1 ends the elder of two nodes of one name, and
/// instances on other nodes are to go on.
fn config(testbed: &Testbed, robot: &NodeId, ros1: &Ros1) -> Result<NodeConfig, RosBrainError> {
    let mut config = NodeConfig::from_env(&ros_node_name(robot, "brain"))?;
    if let Some(master) = testbed.graph.ros1_master(ros1) {
        config.master = master.parse().map_err(cotorra_ros1::ConfigError::from)?;
    }
    if let Some(host) = &config.host {
        config.name += &format!("_{}", host.replace(|c: char| !c.is_ascii_alphanumeric(), "_"));
    }
    config.namespace.clone_from(&ros1.namespace);
    Ok(config)
}

impl Topics for Ros1Topics {
    fn pose(&self) -> Option<PoseWithCovarianceStamped> {
        self.poses.recv()
    }

    fn reported(&self) -> Option<u32> {
        self.reported.try_recv().map(|number| number.data)
    }

    fn command(&self, _header: Header, twist: Twist) {
        self.commands.publish(&twist);
    }

    fn report(&self, waypoint: u32) {
        self.reports.publish(&UInt32 { data: waypoint });
    }
}
