//! The battery of a TurtleBot 2: what standing and driving take from it, and the voltage that is left.
//!
//! Figures are those of Kobuki's documentation and of its driver (`kobuki_core`). A robot whose battery is empty goes on.

use std::time::Duration;

use cotorra_graph::Velocity;

use crate::kobuki::{MAX_SPEED, WHEEL_BASE};

/// Of the small pack, four lithium-ion cells in a row: 14.8 V · 2.2 Ah, watt hours.
const ENERGY: f64 = 14.8 * 2.2;
/// A full pack lasts so long, hours; taken for one that drives at full speed all the time.
const OPERATING: f64 = 3.0;
/// Of both wheels' motors at full speed without a load: 12 V · 0.21 A each, watts.
const MOTORS: f64 = 2.0 * 12.0 * 0.21;
/// Of everything else, watts.
const STANDBY: f64 = ENERGY / OPERATING - MOTORS;
/// Volts of a full pack, and of one that is as good as empty.
const VOLTAGES: (f64, f64) = (16.5, 13.2);
/// The base tells the voltage in such steps, volts.
const RESOLUTION: f64 = 0.1;

/// The battery.
#[derive(Debug, Clone)]
pub(crate) struct Battery {
    /// Share of [`ENERGY`] that is left.
    charge: f64,
}

impl Battery {
    pub fn new(charge: f64) -> Self {
        Self { charge }
    }

    /// The robot moves so for a step.
    pub fn advance(&mut self, velocity: Velocity, step: Duration) {
        let half = velocity.angular * WHEEL_BASE / 2.0;
        let wheels = (velocity.linear - half).abs() + (velocity.linear + half).abs();
        let watts = STANDBY + MOTORS * (wheels / 2.0 / MAX_SPEED);
        self.charge = (self.charge - watts * step.as_secs_f64() / 3600.0 / ENERGY).max(0.0);
    }

    /// Charge and voltage.
    pub fn read(&self) -> Vec<f64> {
        let voltage = VOLTAGES.1 + (VOLTAGES.0 - VOLTAGES.1) * self.charge;
        vec![self.charge, ((voltage / RESOLUTION).round() / 10.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    /// Charge and voltage after so many hours.
    fn after(hours: u64, velocity: Velocity) -> Vec<f64> {
        let mut battery = Battery::new(1.0);
        (0..hours * 3600).for_each(|_| battery.advance(velocity, SECOND));
        battery.read()
    }

    #[test]
    fn a_pack_lasts_three_hours_at_full_speed() {
        let fast = Velocity::planar(MAX_SPEED, 0.0);
        assert_eq!(Battery::new(1.0).read(), [1.0, 16.5]);
        let [charge, voltage] = after(1, fast)[..] else { panic!("there are two") };
        assert!((charge - 2.0 / 3.0).abs() < 1e-9, "{charge}");
        assert!((voltage - 15.4).abs() < 1e-9, "{voltage}");
        assert!(after(3, fast)[0] < 1e-9);
        assert_eq!(after(4, fast), [0.0, 13.2], "an empty one stays empty");
    }

    #[test]
    fn standing_takes_less_than_driving_and_turning_takes_what_its_wheels_do() {
        let charge = |velocity| after(1, velocity)[0];
        let (still, slow) = (charge(Velocity::default()), charge(Velocity::planar(0.35, 0.0)));
        let fast = charge(Velocity::planar(MAX_SPEED, 0.0));
        assert!(fast < slow && slow < still && still < 1.0, "{fast} {slow} {still}");
        assert!((slow - (fast + still) / 2.0).abs() < 1e-9);
        let turning = charge(Velocity::planar(0.0, 0.35 / (WHEEL_BASE / 2.0)));
        assert!((turning - slow).abs() < 1e-9, "{turning} {slow}");
        assert_eq!(charge(Velocity::planar(-0.35, 0.0)), slow);
    }
}
