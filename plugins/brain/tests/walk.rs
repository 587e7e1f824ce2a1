//! Closed loop: the brain walks a small kinematic model of the robot, in virtual time.
#![allow(clippy::unwrap_used, reason = "clippy knows helpers of integration tests for no tests")]

use std::collections::VecDeque;

use cotorra_brain::Brain;
use cotorra_graph::{Cell, Event, Instruction, OccupancyGrid, Pose, Position, Testbed, Timestamp, Velocity};
use cotorra_plugin::{Actions, Plugin};
use cotorra_testing::{
    corridor,
    robot::{RADIUS, context, pose, robot, testbed},
};
use proptest::prelude::*;

/// Seconds between two steps of the model.
const TICK: f64 = 0.02;
/// Ticks between two contexts: 5 Hz.
const CONTROL: usize = 10;
/// m/s², of a Kobuki base.
const ACCELERATION: f64 = 0.5;
/// rad/s².
const TURN_ACCELERATION: f64 = 2.0;

/// Record of a walk.
#[derive(Debug, PartialEq)]
struct Course {
    seconds: f64,
    finished: bool,
    poses: Vec<(f64, f64, f64)>,
    speeds: Vec<f64>,
    /// The nearest that the robot's outline came to an obstacle, metres.
    clearance: f64,
    reasons: Vec<String>,
}

impl Course {
    fn median_speed(&self) -> f64 {
        let mut speeds = self.speeds.clone();
        speeds.sort_by(f64::total_cmp);
        speeds[speeds.len() / 2]
    }

    fn nearest_to(&self, place: Position) -> f64 {
        self.poses.iter().map(|p| Position::new(p.0, p.1).distance(place)).fold(f64::INFINITY, f64::min)
    }
}

fn started(testbed: &Testbed) -> Brain {
    let mut brain = Brain::new();
    brain.start(Timestamp::ZERO, testbed, &mut Actions::default());
    brain
}

fn ask(brain: &mut Brain, event: &Event) -> (Velocity, u32, Option<String>) {
    let mut actions = Actions::default();
    brain.handle(Timestamp::ZERO, event, &mut actions);
    let mut wanted: Vec<_> = actions.drain().collect();
    assert_eq!(wanted.len(), 1, "one answer a context");
    match wanted.remove(0) {
        (Instruction::Move { robot: r, velocity, waypoint }, reason) if r == robot() => {
            (velocity, waypoint, reason)
        }
        other => panic!("not a move of the robot: {other:?}"),
    }
}

/// Walks from `start`, with `first` as the next waypoint, until the walk ends or `limit` seconds have passed. Answers take effect `latency` ticks late.
/// `answer` is given the number of the context and the context.
fn walk(
    testbed: &Testbed,
    (start, first): (Pose, u32),
    latency: usize,
    limit: f64,
    mut answer: impl FnMut(usize, &Event) -> (Velocity, u32, Option<String>),
) -> Course {
    let mut course = Course {
        seconds: 0.0,
        finished: false,
        poses: Vec::new(),
        speeds: Vec::new(),
        clearance: f64::INFINITY,
        reasons: Vec::new(),
    };
    let end = testbed.walk(&robot()).unwrap().waypoints.len() as u32;
    let (mut at, mut moving, mut asked, mut waypoint) =
        (start, Velocity::default(), Velocity::default(), first);
    let mut under_way = VecDeque::new();
    let approach = |from: f64, to: f64, by: f64| from + (to - from).clamp(-by, by);
    for tick in 0..(limit / TICK) as usize {
        if tick % CONTROL == 0 {
            let (velocity, next, reason) = answer(tick / CONTROL, &context(at, waypoint));
            under_way.push_back((tick + latency, velocity, next));
            course.reasons.extend(reason);
            course.poses.push((at.x, at.y, at.heading));
            course.speeds.push(moving.linear);
            if let Some(map) = &testbed.map {
                course.clearance = course.clearance.min(outline_clearance(map, at.position()));
            }
        }
        while under_way.front().is_some_and(|(due, ..)| *due <= tick) {
            (_, asked, waypoint) = under_way.pop_front().unwrap();
        }
        moving.linear = approach(moving.linear, asked.linear, ACCELERATION * TICK);
        moving.angular = approach(moving.angular, asked.angular, TURN_ACCELERATION * TICK);
        at.heading += moving.angular * TICK;
        at.x += moving.linear * at.heading.cos() * TICK;
        at.y += moving.linear * at.heading.sin() * TICK;
        course.seconds = tick as f64 * TICK;
        if waypoint == end && moving == Velocity::default() {
            course.finished = true;
            break;
        }
    }
    course
}

/// Metres between the robot's outline and the nearest cell that is not free, looked for within 0.3 m of it.
fn outline_clearance(map: &OccupancyGrid, at: Position) -> f64 {
    let half = map.resolution() / 2.0;
    let steps = ((RADIUS + 0.3) / map.resolution()) as i32 + 1;
    let mut nearest = RADIUS + 0.3;
    for (i, j) in (-steps..=steps).flat_map(|i| (-steps..=steps).map(move |j| (i, j))) {
        let place =
            Position::new(at.x + f64::from(i) * map.resolution(), at.y + f64::from(j) * map.resolution());
        if map.at(place) == Cell::Free {
            continue;
        }
        let centre = map.index(place).map_or(place, |(column, row)| map.centre(column, row));
        let dx = ((centre.x - at.x).abs() - half).max(0.0);
        let dy = ((centre.y - at.y).abs() - half).max(0.0);
        nearest = nearest.min(dx.hypot(dy));
    }
    nearest - RADIUS
}

fn corridor_course(latency: usize) -> Course {
    let testbed = corridor();
    let mut brain = started(&testbed);
    walk(&testbed, (pose(25.5, -27.8, 1.57), 0), latency, 600.0, |_, event| ask(&mut brain, event))
}

#[test]
fn walks_the_corridor_out_and_back_in_the_published_time() {
    let course = corridor_course(1);
    println!("{:.1} s, median {:.3} m/s", course.seconds, course.median_speed());
    assert!(course.finished);
    assert!((390.0..460.0).contains(&course.seconds), "{} s", course.seconds);
    assert!((0.28..=0.3).contains(&course.median_speed()), "{} m/s", course.median_speed());
    assert!(course.clearance > 0.2, "{} m from a wall", course.clearance);
    assert!(course.speeds.iter().all(|&v| (-1e-9..=0.3 + 1e-9).contains(&v)));
    let waypoints = &corridor().walks[0].waypoints;
    assert!(waypoints.iter().all(|&w| course.nearest_to(w) < 0.5), "no waypoint is left out");
    assert_eq!(course.reasons, Vec::<String>::new());
    assert_eq!(corridor_course(1), course, "the same walk every time");
}

#[test]
fn late_answers_do_not_mislead_the_robot() {
    let course = corridor_course(10);
    assert!(course.finished && course.clearance > 0.2, "{} m from a wall", course.clearance);
    assert!((390.0..460.0).contains(&course.seconds), "{} s", course.seconds);
}

#[test]
fn a_migration_at_any_moment_changes_nothing() {
    let testbed = corridor();
    let start = (pose(25.5, -27.8, -1.0), 0);
    let mut stays = started(&testbed);
    let home = walk(&testbed, start, 1, 60.0, |_, event| ask(&mut stays, event));
    let mut instances: Vec<Brain> = (0..3).map(|_| started(&testbed)).collect();
    let away = walk(&testbed, start, 1, 60.0, |n, event| ask(&mut instances[n * 7 % 3], event));
    assert_eq!(home, away);
}

#[test]
fn returns_to_its_way_from_anywhere_on_the_floor() {
    let testbed = corridor();
    let mut brain = started(&testbed);
    // Beside its leg, around a corner from it, and behind the end.
    for start in [(pose(24.5, -20.0, 0.0), 3), (pose(28.6, -5.0, 0.3), 9), (pose(-3.5, 0.4, 3.1), 18)] {
        let course = walk(&testbed, start, 1, 900.0, |_, event| ask(&mut brain, event));
        assert!(course.finished && course.clearance > 0.0, "from {start:?}: {} m", course.clearance);
    }
}

#[test]
fn in_open_space_it_walks_straight() {
    let testbed =
        testbed(None, vec![Position::new(0.0, 0.0), Position::new(5.0, 0.0), Position::new(5.0, 5.0)]);
    let mut brain = started(&testbed);
    let course = walk(&testbed, (pose(0.0, 0.0, 0.0), 0), 1, 120.0, |_, event| ask(&mut brain, event));
    assert!(course.finished);
    assert!(course.poses.iter().all(|p| p.0 < 5.3 && p.1 > -0.1));
    assert!(course.nearest_to(Position::new(5.0, 5.0)) < 0.15);
}

#[test]
fn at_the_end_it_stands_still() {
    let testbed = corridor();
    let mut brain = started(&testbed);
    let end = testbed.walks[0].waypoints.len() as u32;
    for waypoint in [end, end + 1, u32::MAX] {
        let answer = ask(&mut brain, &context(pose(3.0, 0.0, 0.0), waypoint));
        assert_eq!(answer, (Velocity::default(), end, None));
    }
}

#[test]
fn robot_stops_with_a_reason_where_no_path_leads() {
    let cases = [
        (Position::new(10.0, 10.0), "(10.0, 10.0) is not on the map's floor"),
        (Position::new(100.0, 0.0), "(100.0, 0.0) is not on the map's floor"),
        (Position::new(25.6, -29.7), "(25.6, -29.7) is 0.12 m from an obstacle, too near for the robot"),
    ];
    for (goal, reason) in cases {
        let testbed = testbed(corridor().map, vec![Position::new(25.5, -27.8), goal]);
        let mut brain = started(&testbed);
        let (velocity, waypoint, said) = ask(&mut brain, &context(pose(25.5, -27.8, 0.0), 0));
        assert_eq!((velocity, waypoint, said.as_deref()), (Velocity::default(), 1, Some(reason)));
    }
    let mut brain = started(&corridor());
    let (velocity, _, said) = ask(&mut brain, &context(pose(10.0, 10.0, 0.0), 3));
    assert_eq!(said.as_deref(), Some("the robot at (10.0, 10.0) is off the map's floor"));
    assert_eq!(velocity, Velocity::default());
    let (velocity, _, said) = ask(&mut brain, &context(pose(f64::NAN, 10.0, 0.0), 3));
    assert_eq!(said.as_deref(), Some("the robot's pose is not a number"));
    assert_eq!(velocity, Velocity::default());
}

#[test]
fn contexts_of_robots_without_a_walk_are_left_alone() {
    let mut testbed = corridor();
    testbed.walks.clear();
    let mut actions = Actions::default();
    started(&testbed).handle(Timestamp::ZERO, &context(pose(0.0, 0.0, 0.0), 0), &mut actions);
    assert!(actions.is_empty());
}

/// A walled room of 6 m x 6 m with pillars, and a walk between opposite corners.
fn room(pillars: &[(usize, usize)]) -> Testbed {
    let side = 60;
    let cell = |i: usize| {
        let (x, y) = (i % side, i / side);
        let wall = x == 0 || y == 0 || x == side - 1 || y == side - 1;
        let pillar = pillars.iter().any(|&(px, py)| x.abs_diff(px) <= 2 && y.abs_diff(py) <= 2);
        if wall || pillar { Cell::Occupied } else { Cell::Free }
    };
    let grid =
        OccupancyGrid::new(side, side, 0.1, Position::new(0.0, 0.0), (0..side * side).map(cell).collect());
    testbed(grid, vec![Position::new(0.8, 0.8), Position::new(5.2, 5.2), Position::new(0.8, 5.2)])
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_walk_touches_a_wall(
        pillars in prop::collection::vec((5usize..55, 5usize..55), 0..12),
        heading in -3.1f64..3.1,
        latency in 0usize..8,
    ) {
        let clear = |&(x, y): &(usize, usize)| {
            [(8, 8), (52, 52), (8, 52)].iter().all(|&(cx, cy): &(usize, usize)| x.abs_diff(cx).max(y.abs_diff(cy)) > 5)
        };
        let pillars: Vec<_> = pillars.into_iter().filter(clear).collect();
        let testbed = room(&pillars);
        let mut brain = started(&testbed);
        let course = walk(&testbed, (pose(0.8, 0.8, heading), 0), latency, 200.0, |_, event| ask(&mut brain, event));
        prop_assert!(course.clearance > 0.0, "{} m", course.clearance);
        prop_assert!(course.finished == course.reasons.is_empty(), "arrives or says why: {:?}", course.reasons.first());
    }

    #[test]
    fn every_answer_is_within_bounds_and_depends_on_nothing_before(
        places in prop::collection::vec((-6.0f64..31.0, -31.0f64..3.0, -10.0f64..10.0, 0u32..40), 1..8),
    ) {
        thread_local!(static BRAINS: std::cell::RefCell<[Brain; 2]> =
            std::cell::RefCell::new([started(&corridor()), started(&corridor())]));
        BRAINS.with_borrow_mut(|[one, other]| {
            let ask_all = |brain: &mut Brain, order: &mut dyn Iterator<Item = &(f64, f64, f64, u32)>| -> Vec<_> {
                order.map(|&(x, y, heading, next)| ask(brain, &context(pose(x, y, heading), next))).collect()
            };
            let forwards = ask_all(one, &mut places.iter());
            let mut backwards = ask_all(other, &mut places.iter().rev());
            backwards.reverse();
            prop_assert_eq!(&forwards, &backwards);
            for (velocity, waypoint, _) in forwards {
                prop_assert!((0.0..=0.3).contains(&velocity.linear) && velocity.angular.abs() <= 1.0 + 1e-9);
                prop_assert!(waypoint <= 35);
            }
            Ok(())
        })?;
    }
}
