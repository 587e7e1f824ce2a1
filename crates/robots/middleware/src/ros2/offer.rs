//! A simulated robot's topics in ROS 2: a node that publishes its sensors and takes velocities for it.

use cotorra_graph::{OccupancyGrid, RosTopics, SensorData, Timestamp, Velocity};
use cotorra_plugin::convert::{from_twist, to_time};
use cotorra_ros2::{
    Command, Node, NodeConfig, NodeError, Publisher, Qos, Subscriber,
    messages::{self, Clock, LaserScan, Odometry, PoseWithCovarianceStamped, TFMessage},
};

use crate::{
    lidar::Scan,
    ros,
    ros_offer::{CLOCK, OfferedTime, RosOffer},
};

/// A node with the topics of a TurtleBot, of localization and of a map server. Their poses and map are exact.
#[derive(Debug)]
pub struct Ros2Offer {
    time: OfferedTime,
    odometry: Publisher<Odometry>,
    scans: Publisher<LaserScan>,
    poses: Publisher<PoseWithCovarianceStamped>,
    frames: Publisher<TFMessage>,
    velocities: Subscriber<Command>,
    clock: Option<Publisher<Clock>>,
    /// Keeps the latched map available.
    _map: Option<Publisher<messages::OccupancyGrid>>,
    /// Keeps publishers and subscribers alive.
    _node: Node,
}

impl Ros2Offer {
    /// Starts a node with the robot's topics. Publishes the map, if there is one, and the testbed's time, if stamps count
    /// that.
    ///
    /// # Errors
    /// [`NodeError`] if a name is invalid, or DDS reports an error.
    pub fn connect(
        config: NodeConfig,
        topics: &RosTopics,
        map: Option<&OccupancyGrid>,
        time: OfferedTime,
    ) -> Result<Self, NodeError> {
        let node = Node::new(config)?;
        let map = map.map(|map| {
            let publisher = node.publish(&topics.map, Qos::LATCHED)?;
            publisher.publish(&ros::map(map));
            Ok::<_, NodeError>(publisher)
        });
        let last = Qos { depth: 1, ..Qos::COMMANDS };
        let clock = matches!(time, OfferedTime::Testbed).then(|| node.publish(CLOCK, last));
        Ok(Self {
            time,
            clock: clock.transpose()?,
            odometry: node.publish(&topics.odom, Qos::COMMANDS)?,
            scans: node.publish(&topics.scan, Qos::SENSORS)?,
            poses: node.publish(&topics.amcl_pose, Qos::LATCHED)?,
            frames: node.publish(&topics.tf, Qos::COMMANDS)?,
            velocities: node.subscribe(&topics.cmd_vel, Qos::COMMANDS)?,
            _map: map.transpose()?,
            _node: node,
        })
    }
}

impl RosOffer for Ros2Offer {
    fn asked(&mut self) -> Option<Velocity> {
        self.velocities.try_recv().map(|command| from_twist(&command.twist))
    }

    fn tell(&mut self, at: Timestamp, sensors: &SensorData, scan: Option<&Scan>) {
        let stamp = |at| self.time.stamp(at);
        if let Some(clock) = &self.clock {
            clock.publish(&Clock { clock: to_time(stamp(at)) });
        }
        self.odometry.publish(&ros::odometry(stamp(at), sensors));
        self.frames.publish(&ros::frames(stamp(at), sensors));
        if let Some(scan) = scan {
            self.poses.publish(&ros::localized(stamp(at), sensors));
            self.scans.publish(&ros::laser_scan(&Scan { at: stamp(scan.at), ..scan.clone() }));
        }
    }
}
