//! Robots whose radios are with a radio unit of another core. Here they are silent: they hear no beacons and send no frames
//! until they attach to a radio unit of this graph.

use cotorra_graph::{Dbm, NodeId, Timestamp};

use super::{Radio, station::Purpose};
use crate::settings::FabricError;

impl Radio {
    /// Records that a robot went to a radio unit elsewhere, of that mobility domain. Its queued frames are lost.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::Busy`] while it scans or changes its radio unit.
    pub(crate) fn depart(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        mobility_domain: u16,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        if self.robots[index].station.is_busy() {
            return Err(FabricError::Busy(robot.clone()));
        }
        self.check_not_lent(robot)?;
        self.vacate(index, now);
        self.robots[index].elsewhere = Some(mobility_domain);
        Ok(())
    }

    /// Records that a robot lost its radio unit elsewhere. It scans for one of this graph.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::NotElsewhere`].
    pub(crate) fn come_back(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        let radio = &mut self.robots[index];
        if radio.station.is_busy() || radio.elsewhere.take().is_none() {
            return Err(FabricError::NotElsewhere(robot.clone()));
        }
        self.begin_scan(index, now, Purpose::Roam).map_err(|_| FabricError::Busy(robot.clone()))
    }

    /// Returns the signal of a radio unit at a robot; `None` if it is off, or out of reach.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::UnknownRadioUnit`].
    pub(crate) fn reach(&self, robot: &NodeId, unit: &NodeId) -> Result<Option<Dbm>, FabricError> {
        Ok(self.hears(self.robot(robot)?, self.unit(unit)?))
    }
}
