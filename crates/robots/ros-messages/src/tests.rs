use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;

fn ros1<M: Message>(message: &M) -> Vec<u8> {
    let mut buffer = Vec::new();
    message.encode_ros1(&mut buffer);
    buffer
}

fn cdr<M: Message>(message: &M) -> Vec<u8> {
    let mut buffer = Vec::new();
    message.encode_cdr(&mut buffer);
    buffer
}

/// A header as that version has it.
fn header(version: Version, frame: &str) -> Header {
    let seq = if version == Version::Ros1 { 7 } else { 0 };
    Header { seq, ..Header::new(Time { sec: 1, nanosec: 400_000_123 }, frame) }
}

fn stamped(frame: &str) -> Header {
    header(Version::Ros2, frame)
}

fn twist() -> Twist {
    Twist { linear: Vector3 { x: 0.3, y: 0.0, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: -0.1 } }
}

fn turn() -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }
}

fn counting() -> Covariance {
    Covariance(std::array::from_fn(|i| i as f64))
}

fn pose() -> PoseWithCovariance {
    let pose = Pose { position: Point { x: 25.5, y: -27.8, z: 0.0 }, orientation: turn() };
    PoseWithCovariance { pose, covariance: counting() }
}

fn scan(version: Version) -> LaserScan {
    LaserScan {
        header: header(version, "laser"),
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

fn localized(version: Version) -> PoseWithCovarianceStamped {
    PoseWithCovarianceStamped { header: header(version, "map"), pose: pose() }
}

fn odometry(version: Version) -> Odometry {
    Odometry {
        header: header(version, "odom"),
        child_frame_id: "base_footprint".to_owned(),
        pose: pose(),
        twist: TwistWithCovariance { twist: twist(), covariance: counting() },
    }
}

fn transforms(version: Version, x: f64, y: f64, children: [&str; 2]) -> TFMessage {
    let transform = |child: &str| TransformStamped {
        header: header(version, "odom"),
        child_frame_id: child.to_owned(),
        transform: Transform { translation: Vector3 { x, y, z: 0.0 }, rotation: turn() },
    };
    TFMessage { transforms: children.map(transform).into() }
}

fn map(version: Version, map_load_time: Time, [width, height]: [u32; 2], data: Vec<i8>) -> OccupancyGrid {
    let info = MapMetaData { map_load_time, resolution: 0.05, width, height, origin: pose().pose };
    OccupancyGrid { header: header(version, "map"), info, data }
}

fn imu(version: Version) -> Imu {
    let vector = |x, y, z| Vector3 { x, y, z };
    let covariance = |from: f64| std::array::from_fn(|i| from + i as f64);
    Imu {
        header: header(version, "imu"),
        orientation: turn(),
        orientation_covariance: covariance(-1.0),
        angular_velocity: vector(0.1, 0.2, 0.3),
        angular_velocity_covariance: covariance(10.0),
        linear_acceleration: vector(0.5, -0.25, 9.75),
        linear_acceleration_covariance: covariance(20.0),
    }
}

fn battery(version: Version) -> BatteryState {
    BatteryState {
        header: header(version, "pack"),
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

fn image(version: Version) -> Image {
    Image {
        header: header(version, "camera"),
        height: 2,
        width: 3,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: 4,
        data: (0..8).collect(),
    }
}

fn file(version: Version) -> CompressedImage {
    CompressedImage {
        header: header(version, "camera"),
        format: "jpeg".to_owned(),
        data: vec![0xff, 0xd8, 7],
    }
}

fn array() -> Float64MultiArray {
    let dimension = MultiArrayDimension { label: "fingers".to_owned(), size: 2, stride: 2 };
    let layout = MultiArrayLayout { dim: vec![dimension], data_offset: 0 };
    Float64MultiArray { layout, data: vec![0.5, -2.0] }
}

// The golden files come from rosbags; see `golden/generate.py`.

macro_rules! golden_ros1 {
    ($file:literal, $message:expr) => {
        let (golden, message) = (include_bytes!(concat!("golden/", $file, ".ros1")), $message);
        assert_eq!(ros1(&message), golden);
        assert_eq!(Message::decode_ros1(golden), Ok(message));
    };
}

#[test]
fn ros1_bytes_equal_those_of_an_independent_encoder() {
    let v = Version::Ros1;
    golden_ros1!("String", Text { data: "käse".to_owned() });
    golden_ros1!("Header", header(v, "map"));
    golden_ros1!("Clock", Clock { clock: stamped("").stamp });
    golden_ros1!("Twist", twist());
    golden_ros1!("PoseWithCovarianceStamped", localized(v));
    golden_ros1!("TFMessage", transforms(v, 1.0, 2.0, ["base_footprint", "laser"]));
    golden_ros1!("Odometry", odometry(v));
    let loaded = Time { sec: 5, nanosec: 6 };
    golden_ros1!("OccupancyGrid", map(v, loaded, [3, 2], vec![-1, 0, 100, 50, -1, 0]));
    golden_ros1!("LaserScan", scan(v));
    golden_ros1!("Imu", imu(v));
    golden_ros1!("BatteryState", battery(v));
    golden_ros1!("Image", image(v));
    golden_ros1!("CompressedImage", file(v));
    golden_ros1!("Float64MultiArray", array());
}

macro_rules! golden_cdr {
    ($file:literal, $message:expr) => {
        let little = include_bytes!(concat!("golden/", $file, ".le.cdr"));
        let big = include_bytes!(concat!("golden/", $file, ".be.cdr"));
        let message = $message;
        assert_eq!(cdr(&message), little);
        assert_eq!(Message::decode_cdr(little).as_ref(), Ok(&message));
        assert_eq!(Message::decode_cdr(big), Ok(message));
    };
}

#[test]
fn cdr_bytes_equal_those_of_an_independent_encoder() {
    let v = Version::Ros2;
    golden_cdr!("Twist", twist());
    golden_cdr!("Pose", pose().pose);
    golden_cdr!("PoseWithCovarianceStamped", localized(v));
    golden_cdr!("Odometry", odometry(v));
    golden_cdr!("LaserScan", scan(v));
    golden_cdr!("TwistStamped", TwistStamped { header: stamped("base_link"), twist: twist() });
    golden_cdr!("TFMessage", transforms(v, 1.5, -2.5, ["base_footprint"; 2]));
    golden_cdr!("OccupancyGrid", map(v, stamped("").stamp, [2, 3], vec![-1, 0, 100, -1, 50, 0]));
    golden_cdr!("Clock", Clock { clock: stamped("").stamp });
    golden_cdr!("Imu", imu(v));
    golden_cdr!("BatteryState", battery(v));
    golden_cdr!("Image", image(v));
    golden_cdr!("CompressedImage", file(v));
    golden_cdr!("Float64MultiArray", array());
}

macro_rules! names {
    ($name:ident, $sum:ident: $($type:ident)*) => {
        [$(format!("{} {}\n", $type::$name, $type::description().$sum())),*].concat()
    };
}

#[test]
fn md5_sums_are_those_of_ros() {
    let sums = names!(ROS1_NAME, md5sum:
        Text Bool Float64 Empty Span Header Clock Vector3 Point Quaternion Pose PoseStamped PoseWithCovariance
        PoseWithCovarianceStamped PoseArray Twist TwistStamped TwistWithCovariance Transform TransformStamped
        TFMessage Odometry Path MapMetaData OccupancyGrid LaserScan Imu BatteryState Image CompressedImage
        MultiArrayDimension MultiArrayLayout Float64MultiArray
    );
    assert_eq!(sums, include_str!("golden/md5sums"));
}

#[test]
fn md5_sums_of_services_are_those_of_ros() {
    // From rossrv md5.
    assert_eq!(EmptyService::md5sum(), "d41d8cd98f00b204e9800998ecf8427e");
    assert_eq!(SetBool::md5sum(), "09fb03525b03e7ea1fd3992bafd87e16");
    assert_eq!(GetMap::md5sum(), "6cdd0a18e0aff5b0a3ca2326a89b54ff");
}

#[test]
fn type_hashes_are_those_of_an_independent_implementation() {
    let hashes = names!(ROS2_NAME, type_hash:
        Time Header Text Vector3 Point Quaternion Pose PoseWithCovariance PoseWithCovarianceStamped Twist
        TwistStamped TwistWithCovariance Transform TransformStamped TFMessage Odometry LaserScan MapMetaData
        OccupancyGrid Clock Imu BatteryState Image CompressedImage MultiArrayDimension MultiArrayLayout
        Float64MultiArray
    );
    assert_eq!(hashes, include_str!("golden/hashes"));
}

#[test]
fn ros1_text_has_every_type_once() {
    let expected = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n\n".to_owned()
        + &"=".repeat(80)
        + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
    assert_eq!(Twist::description().ros1_text(), expected);
    assert_eq!(Header::description().ros1_text(), "uint32 seq\ntime stamp\nstring frame_id\n");
}

#[test]
fn ros2_text_has_every_type_once() {
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
    assert_eq!(TFMessage::description().ros2_text(), expected);
    let pose = PoseWithCovariance::description().ros2_text();
    assert!(pose.starts_with("geometry_msgs/Pose pose\nfloat64[36] covariance\n"), "{pose}");
}

message! {
    /// Has what the other messages lack.
    #[derive(Default)]
    pub struct Odd = "cotorra_msgs" / "Odd" {
        /// A keyword of Rust.
        r#type: Byte,
        /// An array of flags.
        flags: Vec<bool>,
        /// A field that ROS 1 lacks.
        late: u16 [Ros2 only],
    }
}

#[test]
fn fields_are_named_as_in_ros() {
    assert_eq!(Odd::description().ros2_text(), "byte type\nbool[] flags\nuint16 late\n");
    let odd = Odd { r#type: Byte(2), flags: vec![true, false], late: 3 };
    assert_eq!(cdr(&odd), [0, 1, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 1, 0, 3, 0]);
}

#[test]
fn a_field_of_one_version_is_left_out_of_the_other() {
    assert_eq!(Odd::description().ros1_text(), "byte type\nbool[] flags\n");
    let odd = Odd { r#type: Byte(2), flags: vec![true, false], late: 3 };
    assert_eq!(ros1(&odd), [2, 2, 0, 0, 0, 1, 0]);
    assert_eq!(Odd::decode_ros1(&ros1(&odd)), Ok(Odd { late: 0, ..odd }));
}

#[test]
fn a_message_without_fields_has_a_byte_in_cdr() {
    assert_eq!((ros1(&Empty {}), cdr(&Empty {})), (vec![], vec![0, 1, 0, 0, 0]));
    assert_eq!(Empty::decode_cdr(&[0, 1, 0, 0, 0]), Ok(Empty {}));
    // From rosidl.
    let hash = "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312";
    assert_eq!(Empty::description().type_hash(), hash);
}

#[test]
fn times_of_ros1_saturate_in_2038() {
    let late = [0xff, 0xff, 0xff, 0xff, 1, 0, 0, 0];
    assert_eq!(Clock::decode_ros1(&late), Ok(Clock { clock: Time { sec: i32::MAX, nanosec: 1 } }));
    assert_eq!(Time::from_nanos(u64::MAX).sec, i32::MAX);
    assert_eq!(Time::from_nanos(1_400_000_123), stamped("").stamp);
}

#[test]
fn cdr_pads_to_the_next_number_and_ends_text_with_zero() {
    let expected = [
        0, 1, 0, 0, // plain CDR, little endian
        1, 0, 0, 0, // 1 s
        0x7b, 0x84, 0xd7, 0x17, // 400 000 123 ns
        4, 0, 0, 0, b'm', b'a', b'p', 0,
    ];
    assert_eq!(cdr(&stamped("map")), expected);
}

#[test]
fn cdr_aligns_eight_byte_numbers_behind_the_encapsulation() {
    let message = PoseWithCovarianceStamped { header: stamped("odom"), pose: pose() };
    // Behind other bytes, as in a packet.
    let mut encoded = vec![9; 3];
    message.encode_cdr(&mut encoded);
    let encoded = &encoded[3..];
    // Stamp to 8, length to 12, `odom\0` to 17, padding to 24, where x begins; 4 bytes of encapsulation before.
    assert_eq!(encoded[4 + 12..4 + 24], *b"odom\0\0\0\0\0\0\0\0");
    assert_eq!(encoded[4 + 24..4 + 32], 25.5f64.to_le_bytes());
    assert_eq!(encoded.len(), 4 + 24 + 56 + 36 * 8);
}

#[test]
fn false_counts_in_ros1_are_rejected_without_allocation() {
    let mut lying = ros1(&scan(Version::Ros1));
    let ranges = lying.len() - 4 - 12 - 4;
    assert_eq!(lying[ranges..ranges + 4], [3, 0, 0, 0]);
    lying[ranges..ranges + 4].copy_from_slice(&[0xff; 4]);
    let error = DecodeError::Count { count: 0xffff_ffff, left: 16 };
    assert_eq!(LaserScan::decode_ros1(&lying), Err(error));
    let mut lying = ros1(&image(Version::Ros1));
    let length = lying.len() - 8 - 4;
    lying[length..length + 4].copy_from_slice(&[0xff; 4]);
    assert_eq!(Image::decode_ros1(&lying), Err(DecodeError::Count { count: 0xffff_ffff, left: 8 }));
    assert!(<Vec<Empty> as Field>::decode(&mut Reader::new(Version::Ros1, &[0xff; 4])).is_err());
}

#[test]
fn false_counts_in_cdr_are_rejected_without_allocation() {
    let mut lying = cdr(&scan(Version::Ros2));
    let ranges = lying.len() - 4 - 12 - 4;
    assert_eq!(lying[ranges..ranges + 4], [3, 0, 0, 0]);
    lying[ranges..ranges + 4].copy_from_slice(&[0xff; 4]);
    assert!(matches!(LaserScan::decode_cdr(&lying), Err(DecodeError::Count { .. })));

    let mut lying = cdr(&image(Version::Ros2));
    let length = lying.len() - 8 - 4;
    assert_eq!(lying[length..length + 4], [8, 0, 0, 0]);
    lying[length..length + 4].copy_from_slice(&[0xff; 4]);
    assert!(matches!(Image::decode_cdr(&lying), Err(DecodeError::Count { .. })));

    let mut lying = cdr(&stamped("map"));
    lying[12..16].copy_from_slice(&[0xff; 4]);
    assert!(matches!(Header::decode_cdr(&lying), Err(DecodeError::Count { .. })));
}

#[test]
fn a_ros1_message_is_neither_shorter_nor_longer() {
    let mut twist = ros1(&twist());
    twist.push(0);
    assert_eq!(Twist::decode_ros1(&twist), Err(DecodeError::Trailing { count: 1 }));
    assert_eq!(Twist::decode_ros1(&twist[..40]), Err(DecodeError::Short { missing: 8 }));
}

#[test]
fn cdr_may_be_padded_and_not_more() {
    let mut padded = cdr(&twist());
    padded.extend_from_slice(&[0; 3]);
    assert_eq!(Twist::decode_cdr(&padded).unwrap(), twist());
    padded.push(0);
    assert!(matches!(Twist::decode_cdr(&padded), Err(DecodeError::Trailing { count: 4, .. })));
    assert!(matches!(Twist::decode_cdr(&[0, 1, 0]), Err(DecodeError::Encapsulation)));
    assert!(matches!(Twist::decode_cdr(&[0, 3, 0, 0]), Err(DecodeError::Encapsulation)));
}

#[test]
fn only_ros1_accepts_text_that_is_not_utf_8() {
    assert_eq!(Text::decode_ros1(b"\x02\0\0\0a\xe4"), Ok(Text { data: "a\u{fffd}".to_owned() }));
    assert_eq!(Text::decode_cdr(b"\0\x01\0\0\x03\0\0\0a\xe4\0"), Err(DecodeError::Text));
    assert_eq!(Text::decode_cdr(&[0, 1, 0, 0, 0, 0, 0, 0]), Ok(Text::default()));
    assert_eq!(Bool::decode_cdr(&[0, 1, 0, 0, 2]), Err(DecodeError::Bool(2)));
    assert_eq!(Bool::decode_ros1(&[2]), Ok(Bool { data: true }));
}

#[test]
fn headings_are_rotations_about_z() {
    let quarter = Quaternion::from_angles(0.0, 0.0, PI / 2.0);
    assert!((quarter.z - 0.5f64.sqrt()).abs() < 1e-15 && (quarter.w - 0.5f64.sqrt()).abs() < 1e-15);
    assert_eq!(Quaternion::default().heading(), 0.0);
}

#[test]
fn planar_covariance_is_that_of_x_y_and_rotation_about_z() {
    let full = Covariance::from_planar(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    assert_eq!((full.0[0], full.0[1], full.0[5]), (1.0, 2.0, 3.0));
    assert_eq!((full.0[6], full.0[7], full.0[11]), (4.0, 5.0, 6.0));
    assert_eq!((full.0[30], full.0[31], full.0[35]), (7.0, 8.0, 9.0));
    assert_eq!(full.planar(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
}

fn decode_ros1_as_anything(bytes: &[u8]) {
    let _ = (LaserScan::decode_ros1(bytes), TFMessage::decode_ros1(bytes));
    let _ = (OccupancyGrid::decode_ros1(bytes), BatteryState::decode_ros1(bytes));
    let _ = (Imu::decode_ros1(bytes), Float64MultiArray::decode_ros1(bytes));
    let _ = (Image::decode_ros1(bytes), CompressedImage::decode_ros1(bytes));
}

proptest! {
    #[test]
    fn decoding_ros1_never_panics(bytes in any::<Vec<u8>>()) {
        decode_ros1_as_anything(&bytes);
    }

    #[test]
    fn decoding_cdr_never_panics(payload in proptest::collection::vec(any::<u8>(), 0..800), big: bool) {
        let mut payload = payload;
        if payload.len() >= 2 {
            (payload[0], payload[1]) = (0, u8::from(!big));
        }
        let _ = (LaserScan::decode_cdr(&payload), Odometry::decode_cdr(&payload), Twist::decode_cdr(&payload));
        let _ = (TFMessage::decode_cdr(&payload), OccupancyGrid::decode_cdr(&payload));
        let _ = (Imu::decode_cdr(&payload), BatteryState::decode_cdr(&payload), Image::decode_cdr(&payload));
    }

    #[test]
    fn scans_survive_both_encodings(
        frame in "\\PC{0,30}",
        ranges in proptest::collection::vec(0.0f32..20.0, 0..400),
        intensities in proptest::collection::vec(0.0f32..20.0, 0..5),
    ) {
        let scan = LaserScan { header: stamped(&frame), ranges, intensities, ..scan(Version::Ros2) };
        prop_assert_eq!(LaserScan::decode_ros1(&ros1(&scan)), Ok(scan.clone()));
        prop_assert_eq!(LaserScan::decode_cdr(&cdr(&scan)), Ok(scan));
    }
}
