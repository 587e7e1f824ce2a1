//! Instructions that send a robot to a radio unit: it roams there, if need be after a scan of that unit's channel. One without a
//! radio unit looks for that one only, and joins it.

use cotorra_fabric::FabricError;
use cotorra_graph::{NodeId, Timestamp};

use super::{Change, Manager, PATIENCE, Program, Refused, Rejected, Request};

/// Destination of a robot.
#[derive(Debug)]
pub(super) struct Errand {
    to: NodeId,
    /// When it is given up.
    pub(super) until: Timestamp,
    step: Step,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// It roams, or does not know the access point.
    First,
    /// It looks for the access point.
    Scanning,
    /// It roams to what it has heard.
    Second,
    /// It is at no radio unit. Until the end of the errand, it may join no other.
    Joining,
    /// It leaves its radio unit for one that takes another passphrase, and may join no other. wpa_supplicant would take a roam there
    /// for a fast transition.
    Rejoining { since: Timestamp },
}

impl Errand {
    /// Returns when it began to leave its radio unit; `None` if it only roams.
    pub(super) fn rejoins_since(&self) -> Option<Timestamp> {
        if let Step::Rejoining { since } = self.step { Some(since) } else { None }
    }
}

impl Manager {
    /// Sends a robot to a radio unit. Events report how it comes there, or why not. Does nothing if it is there.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn attach(&mut self, now: Timestamp, robot: &NodeId, unit: &NodeId) -> Result<(), Rejected> {
        self.check_takes(robot, unit)?;
        if self.robots.get(robot).is_some_and(|state| state.at.as_ref() == Some(unit) && !state.is_busy(now))
        {
            return Ok(());
        }
        let to = &self.plan.units[unit];
        let (bssid, channel) = (to.bssid, to.channel());
        let state = self.running(robot)?;
        // One without a radio unit scans again and again.
        let is_busy = if state.is_attached() { state.is_busy(now) } else { state.is_on_its_way(now) };
        if is_busy {
            return Err(FabricError::Busy(robot.clone()).into());
        }
        let step = if state.is_attached() { Step::First } else { Step::Joining };
        state.errand = Some(Errand { to: unit.clone(), until: now + PATIENCE, step });
        if step == Step::First && self.needs_other_key(robot, unit) {
            // It joins at once if it hears the unit now.
            self.look_for(robot);
        } else if step == Step::First {
            self.roam(now, robot);
        } else {
            self.take_key(robot, unit);
            let look = Request::Scan { channels: vec![channel], stays: false };
            for request in [Request::Pin { to: Some(bssid) }, look] {
                self.request(Program::Supplicant(robot.clone()), request);
            }
        }
        Ok(())
    }

    /// Checks that a radio unit serves a robot that comes.
    ///
    /// # Errors
    /// [`Rejected`].
    pub(super) fn check_takes(&self, robot: &NodeId, unit: &NodeId) -> Result<(), Rejected> {
        use FabricError::{NotServing, OtherNetwork, UnknownRadioUnit, UnknownRobot};
        let planned = self.plan.robots.get(robot).ok_or_else(|| UnknownRobot(robot.clone()))?;
        let to = self.plan.units.get(unit).ok_or_else(|| UnknownRadioUnit(unit.clone()))?;
        if planned.network_name != to.network_name() {
            return Err(OtherNetwork { robot: robot.clone(), radio_unit: unit.clone() }.into());
        }
        if !self.units.get(unit).is_some_and(|unit| unit.serves) {
            return Err(NotServing(unit.clone()).into());
        }
        self.check_key(robot, unit)
    }

    /// Takes a step of a robot's errand: it looks for the access point.
    fn look_for(&mut self, robot: &NodeId) {
        let Some(errand) = self.robots.get_mut(robot).and_then(|state| state.errand.as_mut()) else { return };
        errand.step = Step::Scanning;
        let channels = vec![self.plan.units[&errand.to].channel()];
        let request = Request::Scan { channels, stays: true };
        self.request(Program::Supplicant(robot.clone()), request);
    }

    /// Takes the next step of a robot's errand: it roams.
    fn roam(&mut self, now: Timestamp, robot: &NodeId) {
        let Some(state) = self.robots.get(robot) else { return };
        let (Some(errand), Some(at)) = (&state.errand, &state.at) else { return };
        let unit = errand.to.clone();
        let to = &self.plan.units[&unit];
        let over_ds = to.fast_transition().is_some_and(|fast| fast.over_ds);
        // Over the distribution system, nothing happens between mobility domains.
        let domain = |unit: &NodeId| self.units.get(unit).map(|state| state.access_point.mobility_domain);
        let over_ds = over_ds && domain(at) == domain(&unit);
        let bssid = to.bssid;
        let program = Program::Supplicant(robot.clone());
        if !self.needs_other_key(robot, &unit) {
            return self.request(program, Request::Roam { to: bssid, over_ds });
        }
        self.take_key(robot, &unit);
        if let Some(errand) = self.robots.get_mut(robot).and_then(|state| state.errand.as_mut()) {
            errand.step = Step::Rejoining { since: now };
        }
        for request in [Request::Pin { to: Some(bssid) }, Request::Rejoin] {
            self.request(program.clone(), request);
        }
    }

    pub(super) fn robot_refused(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        request: &Request,
        reason: Refused,
    ) {
        let Some(errand) = self.robots.get_mut(robot).and_then(|state| state.errand.as_mut()) else {
            let program = Program::Supplicant(robot.clone());
            return match reason {
                Refused::Other(reason) if matches!(request, Request::Scan { .. }) => {
                    self.notice(now, format!("`{robot}` cannot scan: {reason}"));
                }
                reason => tracing::debug!("{program} refused {request:?}: {reason:?}"),
            };
        };
        match (request, errand.step, reason) {
            // wpa_supplicant has not heard the access point lately.
            (Request::Roam { .. }, Step::First, Refused::Other(_)) => {
                self.look_for(robot);
            }
            (Request::Roam { .. }, ..) => self.end_errand(now, robot, "it does not hear it"),
            (Request::Pin { to: Some(_) }, Step::Joining | Step::Rejoining { .. }, _) => {
                self.end_errand(now, robot, "its wpa_supplicant takes no access point");
            }
            // The end of the present scan will do as well.
            (Request::Scan { .. }, Step::Scanning | Step::Joining, Refused::Other(reason)) => {
                self.end_errand(now, robot, &format!("it cannot scan: {reason}"));
            }
            _ => {}
        }
    }

    /// Goes on with an errand that waited for a scan.
    pub(super) fn go_on_after_scan(&mut self, now: Timestamp, robot: &NodeId) {
        let errand = self.robots.get_mut(robot).and_then(|state| state.errand.as_mut());
        if let Some(errand) = errand.filter(|errand| errand.step == Step::Scanning) {
            errand.step = Step::Second;
            self.roam(now, robot);
        }
    }

    /// Records that a robot joined a radio unit.
    pub(super) fn arrived(&mut self, now: Timestamp, robot: &NodeId, unit: &NodeId) {
        let Some(state) = self.robots.get_mut(robot) else { return };
        match &state.errand {
            Some(errand) if errand.to == *unit => drop(self.take_errand(robot)),
            Some(_) => self.report_errand(now, robot, &format!("it joined `{unit}` instead")),
            None => {}
        }
    }

    pub(super) fn end_late_errand(&mut self, now: Timestamp, robot: &NodeId) {
        let errand = self.robots.get(robot).and_then(|state| state.errand.as_ref());
        if errand.is_some_and(|errand| errand.until <= now) {
            self.end_errand(now, robot, &format!("it did not come there within {} s", PATIENCE.as_secs()));
        }
    }

    /// Gives an errand up, if there is one.
    pub(super) fn end_errand(&mut self, now: Timestamp, robot: &NodeId, why: &str) {
        let state = self.robots.get_mut(robot);
        let leaves = state.filter(|state| state.errand.as_ref().and_then(Errand::rejoins_since).is_some());
        // It has left its radio unit, and has not come to another.
        if leaves.and_then(|state| state.at.take()).is_some() {
            self.change(Change::Disassociate { robot: robot.clone() });
        }
        self.report_errand(now, robot, why);
    }

    /// Ends an errand, if there is one, and reports why.
    fn report_errand(&mut self, now: Timestamp, robot: &NodeId, why: &str) {
        if let Some(Errand { to, .. }) = self.take_errand(robot) {
            self.notice(now, format!("`{robot}` was not attached to `{to}`: {why}"));
        }
    }

    /// Takes an errand from a robot, which may join any radio unit then.
    fn take_errand(&mut self, robot: &NodeId) -> Option<Errand> {
        let errand = self.robots.get_mut(robot).and_then(|state| state.errand.take())?;
        if matches!(errand.step, Step::Joining | Step::Rejoining { .. }) {
            self.request(Program::Supplicant(robot.clone()), Request::Pin { to: None });
        }
        self.return_key(robot);
        Some(errand)
    }
}
