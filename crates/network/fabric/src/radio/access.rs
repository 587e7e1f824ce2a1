//! Virtual access points. A radio unit is off until a vAP is deployed on it. It admits the robots of its own domain, or,
//! with a key, those that have the key.

use cotorra_graph::{AccessPoint, NodeId, Timestamp};

use super::{Radio, RadioUnitIndex, RobotRadio, StationIndex};
use crate::settings::FabricError;

impl Radio {
    /// Switches on a vAP on a radio unit.
    ///
    /// # Errors
    /// [`FabricError::UnknownRadioUnit`], [`FabricError::Serving`] or [`FabricError::OtherSsid`].
    pub(crate) fn switch_on(
        &mut self,
        now: Timestamp,
        unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.unit(unit)?;
        self.check_deployment(index, &access_point)?;
        self.units[index].serves = Some(access_point);
        Ok(())
    }

    /// Checks whether a vAP could be deployed on a radio unit.
    ///
    /// # Errors
    /// Those of [`Self::switch_on`].
    pub(crate) fn check_switch_on(
        &self,
        unit: &NodeId,
        access_point: &AccessPoint,
    ) -> Result<(), FabricError> {
        self.check_deployment(self.unit(unit)?, access_point)
    }

    /// Switches off a radio unit. Stations on its channel lose it now, others when they come back.
    ///
    /// # Errors
    /// [`FabricError::UnknownRadioUnit`] or [`FabricError::NotServing`].
    pub(crate) fn switch_off(&mut self, now: Timestamp, unit: &NodeId) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.unit(unit)?;
        if self.units[index].serves.take().is_none() {
            return Err(FabricError::NotServing(unit.clone()));
        }
        self.desert(now, index);
        Ok(())
    }

    /// Gives a robot the credentials of a radio unit's vAP. They are not checked here.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`] or [`FabricError::UnknownRadioUnit`].
    pub(crate) fn provision(
        &mut self,
        robot: &NodeId,
        unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), FabricError> {
        let (robot, unit) = (self.robot(robot)?, self.unit(unit)?);
        self.robots[robot].access.insert(unit, access_point);
        Ok(())
    }

    /// Whether a radio unit is on and a robot may attach to it.
    pub(super) fn admits(&self, robot: StationIndex, unit: RadioUnitIndex) -> bool {
        let (robot, radio_unit) = (&self.robots[robot], &self.units[unit]);
        let Some(served) = &radio_unit.serves else { return false };
        if self.check_lent(&radio_unit.id).is_ok() {
            return false;
        }
        match &served.key {
            None => robot.domain == radio_unit.domain,
            Some(_) => robot.access.get(&unit) == Some(served),
        }
    }

    pub(super) fn check_access(&self, robot: StationIndex, unit: RadioUnitIndex) -> Result<(), FabricError> {
        let radio_unit = self.units[unit].id.clone();
        if self.units[unit].serves.is_none() {
            return Err(FabricError::NotServing(radio_unit));
        }
        if !self.admits(robot, unit) {
            return Err(FabricError::NotAdmitted { robot: self.robots[robot].id.clone(), radio_unit });
        }
        Ok(())
    }

    /// Whether a robot's former radio unit, here or elsewhere, and another are in one mobility domain.
    pub(super) fn is_one_mobility_domain(&self, robot: StationIndex, to: Option<RadioUnitIndex>) -> bool {
        let domain = |unit: RadioUnitIndex| {
            let network = &self.networks[self.units[unit].network].spec;
            let serves = self.units[unit].serves.as_ref();
            serves.map_or(network.mobility_domain, |served| served.mobility_domain)
        };
        let RobotRadio { station, elsewhere, .. } = &self.robots[robot];
        let from = station.attached().map(domain).or(*elsewhere);
        from.is_some() && from == to.map(domain)
    }

    fn check_deployment(&self, unit: RadioUnitIndex, access_point: &AccessPoint) -> Result<(), FabricError> {
        let radio_unit = &self.units[unit];
        let network = &self.networks[radio_unit.network].ssid;
        if radio_unit.serves.is_some() {
            return Err(FabricError::Serving(radio_unit.id.clone()));
        }
        if access_point.ssid != *network {
            return Err(FabricError::OtherSsid {
                radio_unit: radio_unit.id.clone(),
                network: network.clone(),
                asked: access_point.ssid.clone(),
            });
        }
        Ok(())
    }

    pub(super) fn unit(&self, id: &NodeId) -> Result<RadioUnitIndex, FabricError> {
        self.unit_by_name.get(id).copied().ok_or_else(|| FabricError::UnknownRadioUnit(id.clone()))
    }
}
