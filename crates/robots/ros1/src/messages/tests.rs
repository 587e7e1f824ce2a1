use proptest::prelude::*;

use super::*;
use crate::{DecodeError, Definition, Field, Message};

fn bytes<M: Message>(message: &M) -> Vec<u8> {
    let mut buffer = Vec::new();
    message.encode(&mut buffer);
    buffer
}

fn stamped(frame: &str) -> Header {
    Header { seq: 7, stamp: Time { sec: 1, nsec: 400_000_123 }, frame_id: frame.to_owned() }
}

fn twist() -> Twist {
    Twist { linear: Vector3 { x: 0.3, y: 0.0, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: -0.1 } }
}

fn turn() -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }
}

fn pose() -> PoseWithCovariance {
    let pose = Pose { position: Point { x: 25.5, y: -27.8, z: 0.0 }, orientation: turn() };
    PoseWithCovariance { pose, covariance: std::array::from_fn(|i| i as f64) }
}

fn scan() -> LaserScan {
    LaserScan {
        header: stamped("laser"),
        angle_min: -3.0,
        angle_max: 3.0,
        angle_increment: 0.5,
        time_increment: 0.001,
        scan_time: 0.1,
        range_min: 0.15,
        range_max: 12.0,
        ranges: vec![1.0, 2.5, f32::INFINITY],
        intensities: vec![],
    }
}

fn imu() -> Imu {
    let vector = |x, y, z| Vector3 { x, y, z };
    let covariance = |from: f64| std::array::from_fn(|i| from + i as f64);
    Imu {
        header: stamped("imu"),
        orientation: turn(),
        orientation_covariance: covariance(-1.0),
        angular_velocity: vector(0.1, 0.2, 0.3),
        angular_velocity_covariance: covariance(10.0),
        linear_acceleration: vector(0.5, -0.25, 9.75),
        linear_acceleration_covariance: covariance(20.0),
    }
}

fn battery() -> BatteryState {
    BatteryState {
        header: stamped("pack"),
        voltage: 16.5,
        temperature: 21.5,
        current: -1.25,
        charge: 1.5,
        capacity: 2.0,
        design_capacity: 2.25,
        percentage: 0.75,
        power_supply_status: BatteryState::POWER_SUPPLY_STATUS_DISCHARGING,
        power_supply_health: BatteryState::POWER_SUPPLY_HEALTH_GOOD,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_LION,
        present: true,
        cell_voltage: vec![4.125, 4.25],
        cell_temperature: vec![20.5],
        location: "slot 1".to_owned(),
        serial_number: "A7".to_owned(),
    }
}

fn image() -> Image {
    Image {
        header: stamped("camera"),
        height: 2,
        width: 3,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: 4,
        data: (0..8).collect(),
    }
}

fn array() -> Float64MultiArray {
    let dimension = MultiArrayDimension { label: "fingers".to_owned(), size: 2, stride: 2 };
    let layout = MultiArrayLayout { dim: vec![dimension], data_offset: 0 };
    Float64MultiArray { layout, data: vec![0.5, -2.0] }
}

/// The golden files come from rosbags; see `golden/generate.py`.
macro_rules! golden {
    ($file:literal, $message:expr) => {
        let (golden, message) = (include_bytes!(concat!("golden/", $file, ".ros1")), $message);
        assert_eq!(bytes(&message), golden);
        assert_eq!(Message::from_bytes(golden), Ok(message));
    };
}

#[test]
fn bytes_are_those_of_an_independent_encoder() {
    let step = Transform { translation: Vector3 { x: 1.0, y: 2.0, z: 0.0 }, rotation: turn() };
    let transform = |child: &str| TransformStamped {
        header: stamped("odom"),
        child_frame_id: child.to_owned(),
        transform: step,
    };
    let info = MapMetaData {
        map_load_time: Time { sec: 5, nsec: 6 },
        resolution: 0.05,
        width: 3,
        height: 2,
        origin: pose().pose,
    };
    golden!("String", Text { data: "käse".to_owned() });
    golden!("Header", stamped("map"));
    golden!("Clock", Clock { clock: stamped("").stamp });
    golden!("Twist", twist());
    golden!("PoseWithCovarianceStamped", PoseWithCovarianceStamped { header: stamped("map"), pose: pose() });
    golden!("TFMessage", TFMessage { transforms: vec![transform("base_footprint"), transform("laser")] });
    golden!(
        "Odometry",
        Odometry {
            header: stamped("odom"),
            child_frame_id: "base_footprint".to_owned(),
            pose: pose(),
            twist: TwistWithCovariance { twist: twist(), covariance: pose().covariance },
        }
    );
    golden!(
        "OccupancyGrid",
        OccupancyGrid { header: stamped("map"), info, data: vec![-1, 0, 100, 50, -1, 0] }
    );
    golden!("LaserScan", scan());
    golden!("Imu", imu());
    golden!("BatteryState", battery());
    golden!("Image", image());
    golden!(
        "CompressedImage",
        CompressedImage { header: stamped("camera"), format: "jpeg".to_owned(), data: vec![0xff, 0xd8, 7] }
    );
    golden!("Float64MultiArray", array());
}

fn definitions() -> Vec<Definition> {
    vec![
        Text::definition(),
        Bool::definition(),
        Float64::definition(),
        Empty::definition(),
        Span::definition(),
        Header::definition(),
        Clock::definition(),
        Vector3::definition(),
        Point::definition(),
        Quaternion::definition(),
        Pose::definition(),
        PoseStamped::definition(),
        PoseWithCovariance::definition(),
        PoseWithCovarianceStamped::definition(),
        PoseArray::definition(),
        Twist::definition(),
        TwistStamped::definition(),
        TwistWithCovariance::definition(),
        Transform::definition(),
        TransformStamped::definition(),
        TFMessage::definition(),
        Odometry::definition(),
        Path::definition(),
        MapMetaData::definition(),
        OccupancyGrid::definition(),
        LaserScan::definition(),
        Imu::definition(),
        BatteryState::definition(),
        Image::definition(),
        CompressedImage::definition(),
        MultiArrayDimension::definition(),
        MultiArrayLayout::definition(),
        Float64MultiArray::definition(),
    ]
}

#[test]
fn md5_sums_are_those_of_ros() {
    let sums: String = definitions().iter().map(|d| format!("{} {}\n", d.type_name, d.md5sum())).collect();
    assert_eq!(sums, include_str!("golden/md5sums"));
}

#[test]
fn services_have_the_md5_sums_of_ros() {
    // From rossrv md5.
    assert_eq!(EmptyService::md5sum(), "d41d8cd98f00b204e9800998ecf8427e");
    assert_eq!(SetBool::md5sum(), "09fb03525b03e7ea1fd3992bafd87e16");
    assert_eq!(GetMap::md5sum(), "6cdd0a18e0aff5b0a3ca2326a89b54ff");
}

#[test]
fn the_text_has_all_that_a_message_is_made_of_once() {
    let expected = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n\n".to_owned()
        + &"=".repeat(80)
        + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
    assert_eq!(Twist::definition().text(), expected);
}

#[test]
fn a_lying_count_is_an_error_and_no_allocation() {
    let mut lying = bytes(&scan());
    let ranges = lying.len() - 4 - 12 - 4;
    assert_eq!(lying[ranges..ranges + 4], [3, 0, 0, 0]);
    lying[ranges..ranges + 4].copy_from_slice(&[0xff; 4]);
    let error = DecodeError::Count { count: 0xffff_ffff, left: 16 };
    assert_eq!(LaserScan::from_bytes(&lying), Err(error));
    let mut lying = bytes(&image());
    let length = lying.len() - 8 - 4;
    lying[length..length + 4].copy_from_slice(&[0xff; 4]);
    assert_eq!(Image::from_bytes(&lying), Err(DecodeError::Count { count: 0xffff_ffff, left: 8 }));
    assert!(<Vec<Empty> as Field>::decode(&mut crate::Reader::new(&[0xff; 4])).is_err());
}

#[test]
fn a_message_is_neither_shorter_nor_longer() {
    let mut twist = bytes(&twist());
    twist.push(0);
    assert_eq!(Twist::from_bytes(&twist), Err(DecodeError::Trailing { count: 1 }));
    assert_eq!(Twist::from_bytes(&twist[..40]), Err(DecodeError::Short { missing: 8 }));
}

#[test]
fn text_that_is_no_utf_8_is_still_heard() {
    assert_eq!(Text::from_bytes(b"\x02\0\0\0a\xe4"), Ok(Text { data: "a\u{fffd}".to_owned() }));
}

proptest! {
    #[test]
    fn decoding_never_panics(bytes in any::<Vec<u8>>()) {
        crate::parse_anything(&bytes);
    }

    #[test]
    fn scans_come_back_as_they_were(
        frame in "\\PC{0,30}",
        ranges in proptest::collection::vec(0.0f32..20.0, 0..400),
        intensities in proptest::collection::vec(0.0f32..20.0, 0..5),
    ) {
        let scan = LaserScan { header: stamped(&frame), ranges, intensities, ..scan() };
        prop_assert_eq!(LaserScan::from_bytes(&bytes(&scan)), Ok(scan));
    }
}
