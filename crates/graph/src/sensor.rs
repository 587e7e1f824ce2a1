//! Sensors of a robot beside those of its base: their declarations and readings. All of them, and
//! the base's, are σ(r).

use std::{collections::BTreeMap, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{
    id::{ComponentId, NodeId, SensorId, VnfId},
    units::{Timestamp, millis},
};

/// A component of σ(r): a sensor that is read at a rate of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Sensor {
    /// Its name.
    #[serde(rename = "sensor")]
    pub id: SensorId,
    /// Time from one reading to the next.
    #[serde(rename = "interval_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub interval: Duration,
    /// Measured quantity.
    #[serde(flatten)]
    pub kind: SensorKind,
}

/// Measured quantity of a sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum SensorKind {
    /// Pose and velocity by the wheels, or by what takes their place.
    Odometry,
    /// The battery's charge and voltage.
    Battery {
        /// A simulated one's charge when the run begins, as a share.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        charge: Option<f64>,
    },
    /// Angular velocity and acceleration.
    Imu,
    /// Turns of the robot's lidar, each as large data.
    Lidar {
        /// Bytes of its readings that a run keeps: the oldest go first.
        keep_bytes: u64,
    },
    /// Images of a simulated camera, each as large data.
    Camera(Camera),
    /// Images of a camera in ROS, each as large data, as they come.
    Images {
        /// Bytes of them that a run keeps: the oldest go first.
        keep_bytes: u64,
    },
    /// Numbers that a plug-in or a program reports ([`crate::Instruction::Report`]), or the robot over ROS.
    Vector {
        /// Number of components.
        size: u8,
        /// Their unit, in the user's words.
        unit: String,
    },
}

/// A camera, which looks ahead.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Camera {
    /// Columns of an image.
    pub width: u16,
    /// Rows of an image.
    pub height: u16,
    /// Pixel format: [`DataFormat::Mono8`] or [`DataFormat::Rgb8`].
    pub format: DataFormat,
    /// Angle from the left column to the right one, radians.
    #[serde(rename = "field_of_view_rad")]
    pub field_of_view: f64,
    /// The VNF to which images go, over the network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<VnfId>,
    /// Bytes of its images that a run keeps: the oldest go first.
    pub keep_bytes: u64,
}

/// Encoding of large data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DataFormat {
    /// A turn of a lidar: a `sensor_msgs/LaserScan` of ROS 2 in CDR.
    Scan,
    /// Brightness of pixels, a byte each, row by row from the top left.
    Mono8,
    /// Red, green and blue of pixels, a byte each, row by row from the top left.
    Rgb8,
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
}

impl DataFormat {
    /// All there are.
    pub const ALL: [Self; 5] = [Self::Scan, Self::Mono8, Self::Rgb8, Self::Jpeg, Self::Png];

    /// Returns the name in events.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Mono8 => "mono8",
            Self::Rgb8 => "rgb8",
            Self::Jpeg => "jpeg",
            Self::Png => "png",
        }
    }
}

/// Names and units of what a reading consists of.
type Components = &'static [(&'static str, &'static str)];

const ODOMETRY: Components = &[
    ("x", "m"),
    ("y", "m"),
    ("z", "m"),
    ("heading", "rad"),
    ("linear", "m/s"),
    ("vertical", "m/s"),
    ("angular", "rad/s"),
];
const BATTERY: Components = &[("charge", ""), ("voltage_v", "V")];
const IMU: Components = &[
    ("angular_x", "rad/s"),
    ("angular_y", "rad/s"),
    ("angular_z", "rad/s"),
    ("acceleration_x", "m/s²"),
    ("acceleration_y", "m/s²"),
    ("acceleration_z", "m/s²"),
];

impl SensorKind {
    /// Numbers of the largest vector.
    pub const LARGEST: u8 = 64;

    /// Names and units of what a reading consists of, in order; a share has no unit.
    pub fn components(&self) -> Vec<(ComponentId, &str)> {
        let name = |name: &str| ComponentId::new(name).expect("it is a name");
        let named = |all: Components| all.iter().map(|(of, unit)| (name(of), *unit)).collect();
        match self {
            Self::Odometry => named(ODOMETRY),
            Self::Battery { .. } => named(BATTERY),
            Self::Imu => named(IMU),
            Self::Lidar { .. } | Self::Camera(_) | Self::Images { .. } => Vec::new(),
            Self::Vector { size, unit } => {
                (0..*size).map(|n| (name(&n.to_string()), unit.as_str())).collect()
            }
        }
    }

    /// Returns how many bytes of its readings a run keeps; `None` for a sensor that measures numbers.
    pub fn keep_bytes(&self) -> Option<u64> {
        match self {
            Self::Lidar { keep_bytes }
            | Self::Camera(Camera { keep_bytes, .. })
            | Self::Images { keep_bytes } => Some(*keep_bytes),
            Self::Odometry | Self::Battery { .. } | Self::Imu | Self::Vector { .. } => None,
        }
    }

    /// The unit of a component of that name, whatever sensor it is of; empty for a share, and for those of vectors.
    pub fn unit(component: &ComponentId) -> &'static str {
        let mut all = ODOMETRY.iter().chain(BATTERY).chain(IMU);
        all.find(|(name, _)| *component == *name).map_or("", |(_, unit)| unit)
    }
}

/// Reading of a sensor: numbers, or a reference to large data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SensorReading {
    /// The robot.
    pub robot: NodeId,
    /// Its sensor.
    pub sensor: SensorId,
    /// Time of the measurement, or of its report.
    #[serde(rename = "measured_ns")]
    pub measured: Timestamp,
    /// Finite numbers, by the names of [`SensorKind::components`].
    #[schema(value_type = BTreeMap<String, f64>)]
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub values: BTreeMap<ComponentId, f64>,
    /// Large data, which is kept apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<LargeData>,
}

/// Large data that a sensor measured, but for its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LargeData {
    /// The number of the sensor's reading, from 0.
    pub sequence: u64,
    /// Encoding of its bytes.
    pub format: DataFormat,
    /// Columns of an image, rays of a scan.
    pub width: u32,
    /// Rows of an image; 1 of a scan.
    pub height: u32,
    /// Number of bytes.
    pub bytes: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_survive_json() {
        let reading = SensorReading {
            robot: NodeId::new("r").unwrap(),
            sensor: SensorId::new("gripper").unwrap(),
            measured: Timestamp::from_nanos(7),
            values: SensorKind::Vector { size: 2, unit: "N".to_owned() }
                .components()
                .into_iter()
                .map(|(name, _)| (name, 1.5))
                .collect(),
            data: None,
        };
        let event = crate::Stamped { at: Timestamp::from_nanos(9), event: crate::Event::Sensor(reading) };
        let json = serde_json::to_string(&event).unwrap();
        assert_eq!(
            json,
            r#"{"at_ns":9,"event":"sensor","robot":"r","sensor":"gripper","measured_ns":7,"values":{"0":1.5,"1":1.5}}"#
        );
        assert_eq!(serde_json::from_str::<crate::Stamped>(&json).unwrap(), event);
    }

    #[test]
    fn sensors_survive_json() {
        let kind = SensorKind::Battery { charge: Some(0.5) };
        let sensor =
            Sensor { id: SensorId::new("pack").unwrap(), interval: Duration::from_millis(1500), kind };
        let json = serde_json::to_string(&sensor).unwrap();
        assert_eq!(json, r#"{"sensor":"pack","interval_ms":1500.0,"kind":"battery","charge":0.5}"#);
        assert_eq!(serde_json::from_str::<Sensor>(&json).unwrap(), sensor);
    }
}
