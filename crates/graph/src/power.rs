//! Electric power of servers and robots, and the energy that follows from what they do.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::units::is_zero;

const SECONDS_PER_HOUR: f64 = 3600.0;

/// Power of a server, linear in the busy share of its CPUs (Fan, Weber and Barroso, ISCA 2007).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ServerPower {
    /// While no CPU is busy, watts.
    #[serde(rename = "idle_power_w")]
    pub idle_w: f64,
    /// While all CPUs are busy, watts; not below that.
    #[serde(rename = "full_power_w")]
    pub full_w: f64,
    /// Price of a kWh, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub energy_cost: f64,
}

impl ServerPower {
    /// Returns the energy that it takes in a time whatever it does, watt hours.
    pub fn idle_wh(&self, time: Duration) -> f64 {
        watt_hours(self.idle_w, time.as_secs_f64())
    }

    /// Returns the energy of so much CPU time on one of so many CPUs, beyond that of an idle server, watt hours.
    pub fn load_wh(&self, cpu_time: Duration, cpus: f64) -> f64 {
        watt_hours(self.full_w - self.idle_w, busy(cpu_time, cpus))
    }
}

/// Power of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RobotPower {
    /// While it stands, watts.
    #[serde(rename = "idle_power_w")]
    pub idle_w: f64,
    /// While it moves or turns, watts; not below that.
    #[serde(rename = "driving_power_w")]
    pub driving_w: f64,
    /// Beside these, while all of its CPUs are busy, watts; linear in their busy share.
    #[serde(rename = "computing_power_w", default, skip_serializing_if = "is_zero")]
    pub computing_w: f64,
    /// Its radio, which comes on top; `None` if it counts in the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radio: Option<RadioPower>,
    /// Energy of its battery when a run begins, watt hours; `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub battery_wh: Option<f64>,
    /// Price of a kWh, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub energy_cost: f64,
}

impl RobotPower {
    /// Returns the energy of its base over a time, of which it drove a part, watt hours.
    pub fn base_wh(&self, time: Duration, driving: Duration) -> f64 {
        watt_hours(self.idle_w, time.as_secs_f64())
            + watt_hours(self.driving_w - self.idle_w, driving.as_secs_f64())
    }

    /// Returns the energy of so much CPU time on one of so many CPUs, watt hours.
    pub fn computing_wh(&self, cpu_time: Duration, cpus: f64) -> f64 {
        watt_hours(self.computing_w, busy(cpu_time, cpus))
    }
}

/// Power of a radio by what it does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RadioPower {
    /// While it listens, watts.
    #[serde(rename = "idle_power_w")]
    pub idle_w: f64,
    /// While it sends, watts.
    #[serde(rename = "sending_power_w")]
    pub sending_w: f64,
    /// While it receives frames that are for it, watts.
    #[serde(rename = "receiving_power_w")]
    pub receiving_w: f64,
}

impl RadioPower {
    /// Returns its energy over a time, of which it sent and received frames in parts, watt hours.
    pub fn energy_wh(&self, time: Duration, sending: Duration, receiving: Duration) -> f64 {
        watt_hours(self.idle_w, time.as_secs_f64())
            + watt_hours(self.sending_w - self.idle_w, sending.as_secs_f64())
            + watt_hours(self.receiving_w - self.idle_w, receiving.as_secs_f64())
    }
}

/// Returns the time for which all of so many CPUs would have been busy, seconds. Nothing computes without CPUs.
fn busy(cpu_time: Duration, cpus: f64) -> f64 {
    if cpu_time.is_zero() { 0.0 } else { cpu_time.as_secs_f64() / cpus }
}

fn watt_hours(watts: f64, seconds: f64) -> f64 {
    watts * seconds / SECONDS_PER_HOUR
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn time() -> impl Strategy<Value = Duration> {
        (0_u64..100_000_000).prop_map(Duration::from_micros)
    }

    fn is_near(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * (1.0 + a.abs())
    }

    proptest! {
        #[test]
        fn energy_of_a_server_is_additive_over_time_and_between_idle_and_full(
            idle_w in 0.0..500.0, more_w in 0.0..500.0, first in time(), second in time(),
            busy in 0.0..=1.0, cpus in 0.5..64.0,
        ) {
            let power = ServerPower { idle_w, full_w: idle_w + more_w, energy_cost: 0.0 };
            let energy = |time: Duration| power.idle_wh(time) + power.load_wh(time.mul_f64(busy * cpus), cpus);
            let whole = energy(first + second);
            prop_assert!((whole - energy(first) - energy(second)).abs() < 1e-6 * (1.0 + whole));
            let hours = (first + second).as_secs_f64() / 3600.0;
            prop_assert!(whole >= idle_w * hours - 1e-9 && whole <= power.full_w * hours + 1e-6);
        }

        #[test]
        fn energy_of_a_robot_is_additive_over_time(
            idle_w in 0.0..50.0, more_w in 0.0..50.0, first in time(), second in time(), driving in 0.0..=1.0,
        ) {
            let radio = RadioPower { idle_w: 0.8, sending_w: 2.0, receiving_w: 1.0 };
            let power = RobotPower {
                idle_w, driving_w: idle_w + more_w, computing_w: 0.0, radio: None, battery_wh: None,
                energy_cost: 0.0,
            };
            let energy = |time: Duration| {
                power.base_wh(time, time.mul_f64(driving))
                    + radio.energy_wh(time, time.mul_f64(0.2 * driving), time.mul_f64(0.3))
            };
            let whole = energy(first + second);
            prop_assert!((whole - energy(first) - energy(second)).abs() < 1e-6 * (1.0 + whole));
        }
    }

    #[test]
    fn a_busy_share_takes_its_part_of_the_difference() {
        let (hour, power) =
            (Duration::from_secs(3600), ServerPower { idle_w: 100.0, full_w: 250.0, energy_cost: 0.0 });
        // Two of four CPUs for an hour.
        assert!(is_near(power.idle_wh(hour) + power.load_wh(2 * hour, 4.0), 175.0));
        let power = RobotPower {
            idle_w: 15.0,
            driving_w: 40.0,
            computing_w: 20.0,
            radio: None,
            battery_wh: Some(55.0),
            energy_cost: 0.0,
        };
        assert!(is_near(power.base_wh(hour, hour / 5) + power.computing_wh(hour, 2.0), 15.0 + 5.0 + 10.0));
        assert_eq!(power.computing_wh(Duration::ZERO, 0.0), 0.0, "a robot without CPUs for VNFs");
    }
}
