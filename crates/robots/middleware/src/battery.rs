//! Battery of a simulated TurtleBot 2: its charge and voltage as the robot stands and drives.
//!
//! Figures are from Kobuki's documentation and its driver (`kobuki_core`). A robot with an empty battery keeps moving.

use std::time::Duration;

use cotorra_graph::Velocity;

use crate::kobuki::{MAX_SPEED, WHEEL_BASE};

/// Energy of the small pack, four lithium-ion cells in series: 14.8 V · 2.2 Ah, watt hours.
const ENERGY: f64 = 14.8 * 2.2;
/// Operating time of a full pack, hours. It is taken for driving at full speed.
const OPERATING: f64 = 3.0;
/// Power of both motors at full speed without load: 12 V · 0.21 A each, watts.
const MOTORS: f64 = 2.0 * 12.0 * 0.21;
/// Power of all other parts, watts.
const STANDBY: f64 = ENERGY / OPERATING - MOTORS;
/// Voltages of a full and of an empty pack, volts.
const VOLTAGES: (f64, f64) = (16.5, 13.2);
/// Resolution of the reported voltage, volts.
const RESOLUTION: f64 = 0.1;

#[derive(Debug, Clone)]
pub(crate) struct Battery {
    /// Remaining share of [`ENERGY`].
    charge: f64,
}

impl Battery {
    pub fn new(charge: f64) -> Self {
        Self { charge }
    }

    /// Discharges the battery by a step at this velocity.
    pub fn advance(&mut self, velocity: Velocity, step: Duration) {
        let half = velocity.angular * WHEEL_BASE / 2.0;
        let wheels = (velocity.linear - half).abs() + (velocity.linear + half).abs();
        let watts = STANDBY + MOTORS * (wheels / 2.0 / MAX_SPEED);
        self.charge = (self.charge - watts * step.as_secs_f64() / 3600.0 / ENERGY).max(0.0);
    }

    /// Returns charge and voltage.
    pub fn read(&self) -> Vec<f64> {
        let voltage = VOLTAGES.1 + (VOLTAGES.0 - VOLTAGES.1) * self.charge;
        vec![self.charge, ((voltage / RESOLUTION).round() / 10.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    /// Returns charge and voltage after `hours`.
    fn after(hours: u64, velocity: Velocity) -> Vec<f64> {
        let mut battery = Battery::new(1.0);
        (0..hours * 3600).for_each(|_| battery.advance(velocity, SECOND));
        battery.read()
    }

    #[test]
    fn pack_lasts_three_hours_at_full_speed() {
        let fast = Velocity::planar(MAX_SPEED, 0.0);
        assert_eq!(Battery::new(1.0).read(), [1.0, 16.5]);
        let [charge, voltage] = after(1, fast)[..] else { panic!("there are two") };
        assert!((charge - 2.0 / 3.0).abs() < 1e-9, "{charge}");
        assert!((voltage - 15.4).abs() < 1e-9, "{voltage}");
        assert!(after(3, fast)[0] < 1e-9);
        assert_eq!(after(4, fast), [0.0, 13.2], "an empty one stays empty");
    }

    #[test]
    fn power_follows_the_speed_of_the_wheels() {
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
