use cotorra_graph::{SensorId, Velocity};
use cotorra_testing::turtlebot::{Kobuki, Memory, Place, Rplidar, room};
use cotorra_turtlebot::{
    Device, Turtlebot,
    kobuki::Base,
    rplidar::{Lidar, LidarSettings, Sample},
};

use super::*;
use crate::fixtures::{id, walk};

/// A driver in virtual time, with both devices.
struct Bench {
    driver: TurtlebotDriver,
    kobuki: Kobuki,
    rplidar: Rplidar,
    ports: [Memory; 2],
    ms: u64,
}

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

impl Bench {
    /// A robot at (1, 1) that looks along the y axis, in a room of 5 m × 4 m.
    fn new() -> Self {
        let place = Place { x: 1.0, y: 1.0, heading: std::f64::consts::FRAC_PI_2 };
        let ports = [Memory::default(), Memory::default()];
        let base = Device::on(Box::new(ports[0].clone()), Base::default(), at(0));
        let lidar = Lidar::new(LidarSettings::default());
        let lidar = Device::on(Box::new(ports[1].clone()), lidar, at(0));
        let walk = walk("robot1", &[(1.0, 1.0)]);
        let driver = TurtlebotDriver::new(
            id("robot1"),
            Position::new(place.x, place.y),
            place.heading,
            Some(&walk),
            Box::new(Turtlebot::on(base, Some(lidar))),
        )
        .with_lidar(Position::default(), 0.0);
        let rplidar = Rplidar::new(room((0.0, 0.0), (5.0, 4.0)), place);
        Self { driver, kobuki: Kobuki::at(place), rplidar, ports, ms: 0 }
    }

    fn run(&mut self, until: u64, command: Option<Velocity>) {
        while self.ms < until {
            self.ms += 1;
            let now = Duration::from_millis(self.ms);
            self.driver.advance(at(self.ms));
            if let Some(velocity) = command.filter(|_| self.ms.is_multiple_of(100)) {
                let _ = self.driver.command(at(self.ms), velocity);
            }
            let bytes = self.ports[0].exchange(self.kobuki.take_output());
            self.kobuki.receive(now, &bytes);
            self.rplidar.place = self.kobuki.place;
            let bytes = self.ports[1].exchange(self.rplidar.take_output());
            self.rplidar.receive(now, &bytes);
        }
    }

    /// Whether the base was last commanded to move.
    fn moves(&self) -> bool {
        self.kobuki.velocity() != (0.0, 0.0)
    }
}

#[test]
fn robot_is_absent_until_base_and_lidar_were_heard_and_then_drives_from_its_start() {
    let mut bench = Bench::new();
    assert_eq!(bench.driver.health(), [RobotFault::Absent]);
    let forward = Velocity::planar(0.2, 0.0);
    assert_eq!(bench.driver.command(at(0), forward), Err(CommandError::Unwell(RobotFault::Absent)));
    bench.run(500, None);
    assert_eq!(bench.driver.health(), []);
    assert_eq!(bench.driver.poll_notice().as_deref(), Some("robot robot1: its Kobuki has firmware 1.2.0"));
    assert_eq!(bench.driver.poll_notice(), None);
    bench.run(2500, Some(forward));
    let SensorData { pose, odometry, velocity, bumper, .. } = bench.driver.sensors();
    assert_eq!((pose, pose.source, bumper), (odometry, PoseSource::Odometry, false));
    let place = bench.kobuki.place;
    assert!((pose.x - place.x).abs() < 0.01 && (pose.y - place.y).abs() < 0.01, "{pose:?} {place:?}");
    assert!(pose.y > 1.35 && (velocity.linear - 0.2).abs() < 0.01, "{pose:?}");
    assert!(pose.covariance[0] > 0.0 && pose.covariance[8] > 0.0);
    assert_eq!(bench.driver.truth(), None);
}

#[test]
fn scan_has_the_shape_and_directions_of_a_simulated_one() {
    let mut bench = Bench::new();
    bench.run(1000, None);
    let scan = bench.driver.scan().unwrap();
    assert_eq!(scan.ranges.len(), RAYS);
    assert!(scan.turn.abs_diff(Duration::from_millis(100)) < Duration::from_millis(4), "{:?}", scan.turn);
    assert!((scan.angle_step + std::f64::consts::TAU / 360.0).abs() < 1e-12, "it turns clockwise");
    let range = |degrees: f64| {
        let off = |ray: &usize| {
            let off = (scan.angle(*ray).to_degrees() - degrees).rem_euclid(360.0);
            off.min(360.0 - off)
        };
        let ray = (0..RAYS).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        scan.ranges[ray]
    };
    // The wall ahead is at y = 4, the one on the left at x = 0, that on the right at x = 5.
    for (degrees, metres) in [(0.0, 3.0), (90.0, 1.0), (180.0, 1.0), (-90.0, 4.0)] {
        assert!((range(degrees) - metres).abs() < 0.02, "{degrees}°: {} m", range(degrees));
    }
    let seen = scan.ranges.iter().filter(|range| range.is_finite()).count();
    assert!(seen > 340, "{seen} rays hit a wall");
    assert!((bench.driver.sensors().nearest_obstacle_m.unwrap() - 1.0).abs() < 0.02);
}

#[test]
fn pose_of_the_lidar_on_the_robot_is_taken_into_account() {
    // It stands 10 cm ahead of the middle, and looks to the left.
    let mount = Planar { x: 0.1, y: 0.0, z: 0.0, heading: std::f64::consts::FRAC_PI_2 };
    // 90° clockwise of its front is ahead of the robot; 180° is the robot's right.
    let sample = |degrees: f64, range| Sample { angle: f64::to_radians(degrees), range };
    let samples =
        vec![sample(90.0, Some(2.0)), sample(180.0, Some(0.1)), sample(0.0, Some(13.0)), sample(270.0, None)];
    let seen = scan(&Turn { at: at(5), period: Duration::from_millis(100), samples }, mount);
    assert!((f64::from(seen.ranges[90]) - 2.1).abs() < 1e-6 && seen.angle(90).abs() < 1e-9);
    assert_eq!(seen.ranges.iter().filter(|range| !range.is_nan()).count(), 3);
    assert!(seen.ranges.contains(&f32::NEG_INFINITY) && seen.ranges.contains(&f32::INFINITY));
    assert_eq!(seen.at, at(5));
}

#[test]
fn robot_stops_0_6_s_after_the_last_command() {
    let mut bench = Bench::new();
    bench.run(2000, Some(Velocity::planar(0.2, 0.0)));
    bench.run(2599, None);
    assert!(bench.moves());
    bench.run(2602, None);
    assert!(!bench.moves(), "{:?}", bench.kobuki.controls.last());
}

#[test]
fn silent_lidar_or_a_cliff_stops_the_robot_until_it_is_well() {
    let forward = Velocity::planar(0.2, 0.0);
    let mut bench = Bench::new();
    bench.run(2000, Some(forward));
    assert!(bench.moves());
    bench.rplidar.is_silent = true;
    bench.run(3100, Some(forward));
    assert_eq!(bench.driver.health(), [RobotFault::Silent]);
    assert!(!bench.moves());
    let refused = bench.driver.command(at(3100), forward);
    assert_eq!(refused, Err(CommandError::Unwell(RobotFault::Silent)));
    bench.rplidar.is_silent = false;
    bench.run(7000, Some(forward));
    assert_eq!((bench.driver.health(), bench.moves()), (&[][..], true), "it was started again");
    bench.kobuki.cliff = 1;
    bench.run(7100, Some(forward));
    assert_eq!((bench.driver.health(), bench.moves()), (&[RobotFault::Cliff][..], false));
}

#[test]
fn velocities_are_limited_by_the_walk_and_nan_is_rejected() {
    let mut bench = Bench::new();
    bench.run(500, None);
    assert_eq!(bench.driver.command(at(500), Velocity::planar(0.6, 1.0)), Ok(Velocity::planar(0.3, 0.5)));
    let refused = bench.driver.command(at(500), Velocity::planar(f64::NAN, 0.0));
    assert!(matches!(refused, Err(CommandError::NotFinite(_))));
    bench.run(600, None);
    assert!(bench.moves(), "the command before goes on");
    bench.driver.stop(at(600));
    bench.run(601, None);
    assert!(!bench.moves());
}

#[test]
fn battery_and_gyro_are_read_once_per_feedback() {
    let sensor = |name: &str, kind| Sensor {
        id: SensorId::new(name).unwrap(),
        interval: Duration::from_secs(1),
        kind,
    };
    let (pack, imu) = (sensor("pack", SensorKind::Battery { charge: None }), sensor("imu", SensorKind::Imu));
    let mut bench = Bench::new();
    assert_eq!(bench.driver.sense(at(0), &pack), None);
    bench.run(1000, None);
    bench.run(2000, Some(Velocity::planar(0.0, 0.5)));
    let (measured, values) = bench.driver.sense(at(2000), &pack).unwrap();
    assert!(measured > at(1950) && values[1] == 16.0 && (values[0] - 0.856).abs() < 0.001, "{values:?}");
    assert_eq!(bench.driver.sense(at(2000), &pack), None);
    let (_, values) = bench.driver.sense(at(2000), &imu).unwrap();
    assert!((values[2] - 0.5).abs() < 0.01 && values[3..].iter().all(|value| value.is_nan()), "{values:?}");
    let lidar = sensor("front", SensorKind::Lidar { keep_bytes: 1 });
    assert!(bench.driver.capture(&lidar, None).is_some());
}

#[test]
fn dropped_driver_leaves_base_and_lidar_at_rest() {
    let mut bench = Bench::new();
    bench.run(2000, Some(Velocity::planar(0.2, 0.0)));
    let Bench { driver, mut kobuki, mut rplidar, ports, .. } = bench;
    assert!(kobuki.velocity().0 > 0.0 && rplidar.motor > 0);
    drop(driver);
    kobuki.receive(Duration::from_millis(2001), &ports[0].exchange(Vec::new()));
    rplidar.receive(Duration::from_millis(2001), &ports[1].exchange(Vec::new()));
    assert_eq!((kobuki.velocity(), rplidar.motor), ((0.0, 0.0), 0));
}
