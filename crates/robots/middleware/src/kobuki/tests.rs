use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;
use crate::fixtures::{id, room};

const STEP: Duration = Duration::from_millis(20);

/// Drives for a number of steps.
fn drive(base: &mut Base, velocity: Velocity, steps: u32, world: &World) {
    for _ in 0..steps {
        base.advance(velocity, STEP, world);
    }
}

fn velocity(linear: f64, angular: f64) -> Velocity {
    Velocity::planar(linear, angular)
}

#[test]
fn tick_is_85_292_nanometres() {
    assert!((METRES_PER_TICK - 0.000_085_292).abs() < 1e-9);
}

#[test]
fn ground_robot_never_leaves_the_floor() {
    let rising = |linear: f64, angular: f64| Velocity { vertical: 0.4, ..velocity(linear, angular) };
    assert_eq!(limited(rising(0.3, 1.0), 0.7), velocity(0.3, 1.0), "within its limits");
    assert_eq!(limited(rising(1.4, 1.0), 0.7), velocity(0.7, 0.5), "over its limits");
}

#[test]
fn constant_velocities_drive_a_circle() {
    let (linear, angular) = (0.3, 0.4);
    let mut base = Base::new(Position::new(1.0, 2.0), PI / 2.0);
    base.velocity = velocity(linear, angular);
    let radius = linear / angular;
    for step in 0..1000 {
        base.advance(velocity(linear, angular), STEP, &World::open());
        let turned = angular * f64::from(step + 1) * STEP.as_secs_f64();
        // From heading north, counter-clockwise: the centre lies to the west.
        let expected = Position::new(1.0 - radius + radius * turned.cos(), 2.0 + radius * turned.sin());
        assert!(base.position.distance(expected) < 1e-9);
        assert!((base.heading - wrapped_angle(PI / 2.0 + turned)).abs() < 1e-9);
    }
}

#[test]
fn speed_follows_the_ramps() {
    let mut base = Base::new(Position::default(), 0.0);
    drive(&mut base, velocity(0.3, 0.0), 15, &World::open());
    assert!((base.velocity.linear - 0.15).abs() < 1e-12, "0.5 m/s² for 0.3 s");
    drive(&mut base, velocity(0.3, 0.0), 15, &World::open());
    assert!((base.velocity.linear - 0.3).abs() < 1e-12);
    drive(&mut base, velocity(0.0, 0.0), 10, &World::open());
    assert!((base.velocity.linear - 0.18).abs() < 1e-12, "0.6 m/s² for 0.2 s");
    drive(&mut base, velocity(-0.3, -3.0), 100, &World::open());
    assert_eq!(base.velocity, velocity(-0.3, -3.0));
}

#[test]
fn wall_stops_the_base_and_presses_its_bumper() {
    let world = World::new(&room(4.0, 2.0));
    let mut base = Base::new(Position::new(2.0, 1.0), 0.0);
    drive(&mut base, velocity(0.5, 0.0), 300, &world);
    assert!(base.bumper);
    assert_eq!(base.velocity.linear, 0.0);
    let gap = 4.0 - base.position.x - RADIUS;
    assert!((0.0..5e-5).contains(&gap), "it touches the wall, {gap} m off");

    drive(&mut base, velocity(0.0, 1.0), 50, &world);
    assert!(base.bumper, "turning leaves the wall where it is");
    assert!(base.heading > 0.5);
    base.heading = 0.0;
    drive(&mut base, velocity(-0.2, 0.0), 50, &world);
    assert!(!base.bumper);
    assert!(base.position.x < 3.8);
}

#[test]
fn base_inside_a_wall_can_only_leave_it() {
    let world = World::new(&room(4.0, 2.0));
    let mut base = Base::new(Position::new(3.9, 1.0), 0.0);
    drive(&mut base, velocity(0.3, 0.0), 20, &world);
    assert_eq!(base.position.x, 3.9);
    assert!(base.bumper);
    drive(&mut base, velocity(-0.3, 0.0), 100, &world);
    assert!(base.position.x < 3.7);
}

#[test]
fn headings_stay_in_one_turn() {
    assert_eq!(wrapped_angle(PI), PI);
    assert_eq!(wrapped_angle(-PI), PI);
    assert!((wrapped_angle(7.0) - (7.0 - 2.0 * PI)).abs() < 1e-12);
    assert!((wrapped_angle(-4.0) - (2.0 * PI - 4.0)).abs() < 1e-12);
}

fn straight(seed: u64, metres: f64) -> Odometer {
    let mut odometer = Odometer::new(seed, &id("robot1"), &Base::new(Position::default(), 0.0));
    let steps = (metres / 0.006).round() as u32;
    for _ in 0..steps {
        odometer.advance(Motion { forward: metres / f64::from(steps), turned: 0.0 }, STEP);
    }
    odometer
}

#[test]
fn encoders_count_whole_ticks_without_loss() {
    let odometer = straight(3, 1.0);
    for wheel in 0..2 {
        let ticks = odometer.turned[wheel] / METRES_PER_TICK;
        assert_eq!(odometer.ticks[wheel] as f64, ticks.floor());
        assert!((11_000..12_500).contains(&odometer.ticks[wheel]), "a metre has 11 724 ticks, drift aside");
    }
    let counted = (odometer.ticks[0] + odometer.ticks[1]) as f64 * METRES_PER_TICK / 2.0;
    assert!((odometer.way - counted).abs() < 1e-9);
    // The measured way of a step is a whole number of half ticks.
    let halves = odometer.velocity().linear * STEP.as_secs_f64() / (METRES_PER_TICK / 2.0);
    assert!((halves - halves.round()).abs() < 1e-6);
}

#[test]
fn standing_robot_does_not_drift() {
    let mut odometer = straight(3, 1.0);
    let before = odometer.pose();
    for _ in 0..1000 {
        odometer.advance(Motion::default(), STEP);
    }
    assert_eq!(odometer.pose(), before);
}

#[test]
fn distances_drift_by_about_a_percent_and_headings_little() {
    const WAY: f64 = 20.0;
    let robots: Vec<Pose> = (0..200).map(|seed| straight(seed, WAY).pose()).collect();
    let rms = |error: fn(&Pose) -> f64| {
        (robots.iter().map(|pose| error(pose).powi(2)).sum::<f64>() / robots.len() as f64).sqrt()
    };
    let scale = rms(|pose| pose.x.hypot(pose.y) / WAY - 1.0);
    assert!((0.008..0.02).contains(&scale), "{scale}");
    let heading = rms(|pose| pose.heading).to_degrees();
    assert!((0.1..1.0).contains(&heading), "{heading}° after 67 s");
    assert!(robots.iter().all(|pose| (pose.x / WAY - 1.0).abs() < 0.05 && pose.heading.abs() < 0.05));
}

#[test]
fn the_covariance_bounds_the_error() {
    for seed in 0..100 {
        let mut base = Base::new(Position::new(3.0, -2.0), 0.5);
        let mut odometer = Odometer::new(seed, &id("robot1"), &base);
        for step in 0..3000 {
            let wanted = velocity(0.3, if step % 900 < 300 { 0.3 } else { -0.05 });
            let motion = base.advance(wanted, STEP, &World::open());
            odometer.advance(motion, STEP);
        }
        let pose = odometer.pose();
        let heading = wrapped_angle(pose.heading - base.heading);
        for (error, variance) in [
            (pose.x - base.position.x, pose.covariance[0]),
            (pose.y - base.position.y, pose.covariance[4]),
            (heading, pose.covariance[8]),
        ] {
            assert!(error.abs() <= 4.0 * variance.sqrt(), "seed {seed}: {error} against {}", variance.sqrt());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn commands_never_drive_through_a_wall(
        commands in proptest::collection::vec((-0.7f64..0.7, -PI..PI, 1u32..80), 1..30),
        heading in -PI..PI,
    ) {
        let world = World::new(&room(1.5, 1.0));
        let mut base = Base::new(Position::new(0.6, 0.5), heading);
        for (linear, angular, steps) in commands {
            for _ in 0..steps {
                base.advance(velocity(linear, angular), STEP, &world);
                prop_assert!(world.distance(base.position, RADIUS) >= RADIUS - 1e-9);
                prop_assert!(base.position.x > 0.0 && base.position.x < 1.5);
                prop_assert!(base.heading > -PI && base.heading <= PI);
            }
        }
    }
}
