//! Suggestions: the radio unit where a robot is asks it to move to another one (802.11v), and the robot's wpa_supplicant decides.

use std::time::Duration;

use cotorra_fabric::FabricError;
use cotorra_graph::{Event, NodeId, Timestamp};
use cotorra_wifi::MacAddress;

use super::{Action, Manager, PATIENCE, Program, Refused, Rejected, Request};

/// Time after which a radio unit asks a robot even if it has not reported keys for it: an agent may have lost the report.
pub(super) const KEYS: Duration = Duration::from_secs(1);

/// A suggestion that a robot has not answered.
#[derive(Debug)]
pub(super) struct Suggestion {
    /// The radio unit that asks.
    by: NodeId,
    /// The one that it suggests.
    to: NodeId,
    /// When it asks at the latest; `None` if it has asked.
    ///
    /// A robot is connected a little before its radio unit has keys for it. With 802.11w, it drops what comes without.
    asks_by: Option<Timestamp>,
    /// When no answer is expected any more.
    until: Timestamp,
}

impl Suggestion {
    pub(super) fn deadline(&self) -> Timestamp {
        self.asks_by.unwrap_or(self.until)
    }
}

impl Manager {
    /// Lets a robot's radio unit suggest another one. An event reports the robot's answer. Does nothing if it is there.
    ///
    /// # Errors
    /// [`Rejected`]. No station was asked then.
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
        let until = now + PATIENCE;
        self.running(robot)?.suggestion =
            Some(Suggestion { by, to: unit.clone(), asks_by: Some(now + KEYS), until });
        self.ask_to_move(now, robot);
        Ok(())
    }

    /// Records that a radio unit has keys for a station, which it may ask now.
    pub(super) fn has_keys(&mut self, now: Timestamp, unit: &NodeId, station: MacAddress) {
        let Some(robot) = self.robot_with(station).cloned() else { return };
        if let Some(state) = self.robots.get_mut(&robot) {
            state.keys_at = Some((unit.clone(), now));
        }
        self.ask_to_move(now, &robot);
    }

    /// Lets a radio unit ask a robot, unless it has no keys for it yet, or has asked.
    fn ask_to_move(&mut self, now: Timestamp, robot: &NodeId) {
        let Some(state) = self.robots.get_mut(robot) else { return };
        let Some(suggestion) = &mut state.suggestion else { return };
        let has_keys = state.keys_at.as_ref().is_some_and(|(unit, _)| *unit == suggestion.by);
        if suggestion.asks_by.take_if(|latest| has_keys || *latest <= now).is_none() {
            return;
        }
        let (by, to) = (suggestion.by.clone(), Box::new(self.plan.units[&suggestion.to].as_neighbour()));
        let station = self.plan.robots[robot].address;
        self.request(Program::Hostapd(by), Request::Suggest { station, to });
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

    /// Asks a robot, or ends a suggestion without an answer, if that is due.
    pub(super) fn advance_suggestion(&mut self, now: Timestamp, robot: &NodeId) {
        self.ask_to_move(now, robot);
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
        let robot = self.robot_with(station)?.clone();
        let state = self.robots.get_mut(&robot)?;
        let suggestion = state.suggestion.take_if(|suggestion| suggestion.by == *by)?;
        Some((robot, suggestion))
    }
}
