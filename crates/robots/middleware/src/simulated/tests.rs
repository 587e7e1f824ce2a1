use cotorra_graph::{PoseSource, Position};
use proptest::prelude::*;

use super::*;
use crate::MAX_ANGULAR_SPEED;
use crate::fixtures::{id, robot, room, walk};

fn millis(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

fn in_room(seed: u64) -> SimulatedRobot {
    let walk = walk("robot1", &[(2.0, 2.0), (4.0, 2.0)]);
    let world = Arc::new(World::new(&room(6.0, 4.0)));
    SimulatedRobot::new(&robot("robot1", None), Some(&walk), world, seed).unwrap()
}

fn base(robot: &SimulatedRobot) -> &Base {
    match &robot.body {
        Body::Turtlebot2(base, _) => base,
        Body::Quadrotor(..) => panic!("it flies"),
    }
}

fn forward(linear: f64) -> Velocity {
    Velocity::planar(linear, 0.0)
}

#[test]
fn robot_starts_at_its_walk_or_its_position() {
    let world = Arc::new(World::open());
    let here = Some(Position::new(7.0, 8.0));
    let start = |node: &Node, walk: Option<&Walk>| {
        SimulatedRobot::new(node, walk, Arc::clone(&world), 1).map(|robot| robot.pose().position())
    };
    let walk = walk("robot1", &[(2.0, 3.0)]);
    assert_eq!(start(&robot("robot1", here), Some(&walk)).unwrap(), Position::new(2.0, 3.0));
    assert_eq!(start(&robot("robot1", here), None).unwrap(), Position::new(7.0, 8.0));
    assert_eq!(start(&robot("robot1", None), None), Err(SimulationError::NoStart(id("robot1"))));
    let switch = Node { kind: NodeKind::Switch, ..robot("switch1", here) };
    assert_eq!(start(&switch, None), Err(SimulationError::NotARobot(id("switch1"))));
}

#[test]
fn pose_is_exact_and_odometry_drifts() {
    let mut robot = in_room(1);
    robot.command(Timestamp::ZERO, forward(0.3)).unwrap();
    robot.advance(millis(600));
    let sensors = robot.sensors();
    assert_eq!((sensors.pose.source, sensors.pose.covariance), (PoseSource::Simulator, [0.0; 9]));
    assert_eq!(sensors.odometry.source, PoseSource::Odometry);
    assert!(sensors.odometry.covariance[0] > 0.0);
    assert_ne!(sensors.odometry.x, sensors.pose.x);
    assert!((sensors.odometry.x - sensors.pose.x).abs() < 0.01);
}

#[test]
fn robot_stops_without_a_command_for_600_ms() {
    let mut robot = in_room(1);
    robot.command(Timestamp::ZERO, Velocity::planar(0.2, 1.0)).unwrap();
    robot.advance(millis(600));
    assert_eq!(base(&robot).velocity, Velocity::planar(0.2, 1.0), "it follows the command up to 0.6 s");
    robot.advance(millis(620));
    assert!(base(&robot).velocity.linear < 0.2);
    robot.advance(millis(1200));
    assert_eq!(base(&robot).velocity, Velocity::default());
}

#[test]
fn motion_does_not_depend_on_the_times_of_calls() {
    let drive = |seed: u64, every: u64| {
        let mut robot = in_room(seed);
        for ms in (0..3000).filter(|ms| ms % every == 0 || ms % 500 == 0) {
            robot.advance(millis(ms));
            if ms % 500 == 0 {
                robot.command(millis(ms), Velocity::planar(0.25, 0.3)).unwrap();
            }
        }
        robot.advance(millis(3000));
        (robot.sensors(), robot.scan().unwrap().clone())
    };
    assert_eq!(drive(1, 1), drive(1, 3000));
    assert_eq!(drive(1, 7), drive(1, 20));
    assert_ne!(drive(1, 20).0.odometry, drive(2, 20).0.odometry);
    assert_ne!(drive(1, 20).1, drive(2, 20).1);
    assert_eq!(drive(1, 20).0.pose, drive(2, 20).0.pose, "noise of sensors moves nobody");
}

#[test]
fn velocities_that_are_not_finite_are_rejected_and_the_last_command_goes_on() {
    let mut robot = in_room(1);
    robot.command(Timestamp::ZERO, forward(0.2)).unwrap();
    for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let turn = Velocity::planar(0.1, wrong);
        assert!(matches!(robot.command(millis(100), forward(wrong)), Err(CommandError::NotFinite(_))));
        assert!(matches!(robot.command(millis(100), turn), Err(CommandError::NotFinite(_))));
    }
    robot.advance(millis(590));
    assert!((base(&robot).velocity.linear - 0.2).abs() < 1e-12);
    robot.advance(millis(2000));
    assert_eq!(base(&robot).velocity, Velocity::default(), "a refused command is no sign of life");
}

#[test]
fn velocity_over_a_limit_is_scaled_on_the_same_curve() {
    let mut robot = in_room(1);
    let mut done =
        |linear, angular| robot.command(Timestamp::ZERO, Velocity::planar(linear, angular)).unwrap();
    assert_eq!(done(0.3, 1.0), Velocity::planar(0.3, 1.0));
    assert_eq!(done(0.6, 1.0), Velocity::planar(0.3, 0.5));
    let turn = done(-0.2, 4.0 * MAX_ANGULAR_SPEED);
    assert!((turn.linear + 0.05).abs() < 1e-12 && (turn.angular - MAX_ANGULAR_SPEED).abs() < 1e-12);
    assert_eq!(done(0.0, 0.0), Velocity::default());
}

#[test]
fn stop_takes_effect_within_the_ramp() {
    let mut robot = in_room(1);
    robot.command(Timestamp::ZERO, forward(0.3)).unwrap();
    robot.stop(millis(590));
    robot.advance(millis(1100));
    assert_eq!(robot.sensors().velocity, Velocity::default());
    let stopped = robot.pose();
    robot.advance(millis(5000));
    assert_eq!(robot.pose(), stopped);
}

#[test]
fn lidar_turns_ten_times_a_second() {
    let mut robot = in_room(1);
    robot.advance(millis(99));
    assert!(robot.scan().is_none() && robot.sensors().nearest_obstacle_m.is_none());
    robot.advance(millis(100));
    assert_eq!(robot.scan().unwrap().at, millis(20));
    robot.advance(millis(1000));
    assert_eq!(robot.scan().unwrap().at, millis(920));
    let nearest = robot.sensors().nearest_obstacle_m.unwrap();
    assert!((nearest - 2.0).abs() < 0.05, "{nearest}");
}

#[test]
fn wall_presses_the_bumper() {
    let mut robot = in_room(1);
    for ms in (0..20_000).step_by(200) {
        robot.command(millis(ms), forward(0.3)).unwrap();
    }
    assert!(robot.sensors().bumper);
    assert!((robot.pose().x - (6.0 - crate::RADIUS)).abs() < 1e-4);
}

#[test]
fn ros_messages_match_the_sensors() {
    let mut robot = in_room(1);
    robot.command(Timestamp::ZERO, forward(0.3)).unwrap();
    robot.advance(millis(400));
    let scan = crate::ros::laser_scan(robot.scan().unwrap());
    assert_eq!(scan.ranges.len(), 360);
    let last = scan.angle_min + 359.0 * scan.angle_increment;
    assert!((last - scan.angle_max).abs() < 1e-4);
    assert_eq!((scan.range_min, scan.range_max, scan.scan_time), (0.15, 12.0, 0.1));
    let odometry = crate::ros::odometry(millis(400), &robot.sensors());
    assert_eq!(odometry.pose.pose.position.x, robot.sensors().odometry.x);
    assert_eq!(odometry.twist.twist.linear.x, robot.sensors().velocity.linear);
    assert_eq!(
        (odometry.header.frame_id.as_str(), odometry.child_frame_id.as_str()),
        ("odom", "base_footprint")
    );
}

fn any_speed() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -1.0f64..1.0]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn commands_never_make_readings_that_are_not_finite(
        commands in proptest::collection::vec((any_speed(), any_speed(), 0u64..900), 1..20), seed: u64,
    ) {
        let mut robot = in_room(seed);
        let mut now = 0;
        for (linear, angular, wait) in commands {
            let _ = robot.command(millis(now), Velocity::planar(linear, angular));
            now += wait;
            robot.advance(millis(now));
            let sensors = robot.sensors();
            for pose in [sensors.pose, sensors.odometry] {
                prop_assert!(pose.x.is_finite() && pose.y.is_finite() && pose.heading.is_finite());
                prop_assert!(pose.covariance.iter().all(|c| c.is_finite()));
            }
            prop_assert!(sensors.velocity.linear.is_finite() && sensors.velocity.angular.is_finite());
            prop_assert!((0.0..=6.0).contains(&sensors.pose.x) && (0.0..=4.0).contains(&sensors.pose.y));
            prop_assert!(base(&robot).velocity.linear.abs() <= 0.3 + 1e-12);
            prop_assert!(robot.scan().is_none_or(|scan| scan.ranges.iter().all(|range| !range.is_nan())));
        }
    }
}
