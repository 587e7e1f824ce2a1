//! Electric power of servers and robots.

use cotorra_graph::{RadioPower, RobotPower, ServerPower};

use super::builder::Builder;
use crate::{
    records::{RobotPowerRecord, RobotRecord, ServerPowerRecord},
    yaml::{Sink, Watts, decode::Spanned},
};

impl Builder<'_> {
    /// Builds the power of a server, if it has one; `None` for a mistake.
    pub(super) fn server_power(
        &mut self,
        record: Option<&ServerPowerRecord>,
    ) -> Option<Option<Box<ServerPower>>> {
        let Some(ServerPowerRecord { idle, full, cost }) = record else { return Some(None) };
        let full_w = not_below(*idle, full, "full", self.sink)?;
        Some(Some(Box::new(ServerPower { idle_w: idle.0, full_w, energy_cost: cost.0 })))
    }

    /// Builds the power of a robot, if it has one; `None` for a mistake.
    pub(super) fn robot_power(&mut self, robot: &RobotRecord) -> Option<Option<Box<RobotPower>>> {
        let Some(record) = &robot.power else { return Some(None) };
        let RobotPowerRecord { idle, driving, computing, radio, battery, cost } = record;
        let driving_w = not_below(*idle, driving, "driving", self.sink)?;
        if let Some(battery) = battery.as_ref().filter(|battery| battery.value.0 == 0.0) {
            self.sink
                .error(&battery.span, "a battery without energy")
                .help("write the energy of a full one, such as `55 Wh`, or leave it out");
            return None;
        }
        Some(Some(Box::new(RobotPower {
            idle_w: idle.0,
            driving_w,
            computing_w: computing.0,
            radio: radio.as_ref().map(|radio| RadioPower {
                idle_w: radio.idle.0,
                sending_w: radio.sending.0,
                receiving_w: radio.receiving.0,
            }),
            battery_wh: battery.as_ref().map(|battery| battery.value.0),
            energy_cost: cost.0,
        })))
    }
}

/// Returns a power that is not below the idle one, watts.
fn not_below(idle: Watts, more: &Spanned<Watts>, key: &str, sink: &mut Sink) -> Option<f64> {
    if more.value.0 < idle.0 {
        sink.error(&more.span, format!("`{key}` is below the {} W of `idle`", idle.0))
            .help(format!("write the whole power, idle power included: {} W or more", idle.0));
        return None;
    }
    Some(more.value.0)
}
