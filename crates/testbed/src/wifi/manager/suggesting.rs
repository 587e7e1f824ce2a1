//! Suggestions: the radio unit where a robot is asks it to move to another one (802.11v), and the robot's wpa_supplicant decides.

use cotorra_fabric::FabricError;
use cotorra_graph::{Event, NodeId, Timestamp};
use cotorra_wifi::MacAddress;

use super::{Action, Manager, PATIENCE, Program, Refused, Rejected, Request};

/// A suggestion that a robot has not answered.
#[derive(Debug)]
pub(super) struct Suggestion {
    /// The radio unit that asked.
    by: NodeId,
    /// The one that it suggested.
    to: NodeId,
    /// When no answer is expected any more.
    pub(super) until: Timestamp,
}

impl Manager {
    /// Lets a robot's radio unit suggest another one. An event reports the robot's answer. Does nothing if it is there.
    ///
    /// # Errors
    /// [`Rejected`]. Nobody was asked then.
    pub(crate) fn suggest(&mut self, now: Timestamp, robot: &NodeId, unit: &NodeId) -> Result<(), Rejected> {
        self.check_takes(robot, unit)?;
        let state = self.running(robot)?;
        let by = state.at.clone().ok_or_else(|| Rejected::Nowhere(robot.clone()))?;
        if state.is_busy(now) || state.suggestion.is_some() {
            return Err(FabricError::Busy(robot.clone()).into());
        }
        if by == *unit {
            return Ok(());
        }
        if self.needs_other_key(robot, unit) {
            return Err(Rejected::OtherKey { robot: robot.clone(), radio_unit: unit.clone() });
        }
        let to = Box::new(self.plan.units[unit].as_neighbour());
        let station = self.plan.robots[robot].address;
        let suggestion = Suggestion { by: by.clone(), to: unit.clone(), until: now + PATIENCE };
        self.running(robot)?.suggestion = Some(suggestion);
        self.request(Program::Hostapd(by), Request::Suggest { station, to });
        Ok(())
    }

    /// Takes a station's answer to a radio unit.
    pub(super) fn suggestion_answered(&mut self, unit: &NodeId, station: MacAddress, status: u8) {
        if let Some((robot, Suggestion { to, .. })) = self.take_suggestion(unit, station) {
            let event = Event::SuggestionAnswered { robot, radio_unit: to, status };
            self.actions.push_back(Action::Report(event));
        }
    }

    pub(super) fn unit_refused(
        &mut self,
        now: Timestamp,
        unit: &NodeId,
        request: &Request,
        reason: &Refused,
    ) {
        if let Request::Suggest { station, .. } = request
            && let Some((robot, Suggestion { to, .. })) = self.take_suggestion(unit, *station)
        {
            let why = match reason {
                Refused::Busy => "its hostapd is busy",
                Refused::Other(reason) => reason,
            };
            return self.notice(now, format!("`{unit}` did not suggest `{to}` to `{robot}`: {why}"));
        }
        tracing::debug!("hostapd of `{unit}` refused {request:?}: {reason:?}");
    }

    pub(super) fn end_late_suggestion(&mut self, now: Timestamp, robot: &NodeId) {
        let Some(state) = self.robots.get_mut(robot) else { return };
        if let Some(Suggestion { by, to, .. }) =
            state.suggestion.take_if(|suggestion| suggestion.until <= now)
        {
            let within = PATIENCE.as_secs();
            let message = format!("`{robot}` did not answer within {within} s that `{by}` suggests `{to}`");
            self.notice(now, message);
        }
    }

    /// Takes the suggestion that a radio unit made to a station.
    fn take_suggestion(&mut self, by: &NodeId, station: MacAddress) -> Option<(NodeId, Suggestion)> {
        let robots = &self.plan.robots;
        let (robot, _) = robots.iter().find(|(_, planned)| planned.address == station)?;
        let state = self.robots.get_mut(robot)?;
        let suggestion = state.suggestion.take_if(|suggestion| suggestion.by == *by)?;
        Some((robot.clone(), suggestion))
    }
}
