//! Large data of sensors, such as scans and images. A reading's event describes it; its bytes travel separately.

use std::sync::Arc;

use cotorra_graph::{DataFormat, LargeData, NodeId, SensorId, Timestamp};
use cotorra_ros_messages::Message;

use crate::{camera::View, lidar::Scan, ros};

/// Content of large data, before it is encoded.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// A turn of a lidar.
    Scan(Arc<Scan>),
    /// Encoded bytes.
    Bytes(Arc<[u8]>),
    /// The view of a simulated camera.
    View(Arc<View>),
}

impl Content {
    /// Returns the size of [`Self::bytes`] without encoding.
    pub fn size(&self) -> u64 {
        match self {
            Self::Scan(scan) => scan_size(scan.ranges.len()) as u64,
            Self::Bytes(bytes) => bytes.len() as u64,
            Self::View(view) => view.len() as u64,
        }
    }

    /// Returns the encoded bytes. This may take a while: do not call it on the thread that drives robots.
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

/// Returns the size of a `sensor_msgs/LaserScan` in the lidar's frame, bytes.
const fn scan_size(rays: usize) -> usize {
    const ENCAPSULATION: usize = 4;
    const STAMP: usize = 8;
    const FRAME: usize = (4 + ros::LASER_FRAME.len() + 1).next_multiple_of(4);
    const FIGURES: usize = 7 * 4;
    const LENGTHS: usize = 2 * 4;
    ENCAPSULATION + STAMP + FRAME + FIGURES + LENGTHS + 4 * rays
}

/// Large data that a driver read from a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// Time of measurement.
    pub measured: Timestamp,
    /// Encoding of the bytes.
    pub format: DataFormat,
    /// Columns of an image, rays of a scan.
    pub width: u32,
    /// Rows of an image; 1 of a scan.
    pub height: u32,
    /// The data itself.
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

/// Large data with its robot and sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct SensedData {
    /// The robot.
    pub robot: NodeId,
    /// Its sensor.
    pub sensor: SensorId,
    /// Time of measurement.
    pub measured: Timestamp,
    /// Time of reading.
    pub at: Timestamp,
    /// Its description in the event.
    pub data: LargeData,
    /// The data itself.
    pub content: Content,
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn scan_is_encoded_as_a_laser_scan_of_the_announced_size() {
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
