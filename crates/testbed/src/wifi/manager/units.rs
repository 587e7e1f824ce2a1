//! Radio units: when they serve, and who their neighbours are.

use cotorra_graph::{self as graph, Event, NodeId, Timestamp, VnfEvent, VnfState};
use cotorra_wifi::Event as WifiEvent;

use super::{Action, Change, Configuration, Manager, Program, Rejected, Request, again};
use crate::wifi::{lifecycle::Lifecycle, plan::PlannedUnit};

/// State of a radio unit.
#[derive(Debug)]
pub(super) struct UnitState {
    pub(super) life: Lifecycle,
    /// Whether it sends beacons.
    pub(super) serves: bool,
    /// Settings of its access point.
    pub(super) access_point: graph::AccessPoint,
    /// Whether its next beginning is news: it was deployed, or has died before.
    is_news: bool,
}

impl UnitState {
    pub(super) fn new(unit: &PlannedUnit) -> Self {
        Self {
            life: Lifecycle::default(),
            serves: false,
            access_point: unit.settings.clone(),
            is_news: !unit.serves,
        }
    }
}

impl Manager {
    /// Checks whether [`Self::switch_on`] would succeed now.
    ///
    /// # Errors
    /// [`Rejected`].
    pub(crate) fn check_switch_on(
        &self,
        unit: &NodeId,
        access_point: &graph::AccessPoint,
    ) -> Result<(), Rejected> {
        use cotorra_fabric::FabricError::{OtherSsid, Serving, UnknownRadioUnit};
        let state = self.units.get(unit).ok_or_else(|| UnknownRadioUnit(unit.clone()))?;
        if state.life.is_wanted() {
            return Err(Serving(unit.clone()).into());
        }
        if access_point.ssid != state.access_point.ssid {
            let (network, asked) = (state.access_point.ssid.clone(), access_point.ssid.clone());
            return Err(OtherSsid { radio_unit: unit.clone(), network, asked }.into());
        }
        if access_point.key.is_some() && !self.plan.units[unit].takes_keys() {
            return Err(Rejected::Key(unit.clone()));
        }
        Ok(())
    }

    /// Starts a radio unit that is off. An event reports when it serves.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn switch_on(
        &mut self,
        unit: &NodeId,
        access_point: graph::AccessPoint,
    ) -> Result<(), Rejected> {
        self.check_switch_on(unit, &access_point)?;
        if let Some(state) = self.units.get_mut(unit) {
            state.access_point = access_point;
            state.is_news = true;
        }
        self.start_hostapd(unit);
        Ok(())
    }

    /// Stops a radio unit. Its stations lose it.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn switch_off(&mut self, unit: &NodeId) -> Result<(), Rejected> {
        use cotorra_fabric::FabricError::{NotServing, UnknownRadioUnit};
        let state = self.units.get_mut(unit).ok_or_else(|| UnknownRadioUnit(unit.clone()))?;
        if !state.life.is_wanted() {
            return Err(NotServing(unit.clone()).into());
        }
        if state.life.end() {
            self.actions.push_back(Action::Stop(Program::Hostapd(unit.clone())));
        }
        self.silence(unit);
        Ok(())
    }

    pub(super) fn start_serving_units(&mut self) {
        let serving = self.plan.units.iter().filter(|(_, unit)| unit.serves);
        for unit in serving.map(|(id, _)| id.clone()).collect::<Vec<_>>() {
            self.start_hostapd(&unit);
        }
    }

    /// Whether all radio units serve that have to.
    pub(super) fn units_serve(&self) -> bool {
        self.units.values().all(|unit| unit.serves || !unit.life.is_wanted())
    }

    pub(super) fn advance_units(&mut self, now: Timestamp) {
        let due = self.units.iter_mut().filter_map(|(unit, state)| state.life.advance(now).then_some(unit));
        for unit in due.cloned().collect::<Vec<_>>() {
            self.launch(&unit);
        }
    }

    fn start_hostapd(&mut self, unit: &NodeId) {
        if self.units.get_mut(unit).is_some_and(|state| state.life.begin()) {
            self.launch(unit);
        }
    }

    fn launch(&mut self, unit: &NodeId) {
        let settings = self.units.get(unit).map(|state| &state.access_point);
        let access_point = settings.and_then(|settings| self.plan.access_point(unit, settings));
        let Some(access_point) = access_point else { return };
        let configuration = Configuration::AccessPoint(Box::new(access_point));
        self.start(Program::Hostapd(unit.clone()), configuration);
    }

    pub(super) fn unit_started(&mut self, now: Timestamp, unit: &NodeId) {
        if !self.units.get_mut(unit).is_some_and(|state| state.life.started(now)) {
            return;
        }
        for neighbour in self.plan.neighbours(unit) {
            let request = Request::SetNeighbour(Box::new(neighbour));
            self.request(Program::Hostapd(unit.clone()), request);
        }
    }

    pub(super) fn unit_event(&mut self, now: Timestamp, unit: &NodeId, event: &WifiEvent) {
        if !self.units.get(unit).is_some_and(|state| state.life.is_running()) {
            return;
        }
        match event {
            WifiEvent::AccessPointEnabled => self.serves(unit),
            WifiEvent::AccessPointDisabled => self.silence(unit),
            WifiEvent::StationConnected { station } => self.has_keys(now, unit, *station),
            WifiEvent::MoveAnswered { station, status, .. } => {
                self.suggestion_answered(unit, *station, *status);
            }
            WifiEvent::PossibleWrongKey { station } if self.robot_with(*station).is_none() => {
                let message =
                    format!("a station that is no robot, {station}, has a wrong passphrase for `{unit}`");
                self.notice(now, message);
            }
            _ => {}
        }
    }

    fn serves(&mut self, unit: &NodeId) {
        let Some(state) = self.units.get_mut(unit).filter(|state| !state.serves) else { return };
        state.serves = true;
        let access_point = state.access_point.clone();
        let is_news = std::mem::replace(&mut state.is_news, true);
        self.change(Change::SwitchOn { radio_unit: unit.clone(), access_point });
        if is_news {
            self.report_life(unit, VnfState::Started, None);
        }
    }

    /// Records that a radio unit serves no more.
    fn silence(&mut self, unit: &NodeId) {
        let Some(state) = self.units.get_mut(unit) else { return };
        if std::mem::take(&mut state.serves) {
            self.robots_lose(unit);
            self.change(Change::SwitchOff { radio_unit: unit.clone() });
        }
    }

    pub(super) fn hostapd_ended(&mut self, now: Timestamp, unit: &NodeId, reason: &str) {
        let until = self.units.get_mut(unit).and_then(|state| state.life.ended(now));
        let Some(until) = until else { return };
        self.silence(unit);
        self.report_life(unit, VnfState::Died, Some(format!("{reason}; {}", again(now, until))));
    }

    fn report_life(&mut self, unit: &NodeId, state: VnfState, detail: Option<String>) {
        let event = VnfEvent { vnf: graph::AccessPoint::vnf(unit), node: unit.clone(), state, detail };
        self.actions.push_back(Action::Report(Event::Vnf(event)));
    }
}
