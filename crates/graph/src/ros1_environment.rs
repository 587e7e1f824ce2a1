//! ROS 1 in hosts: the masters, and the environment of programs.

use crate::{
    driver::{Ros, Ros1, RosMaster},
    hardware::HardwareGraph,
    id::NodeId,
};

impl HardwareGraph {
    /// Returns the address of a robot's master in the emulated network; `None` if it is in the machine's.
    pub fn ros1_master(&self, ros1: &Ros1) -> Option<String> {
        match &ros1.master {
            RosMaster::Machine { .. } => None,
            RosMaster::Testbed { uri } => Some(uri.clone()),
            RosMaster::Node { node } => Some(format!("http://{}:{}", self.ipv4(node)?, RosMaster::PORT)),
        }
    }

    /// Returns the environment variables by which ROS 1 programs on a host find each other: `ROS_IP`, and `ROS_MASTER_URI`
    /// of the first master in the emulated network. Empty without such a master.
    pub fn ros1_environment(&self, host: &NodeId) -> Vec<(&'static str, String)> {
        let master = self.robots().find_map(|(_, robot)| match robot.driver.ros()? {
            Ros::Ros1(ros1) => self.ros1_master(&ros1),
            Ros::Ros2(_) => None,
        });
        let Some((master, host)) = master.zip(self.ipv4(host)) else { return Vec::new() };
        vec![("ROS_MASTER_URI", master), ("ROS_IP", host.to_string())]
    }
}
