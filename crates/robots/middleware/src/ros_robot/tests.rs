use cotorra_ros_messages::{
    Covariance, Point, Pose as RosPose, Time, Transform, TransformStamped, Twist, TwistWithCovariance,
    Vector3,
};
use proptest::prelude::*;

use super::*;
use crate::fixtures::{id, walk};

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

fn header(ms: u64, frame: &str) -> Header {
    let stamp = Time { sec: (1_000_000 + ms / 1000) as i32, nanosec: (ms % 1000) as u32 * 1_000_000 };
    Header::new(stamp, frame)
}

fn pose(x: f64, y: f64, heading: f64) -> PoseWithCovariance {
    PoseWithCovariance {
        pose: RosPose {
            position: Point { x, y, z: 0.0 },
            orientation: Quaternion::from_angles(0.0, 0.0, heading),
        },
        covariance: Covariance::from_planar(&[0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.02]),
    }
}

fn odometry(ms: u64, x: f64) -> Odometry {
    let mut twist = Twist::default();
    twist.linear.x = 0.25;
    Odometry {
        header: header(ms, "odom"),
        child_frame_id: "base_footprint".to_owned(),
        pose: pose(x, 0.0, 0.0),
        twist: TwistWithCovariance { twist, covariance: Covariance::default() },
    }
}

fn scan(ms: u64, rays: usize) -> LaserScan {
    LaserScan {
        header: header(ms, "laser"),
        angle_min: -2.0,
        angle_max: 2.0,
        angle_increment: 4.0 / rays as f32,
        time_increment: 0.0,
        scan_time: 0.1,
        range_min: 0.1,
        range_max: 30.0,
        ranges: vec![5.0; rays],
        intensities: Vec::new(),
    }
}

fn frame(ms: u64, frame_id: &str, child: &str, (x, y, heading): (f64, f64, f64)) -> TFMessage {
    let transform = Transform {
        translation: Vector3 { x, y, z: 0.0 },
        rotation: Quaternion::from_angles(0.0, 0.0, heading),
    };
    let header = header(ms, frame_id);
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id: child.to_owned(), transform }] }
}

/// A robot without messages, which starts at (10, 5) and faces north.
fn absent() -> RosRobot {
    RosRobot::new(
        id("tb"),
        RobotModel::Turtlebot2,
        Position::new(10.0, 5.0),
        std::f64::consts::FRAC_PI_2,
        None,
    )
}

fn well() -> RosRobot {
    let mut robot = absent();
    robot.odometry(at(0), &odometry(0, 3.0));
    robot
}

fn forward(linear: f64) -> Velocity {
    Velocity::planar(linear, 0.0)
}

fn place(robot: &RosRobot) -> (f64, f64, f64, PoseSource) {
    let pose = robot.sensors().pose;
    let round = |x: f64| (x * 1e4).round() / 1e4;
    (round(pose.x), round(pose.y), round(pose.heading.to_degrees()), pose.source)
}

#[test]
fn odometry_continues_from_the_start_without_localization() {
    let mut robot = absent();
    assert_eq!(place(&robot), (10.0, 5.0, 90.0, PoseSource::Odometry));
    robot.odometry(at(0), &odometry(0, 3.0));
    robot.odometry(at(20), &odometry(20, 4.5));
    assert_eq!(place(&robot), (10.0, 6.5, 90.0, PoseSource::Odometry));
    let sensors = robot.sensors();
    assert_eq!((sensors.velocity, sensors.pose), (forward(0.25), sensors.odometry));
    // The robot's x axis is the map's y axis.
    assert!(
        (sensors.pose.covariance[0] - 0.01).abs() < 1e-12
            && (sensors.pose.covariance[4] - 0.04).abs() < 1e-12
    );
}

#[test]
fn odometry_continues_from_amcl_pose() {
    let message = PoseWithCovarianceStamped { header: header(5, "map"), pose: pose(1.0, 1.0, 0.0) };
    let mut earlier = absent();
    earlier.localized(at(0), &message);
    earlier.odometry(at(1), &odometry(1, 3.0));
    assert_eq!(place(&earlier), (1.0, 1.0, 0.0, PoseSource::Localization), "it may come only once");
    let mut robot = well();
    robot.localized(at(5), &message);
    assert_eq!(place(&robot), (1.0, 1.0, 0.0, PoseSource::Localization));
    assert_eq!(robot.sensors().pose.covariance[0], 0.04);
    robot.odometry(at(20), &odometry(20, 3.5));
    assert_eq!(place(&robot), (1.5, 1.0, 0.0, PoseSource::Localization));
}

#[test]
fn newest_reading_is_taken_once_and_ignored_during_a_fault() {
    let imu = SensorId::new("imu").unwrap();
    let mut robot = absent();
    robot.sensed(at(0), &imu, vec![1.0]);
    assert_eq!(robot.take_reading(&imu), None);
    robot.odometry(at(0), &odometry(0, 3.0));
    robot.sensed(at(1), &imu, vec![2.0]);
    robot.sensed(at(2), &imu, vec![3.0]);
    assert_eq!(robot.take_reading(&imu), Some((at(2), vec![3.0])));
    assert_eq!(robot.take_reading(&imu), None);
    let picture =
        Picture { format: cotorra_graph::DataFormat::Mono8, width: 1, height: 1, bytes: [7].into() };
    robot.pictured(at(3), &imu, picture.clone());
    assert_eq!(robot.take_image(&imu).map(|image| image.measured), Some(at(3)));
    robot.pictured(at(9000), &imu, picture);
    assert_eq!(robot.take_image(&imu), None);
    assert_eq!(robot.health(), [RobotFault::Silent]);
    robot.refuse(&imu, "no");
    robot.refuse(&imu, "again no");
    assert_eq!(robot.poll_notice().as_deref(), Some("robot tb, sensor imu: no"));
    assert_eq!(robot.poll_notice(), None);
}

#[test]
fn own_frames_take_precedence_and_frames_of_others_are_ignored() {
    let mut robot = well();
    robot.frames(at(5), &frame(5, "map", "tb9/odom", (7.0, 7.0, 0.0)));
    robot.frames(at(5), &frame(5, "odom", "base_footprint", (7.0, 7.0, 0.0)));
    assert_eq!(place(&robot).3, PoseSource::Odometry);
    robot.frames(at(6), &frame(6, "/map", "/odom", (2.0, 0.0, std::f64::consts::FRAC_PI_2)));
    assert_eq!(place(&robot), (2.0, 3.0, 90.0, PoseSource::Localization));
    let message = PoseWithCovarianceStamped { header: header(7, "map"), pose: pose(1.0, 1.0, 0.0) };
    robot.localized(at(7), &message);
    assert_eq!(
        place(&robot),
        (2.0, 3.0, 90.0, PoseSource::Localization),
        "amcl_pose is older than its frames"
    );
    assert_eq!(robot.sensors().pose.covariance[0], 0.04);
}

#[test]
fn scan_may_have_any_number_of_rays_and_failed_rays() {
    let mut robot = well();
    for rays in [1, 360, 640, 1081] {
        let mut message = scan(10, rays);
        message.ranges[0] = 2.0;
        if rays > 1 {
            message.ranges[rays - 1] = f32::NAN;
        }
        robot.scanned(at(10), message);
        assert_eq!(robot.scan().unwrap().ranges.len(), rays);
        assert_eq!(robot.sensors().nearest_obstacle_m, Some(2.0));
    }
    assert_eq!(robot.health(), []);
    assert!((robot.scan().unwrap().angle(1080) - 2.0).abs() < 0.01);
}

/// Returns the velocities sent in an interval, with their times.
fn said(robot: &mut RosRobot, from: u64, to: u64) -> Vec<(u64, f64)> {
    (from..to).filter_map(|ms| Some((ms, robot.poll_velocity(at(ms))?.linear))).collect()
}

#[test]
fn velocity_is_repeated_until_its_timeout_and_then_the_robot_stops() {
    let mut robot = well();
    assert_eq!(robot.command(at(10), forward(0.2)), Ok(forward(0.2)));
    let moves = (0..6).map(|i| (10 + 100 * i, 0.2));
    let stops = (0..5).map(|i| (610 + 100 * i, 0.0));
    robot.odometry(at(600), &odometry(600, 3.0));
    assert_eq!(said(&mut robot, 10, 1500), moves.chain(stops).collect::<Vec<_>>());
    assert_eq!(said(&mut robot, 1500, 1590), [], "it stands, and nothing needs to be said");
}

#[test]
fn velocities_over_the_limits_are_scaled_and_nan_is_rejected() {
    let mut robot = RosRobot::new(
        id("robot1"),
        RobotModel::Turtlebot2,
        Position::default(),
        0.0,
        Some(&walk("robot1", &[(0.0, 0.0)])),
    );
    robot.odometry(at(0), &odometry(0, 0.0));
    assert_eq!(robot.command(at(1), Velocity::planar(0.6, 1.0)), Ok(Velocity::planar(0.3, 0.5)));
    assert!(matches!(robot.command(at(2), forward(f64::NAN)), Err(CommandError::NotFinite(_))));
    assert_eq!(robot.poll_velocity(at(3)), Some(Velocity::planar(0.3, 0.5)));
}

#[test]
fn absent_robot_rejects_commands_and_gets_no_velocity() {
    let mut robot = absent();
    assert_eq!(robot.command(at(5), forward(0.1)), Err(CommandError::Unwell(RobotFault::Absent)));
    assert_eq!(said(&mut robot, 5, 3000), []);
}

#[test]
fn silent_robot_is_stopped_and_rejects_commands_until_it_is_back() {
    let mut robot = well();
    for ms in [300, 700, 1100] {
        robot.command(at(ms - 1), forward(0.2)).unwrap();
        if ms < 1000 {
            assert_eq!(robot.poll_velocity(at(ms)).unwrap(), forward(0.2));
        }
        if ms == 700 {
            robot.odometry(at(150 + ms), &odometry(850, 3.1));
        }
    }
    robot.command(at(1800), forward(0.2)).unwrap();
    let last = said(&mut robot, 1801, 2000);
    assert_eq!(last, [(1801, 0.2), (1850, 0.0), (1950, 0.0)], "a second after it was heard last");
    assert_eq!(robot.health(), [RobotFault::Silent]);
    assert_eq!(robot.command(at(2000), forward(0.2)), Err(CommandError::Unwell(RobotFault::Silent)));
    robot.odometry(at(2100), &odometry(2100, 3.1));
    assert_eq!(robot.command(at(2100), forward(0.2)), Ok(forward(0.2)));
}

/// Messages of a broken robot, and calls between them.
#[derive(Debug, Clone)]
enum Saying {
    Odometry(Vec<f64>, i32),
    Scan(Vec<f32>, Vec<f32>),
    Pose(Vec<f64>),
    Frame(Vec<f64>),
    Malformed,
    Missed(u64),
    Command(f64, f64),
    Silence(u16),
}

fn any_f64() -> impl Strategy<Value = f64> {
    prop_oneof![
        -10.0..10.0,
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::MAX),
        Just(f64::MIN_POSITIVE),
    ]
}

fn saying() -> impl Strategy<Value = Saying> {
    let figures = |count| proptest::collection::vec(any_f64(), count);
    let f32s =
        |count: std::ops::Range<usize>| proptest::collection::vec(any_f64().prop_map(|x| x as f32), count);
    prop_oneof![
        (figures(10), any::<i32>()).prop_map(|(f, stamp)| Saying::Odometry(f, stamp)),
        (f32s(7..8), f32s(0..40)).prop_map(|(f, ranges)| Saying::Scan(f, ranges)),
        figures(10).prop_map(Saying::Pose),
        figures(10).prop_map(Saying::Frame),
        Just(Saying::Malformed),
        any::<u64>().prop_map(Saying::Missed),
        (any_f64(), any_f64()).prop_map(|(linear, angular)| Saying::Command(linear, angular)),
        (0..2000_u16).prop_map(Saying::Silence),
    ]
}

fn broken_pose(f: &[f64]) -> PoseWithCovariance {
    PoseWithCovariance {
        pose: RosPose {
            position: Point { x: f[0], y: f[1], z: f[2] },
            // Half of them are rotations.
            orientation: if f[3] > 0.0 {
                Quaternion::from_angles(0.0, 0.0, f[4].clamp(-3.0, 3.0))
            } else {
                Quaternion { x: f[3], y: f[4], z: f[5], w: f[6] }
            },
        },
        covariance: Covariance([f[7]; 36]),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With any messages, readings are finite, the robot moves only without faults, and it stops without commands.
    #[test]
    fn broken_robot_never_spoils_a_context_or_runs_away(sayings in proptest::collection::vec(saying(), 0..60)) {
        let mut robot = well();
        let (mut now, mut commanded) = (0, None::<u64>);
        for saying in sayings {
            now += 7;
            match saying {
                Saying::Odometry(f, sec) => {
                    let mut message = odometry(now, 0.0);
                    message.pose = broken_pose(&f);
                    message.twist.twist.linear.x = f[8];
                    message.twist.twist.angular.z = f[9];
                    message.header.stamp.sec = sec;
                    robot.odometry(at(now), &message);
                }
                Saying::Scan(f, ranges) => {
                    let mut message = scan(now, 1);
                    (message.angle_min, message.angle_max, message.angle_increment) = (f[0], f[1], f[2]);
                    (message.time_increment, message.scan_time) = (f[3], f[4]);
                    (message.range_min, message.range_max, message.ranges) = (f[5], f[6], ranges);
                    robot.scanned(at(now), message);
                }
                Saying::Pose(f) => {
                    let message = PoseWithCovarianceStamped { header: header(now, "map"), pose: broken_pose(&f) };
                    robot.localized(at(now), &message);
                }
                Saying::Frame(f) => {
                    let mut message = frame(now, "map", "odom", (0.0, 0.0, 0.0));
                    let RosPose { position: Point { x, y, z }, orientation } = broken_pose(&f).pose;
                    message.transforms[0].transform =
                        Transform { translation: Vector3 { x, y, z }, rotation: orientation };
                    robot.frames(at(now), &message);
                }
                Saying::Malformed => robot.malformed(at(now)),
                Saying::Missed(count) => robot.missed(at(now), Topic::Scan, count),
                Saying::Command(linear, angular) => {
                    if robot.command(at(now), Velocity::planar(linear, angular)).is_ok() {
                        prop_assert_eq!(robot.health(), []);
                        commanded = Some(now);
                    }
                }
                Saying::Silence(ms) => now += u64::from(ms),
            }
            while let Some(velocity) = robot.poll_velocity(at(now)) {
                prop_assert!(velocity.linear.is_finite() && velocity.angular.is_finite());
                if velocity != Velocity::default() {
                    prop_assert_eq!(robot.health(), []);
                    prop_assert!(commanded.is_some_and(|at| now < at + 600));
                }
            }
            let SensorData { pose, odometry, velocity, nearest_obstacle_m, .. } = robot.sensors();
            let figures = [pose.x, pose.y, pose.heading, odometry.x, odometry.y, odometry.heading]
                .into_iter()
                .chain(pose.covariance)
                .chain(odometry.covariance)
                .chain([velocity.linear, velocity.angular])
                .chain(nearest_obstacle_m);
            prop_assert!(figures.into_iter().all(f64::is_finite), "{pose:?} {odometry:?} {velocity:?} {nearest_obstacle_m:?}");
        }
        // Left alone, it has no fault but silence, and stands.
        let later = now + 5000;
        while robot.poll_velocity(at(later)).is_some() {}
        prop_assert_eq!(robot.poll_velocity(at(later + 1000)).unwrap_or_default(), Velocity::default());
        prop_assert!(robot.health().iter().all(|fault| *fault == RobotFault::Silent));
    }
}
