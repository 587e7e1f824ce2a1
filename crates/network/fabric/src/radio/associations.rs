//! Associations of radios that are not the fabric's. Their own software decides and reports them; here they count as
//! attachments do: in φ, ι and events.

use cotorra_graph::{Event, Handover, NodeId, Timestamp};

use super::{Radio, RadioUnitIndex};
use crate::settings::FabricError;

/// A robot's way to a radio unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Association {
    /// When it could not send or receive data any more: the beginning of the gap.
    pub began: Timestamp,
    /// Whether it came by fast transition (IEEE 802.11r).
    pub fast: bool,
}

impl Radio {
    /// Records that a robot whose antenna is lent is associated with a radio unit whose antenna is lent, too. Does nothing if
    /// it is already.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`], [`FabricError::UnknownRadioUnit`], [`FabricError::OtherNetwork`];
    /// [`FabricError::NotLent`].
    pub(crate) fn associate_lent(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        unit: &NodeId,
        Association { began, fast }: Association,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let (index, to) = (self.robot(robot)?, self.unit(unit)?);
        self.check_lent(robot)?;
        self.check_lent(unit)?;
        if self.robots[index].network != self.units[to].network {
            return Err(FabricError::OtherNetwork { robot: robot.clone(), radio_unit: unit.clone() });
        }
        let from = self.robots[index].station.attached();
        if from == Some(to) {
            return Ok(());
        }
        if let Some(from) = from {
            self.units[from].stations.retain(|other| *other != index);
        }
        self.robots[index].station.begin_attached(to);
        let stations = &mut self.units[to].stations;
        let place = stations.partition_point(|other| *other < index);
        stations.insert(place, index);
        let handover = Handover {
            robot: robot.clone(),
            from: from.map(|from| self.units[from].id.clone()),
            to: unit.clone(),
            fast,
            gap: now.since(began),
        };
        self.emit(now, Event::Handover(handover));
        Ok(())
    }

    /// Records that a robot whose antenna is lent has lost its radio unit. Does nothing if it has none.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::NotLent`].
    pub(crate) fn disassociate_lent(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        self.check_lent(robot)?;
        if let Some(unit) = self.robots[index].station.detach() {
            self.units[unit].stations.retain(|other| *other != index);
            let from = self.units[unit].id.clone();
            self.emit(now, Event::Detached { robot: robot.clone(), from });
        }
        Ok(())
    }

    /// Records that the radio of a robot whose antenna is lent has scanned.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::NotLent`].
    pub(crate) fn scanned_lent(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        self.check_lent(robot)?;
        self.listen(index, now);
        self.emit(now, Event::Scanned { robot: robot.clone() });
        Ok(())
    }

    /// Makes all stations of a radio unit lose it.
    pub(super) fn desert(&mut self, now: Timestamp, unit: RadioUnitIndex) {
        for robot in self.units[unit].stations.clone() {
            if self.is_lent(robot) {
                let robot = self.robots[robot].id.clone();
                self.disassociate_lent(now, &robot).expect("a robot whose antenna is lent");
            } else if self.robots[robot].station.on_channel() == Some(unit) {
                self.lose_unit(robot, unit, now);
            }
        }
    }
}
