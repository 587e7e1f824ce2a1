//! The driver of robots in ROS 1 against a rospy node with the faults of real robots.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "drives a real process on the wall clock"
)]
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{sync::Arc, time::Instant};

use cotorra_graph::{NodeId, PoseSource, Position, RobotFault, RosTopics, Timestamp, Velocity};
use cotorra_robot_middleware::{Clock, CommandError, RobotDriver, Ros1Link, RosDriver, RosRobot};
use cotorra_ros1::{
    Endpoint, Node, NodeConfig, PublishOptions, SubscribeOptions,
    messages::{Text, Twist},
};
use cotorra_testing::{process::until, ros1::Ros};

/// A robot with the fault that is set on /mood.
const ROBOT: &str = r#"
import math, rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

mood = "well"
def feel(message):
    global mood
    mood = message.data

rospy.init_node("robot")
odometry = rospy.Publisher("/tb2/odom", Odometry, queue_size=10)
scans = rospy.Publisher("/tb2/scan", LaserScan, queue_size=10)
poses = rospy.Publisher("/tb2/amcl_pose", PoseWithCovarianceStamped, queue_size=1, latch=True)
rospy.Subscriber("/mood", String, feel)

where = PoseWithCovarianceStamped()
where.pose.pose.position.x, where.pose.pose.orientation.w = 7.0, 1.0
poses.publish(where)
said = 0
while not rospy.is_shutdown():
    said += 1
    base = Odometry()
    base.header.stamp, base.header.frame_id = rospy.Time.now(), "odom"
    base.pose.pose.position.x, base.pose.pose.orientation.w = 1.0, 1.0
    base.twist.twist.linear.x = 0.125
    turn = LaserScan()
    turn.header.stamp = base.header.stamp
    turn.angle_min, turn.angle_max, turn.angle_increment = -1.5, 1.5, 3.0 / 640
    turn.range_min, turn.range_max, turn.ranges = 0.1, 20.0, [2.5] * 641
    if mood == "nan":
        base.twist.twist.linear.x = float("nan")
    elif mood == "blind":
        turn.ranges = [float("nan")] * 641
    elif mood == "jump" and said % 10 == 0:
        base.header.stamp -= rospy.Duration(30)
    elif mood == "nonsense":
        base.pose.pose.orientation.w = 0.0
    elif mood == "flood":
        turn.ranges = turn.ranges[:2]
        for _ in range(600):
            scans.publish(turn)
    if mood != "silent":
        odometry.publish(base)
        scans.publish(turn)
    rospy.sleep(0.05)
"#;

fn clock() -> Clock {
    let began = Instant::now();
    Arc::new(move || Timestamp::ZERO + began.elapsed())
}

fn driver(port: u16, clock: &Clock) -> RosDriver<Ros1Link> {
    let config = NodeConfig {
        namespace: "/tb2".to_owned(),
        master: Endpoint { host: "127.0.0.1".to_owned(), port },
        host: Some("127.0.0.1".to_owned()),
        ..NodeConfig::new("cotorra")
    };
    let robot = RosRobot::new(
        NodeId::new("tb").unwrap(),
        cotorra_graph::RobotModel::Turtlebot2,
        Position::new(1.0, 1.0),
        0.0,
        None,
    );
    let connect = move || Ros1Link::connect(config.clone(), &RosTopics::default());
    RosDriver::start(robot, Arc::clone(clock), connect).unwrap()
}

#[test]
fn robot_with_a_fault_is_detected_and_stopped_until_it_recovers() {
    let Some(ros) = Ros::start() else { return };
    let clock = clock();
    let mut robot = driver(ros.port(), &clock);
    robot.advance(clock());
    assert_eq!(robot.health(), [RobotFault::Absent]);
    let forward = Velocity::planar(0.2, 0.0);
    assert_eq!(robot.command(clock(), forward), Err(CommandError::Unwell(RobotFault::Absent)));

    let observer: Node = ros.node("observer", "/");
    let moods =
        observer.publish::<Text>("mood", PublishOptions { latch: true, ..Default::default() }).unwrap();
    let velocities = observer.subscribe::<Twist>("/tb2/cmd_vel", SubscribeOptions { queue: 1 }).unwrap();
    let _robot = ros.python("robot.py", ROBOT);
    let well = |robot: &mut RosDriver<Ros1Link>| {
        until("it is well", || {
            robot.advance(clock());
            robot.health().is_empty() && robot.scan().is_some()
        });
    };
    for (mood, fault) in [
        ("nan", RobotFault::NotFinite),
        ("blind", RobotFault::NotFinite),
        ("jump", RobotFault::TimeJump),
        ("flood", RobotFault::Flood),
        ("nonsense", RobotFault::Malformed),
        ("silent", RobotFault::Silent),
    ] {
        well(&mut robot);
        // On a busy machine the robot may be silent for a moment, and gets no velocity then.
        until(&format!("it moves before it is {mood}"), || {
            robot.command(clock(), forward) == Ok(forward)
                && velocities.try_recv().is_some_and(|velocity| velocity.linear.x == 0.2)
        });
        moods.publish(&Text { data: mood.to_owned() });
        // Commands go on until they are rejected; then the robot is stopped.
        let mut refused = None;
        until(&format!("it is known to be {mood}"), || {
            refused = robot.command(clock(), forward).err();
            refused.is_some() && robot.health().contains(&fault)
        });
        assert!(matches!(refused, Some(CommandError::Unwell(_))), "{mood}");
        until("it is told to stop", || {
            velocities.try_recv().is_some_and(|velocity| velocity == Twist::default())
        });
        let sensors = robot.sensors();
        assert_eq!(
            (sensors.velocity.linear, sensors.pose.x),
            (0.125, 7.0),
            "{mood}: the last that made sense"
        );
        moods.publish(&Text { data: "well".to_owned() });
        well(&mut robot);
        while velocities.try_recv().is_some() {}
    }
    let sensors = robot.sensors();
    assert_eq!((sensors.pose.source, sensors.nearest_obstacle_m), (PoseSource::Localization, Some(2.5)));
    assert_eq!(robot.scan().unwrap().ranges.len(), 641);

    // The driver is dropped while the robot moves.
    until("it moves", || {
        robot.command(clock(), forward) == Ok(forward)
            && velocities.try_recv().is_some_and(|velocity| velocity.linear.x == 0.2)
    });
    drop(robot);
    until("it is told to stop", || {
        velocities.try_recv().is_some_and(|velocity| velocity == Twist::default())
    });
}

#[test]
fn master_that_starts_later_is_found() {
    let Some(mut ros) = Ros::start() else { return };
    let port = ros.port();
    ros.stop();
    let clock = clock();
    let mut robot = driver(port, &clock);
    let failed = robot.command(clock(), Velocity::default());
    assert_eq!(failed, Err(CommandError::Unwell(RobotFault::Absent)));
    ros.restart();
    let _robot = ros.python("robot.py", ROBOT);
    until("it is there", || {
        robot.advance(clock());
        robot.health().is_empty()
    });
}
