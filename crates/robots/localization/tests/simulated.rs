//! Localization of a simulated robot in the corridor and in rooms: it is followed, found without a known start, and found
//! again when it was carried away. Its covariance matches its errors.

#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{path::Path, sync::Arc, time::Duration};

use cotorra_graph::{Cell, Node, NodeKind, OccupancyGrid, Position, Robot, Timestamp, Velocity};
use cotorra_graph_testing as base;
use cotorra_localization::{
    Estimate, LikelihoodField, LocalizationError, Localizer, Parameters, Pose2, Scan,
    trajectory::{Errors, rank_correlation},
};
use cotorra_robot_middleware::{RobotDriver, SimulatedRobot, World};
use cotorra_testbed_file::map_server;

const WALK: [(f64, f64); 5] = [(27.1, -12.4), (27.2, -9.4), (27.5, -6.2), (25.5, -4.3), (22.5, -2.4)];
/// Interval between scans.
const PERIOD: Duration = Duration::from_millis(100);
const SEEDS: std::ops::Range<u64> = 1..3;

fn corridor() -> OccupancyGrid {
    map_server::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../testbeds/maps/corridor.yaml"))
        .unwrap()
}

/// Rooms of different sizes beside a corridor, 20 m × 12 m, with doors.
fn rooms() -> OccupancyGrid {
    let (width, height) = (400, 240);
    let wall = |row: usize, column: usize| {
        let edge = row == 0 || column == 0 || row == height - 1 || column == width - 1;
        let beside = (row == 100 || row == 140) && !(column % 130 > 30 && column % 130 < 52);
        let between = row > 140 && (column == 110 || column == 270);
        let below = row < 100 && (column == 70 || column == 180 || column == 310);
        let cupboard = (200..230).contains(&row) && (20..40).contains(&column);
        edge || beside || between || below || cupboard
    };
    let cells = (0..width * height)
        .map(|i| if wall(i / width, i % width) { Cell::Occupied } else { Cell::Free })
        .collect();
    OccupancyGrid::new(width, height, 0.05, Position::default(), cells).unwrap()
}

/// A simulated robot that drives from place to place, and back.
struct Drive {
    robot: SimulatedRobot,
    places: Vec<(f64, f64)>,
    next: usize,
    now: Timestamp,
    /// Offset of the odometry after the robot was carried away.
    carried: Pose2,
    /// Motion during the last scan, by odometry.
    sweep: Pose2,
}

impl Drive {
    fn new(world: &Arc<World>, seed: u64, places: &[(f64, f64)]) -> Self {
        let heading = (places[1].1 - places[0].1).atan2(places[1].0 - places[0].0);
        let robot = NodeKind::Robot(Robot { heading, ..base::robot("air") });
        let position = Some(Position::new(places[0].0, places[0].1));
        let node = Node { position, ..base::node("robot", robot) };
        let robot = SimulatedRobot::new(&node, None, Arc::clone(world), seed).unwrap();
        let back = places.iter().rev().skip(1);
        let places = places.iter().chain(back).copied().collect();
        Self {
            robot,
            places,
            next: 1,
            now: Timestamp::ZERO,
            carried: Pose2::default(),
            sweep: Pose2::default(),
        }
    }

    fn truth(&self) -> Pose2 {
        let pose = self.robot.pose();
        Pose2::new(pose.x, pose.y, pose.heading)
    }

    fn odometry(&self) -> Pose2 {
        let pose = self.robot.sensors().odometry;
        self.carried * Pose2::new(pose.x, pose.y, pose.heading)
    }

    /// Drives until the next scan. Returns false at the end.
    fn go_on(&mut self) -> bool {
        let at = self.truth();
        let Some(&(x, y)) = self.places.get(self.next) else { return false };
        if at.distance(Pose2::new(x, y, 0.0)) < 0.3 {
            self.next += 1;
        }
        let off = Pose2::new(0.0, 0.0, (y - at.y).atan2(x - at.x) - at.heading).heading;
        let linear = if off.abs() < 0.5 { 0.3 } else { 0.0 };
        self.robot.command(self.now, Velocity::planar(linear, (1.5 * off).clamp(-0.8, 0.8))).unwrap();
        let before = self.odometry();
        self.now = self.now + PERIOD;
        self.robot.advance(self.now);
        self.sweep = before.step_to(self.odometry());
        true
    }

    fn observe(&self, localizer: &mut Localizer) -> Option<Estimate> {
        self.observe_past(localizer, 0.0)
    }

    /// Observes while people at a distance of 0.5 m hide this share of the beams.
    fn observe_past(&self, localizer: &mut Localizer, share: f64) -> Option<Estimate> {
        let turn = self.robot.scan()?;
        let mut ranges = turn.ranges.clone();
        let hidden = (share * ranges.len() as f64) as usize;
        ranges.iter_mut().take(hidden).for_each(|range| *range = range.min(0.5));
        let scan = Scan {
            angle_min: turn.first_angle,
            angle_increment: turn.angle_step,
            ranges: &ranges,
            mount: Pose2::default(),
            sweep: self.sweep,
        };
        Some(localizer.observe(self.odometry(), &scan).unwrap())
    }

    fn follow(&mut self, localizer: &mut Localizer) -> Errors {
        let mut errors = Errors::default();
        while self.go_on() {
            if let Some(estimate) = self.observe(localizer) {
                errors.push(&estimate.belief(), self.truth());
            }
        }
        errors
    }
}

/// AMCL with a TurtleBot's lidar.
fn amcl() -> Parameters {
    let mut parameters = Parameters::amcl();
    parameters.beams.range_max = 12.0;
    parameters
}

const ABOUT: [f64; 9] = [0.04, 0.0, 0.0, 0.0, 0.04, 0.0, 0.0, 0.0, 0.01];

#[test]
fn robot_is_followed_along_the_corridor() {
    let (map, parameters) = (corridor(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    for seed in SEEDS {
        let mut drive = Drive::new(&world, seed, &WALK);
        let mut localizer =
            Localizer::at(Arc::clone(&field), parameters, seed, drive.truth(), &ABOUT).unwrap();
        let errors = drive.follow(&mut localizer);
        assert!(errors.len() > 500, "{}", errors.len());
        assert!(errors.position_rmse() < 0.07 && errors.farthest() < 0.25, "seed {seed}: {errors}");
        assert!(errors.heading_rmse() < 0.02, "seed {seed}: {errors}");
        // The covariance matches the errors.
        assert!((0.5..6.0).contains(&errors.mean_nees()), "seed {seed}: {errors}");
    }
}

#[test]
fn amcl_parameters_follow_a_robot() {
    let (map, parameters) = (rooms(), amcl());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    let mut drive = Drive::new(&world, 1, &[(2.0, 6.0), (18.0, 6.0)]);
    let mut localizer = Localizer::at(field, parameters, 1, drive.truth(), &ABOUT).unwrap();
    let errors = drive.follow(&mut localizer);
    assert!(errors.position_rmse() < 0.15 && errors.lost() == 0.0, "{errors}");
}

#[test]
fn robot_is_found_without_a_known_start() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    for seed in SEEDS {
        let mut drive =
            Drive::new(&world, seed, &[(15.0, 8.5), (18.0, 10.5), (15.0, 9.0), (15.0, 6.0), (8.0, 6.0)]);
        let mut localizer = Localizer::anywhere(Arc::clone(&field), parameters, seed).unwrap();
        // The filter has the first 4 m to find the robot.
        for _ in 0..200 {
            assert!(drive.go_on());
            drive.observe(&mut localizer);
        }
        let errors = drive.follow(&mut localizer);
        assert!(errors.position_rmse() < 0.06 && errors.lost() == 0.0, "seed {seed}: {errors}");
    }
}

#[test]
fn robot_is_found_again_after_it_was_carried_away() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    for seed in SEEDS {
        let mut drive = Drive::new(&world, seed, &[(2.0, 6.0), (12.0, 6.0), (3.0, 6.0)]);
        let mut localizer =
            Localizer::at(Arc::clone(&field), parameters, seed, drive.truth(), &ABOUT).unwrap();
        let errors = drive.follow(&mut localizer);
        assert_eq!(errors.lost(), 0.0, "seed {seed}: {errors}");
        let before = drive.odometry();
        // It is carried into a room 14 m away; its wheels do not turn.
        let mut drive = Drive::new(&world, seed, &[(18.0, 10.5), (15.0, 9.0), (15.0, 6.0), (8.0, 6.0)]);
        drive.carried = before * drive.odometry().inverse();
        for _ in 0..250 {
            assert!(drive.go_on());
            drive.observe(&mut localizer);
        }
        let errors = drive.follow(&mut localizer);
        assert!(errors.position_rmse() < 0.06 && errors.lost() == 0.0, "seed {seed}: {errors}");
    }
}

/// The rooms with walls up to so many cells off, to varying sides.
fn roughly_mapped_rooms(cells_off: f64) -> OccupancyGrid {
    let rooms = rooms();
    let (width, height) = (rooms.width(), rooms.height());
    let moved = |at: usize, along: usize, length: usize| {
        let off = (cells_off * (along as f64 / 15.0).sin()).round() as isize;
        at.saturating_add_signed(off).min(length - 1)
    };
    let cells = (0..width * height)
        .map(|i| rooms.cell(moved(i % width, i / width, width), moved(i / width, i % width, height)))
        .collect();
    OccupancyGrid::new(width, height, 0.05, Position::default(), cells).unwrap()
}

/// Parameters for a TurtleBot on a map that somebody drew from scans.
fn of_rough_maps() -> Parameters {
    let Parameters { systematic, disagreement, .. } = Parameters::default();
    Parameters { systematic, disagreement, ..Parameters::turtlebot2() }
}

const ALONG_THE_CORRIDOR: &[(f64, f64)] = &[(2.0, 6.0), (8.0, 6.0)];
const THROUGH_ROOMS: &[(f64, f64)] = &[
    (2.0, 6.0),
    (2.0, 3.5),
    (2.0, 6.0),
    (8.5, 6.0),
    (8.5, 8.5),
    (11.0, 9.5),
    (8.5, 8.5),
    (8.5, 6.0),
    (15.0, 6.0),
    (15.0, 3.5),
    (15.0, 6.0),
    (15.0, 9.0),
    (18.0, 10.5),
];

/// Reported deviations, errors, and whether the true pose is inside the 95 % ellipse, for each scan that is used.
#[derive(Default)]
struct Told {
    deviations: Vec<f64>,
    errors: Vec<f64>,
    inside: Vec<bool>,
}

impl Told {
    /// Adds those of a walk in this world, by this map.
    fn add(&mut self, world: &Arc<World>, map: &OccupancyGrid, walk: &[(f64, f64)], seed: u64) {
        let parameters = of_rough_maps();
        let field = Arc::new(LikelihoodField::new(map, &parameters));
        let mut drive = Drive::new(world, seed, walk);
        let mut localizer = Localizer::at(field, parameters, seed, drive.truth(), &ABOUT).unwrap();
        while drive.go_on() {
            let Some(estimate) = drive.observe(&mut localizer).filter(|estimate| estimate.updated) else {
                continue;
            };
            self.deviations.push((estimate.covariance[0] + estimate.covariance[4]).sqrt());
            self.errors.push(estimate.pose.distance(drive.truth()));
            // The quantile of χ² with three degrees of freedom: x, y and heading.
            self.inside.push(estimate.belief().nees(drive.truth()).unwrap() <= 7.815);
        }
    }

    fn extend(&mut self, other: Self) {
        self.deviations.extend(other.deviations);
        self.errors.extend(other.errors);
        self.inside.extend(other.inside);
    }

    fn share_inside(&self) -> f64 {
        self.inside.iter().filter(|inside| **inside).count() as f64 / self.inside.len() as f64
    }

    fn rank(&self) -> f64 {
        rank_correlation(&self.deviations, &self.errors)
    }
}

#[test]
fn true_pose_is_inside_the_95_percent_ellipse_95_percent_of_the_time() {
    let world = Arc::new(World::new(&rooms()));
    let (mut all, mut roughest) = (Told::default(), Told::default());
    // Walls up to 5, 10, 15 and 20 cm off. The ellipse was chosen for public logs, whose maps differ as well: on one map
    // it is too wide, and on another too narrow.
    for cells_off in [1.0, 2.0, 3.0, 3.6] {
        let map = roughly_mapped_rooms(cells_off);
        for seed in 1..5 {
            all.add(&world, &map, ALONG_THE_CORRIDOR, seed);
        }
        all.add(&world, &map, THROUGH_ROOMS, 1);
    }
    // With the last map, the errors along the corridor are as large as on the worst of the logs indoors: 7 cm.
    for seed in 1..9 {
        roughest.add(&world, &roughly_mapped_rooms(3.6), ALONG_THE_CORRIDOR, seed);
    }
    let (share, least) = (all.share_inside(), roughest.share_inside());
    assert!(all.errors.len() > 1000 && (0.93..0.99).contains(&share), "{share} of {}", all.errors.len());
    assert!(roughest.errors.len() > 300 && (0.9..0.99).contains(&least), "{least}");
}

#[test]
fn deviation_is_larger_on_a_map_that_is_off() {
    let world = Arc::new(World::new(&rooms()));
    let (mut exact, mut rough) = (Told::default(), Told::default());
    for seed in SEEDS {
        exact.add(&world, &rooms(), THROUGH_ROOMS, seed);
        rough.add(&world, &roughly_mapped_rooms(3.6), THROUGH_ROOMS, seed);
    }
    // On one map, it does not tell a better pose from a worse one: walls that are off together agree about the pose.
    let alone = [exact.rank(), rough.rank()];
    assert!(alone.iter().all(|rank| rank.abs() < 0.2), "{alone:?}");
    exact.extend(rough);
    let (rank, share) = (exact.rank(), exact.share_inside());
    assert!(exact.errors.len() > 1000 && rank > 0.5 && share > 0.9, "{rank}, {share}");
}

#[test]
fn lost_robot_has_a_large_deviation_and_is_found_within_some_metres() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    let places: [&[(f64, f64)]; 4] = [
        &[(18.0, 10.5), (15.0, 9.0), (15.0, 6.0), (8.0, 6.0)],
        &[(10.0, 10.0), (8.5, 8.5), (8.5, 6.0), (14.0, 6.0)],
        &[(12.0, 1.5), (15.0, 3.5), (15.0, 6.0), (9.0, 6.0)],
        &[(6.0, 1.5), (8.5, 3.5), (8.5, 6.0), (15.0, 6.0)],
    ];
    let (mut recovery, mut lost, mut vain) = (Vec::new(), 0, 0);
    for (seed, places) in (1..3).flat_map(|seed| places.map(|places| (seed, places))) {
        let mut drive = Drive::new(&world, seed, &[(2.0, 6.0), (4.0, 6.0)]);
        let mut localizer =
            Localizer::at(Arc::clone(&field), parameters, seed, drive.truth(), &ABOUT).unwrap();
        assert_eq!(drive.follow(&mut localizer).lost(), 0.0);
        let before = drive.odometry();
        let mut drive = Drive::new(&world, seed, places);
        drive.carried = before * drive.odometry().inverse();
        let (mut gone, mut last, mut found) = (0.0, drive.truth(), 0.0);
        while gone < 12.0 && drive.go_on() {
            gone += last.distance(drive.truth());
            last = drive.truth();
            let Some(estimate) = drive.observe(&mut localizer) else { continue };
            if estimate.pose.distance(last) > 0.5 {
                found = gone;
                lost += 1;
                let claimed = (estimate.covariance[0] + estimate.covariance[4]).sqrt();
                vain += usize::from(claimed < 0.3);
            }
        }
        recovery.push(found);
    }
    recovery.sort_by(f64::total_cmp);
    assert!(lost > 0 && vain * 10 <= lost, "{vain} of {lost} lost scans claim to know");
    assert!(recovery[4] <= 3.0 && recovery[7] <= 10.0, "{recovery:?}");
}

/// Two equal rooms, 8 m × 5 m, with a corridor along both. With one cupboard, it is in the second room; with two, in both.
fn twins(cupboards: usize) -> OccupancyGrid {
    let (width, height) = (340, 160);
    let wall = |row: usize, column: usize| {
        let edge = row == 0 || column == 0 || row == height - 1 || column == width - 1;
        let beside = row == 100 && !(60..82).contains(&(column % 170));
        let between = row < 100 && column.is_multiple_of(170);
        let cupboard = (20..60).contains(&row) && (110..150).contains(&(column % 170));
        edge || beside || between || cupboard && column / 170 >= 2 - cupboards
    };
    let cells = (0..width * height)
        .map(|i| if wall(i / width, i % width) { Cell::Occupied } else { Cell::Free })
        .collect();
    OccupancyGrid::new(width, height, 0.05, Position::default(), cells).unwrap()
}

#[test]
fn estimate_does_not_jump_to_a_similar_room_that_fits_better() {
    let parameters = Parameters::turtlebot2();
    // The first room has a cupboard that is not on the map, where the second room has one.
    let (map, world) = (twins(1), Arc::new(World::new(&twins(2))));
    let field = Arc::new(LikelihoodField::new(&map, &parameters));
    for seed in SEEDS {
        let mut drive = Drive::new(&world, seed, &[(3.5, 6.5), (3.5, 3.5), (5.5, 3.2), (2.0, 1.5)]);
        let mut localizer =
            Localizer::at(Arc::clone(&field), parameters, seed, drive.truth(), &ABOUT).unwrap();
        let (mut gone, mut last) = (0.0, drive.truth());
        while drive.go_on() {
            gone += last.distance(drive.truth());
            last = drive.truth();
            // In each 3 m, people hide half of all beams for 0.5 m.
            let hidden = if gone % 3.0 > 2.5 { 0.5 } else { 0.0 };
            let Some(estimate) = drive.observe_past(&mut localizer, hidden) else { continue };
            let off = estimate.pose.distance(last);
            assert!(off < 0.3, "seed {seed}: {off} m off after {gone} m");
        }
        assert!(gone > 10.0, "{gone}");
    }
}

#[test]
fn standing_robot_that_is_carried_away_is_sought_at_once() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    let mut drive = Drive::new(&world, 1, &[(2.0, 6.0), (4.0, 6.0)]);
    let mut localizer = Localizer::at(field, parameters, 1, drive.truth(), &ABOUT).unwrap();
    drive.follow(&mut localizer);
    let deviation = |estimate: &Estimate| (estimate.covariance[0] + estimate.covariance[4]).sqrt();
    let stands = drive.observe(&mut localizer).unwrap();
    assert!(!stands.updated && deviation(&stands) < 0.1, "{stands:?}");
    let before = drive.odometry();
    let mut drive = Drive::new(&world, 1, &[(18.0, 10.5), (15.0, 9.0)]);
    assert!(drive.go_on());
    drive.carried = before * drive.odometry().inverse();
    let carried = drive.observe(&mut localizer).unwrap();
    assert!(carried.updated && deviation(&carried) > 1.0, "{carried:?}");
    // The same scan again changes nothing.
    assert!(!drive.observe(&mut localizer).unwrap().updated);
}

#[test]
fn same_seed_gives_the_same_trajectory() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let (world, field) = (Arc::new(World::new(&map)), Arc::new(LikelihoodField::new(&map, &parameters)));
    let trajectory = |seed| {
        let mut drive = Drive::new(&world, 1, &[(2.0, 6.0), (5.0, 6.0)]);
        let mut localizer =
            Localizer::at(Arc::clone(&field), parameters, seed, drive.truth(), &ABOUT).unwrap();
        let mut estimates = Vec::new();
        while drive.go_on() {
            estimates.extend(drive.observe(&mut localizer));
        }
        estimates
    };
    assert_eq!(trajectory(1), trajectory(1));
    assert_ne!(trajectory(1), trajectory(2));
}

#[test]
fn invalid_poses_and_maps_are_rejected() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let field = Arc::new(LikelihoodField::new(&map, &parameters));
    let mut localizer = Localizer::at(field, parameters, 1, Pose2::new(2.0, 6.0, 0.0), &ABOUT).unwrap();
    let scan = Scan {
        angle_min: 0.0,
        angle_increment: 0.1,
        ranges: &[2.0; 60],
        mount: Pose2::default(),
        sweep: Pose2::default(),
    };
    let before = localizer.observe(Pose2::default(), &scan).unwrap();
    let nowhere = Pose2 { x: f64::NAN, y: 0.0, heading: 0.0 };
    assert!(localizer.observe(nowhere, &scan).is_err());
    let after = localizer.observe(Pose2::default(), &scan).unwrap();
    assert_eq!((before.pose, after.updated), (after.pose, false));
    // Finite, but beyond the valid range.
    let far = Pose2 { x: 1e300, y: 0.0, heading: 0.0 };
    assert_eq!(localizer.observe(far, &scan), Err(LocalizationError::NoPose(far)));
    let mounted = Scan { mount: far, ..scan };
    assert!(localizer.observe(Pose2::default(), &mounted).is_err());
    // A lidar that sees nothing, and maps without free space or walls.
    let blind = Scan { ranges: &[f32::INFINITY; 60], ..scan };
    assert!(!localizer.observe(Pose2::new(1.0, 0.0, 0.0), &blind).unwrap().updated);
    for (cell, reason) in
        [(Cell::Occupied, LocalizationError::NoFreeSpace), (Cell::Free, LocalizationError::NoWall)]
    {
        let map = OccupancyGrid::new(2, 2, 0.05, Position::default(), vec![cell; 4]).unwrap();
        let field = Arc::new(LikelihoodField::new(&map, &parameters));
        assert_eq!(Localizer::anywhere(Arc::clone(&field), parameters, 1).unwrap_err(), reason);
        let at = Localizer::at(field, parameters, 1, Pose2::default(), &ABOUT);
        assert_eq!(at.unwrap_err(), reason);
    }
}

#[test]
fn blind_first_scan_leaves_the_next_one_to_find_the_robot() {
    let (map, parameters) = (rooms(), Parameters::turtlebot2());
    let field = Arc::new(LikelihoodField::new(&map, &parameters));
    let start = Pose2::new(2.0, 6.0, 0.0);
    let mut localizer = Localizer::at(field, parameters, 1, start, &ABOUT).unwrap();
    let scan = |ranges| Scan {
        angle_min: 0.0,
        angle_increment: 0.1,
        ranges,
        mount: Pose2::default(),
        sweep: Pose2::default(),
    };
    let blind = localizer.observe(start, &scan(&[f32::NAN; 60])).unwrap();
    assert!(!blind.updated && blind.covariance.iter().all(|entry| entry.is_finite()));
    assert!(blind.pose.distance(start) < 0.1);
    assert!(localizer.observe(start, &scan(&[2.0; 60])).unwrap().updated);
}
