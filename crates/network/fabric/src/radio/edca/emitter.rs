//! Networks, places and antennas of all senders of a channel.

use cotorra_graph::{Dbm, Position};

use super::{Edca, Emitter, foreign::Foreign, interference::Interference};
use crate::radio::{Radio, phy::Phy};

impl Edca {
    fn source(&self, source: usize) -> &Interference {
        &self.interference[source]
    }
}

impl Radio {
    /// Returns a source of interference.
    fn source(&self, source: usize) -> &Interference {
        self.edca.as_ref().expect("interference comes with contention").source(source)
    }

    fn foreign(&self, radio: usize) -> &Foreign {
        &self.edca.as_ref().expect("antennas are lent with contention").foreign[radio]
    }

    /// Returns whose antenna an emitter has: its own, unless it is lent.
    pub(super) fn place_of(&self, emitter: Emitter) -> Emitter {
        match emitter {
            Emitter::Foreign(radio) => self.foreign(radio).place,
            Emitter::Robot(_) | Emitter::Unit(_) | Emitter::Interference(_) => emitter,
        }
    }

    /// Returns the network that an emitter belongs to, or whose channels it disturbs.
    pub(in crate::radio) fn network_of(&self, emitter: Emitter) -> usize {
        match emitter {
            Emitter::Robot(robot) => self.robots[robot].network,
            Emitter::Unit(unit) => self.units[unit].network,
            Emitter::Interference(source) => self.source(source).network(),
            Emitter::Foreign(_) => self.network_of(self.place_of(emitter)),
        }
    }

    pub(super) fn phy_of(&self, emitter: Emitter) -> &'static Phy {
        self.networks[self.network_of(emitter)].phy
    }

    /// Whether an emitter aggregates frames.
    pub(super) fn aggregates(&self, emitter: Emitter) -> bool {
        self.networks[self.network_of(emitter)].spec.access.edca().is_some_and(|edca| edca.aggregation)
    }

    /// Whether stations recognise an emitter's frames, and wait for them even if they are weak.
    pub(super) fn is_wifi(&self, emitter: Emitter) -> bool {
        match emitter {
            Emitter::Robot(_) | Emitter::Unit(_) | Emitter::Foreign(_) => true,
            Emitter::Interference(source) => self.source(source).is_wifi(),
        }
    }

    /// Returns an emitter's power and place.
    pub(super) fn antenna(&self, emitter: Emitter) -> (Dbm, Position) {
        match emitter {
            Emitter::Robot(robot) => (self.robots[robot].tx_power, self.robots[robot].position),
            Emitter::Unit(unit) => (self.units[unit].tx_power, self.units[unit].position),
            Emitter::Interference(source) => (self.source(source).tx_power(), self.source(source).position()),
            Emitter::Foreign(_) => self.antenna(self.place_of(emitter)),
        }
    }

    /// Returns the centre of an emitter's channel. A robot sends on that of its radio unit.
    pub(super) fn frequency_mhz(&self, emitter: Emitter) -> u16 {
        match emitter {
            Emitter::Robot(robot) => self.robots[robot].home.map_or(0, |unit| self.units[unit].frequency_mhz),
            Emitter::Unit(unit) => self.units[unit].frequency_mhz,
            Emitter::Interference(source) => self.source(source).frequency_mhz(),
            Emitter::Foreign(radio) => self.foreign(radio).frequency_mhz(),
        }
    }
}
