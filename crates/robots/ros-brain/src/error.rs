//! Reasons for which the brain does not run.

use cotorra_brain::NoWalk;
use cotorra_graph::NodeId;
use cotorra_vnfs::VnfError;

/// Error of the brain in ROS.
#[derive(Debug, thiserror::Error)]
pub enum RosBrainError {
    /// The VNF was started without its variables, or its testbed file cannot be read.
    #[error(transparent)]
    Vnf(#[from] VnfError),
    /// The robot has no walk.
    #[error(transparent)]
    NoWalk(#[from] NoWalk),
    /// The robot has no topics.
    #[error("robot `{0}` is not in ROS: add `offer: ros1` or `offer: ros2` to it")]
    NotInRos(NodeId),
    /// The environment or the robot's address of its master is invalid.
    #[error(transparent)]
    Ros1Config(#[from] cotorra_ros1::ConfigError),
    /// There is no ROS 1 node.
    #[error(transparent)]
    Ros1(#[from] cotorra_ros1::NodeError),
    /// The environment is invalid.
    #[error(transparent)]
    Ros2Config(#[from] cotorra_ros2::ConfigError),
    /// There is no ROS 2 node.
    #[error(transparent)]
    Ros2(#[from] cotorra_ros2::NodeError),
    /// Somebody ended the node, for example by `rosnode kill`.
    #[error("the ROS node was shut down")]
    ShutDown,
}
