//! Keys of single radio units, which a robot uses in place of its network's passphrase while it is there.

use std::collections::BTreeMap;

use cotorra_fabric::FabricError;
use cotorra_graph::{self as graph, FtKey, NodeId};
use cotorra_wifi::Passphrase;

use super::{Manager, Program, Rejected, Request};

/// A robot's keys.
#[derive(Debug, Default)]
pub(super) struct Keys {
    /// The settings with which it may attach to radio units.
    of_units: BTreeMap<NodeId, graph::AccessPoint>,
    /// The radio unit whose key it uses; `None` for its network's passphrase.
    in_use: Option<NodeId>,
}

impl Keys {
    /// Records that its program has begun anew, with its network's passphrase.
    pub(super) fn forget(&mut self) {
        self.in_use = None;
    }
}

impl Manager {
    /// Gives a robot the settings and the key of a radio unit. Without a key, takes them back.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn provision(
        &mut self,
        robot: &NodeId,
        unit: &NodeId,
        access_point: graph::AccessPoint,
    ) -> Result<(), Rejected> {
        let state = self.robots.get_mut(robot).ok_or_else(|| FabricError::UnknownRobot(robot.clone()))?;
        if !self.units.contains_key(unit) {
            return Err(FabricError::UnknownRadioUnit(unit.clone()).into());
        }
        if access_point.key.is_some() {
            state.keys.of_units.insert(unit.clone(), access_point);
        } else {
            state.keys.of_units.remove(unit);
        }
        Ok(())
    }

    /// Checks that a robot has the key of a radio unit, if that has one of its own.
    pub(super) fn check_key(&self, robot: &NodeId, unit: &NodeId) -> Result<(), Rejected> {
        let served = self.units.get(unit).map(|state| &state.access_point);
        let Some(served) = served.filter(|served| served.key.is_some()) else { return Ok(()) };
        let own = self.robots.get(robot).and_then(|state| state.keys.of_units.get(unit));
        if own != Some(served) {
            let (robot, radio_unit) = (robot.clone(), unit.clone());
            return Err(FabricError::NotAdmitted { robot, radio_unit }.into());
        }
        Ok(())
    }

    /// Whether a radio unit takes another passphrase than the one that a robot uses.
    pub(super) fn needs_other_key(&self, robot: &NodeId, unit: &NodeId) -> bool {
        let in_use = self.robots.get(robot).and_then(|state| state.keys.in_use.as_ref());
        in_use != self.key_of(unit).map(|_| unit)
    }

    /// Makes a robot use what a radio unit takes: its own key, or else the passphrase of the robot's network.
    pub(super) fn take_key(&mut self, robot: &NodeId, unit: &NodeId) {
        if self.needs_other_key(robot, unit) {
            let key = self.key_of(unit).map(|key| (unit.clone(), Passphrase::of_key(&key.0)));
            self.use_key(robot, key);
        }
    }

    /// Makes a robot use its network's passphrase again, unless it is where it uses another key, or on the way.
    pub(super) fn return_key(&mut self, robot: &NodeId) {
        let Some(state) = self.robots.get(robot) else { return };
        let is_there = state.keys.in_use == state.at;
        if state.keys.in_use.is_some() && state.errand.is_none() && !is_there {
            self.use_key(robot, None);
        }
    }

    fn use_key(&mut self, robot: &NodeId, key: Option<(NodeId, Passphrase)>) {
        let (Some(planned), Some(state)) = (self.plan.robots.get(robot), self.robots.get_mut(robot)) else {
            return;
        };
        let (in_use, passphrase) = match key {
            Some((unit, passphrase)) => (Some(unit), Some(passphrase)),
            None => (None, planned.passphrase().cloned()),
        };
        let Some(passphrase) = passphrase else { return };
        state.keys.in_use = in_use;
        let ssid = planned.network().ssid.clone();
        self.request(Program::Supplicant(robot.clone()), Request::SetPassphrase { ssid, passphrase });
    }

    fn key_of(&self, unit: &NodeId) -> Option<&FtKey> {
        self.units.get(unit)?.access_point.key.as_ref()
    }
}
