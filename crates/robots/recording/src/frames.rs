//! Frames of robots in the tree of transforms. Each robot has frames of its own, named like its topics; all share the map.

use cotorra_graph::{SensorData, Timestamp};
use cotorra_robot_middleware::ros::{self, BASE_FRAME, MAP_FRAME};
use cotorra_ros_messages::TFMessage;

/// Frames of a robot.
#[derive(Debug, Clone)]
pub(crate) struct Frames(String);

impl Frames {
    /// The frames of the robot with the topic part `robot`.
    pub fn of(robot: &str) -> Self {
        Self(robot.to_owned())
    }

    /// Prefixes the name of a frame with the robot's.
    pub fn own(&self, frame: &mut String) {
        if frame != MAP_FRAME {
            *frame = self.named(frame);
        }
    }

    /// Returns the frame of the robot's base.
    pub fn base(&self) -> String {
        self.named(BASE_FRAME)
    }

    fn named(&self, frame: &str) -> String {
        format!("{}/{frame}", self.0)
    }

    /// Returns the transforms of the robot and its lidar.
    pub fn transforms(&self, at: Timestamp, sensors: &SensorData) -> TFMessage {
        let mut frames = ros::frames(at, sensors);
        for transform in &mut frames.transforms {
            self.own(&mut transform.header.frame_id);
            self.own(&mut transform.child_frame_id);
        }
        frames
    }
}
