//! Large data that sensors measure, such as scans and images: a reading's event tells of it, and its bytes go apart.

use std::sync::Arc;

use cotorra_graph::{DataFormat, LargeData, NodeId, SensorId, Timestamp};
use cotorra_ros_messages::Message;

use crate::{camera::View, lidar::Scan, ros};

/// What large data consists of, before it is written as bytes.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// A turn of a lidar.
    Scan(Arc<Scan>),
    /// Bytes as they are stored.
    Bytes(Arc<[u8]>),
    /// What a simulated camera sees.
    View(Arc<View>),
}

impl Content {
    /// How many bytes [`Self::bytes`] gives, which is known without making them.
    pub fn size(&self) -> u64 {
        match self {
            Self::Scan(scan) => scan_size(scan.ranges.len()) as u64,
            Self::Bytes(bytes) => bytes.len() as u64,
            Self::View(view) => view.len() as u64,
        }
    }

    /// The bytes as they are stored. This may take a while: it is not for the thread that drives robots.
    pub fn bytes(&self) -> Arc<[u8]> {
        match self {
            Self::Scan(scan) => {
                let mut bytes = Vec::with_capacity(scan_size(scan.ranges.len()));
                ros::laser_scan(scan).encode_cdr(&mut bytes);
                bytes.into()
            }
            Self::Bytes(bytes) => Arc::clone(bytes),
            Self::View(view) => view.bytes(),
        }
    }
}

/// Bytes of a `sensor_msgs/LaserScan` with so many ranges, in the frame of the lidar.
const fn scan_size(rays: usize) -> usize {
    const ENCAPSULATION: usize = 4;
    const STAMP: usize = 8;
    const FRAME: usize = (4 + ros::LASER_FRAME.len() + 1).next_multiple_of(4);
    const FIGURES: usize = 7 * 4;
    const LENGTHS: usize = 2 * 4;
    ENCAPSULATION + STAMP + FRAME + FIGURES + LENGTHS + 4 * rays
}

/// Large data that a driver gives for a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// When it was measured.
    pub measured: Timestamp,
    /// How its bytes are written.
    pub format: DataFormat,
    /// Columns of an image, rays of a scan.
    pub width: u32,
    /// Rows of an image; 1 of a scan.
    pub height: u32,
    /// What it is.
    pub content: Content,
}

impl From<&Scan> for Captured {
    fn from(scan: &Scan) -> Self {
        Self {
            measured: scan.at,
            format: DataFormat::Scan,
            width: u32::try_from(scan.ranges.len()).unwrap_or(u32::MAX),
            height: 1,
            content: Content::Scan(Arc::new(scan.clone())),
        }
    }
}

/// Large data that a sensor of a robot measured.
#[derive(Debug, Clone, PartialEq)]
pub struct SensedData {
    /// The robot.
    pub robot: NodeId,
    /// Its sensor.
    pub sensor: SensorId,
    /// When it was measured.
    pub measured: Timestamp,
    /// When it was read.
    pub at: Timestamp,
    /// What its event says of it.
    pub data: LargeData,
    /// What it is.
    pub content: Content,
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_scan_is_a_laser_scan_of_the_size_that_was_told() {
        for rays in [0, 1, 7, 360] {
            let scan = Scan {
                at: Timestamp::from_nanos(5),
                first_angle: -1.0,
                angle_step: 0.5,
                ray_interval: Duration::from_millis(1),
                turn: Duration::from_millis(100),
                range_min: 0.15,
                range_max: 12.0,
                ranges: vec![2.5; rays],
            };
            let captured = Captured::from(&scan);
            let bytes = captured.content.bytes();
            assert_eq!(captured.content.size(), bytes.len() as u64);
            let message = cotorra_ros_messages::LaserScan::decode_cdr(&bytes).unwrap();
            assert_eq!(message, ros::laser_scan(&scan));
        }
    }
}
