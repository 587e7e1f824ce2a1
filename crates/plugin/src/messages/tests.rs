use std::f64::consts::PI;

use cotorra_graph::{self as graph, PoseSource, Timestamp, Velocity};
use proptest::prelude::*;

use super::*;

fn bytes<M: Message>(message: &M) -> Vec<u8> {
    let mut buffer = Vec::new();
    message.encode(&mut buffer);
    buffer
}

fn stamped(frame: &str) -> Header {
    Header::new(Timestamp::from_nanos(1_400_000_123), frame)
}

fn twist() -> Twist {
    Velocity::planar(0.3, -0.1).into()
}

fn counting() -> Covariance {
    Covariance(std::array::from_fn(|i| i as f64))
}

fn pose() -> PoseWithCovariance {
    PoseWithCovariance {
        pose: Pose {
            position: Point { x: 25.5, y: -27.8, z: 0.0 },
            orientation: Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 },
        },
        covariance: counting(),
    }
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

fn odometry() -> Odometry {
    Odometry {
        header: stamped("odom"),
        child_frame_id: "base_footprint".to_owned(),
        pose: pose(),
        twist: TwistWithCovariance { twist: twist(), covariance: counting() },
    }
}

fn transforms() -> TFMessage {
    let transform = Transform {
        translation: Vector3 { x: 1.5, y: -2.5, z: 0.0 },
        rotation: Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 },
    };
    let child_frame_id = "base_footprint".to_owned();
    let transform = TransformStamped { header: stamped("odom"), child_frame_id, transform };
    TFMessage { transforms: vec![transform.clone(), transform] }
}

fn map() -> OccupancyGrid {
    let info = MapMetaData {
        map_load_time: stamped("").stamp,
        resolution: 0.05,
        width: 2,
        height: 3,
        origin: pose().pose,
    };
    OccupancyGrid { header: stamped("map"), info, data: vec![-1, 0, 100, -1, 50, 0] }
}

fn imu() -> Imu {
    let vector = |x, y, z| Vector3 { x, y, z };
    let covariance = |from: f64| std::array::from_fn(|i| from + i as f64);
    Imu {
        header: stamped("imu"),
        orientation: Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 },
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
        power_supply_status: 2,
        power_supply_health: 1,
        power_supply_technology: 2,
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
        data: Bytes((0..8).collect()),
    }
}

fn array() -> Float64MultiArray {
    let dimension = MultiArrayDimension { label: "fingers".to_owned(), size: 2, stride: 2 };
    let layout = MultiArrayLayout { dim: vec![dimension], data_offset: 0 };
    Float64MultiArray { layout, data: vec![0.5, -2.0] }
}

#[test]
fn a_header_pads_to_the_next_number_and_ends_its_text_with_zero() {
    let expected = [
        0, 1, 0, 0, // plain CDR, little endian
        1, 0, 0, 0, // 1 s
        0x7b, 0x84, 0xd7, 0x17, // 400 000 123 ns
        4, 0, 0, 0, b'm', b'a', b'p', 0,
    ];
    assert_eq!(bytes(&stamped("map")), expected);
}

#[test]
fn eight_byte_numbers_are_aligned_from_behind_the_encapsulation() {
    let message = PoseWithCovarianceStamped { header: stamped("odom"), pose: pose() };
    let encoded = bytes(&message);
    // Stamp to 8, length to 12, `odom\0` to 17, padding to 24, where x stands; 4 bytes of encapsulation before.
    assert_eq!(encoded[4 + 12..4 + 24], *b"odom\0\0\0\0\0\0\0\0");
    assert_eq!(encoded[4 + 24..4 + 32], 25.5f64.to_le_bytes());
    assert_eq!(encoded.len(), 4 + 24 + 56 + 36 * 8);
}

/// The golden files come from rosbags; see `golden/generate.py`.
macro_rules! golden {
    ($message:expr, $type:ident) => {
        let little = include_bytes!(concat!("golden/", stringify!($type), ".le.cdr"));
        let big = include_bytes!(concat!("golden/", stringify!($type), ".be.cdr"));
        let message: $type = $message;
        assert_eq!(bytes(&message), little);
        assert_eq!($type::decode(little).unwrap(), message);
        assert_eq!($type::decode(big).unwrap(), message);
    };
}

#[test]
fn bytes_are_those_of_an_independent_encoder() {
    golden!(twist(), Twist);
    golden!(pose().pose, Pose);
    golden!(PoseWithCovarianceStamped { header: stamped("map"), pose: pose() }, PoseWithCovarianceStamped);
    golden!(odometry(), Odometry);
    golden!(scan(), LaserScan);
    golden!(TwistStamped { header: stamped("base_link"), twist: twist() }, TwistStamped);
    golden!(transforms(), TFMessage);
    golden!(map(), OccupancyGrid);
    golden!(Clock { clock: stamped("").stamp }, Clock);
    golden!(imu(), Imu);
    golden!(battery(), BatteryState);
    golden!(image(), Image);
    let data = Bytes(vec![0xff, 0xd8, 7]);
    golden!(CompressedImage { header: stamped("camera"), format: "jpeg".to_owned(), data }, CompressedImage);
    golden!(array(), Float64MultiArray);
}

#[test]
fn type_hashes_are_those_of_an_independent_implementation() {
    let hashes: Vec<_> = include_str!("golden/hashes").lines().collect();
    macro_rules! ours {
        ($($type:ident),*) => { [$(format!("{} {}", $type::TYPE_NAME, $type::description().hash())),*] };
    }
    let ours = ours![
        Time,
        Header,
        Text,
        Vector3,
        Point,
        Quaternion,
        Pose,
        PoseWithCovariance,
        PoseWithCovarianceStamped,
        Twist,
        TwistStamped,
        TwistWithCovariance,
        Transform,
        TransformStamped,
        TFMessage,
        Odometry,
        LaserScan,
        MapMetaData,
        OccupancyGrid,
        Clock,
        Imu,
        BatteryState,
        Image,
        CompressedImage,
        MultiArrayDimension,
        MultiArrayLayout,
        Float64MultiArray
    ];
    assert_eq!(hashes, ours);
}

#[test]
fn a_definition_has_every_type_once_and_names_it() {
    let separator = "=".repeat(80);
    let expected = format!(
        "geometry_msgs/TransformStamped[] transforms\n\
         {separator}\nMSG: geometry_msgs/TransformStamped\n\
         std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n\
         {separator}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
         {separator}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
         {separator}\nMSG: geometry_msgs/Transform\n\
         geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n\
         {separator}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n\
         {separator}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    );
    assert_eq!(TFMessage::description().definition(), expected);
    let pose = PoseWithCovariance::description().definition();
    assert!(pose.starts_with("geometry_msgs/Pose pose\nfloat64[36] covariance\n"), "{pose}");
}

message! {
    /// Has what the other messages lack.
    #[derive(Default)]
    pub struct Odd = "cotorra_msgs/msg/Odd" {
        /// A word of Rust's.
        r#type: Byte,
        /// One of several.
        flags: Vec<bool>,
    }
}

#[test]
fn fields_are_named_as_ros_names_them() {
    assert_eq!(Odd::description().definition(), "byte type\nbool[] flags\n");
    let odd = Odd { r#type: Byte(2), flags: vec![true, false] };
    assert_eq!(bytes(&odd), [0, 1, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 1, 0]);
}

#[test]
fn a_lying_length_is_an_error_and_no_allocation() {
    let mut lying = bytes(&scan());
    let ranges = lying.len() - 4 - 12 - 4;
    assert_eq!(lying[ranges..ranges + 4], [3, 0, 0, 0]);
    lying[ranges..ranges + 4].copy_from_slice(&[0xff; 4]);
    assert!(matches!(LaserScan::decode(&lying), Err(MessageError::Body { .. })));

    let mut lying = bytes(&image());
    let length = lying.len() - 8 - 4;
    assert_eq!(lying[length..length + 4], [8, 0, 0, 0]);
    lying[length..length + 4].copy_from_slice(&[0xff; 4]);
    assert!(matches!(Image::decode(&lying), Err(MessageError::Body { .. })));

    let mut lying = bytes(&stamped("map"));
    lying[12..16].copy_from_slice(&[0xff; 4]);
    assert!(matches!(Header::decode(&lying), Err(MessageError::Body { .. })));
}

#[test]
fn padding_is_let_pass_and_more_is_not() {
    let mut padded = bytes(&twist());
    padded.extend_from_slice(&[0; 3]);
    assert_eq!(Twist::decode(&padded).unwrap(), twist());
    padded.push(0);
    assert!(matches!(Twist::decode(&padded), Err(MessageError::Trailing { count: 4, .. })));
    assert!(matches!(Twist::decode(&[0, 1, 0]), Err(MessageError::Encapsulation)));
    assert!(matches!(Twist::decode(&[0, 3, 0, 0]), Err(MessageError::Encapsulation)));
}

#[test]
fn headings_are_rotations_about_z() {
    let quarter = Quaternion::from_heading(PI / 2.0);
    assert!((quarter.z - 0.5f64.sqrt()).abs() < 1e-15 && (quarter.w - 0.5f64.sqrt()).abs() < 1e-15);
    assert_eq!(Quaternion::default().heading(), 0.0);
}

#[test]
fn planar_covariance_stands_at_x_y_and_rotation_about_z() {
    let full = Covariance::from_planar(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    assert_eq!((full.0[0], full.0[1], full.0[5]), (1.0, 2.0, 3.0));
    assert_eq!((full.0[6], full.0[7], full.0[11]), (4.0, 5.0, 6.0));
    assert_eq!((full.0[30], full.0[31], full.0[35]), (7.0, 8.0, 9.0));
    assert_eq!(full.planar(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
}

proptest! {
    #[test]
    fn decoding_never_panics(payload in proptest::collection::vec(any::<u8>(), 0..800), big: bool) {
        let mut payload = payload;
        if payload.len() >= 2 {
            (payload[0], payload[1]) = (0, u8::from(!big));
        }
        let _ = (LaserScan::decode(&payload), Odometry::decode(&payload), Twist::decode(&payload));
        let _ = (TFMessage::decode(&payload), OccupancyGrid::decode(&payload));
        let _ = (Imu::decode(&payload), BatteryState::decode(&payload), Image::decode(&payload));
    }

    #[test]
    fn scans_come_back_as_they_were(
        frame in "\\PC{0,30}",
        ranges in proptest::collection::vec(0.0f32..20.0, 0..400),
        intensities in proptest::collection::vec(0.0f32..20.0, 0..5),
    ) {
        let scan = LaserScan { header: stamped(&frame), ranges, intensities, ..scan() };
        prop_assert_eq!(LaserScan::decode(&bytes(&scan)).unwrap(), scan);
    }

    #[test]
    fn planar_poses_come_back(x in -1e6f64..1e6, y in -1e6f64..1e6, heading in -3.0f64..3.0) {
        let pose = graph::Pose::planar(x, y, heading, [0.25; 9], PoseSource::Simulator);
        let back = PoseWithCovariance::from(&pose).from_source(PoseSource::Simulator);
        prop_assert_eq!((back.x, back.y, back.covariance), (x, y, pose.covariance));
        prop_assert!((back.heading - heading).abs() < 1e-12);
    }
}
