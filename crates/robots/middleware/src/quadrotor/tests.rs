use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use proptest::prelude::*;

use super::*;
use crate::fixtures::{id, room};

const STEP: Duration = Duration::from_millis(20);

/// Flies for a number of steps.
fn fly(airframe: &mut Airframe, world: &World, steps: u32, wanted: Velocity) {
    for _ in 0..steps {
        airframe.advance(wanted, STEP, world);
    }
}

fn hovering(height: f64) -> Airframe {
    Airframe::new(Position::new(2.0, 2.0).at_height(height), 0.0)
}

#[test]
fn velocity_follows_a_first_order_lag() {
    let mut airframe = hovering(1.0);
    let wanted = Velocity { linear: 0.5, vertical: 0.2, angular: 0.4 };
    fly(&mut airframe, &World::open(), 13, wanted);
    let velocity = airframe.velocity();
    // After 0.26 s, slightly more than one time constant: 1 - (1 - 0.02 / 0.25)^13 = 0.66.
    for (found, wanted) in [(velocity.vertical, 0.2), (velocity.angular, 0.4)] {
        assert!((found / wanted - 0.662).abs() < 0.01, "{velocity:?}");
    }
    fly(&mut airframe, &World::open(), 287, wanted);
    let velocity = airframe.velocity();
    assert!((velocity.vertical - 0.2).abs() < 1e-3 && (velocity.angular - 0.4).abs() < 1e-3, "{velocity:?}");
}

#[test]
fn tilt_follows_the_acceleration() {
    let mut airframe = hovering(1.0);
    let forward = Velocity::planar(3.0, 0.0);
    fly(&mut airframe, &World::open(), 1, forward);
    let pose = airframe.pose();
    assert!((pose.pitch - (ACCELERATION / GRAVITY).atan()).abs() < 1e-9, "nose down: {pose:?}");
    assert_eq!(pose.roll, 0.0);
    fly(&mut airframe, &World::open(), 399, forward);
    assert!(airframe.pose().pitch.abs() < 1e-3);
    // It leans into a turn to the left, which is a negative roll.
    fly(&mut airframe, &World::open(), 20, Velocity::planar(3.0, 1.0));
    assert!(airframe.pose().roll < -0.1, "{:?}", airframe.pose());
}

#[test]
fn quadrotor_never_descends_below_the_floor() {
    let mut airframe = Airframe::new(Position::new(2.0, 2.0), FRAC_PI_2);
    let up = Velocity { vertical: 1.0, ..Velocity::default() };
    fly(&mut airframe, &World::open(), 100, up);
    assert!((airframe.position.z - 1.75).abs() < 0.05, "2 s at 1 m/s less its lag: {:?}", airframe.position);
    assert_eq!(airframe.heading, FRAC_PI_2);
    fly(&mut airframe, &World::open(), 300, up.scaled(-1.0));
    assert_eq!((airframe.position.z, airframe.velocity()), (0.0, Velocity::default()));
}

#[test]
fn quadrotor_on_the_floor_only_takes_off() {
    let mut airframe = Airframe::new(Position::new(2.0, 2.0), 0.0);
    fly(&mut airframe, &World::open(), 50, Velocity::planar(1.0, 1.0));
    assert_eq!(airframe.pose(), Airframe::new(Position::new(2.0, 2.0), 0.0).pose());
}

#[test]
fn quadrotor_hovers_without_commands() {
    let mut airframe = hovering(1.5);
    fly(&mut airframe, &World::open(), 100, Velocity { linear: 2.0, vertical: 0.5, angular: 0.5 });
    fly(&mut airframe, &World::open(), 300, Velocity::default());
    assert_eq!(airframe.velocity(), Velocity::default());
    assert!(airframe.position.z > 2.0);
    assert_eq!((airframe.pose().roll, airframe.pose().pitch), (0.0, 0.0));
}

#[test]
fn velocity_over_a_limit_is_scaled_on_the_same_curve() {
    let over = Velocity { linear: 0.5, vertical: 6.0, angular: 0.4 };
    assert_eq!(limited(over, 5.0), over.scaled(0.5));
    assert_eq!(limited(over.scaled(-0.5), 5.0), over.scaled(-0.25), "it descends half as fast as it rises");
    assert_eq!(limited(Velocity::planar(2.0, 0.5), 1.0), Velocity::planar(1.0, 0.25));
    let within = Velocity { linear: 1.0, vertical: -1.0, angular: 0.1 };
    assert_eq!(limited(within, 5.0), within);
}

#[test]
fn odometry_drifts_in_the_plane_but_not_in_height() {
    let mut airframe = hovering(1.0);
    let mut odometer = FlightOdometer::new(7, &id("uav"), &airframe);
    let world = World::open();
    for _ in 0..1000 {
        let flown = airframe.advance(Velocity { linear: 1.0, vertical: 0.05, angular: 0.2 }, STEP, &world);
        odometer.advance(&airframe, flown, STEP);
    }
    let (truth, measured) = (airframe.pose(), odometer.pose());
    let off = measured.position().on_floor().distance(truth.position().on_floor());
    assert!(off > 0.001 && off < 3.5 * (2.0 * measured.covariance[0]).sqrt(), "{off}");
    assert!((measured.z - truth.z).abs() < 4.0 * HEIGHT);
    assert_eq!(measured.source, PoseSource::Odometry);
}

proptest! {
    #[test]
    fn limits_and_walls_hold(
        commands in prop::collection::vec((-8.0..8.0f64, -5.0..5.0f64, -4.0..4.0f64), 1..20), heading in -3.0..3.0f64,
    ) {
        let world = World::new(&room(4.0, 4.0));
        let mut airframe = Airframe::new(Position::new(2.0, 2.0).at_height(1.0), heading);
        for (linear, vertical, angular) in commands {
            let wanted = limited(Velocity { linear, vertical, angular }, 5.0);
            for _ in 0..25 {
                let before = airframe.velocity;
                airframe.advance(wanted, STEP, &world);
                let pose = airframe.pose();
                prop_assert!(world.distance(airframe.position, RADIUS) >= RADIUS);
                prop_assert!(pose.z >= 0.0 && pose.roll.abs() < FRAC_PI_4 && pose.pitch.abs() < FRAC_PI_4);
                let [vx, vy, vz] = airframe.velocity;
                prop_assert!(vx.hypot(vy) <= 5.0 + 1e-9 && vz <= CLIMB.0 + 1e-9 && vz >= -CLIMB.1 - 1e-9);
                // Contact with a wall or the floor stops it at once.
                if !airframe.bumper && pose.z > 0.0 {
                    let change = (vx - before[0]).hypot(vy - before[1]);
                    prop_assert!(change <= ACCELERATION * STEP.as_secs_f64() + STILL, "{change}");
                }
            }
        }
    }
}
