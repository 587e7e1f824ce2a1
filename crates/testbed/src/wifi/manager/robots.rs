//! Robots: where they are, how they came there, and what they hear.

use cotorra_graph::{NodeId, Timestamp};
use cotorra_wifi::{DisabledReason, Event as WifiEvent, MacAddress, wpa_supplicant::Heard};

use super::{
    Change, Configuration, MOST_STRANGERS, Manager, PATIENCE, Program, Rejected, Request, again,
    attaching::Errand, keys::Keys, suggesting::Suggestion,
};
use crate::wifi::{lifecycle::Lifecycle, words};

/// State of a robot.
#[derive(Debug, Default)]
pub(super) struct RobotState {
    pub(super) life: Lifecycle,
    /// The radio unit that it is associated with.
    pub(super) at: Option<NodeId>,
    /// The access point that it is about to join.
    joining: Option<Joining>,
    /// Whether it scans.
    pub(super) scans: bool,
    /// Its destination.
    pub(super) errand: Option<Errand>,
    /// The radio unit that has keys for it since it last began to join one, and since when.
    pub(super) keys_at: Option<(NodeId, Timestamp)>,
    /// Suggestion of its radio unit, sent or due, that it has not answered.
    pub(super) suggestion: Option<Suggestion>,
    /// Its keys of radio units, and the one that it uses in place of its network's passphrase.
    pub(super) keys: Keys,
}

/// A robot on its way to an access point.
#[derive(Debug, Clone, Copy)]
struct Joining {
    bssid: MacAddress,
    began: Timestamp,
    /// Whether the association was dealt with before the robot was connected, i.e. a handshake of keys follows.
    shakes_hands: bool,
}

impl RobotState {
    pub(super) fn is_attached(&self) -> bool {
        self.at.is_some()
    }

    /// Whether it scans, or is on its way to an access point.
    pub(super) fn is_busy(&self, now: Timestamp) -> bool {
        self.scans || self.is_on_its_way(now)
    }

    /// Whether it is on its way to an access point.
    pub(super) fn is_on_its_way(&self, now: Timestamp) -> bool {
        // wpa_supplicant does not report an access point that never answers.
        let joins = self.joining.is_some_and(|joining| now.since(joining.began) < PATIENCE);
        self.errand.is_some() || joins
    }

    pub(super) fn deadline(&self) -> Option<Timestamp> {
        let errand = self.errand.as_ref().map(|errand| errand.until);
        let suggestion = self.suggestion.as_ref().map(Suggestion::deadline);
        [self.life.deadline(), errand, suggestion].into_iter().flatten().min()
    }

    /// Records a step on the way to an access point.
    fn joins(&mut self, now: Timestamp, bssid: MacAddress) -> &mut Joining {
        match &mut self.joining {
            Some(joining) if joining.bssid == bssid => {}
            joining => {
                *joining = Some(Joining { bssid, began: now, shakes_hands: false });
                // Agents report at different times, but each event with its own.
                self.keys_at.take_if(|(_, since)| *since <= now);
            }
        }
        self.joining.as_mut().expect("it was set above")
    }
}

impl Manager {
    /// Makes a robot's radio scan. An event reports the end.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn scan(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), Rejected> {
        if self.running(robot)?.is_busy(now) {
            return Err(cotorra_fabric::FabricError::Busy(robot.clone()).into());
        }
        let planned = &self.plan.robots[robot];
        let (channels, stays) = (planned.network().channels.clone(), planned.is_instructed);
        self.request(Program::Supplicant(robot.clone()), Request::Scan { channels, stays });
        Ok(())
    }

    /// Returns a robot whose program runs.
    ///
    /// # Errors
    /// [`Rejected`].
    pub(super) fn running(&mut self, robot: &NodeId) -> Result<&mut RobotState, Rejected> {
        let unknown = || cotorra_fabric::FabricError::UnknownRobot(robot.clone());
        let state = self.robots.get_mut(robot).ok_or_else(unknown)?;
        if !state.life.is_running() {
            return Err(Rejected::NotRunning(Program::Supplicant(robot.clone()).to_string()));
        }
        Ok(state)
    }

    /// Returns the robot whose radio has this address.
    pub(super) fn robot_with(&self, address: MacAddress) -> Option<&NodeId> {
        self.plan.robots.iter().find(|(_, planned)| planned.address == address).map(|(robot, _)| robot)
    }

    /// Whether all robots have joined.
    pub(super) fn all_joined(&self) -> bool {
        self.robots.values().all(RobotState::is_attached)
    }

    pub(super) fn advance_robots(&mut self, now: Timestamp) {
        for robot in self.robots.keys().cloned().collect::<Vec<_>>() {
            if self.robots.get_mut(&robot).is_some_and(|state| state.life.advance(now)) {
                self.launch_supplicant(&robot);
            }
            self.end_late_errand(now, &robot);
            self.advance_suggestion(now, &robot);
        }
    }

    pub(super) fn start_supplicant(&mut self, robot: &NodeId) {
        if self.robots.get_mut(robot).is_some_and(|state| state.life.begin()) {
            self.launch_supplicant(robot);
        }
    }

    fn launch_supplicant(&mut self, robot: &NodeId) {
        let Some(planned) = self.plan.robots.get(robot) else { return };
        let configuration = Configuration::Station(Box::new(planned.station.clone()));
        self.start(Program::Supplicant(robot.clone()), configuration);
    }

    pub(super) fn supplicant_started(&mut self, now: Timestamp, robot: &NodeId) {
        if let Some(state) = self.robots.get_mut(robot) {
            state.life.started(now);
        }
    }

    pub(super) fn supplicant_ended(&mut self, now: Timestamp, robot: &NodeId, reason: &str) {
        let Some(state) = self.robots.get_mut(robot) else { return };
        let Some(until) = state.life.ended(now) else { return };
        // It begins with its network's passphrase.
        state.keys.forget();
        let was_attached = state.at.take().is_some();
        (state.joining, state.scans) = (None, false);
        if was_attached {
            self.change(Change::Disassociate { robot: robot.clone() });
        }
        self.end_errand(now, robot, "its wpa_supplicant ended");
        self.notice(now, format!("wpa_supplicant of `{robot}`: {reason}; {}", again(now, until)));
    }

    /// Records that a radio unit is off: robots there have lost it, whether they know it already or not.
    pub(super) fn robots_lose(&mut self, unit: &NodeId) {
        let there = self.robots.iter().filter(|(_, state)| state.at.as_ref() == Some(unit));
        for robot in there.map(|(robot, _)| robot.clone()).collect::<Vec<_>>() {
            if let Some(state) = self.robots.get_mut(&robot) {
                state.at = None;
            }
            self.return_key(&robot);
        }
    }

    pub(super) fn robot_event(&mut self, now: Timestamp, robot: &NodeId, event: &WifiEvent) {
        let Some(state) = self.robots.get_mut(robot).filter(|state| state.life.is_running()) else { return };
        match event {
            WifiEvent::Authenticating { bssid } => {
                // Another try begins anew.
                state.joining = None;
                state.joins(now, *bssid);
            }
            WifiEvent::Associating { bssid } | WifiEvent::Associated { bssid } => {
                state.joins(now, *bssid);
            }
            WifiEvent::AssociationHandled => {
                // After a fast transition, the robot has arrived.
                if let Some(joining) = &mut state.joining {
                    joining.shakes_hands = true;
                }
            }
            WifiEvent::Connected { bssid } => self.connected(now, robot, *bssid),
            WifiEvent::Disconnected { bssid, reason, locally } => {
                self.disconnected(now, robot, *bssid, (*reason, *locally));
            }
            WifiEvent::AuthenticationRejected { bssid, status } => {
                self.refused_by(now, robot, Some(*bssid), *status);
            }
            WifiEvent::AssociationRejected { bssid, status } => self.refused_by(now, robot, *bssid, *status),
            WifiEvent::NetworkDisabled { duration, reason, .. } => {
                state.joining = None;
                let network = &self.plan.robots[robot].network().ssid;
                let network = String::from_utf8_lossy(network.as_bytes());
                let why = match reason {
                    DisabledReason::WrongKey => format!("`{robot}` has a wrong passphrase for `{network}`"),
                    DisabledReason::AuthenticationFailed => {
                        format!("`{robot}` is not authenticated in `{network}`")
                    }
                    DisabledReason::ConnectionFailed | DisabledReason::Other => {
                        format!("`{robot}` cannot join `{network}`")
                    }
                };
                self.notice(now, format!("{why}: it tries again after {} s", duration.as_secs()));
            }
            WifiEvent::ScanStarted => state.scans = true,
            WifiEvent::ScanResults => {
                state.scans = false;
                self.change(Change::Scanned { robot: robot.clone() });
                self.request(Program::Supplicant(robot.clone()), Request::ReadHeard);
                self.go_on_after_scan(now, robot);
            }
            WifiEvent::ScanFailed => {
                state.scans = false;
                self.end_errand(now, robot, "its radio could not scan");
            }
            _ => {}
        }
    }

    fn connected(&mut self, now: Timestamp, robot: &NodeId, bssid: MacAddress) {
        let Some(state) = self.robots.get_mut(robot) else { return };
        let joining = state.joining.take().filter(|joining| joining.bssid == bssid);
        let Some(unit) = self.plan.unit_of(robot, bssid).cloned() else {
            state.at = None;
            self.change(Change::Disassociate { robot: robot.clone() });
            self.end_errand(now, robot, "it joined an access point that is none of its network");
            let who = self.stranger(bssid);
            return self
                .notice(now, format!("`{robot}` joined an access point that is none of its network: {who}"));
        };
        // A robot without a handshake has come by fast transition. The first association in a mobility domain has one.
        let fast = self.plan.units[&unit].fast_transition().is_some()
            && joining.is_some_and(|joining| !joining.shakes_hands);
        let left = state.errand.as_ref().and_then(Errand::rejoins_since);
        let began = left.or(joining.map(|joining| joining.began)).unwrap_or(now);
        if state.at.as_ref() != Some(&unit) {
            state.at = Some(unit.clone());
            let (robot, radio_unit) = (robot.clone(), unit.clone());
            self.change(Change::Associate { robot, radio_unit, began, fast });
        }
        self.arrived(now, robot, &unit);
    }

    fn disconnected(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        bssid: MacAddress,
        (reason, locally): (u16, bool),
    ) {
        let unit = self.plan.unit_of(robot, bssid).cloned();
        let Some(state) = self.robots.get_mut(robot) else { return };
        let rejoins = state.errand.as_ref().and_then(Errand::rejoins_since).is_some();
        if state.at.is_none() || state.at != unit || (locally && rejoins) {
            return;
        }
        state.at = None;
        self.change(Change::Disassociate { robot: robot.clone() });
        self.return_key(robot);
        if let (false, Some(unit)) = (locally, unit) {
            let words = words::reason(reason);
            self.notice(now, format!("`{unit}` disconnected `{robot}` for reason {reason}{words}"));
        }
    }

    fn refused_by(&mut self, now: Timestamp, robot: &NodeId, bssid: Option<MacAddress>, status: u16) {
        if let Some(state) = self.robots.get_mut(robot) {
            state.joining = None;
        }
        let who = match bssid.map(|bssid| (bssid, self.plan.unit_with(bssid))) {
            Some((_, Some(unit))) => format!("`{unit}`"),
            Some((bssid, None)) => bssid.to_string(),
            None => "an access point".to_owned(),
        };
        self.notice(now, format!("{who} refused `{robot}` with status {status}{}", words::status(status)));
    }

    /// Returns the name of an access point that is none of a robot's network, for people.
    fn stranger(&self, bssid: MacAddress) -> String {
        match self.plan.unit_with(bssid) {
            Some(unit) => {
                format!("`{unit}` of network `{}`, {bssid}", self.plan.units[unit].network_name())
            }
            None => bssid.to_string(),
        }
    }

    /// Reports access points with the SSID of a robot's network that are none of that network.
    pub(super) fn heard(&mut self, now: Timestamp, robot: &NodeId, heard: &[Heard]) {
        let Some(planned) = self.plan.robots.get(robot) else { return };
        let (ssid, network) = (planned.network().ssid.clone(), planned.network_name.clone());
        for Heard { bssid, frequency_mhz, signal_dbm, ssid: name, .. } in heard {
            let is_strange = name.as_ref() == Some(&ssid) && self.plan.unit_of(robot, *bssid).is_none();
            let stranger = (network.clone(), *bssid);
            if is_strange && self.strangers.len() < MOST_STRANGERS && self.strangers.insert(stranger) {
                let (name, who) = (String::from_utf8_lossy(ssid.as_bytes()), self.stranger(*bssid));
                self.notice(
                    now,
                    format!(
                        "`{robot}` hears an access point that calls itself `{name}` and is none of its network: {who} at \
                         {frequency_mhz} MHz with {signal_dbm} dBm"
                    ),
                );
            }
        }
    }
}
