//! `sensor_msgs`: scans, images and states of a robot.

use crate::{Header, Quaternion, Vector3, message};

message! {
    /// One turn of a planar lidar.
    #[derive(Default)]
    pub struct LaserScan = "sensor_msgs" / "LaserScan" {
        /// Time of the first ray; the frame in which angle 0 points along x.
        header: Header,
        /// Angle of the first ray, rad.
        angle_min: f32,
        /// Angle of the last ray, rad.
        angle_max: f32,
        /// Angle between two rays, rad.
        angle_increment: f32,
        /// Time between two rays, s.
        time_increment: f32,
        /// Time between two scans, s.
        scan_time: f32,
        /// Shortest valid range, m.
        range_min: f32,
        /// Longest valid range, m; +∞ means that the ray hit nothing (REP 117).
        range_max: f32,
        /// Distances, m.
        ranges: Vec<f32>,
        /// Intensities in the device's unit; empty if it has none.
        intensities: Vec<f32>,
    }
}

message! {
    /// Readings of a gyroscope and an accelerometer.
    #[derive(Default)]
    pub struct Imu = "sensor_msgs" / "Imu" {
        /// Time and frame of the readings.
        header: Header,
        /// A unit quaternion.
        orientation: Quaternion,
        /// Row-major 3 × 3, about x, y, z; -1 first if there is no estimate.
        orientation_covariance: [f64; 9],
        /// rad/s.
        angular_velocity: Vector3,
        /// Row-major 3 × 3, about x, y, z; -1 first if there is no estimate.
        angular_velocity_covariance: [f64; 9],
        /// m/s².
        linear_acceleration: Vector3,
        /// Row-major 3 × 3, x, y, z; -1 first if there is no estimate.
        linear_acceleration_covariance: [f64; 9],
    }
}

message! {
    /// Charge and condition of a battery.
    #[derive(Default)]
    pub struct BatteryState = "sensor_msgs" / "BatteryState"
    const {
        /// The status is unknown.
        POWER_SUPPLY_STATUS_UNKNOWN: u8 = 0,
        /// It is being charged.
        POWER_SUPPLY_STATUS_CHARGING: u8 = 1,
        /// It is in use.
        POWER_SUPPLY_STATUS_DISCHARGING: u8 = 2,
        /// It is neither charged nor in use.
        POWER_SUPPLY_STATUS_NOT_CHARGING: u8 = 3,
        /// It is full.
        POWER_SUPPLY_STATUS_FULL: u8 = 4,
        /// The condition is unknown.
        POWER_SUPPLY_HEALTH_UNKNOWN: u8 = 0,
        /// It works.
        POWER_SUPPLY_HEALTH_GOOD: u8 = 1,
        /// It is too hot.
        POWER_SUPPLY_HEALTH_OVERHEAT: u8 = 2,
        /// It is worn out.
        POWER_SUPPLY_HEALTH_DEAD: u8 = 3,
        /// Its voltage is too high.
        POWER_SUPPLY_HEALTH_OVERVOLTAGE: u8 = 4,
        /// It failed for a reason that it does not report.
        POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: u8 = 5,
        /// It is too cold.
        POWER_SUPPLY_HEALTH_COLD: u8 = 6,
        /// Its watchdog was not served.
        POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: u8 = 7,
        /// Its safety timer ran out.
        POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: u8 = 8,
        /// The technology is unknown.
        POWER_SUPPLY_TECHNOLOGY_UNKNOWN: u8 = 0,
        /// Nickel-metal hydride.
        POWER_SUPPLY_TECHNOLOGY_NIMH: u8 = 1,
        /// Lithium-ion.
        POWER_SUPPLY_TECHNOLOGY_LION: u8 = 2,
        /// Lithium polymer.
        POWER_SUPPLY_TECHNOLOGY_LIPO: u8 = 3,
        /// Lithium iron phosphate.
        POWER_SUPPLY_TECHNOLOGY_LIFE: u8 = 4,
        /// Nickel-cadmium.
        POWER_SUPPLY_TECHNOLOGY_NICD: u8 = 5,
        /// Lithium manganese.
        POWER_SUPPLY_TECHNOLOGY_LIMN: u8 = 6,
    }
    {
        /// Time of the measurement.
        header: Header,
        /// V.
        voltage: f32,
        /// °C; NaN if it is not measured.
        temperature: f32,
        /// A, negative while it discharges; NaN if it is not measured.
        current: f32,
        /// Ah; NaN if it is not measured.
        charge: f32,
        /// Ah when it was last full; NaN if it is not measured.
        capacity: f32,
        /// Ah by design; NaN if it is not known.
        design_capacity: f32,
        /// In 0..=1; NaN if it is not measured.
        percentage: f32,
        /// `POWER_SUPPLY_STATUS_…`.
        power_supply_status: u8,
        /// `POWER_SUPPLY_HEALTH_…`.
        power_supply_health: u8,
        /// `POWER_SUPPLY_TECHNOLOGY_…`.
        power_supply_technology: u8,
        /// Whether a battery is present.
        present: bool,
        /// Voltage of each cell, V.
        cell_voltage: Vec<f32>,
        /// Temperature of each cell, °C.
        cell_temperature: Vec<f32>,
        /// Its slot.
        location: String,
        /// Its serial number.
        serial_number: String,
    }
}

message! {
    /// An uncompressed image.
    #[derive(Default)]
    pub struct Image = "sensor_msgs" / "Image" {
        /// Time and frame of the image: z points ahead, x to the right.
        header: Header,
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
        /// Format of a pixel, such as `rgb8`.
        encoding: String,
        /// Whether numbers of more than a byte are big endian: 0 or 1.
        is_bigendian: u8,
        /// Bytes of a row.
        step: u32,
        /// Rows from the top.
        data: Vec<u8>,
    }
}

message! {
    /// An image as a file.
    #[derive(Default)]
    pub struct CompressedImage = "sensor_msgs" / "CompressedImage" {
        /// Time and frame of the image.
        header: Header,
        /// Its format, such as `jpeg`.
        format: String,
        /// The file.
        data: Vec<u8>,
    }
}
