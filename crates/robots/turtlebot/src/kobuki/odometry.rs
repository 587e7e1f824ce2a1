//! Odometry: distances by the encoders, and the heading by the gyro, as in Kobuki's own node.

use std::{f64::consts::PI, time::Duration};

use cotorra_graph::{Timestamp, Velocity, wrapped_angle};
use serde::{Deserialize, Serialize};

use super::{
    command::WHEEL_BASE,
    feedback::{Basic, Inertia},
};

/// Radius of a wheel, metres (`en_appendix_parameters.dox`).
const WHEEL_RADIUS: f64 = 0.035;
/// Rotation of a wheel per encoder tick, radians (`en_appendix_parameters.dox`): a revolution has 52 · 6545/132 = 2578.33
/// ticks.
const RADIANS_PER_TICK: f64 = 0.002_436_916_871_363_93;
/// Way of a wheel per encoder tick: 0.000 085 292 m.
pub const METRES_PER_TICK: f64 = WHEEL_RADIUS * RADIANS_PER_TICK;
/// Time without feedback after which the way since then is unknown. The encoders wrap after 2.8 m.
const LOST: Duration = Duration::from_secs(2);
/// Speed of a wheel that no base reaches, m/s, and the way that is allowed beside it, metres.
const IMPOSSIBLE: (f64, f64) = (2.0, 0.1);

/// Odometry of a base since its first feedback.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Odometry {
    /// Position, metres, in the frame of the start: forward, and to the left.
    pub position: (f64, f64),
    /// Heading, radians in (-π, π], counter-clockwise from that of the start.
    pub heading: f64,
    /// Velocity between the last two readings.
    pub velocity: Velocity,
    /// Length of the way so far, metres.
    pub way: f64,
    /// Time in which the base moved.
    pub moved: Duration,
    #[serde(skip)]
    last: Option<(Timestamp, Basic, Option<Inertia>)>,
}

impl Odometry {
    /// Returns the odometry since the start of `before`, at whose end this one began.
    #[must_use]
    pub fn after(&self, before: &Self) -> Self {
        let (sin, cos) = before.heading.sin_cos();
        let ((x, y), (forward, left)) = (before.position, self.position);
        Self {
            position: (x + forward * cos - left * sin, y + forward * sin + left * cos),
            heading: wrapped_angle(before.heading + self.heading),
            velocity: self.velocity,
            way: before.way + self.way,
            moved: before.moved.saturating_add(self.moved),
            last: self.last,
        }
    }

    /// Takes a reading. After a gap of two seconds, or if the encoders jump, the way since the last reading is unknown,
    /// and counts as none.
    pub fn update(&mut self, now: Timestamp, basic: Basic, inertia: Option<Inertia>) {
        let Some((at, before, turned)) = self.last.replace((now, basic, inertia)) else { return };
        // The base's clock is free of the delays of the port, and wraps after 65 s.
        let elapsed = Duration::from_millis(basic.stamp.wrapping_sub(before.stamp).into());
        let ticks =
            |now: u16, before: u16| f64::from(now.wrapping_sub(before).cast_signed()) * METRES_PER_TICK;
        let (left, right) = (ticks(basic.left, before.left), ticks(basic.right, before.right));
        let (speed, slack) = IMPOSSIBLE;
        let longest = speed * now.since(at).max(elapsed).as_secs_f64() + slack;
        if now.since(at) > LOST || left.abs() > longest || right.abs() > longest {
            self.velocity = Velocity::default();
            return;
        }
        let forward = (left + right) / 2.0;
        let turn = match (inertia, turned) {
            (Some(now), Some(before)) => wrapped_angle(hundredths(now.angle) - hundredths(before.angle)),
            _ => (right - left) / WHEEL_BASE,
        };
        let (sin, cos) = (self.heading + turn / 2.0).sin_cos();
        self.position = (self.position.0 + forward * cos, self.position.1 + forward * sin);
        self.heading = wrapped_angle(self.heading + turn);
        self.way += forward.abs();
        if left != 0.0 || right != 0.0 {
            self.moved += elapsed;
        }
        if !elapsed.is_zero() {
            let angular = inertia.map_or(turn / elapsed.as_secs_f64(), |inertia| hundredths(inertia.rate));
            self.velocity = Velocity::planar(forward / elapsed.as_secs_f64(), angular);
        }
    }
}

/// Returns hundredths of degrees in radians.
fn hundredths(degrees: i16) -> f64 {
    f64::from(degrees) / 100.0 * PI / 180.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn basic(stamp: u16, left: u16, right: u16) -> Basic {
        Basic { stamp, bumper: 0, wheel_drop: 0, cliff: 0, left, right, charger: 0, battery: 160 }
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn a_tick_is_the_published_way() {
        assert!((1.0 / METRES_PER_TICK - 11_724.416_580_298_566).abs() < 1e-6);
        let by_gears = std::f64::consts::TAU * 0.035 / (52.0 * 6545.0 / 132.0);
        assert!((METRES_PER_TICK - by_gears).abs() < 1e-8, "{by_gears}");
    }

    #[test]
    fn encoders_and_clock_wrap() {
        let mut odometry = Odometry::default();
        odometry.update(at(0), basic(65_530, 65_500, 10), None);
        odometry.update(at(20), basic(14, 81, 127), None);
        assert!((odometry.position.0 - 117.0 * METRES_PER_TICK).abs() < 1e-9, "{odometry:?}");
        assert!((odometry.velocity.linear - 117.0 * METRES_PER_TICK / 0.020).abs() < 1e-9);
        odometry.update(at(40), basic(34, 65_500, 10), None);
        assert!(odometry.position.0.abs() < 1e-9 && odometry.velocity.linear < 0.0, "backward: {odometry:?}");
        assert_eq!(odometry.moved, Duration::from_millis(40));
    }

    #[test]
    fn heading_is_the_gyros_also_where_it_wraps() {
        let inertia = |angle| Some(Inertia { angle, rate: 4500 });
        let mut odometry = Odometry::default();
        odometry.update(at(0), basic(0, 0, 0), inertia(17_950));
        odometry.update(at(20), basic(20, 0, 0), inertia(-17_950));
        assert!((odometry.heading - 1_f64.to_radians()).abs() < 1e-9, "{odometry:?}");
        assert!((odometry.velocity.angular - PI / 4.0).abs() < 1e-12);
        // Without a gyro, it follows from the wheels.
        odometry.update(at(40), basic(40, 0, 100), None);
        let turned = 100.0 * METRES_PER_TICK / WHEEL_BASE;
        assert!((odometry.heading - 1_f64.to_radians() - turned).abs() < 1e-9);
    }

    #[test]
    fn a_gap_or_a_restart_of_the_base_is_no_way() {
        let mut odometry = Odometry::default();
        odometry.update(at(0), basic(0, 0, 0), None);
        odometry.update(at(20), basic(20, 20_000, 20_000), None);
        assert_eq!(odometry.position, (0.0, 0.0), "1.7 m in 20 ms is no way");
        odometry.update(at(40), basic(40, 20_100, 20_100), None);
        let gone = odometry.position;
        assert!(gone.0 > 0.008);
        odometry.update(at(3000), basic(3000, 20_500, 20_500), None);
        assert_eq!((odometry.position, odometry.velocity), (gone, Velocity::default()));
    }

    #[test]
    fn odometry_goes_on_where_an_earlier_one_ended() {
        let part = |x: f64, y: f64, heading: f64| Odometry {
            position: (x, y),
            heading,
            way: 2.0,
            ..Odometry::default()
        };
        let joined = part(1.0, 0.5, 0.0).after(&part(3.0, 4.0, PI / 2.0));
        assert!(
            (joined.position.0 - 2.5).abs() < 1e-12 && (joined.position.1 - 5.0).abs() < 1e-12,
            "{joined:?}"
        );
        assert_eq!((joined.heading, joined.way), (PI / 2.0, 4.0));
        assert_eq!(part(1.0, 2.0, 3.0).after(&Odometry::default()), part(1.0, 2.0, 3.0));
    }

    proptest! {
        /// A quarter of a circle, in any number of steps, ends where geometry says.
        #[test]
        fn arcs_end_where_they_should(steps in 20..400_u32, from in any::<u16>()) {
            let (mut odometry, radius) = (Odometry::default(), 1.0);
            for step in 0..=steps {
                let angle = PI / 2.0 * f64::from(step) / f64::from(steps);
                let ticks = |radius: f64| from.wrapping_add((radius * angle / METRES_PER_TICK).round() as u16);
                let inertia = Inertia { angle: (angle.to_degrees() * 100.0).round() as i16, rate: 0 };
                let (left, right) = (ticks(radius - WHEEL_BASE / 2.0), ticks(radius + WHEEL_BASE / 2.0));
                let now = u64::from(step) * 100;
                odometry.update(at(now), basic(now as u16, left, right), Some(inertia));
            }
            let (x, y) = odometry.position;
            prop_assert!((x - 1.0).abs() < 2e-3 && (y - 1.0).abs() < 2e-3, "{x} {y}");
            prop_assert!((odometry.heading - PI / 2.0).abs() < 1e-4);
        }
    }
}
