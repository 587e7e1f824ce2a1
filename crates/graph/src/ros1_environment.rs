//! Environment of ROS 1 programs in hosts.

use crate::{
    driver::{Driver, Offer, Ros, RosMaster},
    hardware::HardwareGraph,
    id::NodeId,
};

impl HardwareGraph {
    /// Returns the environment variables by which ROS 1 programs on a host find each other: `ROS_IP`, and `ROS_MASTER_URI`
    /// of the first master in the emulated network. Empty without such a master.
    pub fn ros1_environment(&self, host: &NodeId) -> Vec<(&'static str, String)> {
        let address = |node: &NodeId| self.ipv4(node).map(|address| address.to_string());
        let master = self.robots().find_map(|(_, robot)| {
            let (Driver::Ros1(ros1) | Driver::Simulated { offer: Some(Offer { ros: Ros::Ros1(ros1), .. }) }) =
                &robot.driver
            else {
                return None;
            };
            match &ros1.master {
                RosMaster::Machine { .. } => None,
                RosMaster::Testbed { uri } => Some(uri.clone()),
                RosMaster::Node { node } => Some(format!("http://{}:{}", address(node)?, RosMaster::PORT)),
            }
        });
        let Some((master, host)) = master.zip(address(host)) else { return Vec::new() };
        vec![("ROS_MASTER_URI", master), ("ROS_IP", host)]
    }
}
