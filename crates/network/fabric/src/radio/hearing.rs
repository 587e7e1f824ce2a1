//! Signals at both ends of a robot's link to a radio unit, and the radio units that a robot has heard.

use cotorra_graph::{Dbm, Direction, LinkId, Timestamp};
use cotorra_numbers::Draws;

use super::{
    Network, Path, Radio, RadioUnitIndex, RobotRadio, StationIndex, fading::Moment, phy::Reception,
    shadowing::ShadowingField,
};

/// A signal that a robot received.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heard {
    pub(super) signal: Dbm,
    pub(super) at: Timestamp,
}

impl Radio {
    /// Returns the received power at the radio unit and at the robot: transmitted power less the losses by distance, walls
    /// and shadowing, which are equal in both directions. Stations decide by it, and reports have it. Single frames also see
    /// fading, whose mean is 0 dB of power.
    pub(super) fn signals(&self, robot: StationIndex, unit: RadioUnitIndex) -> [Dbm; 2] {
        let (r, u) = (&self.robots[robot], &self.units[unit]);
        let spec = &self.networks[r.network].spec;
        let field = self.fields[self.pair(robot, unit)].get_or_init(|| {
            let label = format!("shadowing {}", LinkId::wireless(&r.id, &u.id));
            ShadowingField::new(spec.shadowing, Draws::new(self.seed, &label))
        });
        let path_loss = spec.path_loss.loss_db(r.position.distance(u.position), u.frequency_mhz);
        let loss = path_loss + field.at(r.position) + spec.wall_loss_db(r.position, u.position);
        [Dbm(r.tx_power.0 - loss), Dbm(u.tx_power.0 - loss)]
    }

    /// Returns the receptions at the radio unit and at the robot, with fading by so many dB.
    pub(super) fn receptions(
        &self,
        robot: StationIndex,
        unit: RadioUnitIndex,
        fading_db: f64,
    ) -> [Reception; 2] {
        let Network { spec, phy, .. } = &self.networks[self.units[unit].network];
        self.signals(robot, unit).map(|signal| Reception::new(phy, signal.0 + fading_db - spec.noise().0))
    }

    /// Returns the receptions of a frame at the radio unit and at the robot now, with fading if the network has any.
    pub(super) fn receptions_at(
        &mut self,
        now: Timestamp,
        robot: StationIndex,
        unit: RadioUnitIndex,
    ) -> [Reception; 2] {
        let fading_db = self.fading_now(now, robot, unit);
        self.receptions(robot, unit, fading_db)
    }

    /// Returns the fading of a frame that is sent now, dB; 0 without fading.
    pub(super) fn fading_now(&mut self, now: Timestamp, robot: StationIndex, unit: RadioUnitIndex) -> f64 {
        if self.networks[self.units[unit].network].spec.fading.is_none() {
            return 0.0;
        }
        let place = self.robots[robot].position;
        let moment = self.link(robot, unit).moment(now, place);
        self.fading_db(Path { robot, unit, direction: Direction::Backward }, moment)
    }

    /// Returns the fading of frames on a path in a moment, dB; 0 without fading. It is the same in both directions.
    pub(super) fn fading_db(&mut self, path: Path, moment: Moment) -> f64 {
        let distance_m = moment.place.distance(self.units[path.unit].position);
        self.link(path.robot, path.unit).fading_db(moment, distance_m)
    }

    /// Returns the signal of a radio unit at a robot; `None` if it is off, or either cannot receive the other.
    pub(super) fn hears(&self, robot: StationIndex, unit: RadioUnitIndex) -> Option<Dbm> {
        self.units[unit].serves.as_ref()?;
        let sensitivity = self.networks[self.units[unit].network].sensitivity;
        let [up, down] = self.signals(robot, unit);
        (up >= sensitivity && down >= sensitivity).then_some(down)
    }

    /// Records the signals of all radio units of a robot's network.
    pub(super) fn listen(&mut self, robot: StationIndex, at: Timestamp) {
        let mut heard = std::mem::take(&mut self.robots[robot].heard);
        let units = &self.networks[self.robots[robot].network].units;
        heard.clear();
        heard.extend(units.iter().map(|unit| Some(Heard { signal: self.hears(robot, *unit)?, at })));
        self.robots[robot].heard = heard;
    }

    /// Forgets all signals: no scan has been made.
    pub(super) fn forget(&mut self, robot: StationIndex) {
        self.robots[robot].heard.fill(None);
    }

    /// Records the signal of the radio unit that a robot is attached to, before the robot leaves its channel.
    pub(super) fn part(&mut self, robot: StationIndex, at: Timestamp) {
        let Some(unit) = self.robots[robot].station.attached() else { return };
        let [_, signal] = self.signals(robot, unit);
        let units = &self.networks[self.robots[robot].network].units;
        if let Some(place) = units.iter().position(|its| *its == unit) {
            self.robots[robot].heard[place] = Some(Heard { signal, at });
        }
    }

    /// Returns the radio units that a robot heard last, with their signals.
    fn heard(&self, robot: StationIndex) -> impl Iterator<Item = (RadioUnitIndex, Dbm)> {
        let RobotRadio { network, heard, .. } = &self.robots[robot];
        self.networks[*network]
            .units
            .iter()
            .zip(heard)
            .filter_map(|(unit, heard)| Some((*unit, heard.as_ref()?.signal)))
    }

    /// Returns the radio units that a robot heard last and may attach to, with their signals.
    pub(super) fn joinable(&self, robot: StationIndex) -> impl Iterator<Item = (RadioUnitIndex, Dbm)> {
        self.heard(robot).filter(move |(unit, _)| self.admits(robot, *unit))
    }

    /// Returns the strongest radio unit that a robot heard last and may attach to; of equals, the first.
    pub(super) fn strongest(&self, robot: StationIndex) -> Option<RadioUnitIndex> {
        let stronger = |best: (RadioUnitIndex, Dbm), next: (RadioUnitIndex, Dbm)| {
            if next.1 > best.1 { next } else { best }
        };
        self.joinable(robot).reduce(stronger).map(|(unit, _)| unit)
    }
}
